#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;

use super::simulated::{Hall, Simulated, simulate};
use super::{MapInput, MappingParams, map};
use crate::association::{
    Association, AssociationParams, FeatureRef, Landmark, Scene, Sight, associate, triangulate,
};
use crate::pose::Pose;

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
    let session = simulate(&Hall::default());
    let mut scene = Scene::default();
    let tracks = session.add_to(&mut scene);
    let poses = session.guess(0.15, 0.02);
    let mut landmarks = landmarks(&scene, &poses, tracks);
    let (before, parts_before) = purity(&session, &landmarks);
    eprintln!(
        "{} landmarks, {before:.3} {parts_before:.2}",
        landmarks.len()
    );
    for radius_px in [12.0, 6.0] {
        let params = AssociationParams {
            radius_px,
            ..AssociationParams::default()
        };
        let start = std::time::Instant::now();
        let found = associate(&scene, &poses, &landmarks, &params);
        let Association { merged, added, .. } = found;
        landmarks = found.landmarks;
        let (pure, parts) = purity(&session, &landmarks);
        eprintln!(
            "{} landmarks, {merged} merged, {added} added, {pure:.3} {parts:.2} {:?}",
            landmarks.len(),
            start.elapsed()
        );
    }
}

/// Root mean square distance after the best rigid alignment.
fn error_m(found: &[Pose], truth: &[Pose]) -> f64 {
    let points = |poses: &[Pose]| {
        poses
            .iter()
            .map(|pose| pose.translation)
            .collect::<Vec<_>>()
    };
    let (found, truth) = (points(found), points(truth));
    let truth_from_found = crate::trajectory::align_points(&found, &truth).unwrap();
    let squares = found
        .iter()
        .zip(&truth)
        .map(|(found, truth)| (truth_from_found.transform(found) - truth).norm_squared());
    (squares.sum::<f64>() / truth.len() as f64).sqrt()
}

#[test]
fn a_rough_graph_becomes_an_accurate_map() {
    let session = simulate(&Hall::default());
    let mut scene = Scene::default();
    let tracks = session.add_to(&mut scene);
    let guess = session.guess(0.25, 0.03);
    let input = MapInput {
        scene: &scene,
        poses: &guess,
        landmarks: &[],
        tracks: &tracks,
        fixed: 0,
    };
    let before = error_m(&guess, &session.truth);
    let start = std::time::Instant::now();
    let found = map(&input, &MappingParams::default());
    for round in &found.rounds {
        eprintln!("{round:?}");
    }
    eprintln!("{:?} scale {:?}", start.elapsed(), found.odometry_scales);
    let after = error_m(&found.poses, &session.truth);
    eprintln!("{before} -> {after}");
    assert_eq!(found.poses[0], guess[0]);
    assert!(after < 0.01, "{after} m");
    let (pure, parts) = purity(&session, &found.landmarks);
    assert!(pure > 0.999 && parts < 1.1, "{pure} {parts}");
}
