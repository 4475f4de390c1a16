//! A made-up metric map: a session around an ellipse whose odometry turns too much, landmarks along walls that every
//! third keyframe sees, one good loop closure and one bad one, and localisations of which some are lost.

use evermap_schemas::layers::{
    AdjustedPose, Features, FramePose, GraphPose, Keyframe, Landmark, Localisation, LoopClosure,
    LoopEdge, Observation, PlacedLabel, Sighting, Source, VehiclePose,
};
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, Pose, Stamp, Wkb};

const CAMERA: &str = "front_optical_frame";
const SEEN: u32 = 3;

fn yawed(x: f64, y: f64, yaw: f64) -> Pose {
    Pose {
        x,
        y,
        qz: (yaw / 2.0).sin(),
        qw: (yaw / 2.0).cos(),
        ..Pose::IDENTITY
    }
}

/// Odometry that draws the same path, turned a little more with every keyframe.
pub fn keyframes(poses: &[VehiclePose]) -> Vec<Keyframe> {
    let row = |(k, pose): (u32, &VehiclePose)| {
        let at = &pose.map_from_vehicle;
        let turn = 0.0006 * f64::from(k);
        let (x, y) = (
            at.x - poses[0].map_from_vehicle.x,
            at.y - poses[0].map_from_vehicle.y,
        );
        Keyframe {
            site: pose.site.clone(),
            session: pose.session.clone(),
            stamp: pose.stamp,
            keyframe: k,
            distance_m: 0.2 * f64::from(k),
            stretch: 0,
            odom_from_vehicle: yawed(
                x * turn.cos() - y * turn.sin(),
                x * turn.sin() + y * turn.cos(),
                turn,
            ),
            images: vec![],
        }
    };
    (0..).zip(poses).map(row).collect()
}

pub fn graph_poses(poses: &[VehiclePose]) -> Vec<GraphPose> {
    let last = poses.len() as u32 - 1;
    let row = |(k, pose): (u32, &VehiclePose)| {
        let edge = |keyframe, weight, residual_m| LoopEdge {
            session: pose.session.clone(),
            keyframe,
            residual_m,
            residual_rad: 0.01 * residual_m,
            weight,
        };
        GraphPose {
            site: pose.site.clone(),
            session: pose.session.clone(),
            stamp: pose.stamp,
            keyframe: k,
            map_from_vehicle: pose.map_from_vehicle.clone(),
            loops: match k {
                k if k == last => vec![edge(0, 0.97, 0.04)],
                100 => vec![edge(3, 0.01, 31.0)],
                _ => vec![],
            },
            optimality: "optimal".into(),
        }
    };
    (0..).zip(poses).map(row).collect()
}

pub fn loop_closures(poses: &[VehiclePose]) -> Vec<LoopClosure> {
    let (first, last) = (&poses[0], &poses[poses.len() - 1]);
    vec![LoopClosure {
        site: last.site.clone(),
        session: last.session.clone(),
        stamp: last.stamp,
        keyframe: poses.len() as u32 - 1,
        other_session: first.session.clone(),
        other_stamp: first.stamp,
        other_keyframe: 0,
        other_from_vehicle: yawed(0.0, -0.5, 0.0),
        matches: 80,
        inliers: 41,
        sigma_m: 0.03,
        sigma_rad: 0.004,
    }]
}

pub fn adjusted_poses(poses: &[VehiclePose]) -> Vec<AdjustedPose> {
    let row = |(k, pose): (u32, &VehiclePose)| {
        let seen = |feature: u32| Observation {
            camera: CAMERA.into(),
            feature,
            u: 100.0 + feature as f32,
            v: 50.0,
            size_px: 8.0,
            landmark: k / 3 * SEEN + feature,
            residual_px: 0.25 * (feature + 1) as f32,
            weight: if feature == 2 { 0.1 } else { 1.0 },
        };
        AdjustedPose {
            site: pose.site.clone(),
            session: pose.session.clone(),
            stamp: pose.stamp,
            keyframe: k,
            map_from_vehicle: pose.map_from_vehicle.clone(),
            stretch: 0,
            odom_from_vehicle: pose.map_from_vehicle.clone(),
            observations: (0..SEEN).map(seen).collect(),
            descriptors: Default::default(),
            images: vec![],
        }
    };
    (0..).zip(poses).map(row).collect()
}

pub fn frame_poses(poses: &[VehiclePose]) -> Vec<FramePose> {
    let row = |pose: &VehiclePose| FramePose {
        site: pose.site.clone(),
        session: pose.session.clone(),
        stamp: pose.stamp,
        frame: 0,
        frame_from_vehicle: pose.map_from_vehicle.clone(),
        map_from_vehicle: pose.map_from_vehicle.clone(),
    };
    poses.iter().map(row).collect()
}

pub fn features(poses: &[VehiclePose]) -> Vec<Features> {
    let row = |(k, pose): (u32, &VehiclePose)| Features {
        site: pose.site.clone(),
        session: pose.session.clone(),
        stamp: pose.stamp,
        keyframe: k,
        camera: CAMERA.into(),
        width: 400,
        height: 300,
        u: (0..=SEEN).map(|f| 100.0 + 20.0 * f as f32).collect(),
        v: (0..=SEEN).map(|f| 150.0 + f as f32).collect(),
        size_px: vec![8.0; SEEN as usize + 1],
        descriptors: Bytes(vec![0; 64 * (SEEN as usize + 1)]),
    };
    (0..).zip(poses).map(row).collect()
}

pub fn landmarks(poses: &[VehiclePose]) -> Vec<Landmark> {
    let count = (poses.len() as u32).div_ceil(3) * SEEN;
    let row = |landmark: u32| {
        let pose = &poses[(landmark / SEEN * 3) as usize];
        let at = &pose.map_from_vehicle;
        let outwards = 1.2 + 0.15 * f64::from(landmark % SEEN);
        let place = [
            25.0 + (at.x - 25.0) * outwards,
            25.0 + (at.y - 25.0) * outwards,
            1.5,
        ];
        let sighting = |k: u32| Sighting {
            session: pose.session.clone(),
            keyframe: landmark / SEEN * 3 + k,
            camera: CAMERA.into(),
            feature: landmark % SEEN,
        };
        Landmark {
            site: pose.site.clone(),
            landmark,
            x: place[0],
            y: place[1],
            z: place[2],
            sigma_m: 0.02,
            parallax_rad: 0.1,
            rms_px: 0.4,
            view: [1.0, 0.0, 0.0],
            view_cos: 0.9,
            near_m: 3.0,
            far_m: 5.0,
            descriptors: Bytes(vec![0; 64]),
            sightings: (0..3).map(sighting).collect(),
            sources: vec![Source {
                session: pose.session.clone(),
                first_stamp: pose.stamp,
                last_stamp: pose.stamp,
            }],
            geometry: Wkb::point(place),
        }
    };
    (0..count).map(row).collect()
}

pub fn localisations(poses: &[VehiclePose]) -> Vec<Localisation> {
    let row = |(k, pose): (u32, &VehiclePose)| {
        let lost = (50..60).contains(&k);
        let known = |value: f64| (!lost).then_some(value);
        Localisation {
            site: pose.site.clone(),
            session: pose.session.clone(),
            stamp: pose.stamp,
            keyframe: k,
            state: if lost { "lost" } else { "localised" }.into(),
            map_from_vehicle: (!lost).then(|| pose.map_from_vehicle.clone()),
            covariance: vec![],
            sigma_m: known(0.01),
            sigma_rad: known(0.001),
            candidates: 300,
            matches: 120,
            inliers: if lost { 0 } else { 80 },
            rms_px: known(0.7),
            observations: vec![],
        }
    };
    (0..).zip(poses).map(row).collect()
}

pub fn cameras(session: &str) -> Vec<Calibration> {
    vec![Calibration {
        site: "lot".into(),
        session: session.into(),
        stamp: Stamp(0),
        camera: CAMERA.into(),
        width: 400,
        height: 300,
        model: "equidistant".into(),
        intrinsics: vec![120.0, 0.0, 199.5, 0.0, 120.0, 149.5, 0.0, 0.0, 1.0],
        distortion: vec![0.1, 0.0, 0.0, 0.0],
        mount: None,
    }]
}

pub fn mounts(session: &str) -> Vec<Transform> {
    vec![Transform {
        site: "lot".into(),
        session: session.into(),
        stamp: Stamp(0),
        parent: "base_link".into(),
        child: CAMERA.into(),
        parent_from_child: Pose {
            x: 3.0,
            y: 0.0,
            z: 0.8,
            qx: -0.5,
            qy: 0.5,
            qz: -0.5,
            qw: 0.5,
        },
        fixed: true,
    }]
}

/// A crossing that somebody drew.
pub fn placed_labels() -> Vec<PlacedLabel> {
    let points = vec![[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -2.0, 0.0]];
    vec![PlacedLabel {
        site: "lot".into(),
        label: "crossing_1".into(),
        kind: "crossing".into(),
        standing: "drawn".into(),
        author: "ada".into(),
        said: Stamp(0),
        placed_by: "drawing".into(),
        anchor: None,
        shape: "polygon".into(),
        map_from_label: Pose::IDENTITY,
        length_m: None,
        width_m: None,
        geometry: Wkb::polygon(&[[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]]),
        points,
    }]
}
