//! From features and rough poses to an accurate map, through the operators.

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{
    AdjustedPose, Features, GraphPose, Keyframe, Landmark, Track, TrackPoint,
};
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, Stamp};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::json;

use crate::yields;

const K: [f64; 9] = [127.0, 0.0, 199.5, 0.0, 127.0, 149.5, 0.0, 0.0, 1.0];

/// A camera that looks to the left of a vehicle that drives along x, at marks on a wall.
struct Drive {
    truth: Vec<Pose>,
    features: Vec<Features>,
    tracks: Vec<Track>,
}

fn left() -> Pose {
    // Optical z along the vehicle's y, x along its x, y down.
    let rotation = UnitQuaternion::from_euler_angles(-std::f64::consts::FRAC_PI_2, 0.0, 0.0);
    Pose::new(Vector3::new(1.0, 0.5, 1.0), rotation)
}

fn camera() -> Camera {
    Camera::from_calibration("equidistant", 400, 300, &K, &[0.0; 4]).unwrap()
}

/// Fixed numbers that look random, in [0, 1).
fn chance(at: usize, salt: usize) -> f64 {
    let mixed = (at as u64)
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add((salt as u64).wrapping_mul(1_442_695_040_888_963_407))
        .wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 31)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (mixed >> 40) as f64 / f64::from(1 << 24)
}

fn marks() -> Vec<Vector3<f64>> {
    (0..260)
        .map(|at| {
            let depth = if at % 3 == 0 { 3.0 } else { 5.0 };
            Vector3::new(
                -4.0 + 16.0 * chance(at, 1),
                depth + chance(at, 2),
                2.5 * chance(at, 3),
            )
        })
        .collect()
}

fn descriptor(mark: usize) -> impl Iterator<Item = u8> {
    (0..64).map(move |byte| (256.0 * chance(mark, 100 + byte)) as u8)
}

fn pose_row(pose: &Pose) -> evermap_schemas::Pose {
    evermap_schemas::Pose::from_array(pose.to_array())
}

fn drive() -> Drive {
    let truth: Vec<Pose> = (0..20)
        .map(|at| Pose::from_yaw(0.4 * f64::from(at), 0.1 * f64::from(at).sin(), 0.02))
        .collect();
    let (camera, marks) = (camera(), marks());
    let mut seen: Vec<Vec<TrackPoint>> = vec![Vec::new(); marks.len()];
    let mut features = Vec::new();
    for (keyframe, pose) in truth.iter().enumerate() {
        let camera_from_map = pose.compose(&left()).inverse();
        let mut row = Features {
            site: "lot".into(),
            session: "a".into(),
            stamp: Stamp(keyframe as i64),
            keyframe: keyframe as u32,
            camera: "left".into(),
            width: 400,
            height: 300,
            u: Vec::new(),
            v: Vec::new(),
            size_px: Vec::new(),
            descriptors: Bytes(Vec::new()),
        };
        for (mark, point) in marks.iter().enumerate() {
            let pixel = camera.project(&camera_from_map.transform(point));
            let Some([u, v]) = pixel.filter(|pixel| camera.contains(*pixel)) else {
                continue;
            };
            seen[mark].push(TrackPoint {
                keyframe: keyframe as u32,
                feature: row.u.len() as u32,
            });
            row.u
                .push((u + 0.3 * (chance(mark, 7 + keyframe) - 0.5)) as f32);
            row.v
                .push((v + 0.3 * (chance(mark, 70 + keyframe) - 0.5)) as f32);
            row.size_px.push(12.0);
            row.descriptors.0.extend(descriptor(mark));
        }
        features.push(row);
    }
    // Every mark is lost once on the way, so that there are two tracks of it.
    let parts = seen.into_iter().flat_map(|points| {
        let (before, after) = points.split_at(points.len() / 2);
        [before.to_vec(), after.to_vec()]
    });
    let tracks = parts.filter(|points| points.len() > 1).zip(0..);
    let tracks = tracks.map(|(points, track)| Track {
        site: "lot".into(),
        session: "a".into(),
        camera: "left".into(),
        track,
        points,
    });
    Drive {
        tracks: tracks.collect(),
        truth,
        features,
    }
}

fn keyframes(drive: &Drive) -> Vec<Keyframe> {
    let row = |(keyframe, pose): (usize, &Pose)| Keyframe {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(keyframe as i64),
        keyframe: keyframe as u32,
        distance_m: 0.0,
        stretch: 0,
        odom_from_vehicle: pose_row(pose),
        images: Vec::new(),
    };
    drive.truth.iter().enumerate().map(row).collect()
}

/// Off by some centimetres, but for the first.
fn graph_poses(drive: &Drive) -> Vec<GraphPose> {
    let row = |(keyframe, pose): (usize, &Pose)| {
        let off = 0.05 * (keyframe as f64 * 0.7).sin();
        GraphPose {
            site: "lot".into(),
            session: "a".into(),
            stamp: Stamp(keyframe as i64),
            keyframe: keyframe as u32,
            map_from_vehicle: pose_row(&pose.compose(&Pose::from_yaw(off, -off, 0.1 * off))),
            loops: Vec::new(),
            optimality: "optimal".into(),
        }
    };
    drive.truth.iter().enumerate().map(row).collect()
}

fn calibration() -> Vec<Calibration> {
    vec![Calibration {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(0),
        camera: "left".into(),
        width: 400,
        height: 300,
        model: "equidistant".into(),
        intrinsics: K.to_vec(),
        distortion: vec![0.0; 4],
    }]
}

fn transforms() -> Vec<Transform> {
    vec![Transform {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(0),
        parent: "base_link".into(),
        child: "left".into(),
        parent_from_child: pose_row(&left()),
        fixed: true,
    }]
}

fn adjusted(drive: &Drive, previous: Vec<AdjustedPose>) -> Vec<AdjustedPose> {
    let mut inputs = vec![
        inputs_of("poses", graph_poses(drive)).unwrap(),
        inputs_of("keyframes", keyframes(drive)).unwrap(),
        inputs_of("features", drive.features.clone()).unwrap(),
        inputs_of("tracks", drive.tracks.clone()).unwrap(),
        inputs_of("calibration", calibration()).unwrap(),
        inputs_of("transforms", transforms()).unwrap(),
    ];
    if !previous.is_empty() {
        inputs.push(inputs_of("previous", previous).unwrap());
    }
    let (rows, losses) = yields("bundle_adjustment", json!({}), inputs);
    assert!(losses.is_empty(), "{losses:?}");
    rows
}

fn farthest_m(rows: &[AdjustedPose], drive: &Drive) -> f64 {
    let off = |(row, truth): (&AdjustedPose, &Pose)| {
        let pose = &row.map_from_vehicle;
        (Vector3::new(pose.x, pose.y, pose.z) - truth.translation).norm()
    };
    rows.iter().zip(&drive.truth).map(off).fold(0.0, f64::max)
}

#[test]
fn rough_poses_become_exact_and_stay_where_they_are() {
    let drive = drive();
    let first = adjusted(&drive, Vec::new());
    assert_eq!(first.len(), drive.truth.len());
    assert!(
        farthest_m(&first, &drive) < 0.01,
        "{}",
        farthest_m(&first, &drive)
    );
    assert_eq!(first[0].map_from_vehicle, pose_row(&drive.truth[0]));
    let numbers = |rows: &[AdjustedPose]| {
        let seen = rows.iter().flat_map(|row| &row.observations);
        seen.map(|seen| seen.landmark)
            .collect::<std::collections::BTreeSet<u32>>()
    };
    // The two tracks of a mark are one landmark.
    assert!(numbers(&first).len() <= marks().len());
    // The version after starts from this one: nothing new, so nothing moves, and landmarks keep their numbers.
    let again = adjusted(&drive, first.clone());
    assert_eq!(again[0].map_from_vehicle, first[0].map_from_vehicle);
    assert!(farthest_m(&again, &drive) < 0.01);
    let (before, after) = (numbers(&first), numbers(&again));
    assert!(after.intersection(&before).count() * 10 >= 9 * before.len());
    let inputs = [
        inputs_of("poses", first).unwrap(),
        inputs_of("features", drive.features).unwrap(),
        inputs_of("calibration", calibration()).unwrap(),
        inputs_of("transforms", transforms()).unwrap(),
    ];
    let (landmarks, losses) = yields::<Landmark>("landmarks", json!({}), inputs);
    assert!(losses.is_empty(), "{losses:?}");
    assert_eq!(landmarks.len(), before.len());
    for landmark in &landmarks {
        let place = Vector3::new(landmark.x, landmark.y, landmark.z);
        let nearest = marks()
            .iter()
            .map(|mark| (mark - place).norm())
            .fold(f64::INFINITY, f64::min);
        assert!(nearest < 0.1, "{landmark:?}");
        assert!(landmark.near_m <= landmark.far_m && landmark.view_cos <= 1.0);
        assert!(landmark.descriptors.0.len() % 64 == 0 && !landmark.descriptors.0.is_empty());
    }
}
