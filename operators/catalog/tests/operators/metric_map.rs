//! From features and rough poses to an accurate map, through the operators.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{
    AdjustedPose, AntennaPosition, Features, GraphPose, Keyframe, Landmark, Localisation,
    LoopClosure, MapFrame, Track, TrackPoint, VehiclePose,
};
use evermap_schemas::roles::{Calibration, GnssFix, Transform};
use evermap_schemas::{Bytes, Stamp};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::json;

use crate::yields;

const K: [f64; 9] = [127.0, 0.0, 199.5, 0.0, 127.0, 149.5, 0.0, 0.0, 1.0];

/// A camera that looks to the left of a vehicle that drives along x, at marks on a wall.
struct Drive {
    session: String,
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

/// Of the same way, in the same noise, past the same marks; `off_m` to the side.
fn drive(session: &str, off_m: f64) -> Drive {
    let truth: Vec<Pose> = (0..20)
        .map(|at| Pose::from_yaw(0.4 * f64::from(at), 0.1 * f64::from(at).sin() + off_m, 0.02))
        .collect();
    let (camera, marks) = (camera(), marks());
    let mut seen: Vec<Vec<TrackPoint>> = vec![Vec::new(); marks.len()];
    let mut features = Vec::new();
    for (keyframe, pose) in truth.iter().enumerate() {
        let camera_from_map = pose.compose(&left()).inverse();
        let mut row = Features {
            site: "lot".into(),
            session: session.into(),
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
        session: session.into(),
        camera: "left".into(),
        track,
        points,
    });
    Drive {
        session: session.to_owned(),
        tracks: tracks.collect(),
        truth,
        features,
    }
}

fn keyframes(drive: &Drive) -> Vec<Keyframe> {
    let session = drive.session.as_str();
    let row = |(keyframe, pose): (usize, &Pose)| Keyframe {
        site: "lot".into(),
        session: session.into(),
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
fn graph_poses(drive: &Drive) -> Vec<VehiclePose> {
    let row = |(keyframe, pose): (usize, &Pose)| {
        let off = 0.05 * (keyframe as f64 * 0.7).sin();
        VehiclePose {
            site: "lot".into(),
            session: drive.session.clone(),
            stamp: Stamp(keyframe as i64),
            map_from_vehicle: pose_row(&pose.compose(&Pose::from_yaw(off, -off, 0.1 * off))),
        }
    };
    drive.truth.iter().enumerate().map(row).collect()
}

fn calibration() -> Vec<Calibration> {
    let of = |session: &str| Calibration {
        site: "lot".into(),
        session: session.into(),
        stamp: Stamp(0),
        camera: "left".into(),
        width: 400,
        height: 300,
        model: "equidistant".into(),
        intrinsics: K.to_vec(),
        distortion: vec![0.0; 4],
        mount: None,
    };
    vec![of("a"), of("b")]
}

fn transforms() -> Vec<Transform> {
    let of = |session: &str| Transform {
        site: "lot".into(),
        session: session.into(),
        stamp: Stamp(0),
        parent: "base_link".into(),
        child: "left".into(),
        parent_from_child: pose_row(&left()),
        fixed: true,
    };
    vec![of("a"), of("b")]
}

#[test]
fn sessions_that_nothing_connects_are_named_as_far_as_they_are_few() {
    let of = |number: u32| Keyframe {
        site: "lot".into(),
        session: format!("s{number:02}"),
        stamp: Stamp(i64::from(number)),
        keyframe: 0,
        distance_m: 0.0,
        stretch: 0,
        odom_from_vehicle: pose_row(&Pose::identity()),
        images: vec![],
    };
    let told = |sessions: u32| {
        let keyframes: Vec<Keyframe> = (0..sessions).map(of).collect();
        let inputs = [
            inputs_of("keyframes", keyframes).unwrap(),
            inputs_of::<LoopClosure>("loop_closures", vec![]).unwrap(),
            inputs_of::<Localisation>("localisations", vec![]).unwrap(),
            inputs_of::<VehiclePose>("previous", vec![]).unwrap(),
        ];
        let (rows, losses) = yields::<GraphPose>("pose_graph", json!({}), inputs);
        assert_eq!(rows.len(), 1);
        losses
    };
    let named = "keyframe of session s01, which nothing sure connects with the map".to_owned();
    assert_eq!(told(2).0, BTreeMap::from([(named.clone(), 1)]));
    let many = told(40).0;
    assert_eq!((many.len(), many[&named]), (17, 1));
    let rest = "keyframe of a session that nothing sure connects with the map";
    assert_eq!(many[rest], 39 - 16);
}

#[test]
fn a_camera_whose_calibration_changes_within_a_session_is_counted_once() {
    let drive = drive("a", 0.0);
    let lost = |focal: f64, from: i64| {
        let first = calibration().remove(0);
        let mut later = first.clone();
        later.stamp = Stamp(from);
        for entry in [0, 4] {
            later.intrinsics[entry] *= focal;
        }
        let mut last = later.clone();
        last.stamp = Stamp(from + 1);
        let inputs = [
            inputs_of("features", drive.features.clone()).unwrap(),
            inputs_of("keyframes", keyframes(&drive)).unwrap(),
            inputs_of("calibration", vec![first, later, last]).unwrap(),
            inputs_of("transforms", transforms()).unwrap(),
        ];
        yields::<Track>("tracks", json!({}), inputs).1.0
    };
    let reason = "calibration of camera `left` changes within a session; the first is used";
    assert_eq!(lost(1.3, 10), BTreeMap::from([(reason.to_owned(), 1)]));
    // No lens, but another one than the first.
    assert_eq!(lost(0.0, 10), BTreeMap::from([(reason.to_owned(), 1)]));
    // The same, nearly the same, and one that holds for no image.
    for (focal, from) in [(1.0, 10), (1.00001, 10), (1.3, 100)] {
        let lost = lost(focal, from);
        assert!(lost.is_empty(), "{focal} from {from}: {lost:?}");
    }
}

#[test]
fn fixes_none_of_which_are_of_the_time_of_their_drive_are_counted() {
    let fix = |stamp: i64| GnssFix {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(stamp),
        topic: "/fix".into(),
        frame: "left".into(),
        latitude_deg: 52.25,
        longitude_deg: 10.5,
        height_m: None,
        horizontal_sd_m: None,
        vertical_sd_m: None,
    };
    // Keyframes are from 0 to 19.
    let hung = |keyframes: Vec<Keyframe>, stamps: &[i64]| {
        let inputs = [
            inputs_of("keyframes", keyframes).unwrap(),
            inputs_of("gnss_fixes", stamps.iter().copied().map(fix).collect()).unwrap(),
            inputs_of("transforms", transforms()).unwrap(),
        ];
        let (rows, losses) = yields::<AntennaPosition>("antenna_positions", json!({}), inputs);
        (rows.len(), losses.0)
    };
    let driven = || keyframes(&drive("a", 0.0));
    let lost = |reason: &str, fixes: u64| BTreeMap::from([(reason.to_owned(), fixes)]);
    let none = "fix of a session none of whose fixes are of the time of its drive";
    assert_eq!(hung(driven(), &[3600, 3601, 3602]), (0, lost(none, 3)));
    assert_eq!(hung(driven(), &[-9, -8, 3600]), (0, lost(none, 3)));
    // As a receiver has it that is on before the drive and after it.
    assert_eq!(hung(driven(), &[-9, -8, 5, 19, 3600]), (2, BTreeMap::new()));
    assert_eq!(hung(driven(), &[]), (0, BTreeMap::new()));
    // A car that stood, and one whose poses are none.
    let mut stood = driven();
    stood.truncate(1);
    assert_eq!(hung(stood, &[-9, 5, 6]), (0, BTreeMap::new()));
    let mut bent = driven();
    bent[5].odom_from_vehicle.x = f64::NAN;
    bent[5].stamp = Stamp(6);
    bent.remove(6);
    let beside = "fix beside a keyframe whose pose is not a rigid transform";
    assert_eq!(hung(bent, &[-9, 5, 8]), (1, lost(beside, 1)));
}

/// What `bundle_adjustment` makes of a drive, of which these frames of the map are held.
fn adjusted(
    drive: &Drive,
    previous: Vec<AdjustedPose>,
    previous_frames: Vec<MapFrame>,
    params: serde_json::Value,
) -> Vec<AdjustedPose> {
    let inputs = [
        inputs_of("poses", graph_poses(drive)).unwrap(),
        inputs_of("keyframes", keyframes(drive)).unwrap(),
        inputs_of("features", drive.features.clone()).unwrap(),
        inputs_of("tracks", drive.tracks.clone()).unwrap(),
        inputs_of("calibration", calibration()).unwrap(),
        inputs_of("transforms", transforms()).unwrap(),
        inputs_of("previous", previous).unwrap(),
        inputs_of("previous_frames", previous_frames).unwrap(),
    ];
    let (rows, losses) = yields("bundle_adjustment", params, inputs);
    assert!(losses.is_empty(), "{losses:?}");
    rows
}

fn farthest_m(rows: &[AdjustedPose], drive: &Drive) -> f64 {
    let of_drive = rows.iter().filter(|row| row.session == drive.session);
    let off = |row: &AdjustedPose| {
        let (pose, truth) = (&row.map_from_vehicle, &drive.truth[row.keyframe as usize]);
        (Vector3::new(pose.x, pose.y, pose.z) - truth.translation).norm()
    };
    of_drive.map(off).fold(0.0, f64::max)
}

fn of_session(rows: &[AdjustedPose], session: &str) -> usize {
    rows.iter().filter(|row| row.session == session).count()
}

/// The landmarks that a session sees, by number.
fn seen_by(rows: &[AdjustedPose], session: &str) -> BTreeSet<u32> {
    let of_session = rows.iter().filter(|row| row.session == session);
    let seen = of_session.flat_map(|row| &row.observations);
    seen.map(|seen| seen.landmark).collect()
}

fn map_frame(of: &AdjustedPose) -> MapFrame {
    MapFrame {
        site: of.site.clone(),
        frame: 0,
        session: of.session.clone(),
        stamp: of.stamp,
        map_from_frame: of.map_from_vehicle.clone(),
        moved_m: None,
        moved_rad: None,
    }
}

#[test]
fn rough_poses_become_exact_and_landmarks_are_described() {
    let drive = drive("a", 0.0);
    let first = adjusted(&drive, Vec::new(), Vec::new(), json!({}));
    assert_eq!(first.len(), drive.truth.len());
    assert!(
        farthest_m(&first, &drive) < 0.01,
        "{}",
        farthest_m(&first, &drive)
    );
    assert_eq!(first[0].map_from_vehicle, pose_row(&drive.truth[0]));
    let seen = seen_by(&first, "a");
    // The two tracks of a mark are one landmark.
    assert!(seen.len() <= marks().len());
    let inputs = [
        inputs_of("poses", first).unwrap(),
        inputs_of("calibration", calibration()).unwrap(),
        inputs_of("transforms", transforms()).unwrap(),
    ];
    let (landmarks, losses) = yields::<Landmark>("landmarks", json!({}), inputs);
    assert!(losses.is_empty(), "{losses:?}");
    assert_eq!(landmarks.len(), seen.len());
    for landmark in &landmarks {
        let place = Vector3::new(landmark.x, landmark.y, landmark.z);
        let nearest = marks()
            .iter()
            .map(|mark| (mark - place).norm())
            .fold(f64::INFINITY, f64::min);
        assert!(nearest < 0.1, "{landmark:?}");
        assert!(landmark.near_m <= landmark.far_m && landmark.view_cos <= 1.0);
        assert!(landmark.descriptors.0.len() % 64 == 0 && !landmark.descriptors.0.is_empty());
        for sighting in &landmark.sightings {
            let row = &drive.features[sighting.keyframe as usize];
            assert!((sighting.feature as usize) < row.u.len());
        }
    }
}

#[test]
fn observations_look_like_their_features_whether_those_are_fetched_or_kept() {
    let (a, b) = (drive("a", 0.0), drive("b", 0.2));
    let first = adjusted(&a, Vec::new(), Vec::new(), json!({}));
    let both = adjusted(&b, first, Vec::new(), json!({}));
    for row in &both {
        let of_row = if row.session == "a" { &a } else { &b };
        let features = &of_row.features[row.keyframe as usize];
        let looks: Vec<&[u8]> = features.descriptors.0.chunks_exact(64).collect();
        let seen = row.observations.iter();
        let seen: Vec<&[u8]> = seen.map(|seen| looks[seen.feature as usize]).collect();
        assert!(!seen.is_empty() && row.descriptors.0 == seen.concat());
    }
}

#[test]
fn a_site_adjusted_by_regions_has_the_poses_of_one_piece() {
    let drive = drive("a", 0.0);
    let whole = adjusted(&drive, Vec::new(), Vec::new(), json!({}));
    let by_regions = json!({ "region_keyframes": 7 });
    let found = adjusted(&drive, Vec::new(), Vec::new(), by_regions);
    assert_eq!(found.len(), whole.len());
    for (a, b) in whole.iter().zip(&found) {
        let (a, b) = (&a.map_from_vehicle, &b.map_from_vehicle);
        let apart_m = Vector3::new(a.x - b.x, a.y - b.y, a.z - b.z).norm();
        assert!(apart_m < 1e-4, "{a:?} {b:?}");
    }
}

#[test]
fn a_new_drive_is_added_to_what_is_kept_of_those_before() {
    let (a, b) = (drive("a", 0.0), drive("b", 0.2));
    let first = adjusted(&a, Vec::new(), Vec::new(), json!({}));
    let both = adjusted(&b, first.clone(), Vec::new(), json!({}));
    assert_eq!(both.len(), a.truth.len() + b.truth.len());
    assert_eq!(both[0].map_from_vehicle, first[0].map_from_vehicle);
    for drive in [&a, &b] {
        let farthest_m = farthest_m(&both, drive);
        assert!(farthest_m < 0.01, "{}: {farthest_m}", drive.session);
    }
    // Landmarks keep their numbers, and the new drive sees the same ones.
    let before = seen_by(&first, "a");
    for session in ["a", "b"] {
        let seen = seen_by(&both, session);
        let kept = seen.intersection(&before).count();
        assert!(
            kept * 10 >= 9 * before.len(),
            "{session}: {kept} of {}",
            before.len()
        );
    }
    // What shows nothing more is not kept, what a map frame stands on is.
    let last = map_frame(&first[19]);
    let thinned = adjusted(&b, first, vec![last], json!({ "spot_keyframes": 1 }));
    let kept: Vec<u32> = thinned
        .iter()
        .filter(|row| row.session == "a")
        .map(|row| row.keyframe)
        .collect();
    assert!(
        (8..=16).contains(&kept.len()) && kept.contains(&19),
        "{kept:?}"
    );
    assert_eq!(of_session(&thinned, "b"), b.truth.len());
    assert!(farthest_m(&thinned, &a) < 0.02 && farthest_m(&thinned, &b) < 0.02);
}
