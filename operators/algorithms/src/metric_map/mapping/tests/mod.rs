#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::{Map, MapInput, MappingParams, map};
use crate::geometry::pose::Pose;
use crate::metric_map::association::{
    AssociationParams, FeatureRef, Landmark, Scene, Sight, associate, triangulate,
};

mod simulated;

use simulated::{Album, Hall, Simulated, simulate};

/// A map of sessions that look as they do.
fn map_of(input: &MapInput<'_>, sessions: &[&Simulated], params: &MappingParams) -> Map {
    map(input, &album(sessions), params).unwrap()
}

fn album<'a>(sessions: &[&'a Simulated]) -> Album<'a> {
    Album {
        sessions: sessions.to_vec(),
        missing: None,
    }
}

fn landmarks(scene: &Scene, poses: &[Pose], tracks: Vec<Vec<FeatureRef>>) -> Vec<Landmark> {
    let cameras = scene.map_from_cameras(poses);
    let landmark = |features: Vec<FeatureRef>| {
        let sights: Vec<Sight> = features
            .iter()
            .filter_map(|feature| scene.sight(&cameras, *feature))
            .collect();
        let found = triangulate(&sights)?;
        (found.parallax_rad > 0.03).then_some(Landmark {
            id: 0,
            point: found.point,
            features,
        })
    };
    tracks.into_iter().filter_map(landmark).collect()
}

/// Part of the landmarks' features that show what most of the landmark's features show, and the number of landmarks
/// for each mark.
fn purity(session: &Simulated, landmarks: &[Landmark]) -> (f64, f64) {
    let (mut pure, mut all) = (0, 0);
    let mut landmarks_of: BTreeMap<usize, usize> = BTreeMap::new();
    for landmark in landmarks {
        let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
        for feature in &landmark.features {
            let (keyframe, camera) = (feature.image as usize / 4, feature.image as usize % 4);
            let mark = session.shown[keyframe][camera][feature.feature as usize];
            *counts.entry(mark).or_default() += 1;
        }
        let (mark, most) = counts.iter().max_by_key(|(_, count)| **count).unwrap();
        pure += most;
        all += landmark.features.len();
        *landmarks_of.entry(*mark).or_default() += 1;
    }
    (
        pure as f64 / all as f64,
        landmarks.len() as f64 / landmarks_of.len() as f64,
    )
}

#[test]
fn tracks_of_one_mark_become_one_landmark() {
    let session = simulate(&Hall {
        points: 1500,
        keyframes: 80,
        ..Hall::default()
    });
    let mut scene = Scene::default();
    let tracks = session.add_to(&mut scene);
    let poses = session.guess(0.15, 0.02);
    let landmarks = landmarks(&scene, &poses, tracks);
    let (pure_before, parts_before) = purity(&session, &landmarks);
    let params = AssociationParams {
        radius_px: 12.0,
        ..AssociationParams::default()
    };
    let seen = album(&[&session]);
    let found = associate(&scene, &seen, &poses, &landmarks, &params).unwrap();
    assert!(found.len() < landmarks.len());
    let mut features: Vec<FeatureRef> = Vec::new();
    for landmark in &found {
        features.extend(&landmark.features);
    }
    let all = features.len();
    features.sort_unstable();
    features.dedup();
    assert_eq!(features.len(), all, "a feature is in two landmarks");
    let (pure, parts) = purity(&session, &found);
    assert!(pure >= pure_before && pure > 0.98, "{pure_before} {pure}");
    assert!(
        parts < 2.0 && parts < 0.4 * parts_before,
        "{parts_before} {parts}"
    );
}

/// The rigid motion that lays points onto others best.
fn aligned(source: &[Vector3<f64>], target: &[Vector3<f64>]) -> Pose {
    let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let (from, to) = (mean(source), mean(target));
    let pairs = source.iter().zip(target);
    let products = pairs.map(|(a, b)| (b - to) * (a - from).transpose());
    let nearest = Rotation3::from_matrix_eps(&products.sum(), 1e-12, 1000, Rotation3::identity());
    let rotation = UnitQuaternion::from_rotation_matrix(&nearest);
    Pose::new(to - rotation * from, rotation)
}

/// Root mean square distance after the best rigid alignment.
/// A first drive: there are no landmarks yet.
fn nothing_mapped<'a>(
    scene: &'a Scene,
    poses: &'a [Pose],
    tracks: &'a [Vec<FeatureRef>],
) -> MapInput<'a> {
    MapInput {
        scene,
        poses,
        landmarks: &[],
        tracks,
        fixed: &[0],
        datum: &[],
        first_new: 0,
    }
}

fn error_m(found: &[Pose], truth: &[Pose]) -> f64 {
    let points = |poses: &[Pose]| {
        poses
            .iter()
            .map(|pose| pose.translation)
            .collect::<Vec<_>>()
    };
    let (found, truth) = (points(found), points(truth));
    let truth_from_found = aligned(&found, &truth);
    let squares = found
        .iter()
        .zip(&truth)
        .map(|(found, truth)| (truth_from_found.transform(found) - truth).norm_squared());
    (squares.sum::<f64>() / truth.len() as f64).sqrt()
}

/// How well a hall is mapped from poses that are off: error in metres, and the map.
fn mapped(hall: &Hall) -> (f64, Map, Simulated) {
    let session = simulate(hall);
    let mut scene = Scene::default();
    let tracks = session.add_to(&mut scene);
    let guess = session.guess(0.25, 0.03);
    assert!(error_m(&guess, &session.truth) > 0.2);
    let input = nothing_mapped(&scene, &guess, &tracks);
    let found = map_of(&input, &[&session], &MappingParams::default());
    assert_eq!(found.poses[0], guess[0]);
    (error_m(&found.poses, &session.truth), found, session)
}

fn small() -> Hall {
    Hall {
        points: 1500,
        keyframes: 80,
        ..Hall::default()
    }
}

#[test]
fn a_rough_graph_becomes_an_accurate_map() {
    let (error, found, session) = mapped(&small());
    assert!(error < 0.01, "{error} m");
    let (pure, parts) = purity(&session, &found.landmarks);
    assert!(pure > 0.995 && parts < 1.2, "{pure} {parts}");
    assert!((found.odometry_scales[0] - 1.0 / 1.01).abs() < 0.002);
}

#[test]
fn a_map_by_regions_is_that_in_one_piece() {
    let session = simulate(&small());
    let mut scene = Scene::default();
    let tracks = session.add_to(&mut scene);
    let guess = session.guess(0.25, 0.03);
    let input = nothing_mapped(&scene, &guess, &tracks);
    let whole = map_of(&input, &[&session], &MappingParams::default());
    let mut params = MappingParams::default();
    params.adjust.region_keyframes = Some(30);
    let found = map_of(&input, &[&session], &params);
    let poses = whole.poses.iter().zip(&found.poses);
    let apart = poses.map(|(a, b)| (a.translation - b.translation).norm());
    let apart_m = apart.fold(0.0, f64::max);
    assert!(apart_m < 1e-4, "{apart_m} m");
    assert_eq!(found.landmarks.len(), whole.landmarks.len());
}

#[test]
fn a_dark_camera_and_odometry_that_is_far_off_do_little_harm() {
    let (error, found, _) = mapped(&Hall {
        dark: Some(1),
        odometry_scale: 1.05,
        ..small()
    });
    assert!(error < 0.02, "{error} m");
    assert!((found.odometry_scales[0] - 1.0 / 1.05).abs() < 0.004);
}

#[test]
fn nothing_seen_leaves_poses_where_they_are() {
    let session = simulate(&small());
    let mut scene = Scene::default();
    session.add_to(&mut scene);
    let guess = session.guess(0.25, 0.03);
    let input = nothing_mapped(&scene, &guess, &[]);
    let found = map_of(&input, &[&session], &MappingParams::default());
    assert!(found.landmarks.is_empty() && found.poses[0] == guess[0]);
}

#[test]
fn descriptors_that_cannot_be_fetched_are_told() {
    let session = simulate(&small());
    let mut scene = Scene::default();
    let tracks = session.add_to(&mut scene);
    let guess = session.guess(0.25, 0.03);
    let input = nothing_mapped(&scene, &guess, &tracks);
    let seen = Album {
        missing: Some(7),
        ..album(&[&session])
    };
    let found = map(&input, &seen, &MappingParams::default());
    assert_eq!(found, Err("no descriptors of 7".to_owned()));
}

/// The poses with a turn added at each step, so that the last one is `off_m` beside where it was.
fn bent(poses: &[Pose], off_m: f64) -> Vec<Pose> {
    let chain = |turn_rad: f64| {
        let mut bent = vec![poses[0]];
        for pair in poses.windows(2) {
            let step = pair[0].inverse().compose(&pair[1]);
            let turned = step.compose(&Pose::from_yaw(0.0, 0.0, turn_rad));
            bent.push(bent[bent.len() - 1].compose(&turned));
        }
        bent
    };
    let last = poses.len() - 1;
    let little = 1e-4;
    let moved = (chain(little)[last].translation - poses[last].translation).norm();
    chain(little * off_m / moved)
}

#[test]
fn a_bent_map_is_straightened_by_a_revisit() {
    let hall = Hall {
        points: 2000,
        keyframes: 100,
        loops: 0.9,
        ..Hall::default()
    };
    let base = simulate(&hall);
    let mut scene = Scene::default();
    let tracks = base.add_to(&mut scene);
    let guess = base.guess(0.0, 0.0);
    let input = nothing_mapped(&scene, &guess, &tracks);
    let straight = map_of(&input, &[&base], &MappingParams::default());
    let mut poses = bent(&straight.poses, 1.0);
    let off_m = |poses: &[Pose]| {
        let off = poses.iter().zip(&straight.poses);
        let off = off.map(|(pose, straight)| (pose.translation - straight.translation).norm());
        off.fold(0.0, f64::max)
    };
    assert!(off_m(&poses) > 0.9);
    // The revisit finds its way in the bent map.
    let revisit = simulate(&Hall {
        seed: 8,
        yaw_bias_rad_per_m: 0.0,
        ..hall
    });
    let tracks = revisit.add_to(&mut scene);
    let localised = revisit.truth.iter().map(|truth| {
        let away = |at: &usize| (base.truth[*at].translation - truth.translation).norm();
        let nearest = (0..base.truth.len()).min_by(|a, b| away(a).total_cmp(&away(b)));
        let nearest = nearest.unwrap();
        let from_base = base.truth[nearest].inverse().compose(truth);
        poses[nearest].compose(&from_base)
    });
    let localised: Vec<Pose> = localised.collect();
    poses.extend(localised);
    let input = MapInput {
        scene: &scene,
        poses: &poses,
        landmarks: &straight.landmarks,
        tracks: &tracks,
        fixed: &[0],
        datum: &[],
        first_new: straight
            .landmarks
            .iter()
            .map(|one| one.id + 1)
            .max()
            .unwrap(),
    };
    let found = map_of(&input, &[&base, &revisit], &MappingParams::default());
    let left_m = off_m(&found.poses[..base.truth.len()]);
    assert!(left_m < 0.05, "{left_m} m");
}
