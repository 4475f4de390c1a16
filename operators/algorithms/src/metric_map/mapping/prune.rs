//! Landmarks at their place, without the features that do not show them.

use std::collections::BTreeSet;

use rayon::prelude::*;

use super::{MapInput, MappingParams};
use crate::geometry::pose::Pose;
use crate::metric_map::association::{FeatureRef, Landmark, Scene, Sight, triangulate};

/// The landmarks of the version before and the tracks, triangulated.
pub(super) fn first(input: &MapInput<'_>, params: &MappingParams) -> Vec<Landmark> {
    let mut taken: BTreeSet<FeatureRef> = BTreeSet::new();
    let mut landmarks = Vec::with_capacity(input.landmarks.len() + input.tracks.len());
    let known = input
        .landmarks
        .iter()
        .map(|known| (known.id, &known.features));
    let new = input.tracks.iter().map(|track| (input.first_new, track));
    for (id, features) in known.chain(new) {
        let mut features = features.clone();
        features.sort_unstable();
        features.dedup_by_key(|feature| feature.image);
        features.retain(|feature| input.scene.has(*feature) && taken.insert(*feature));
        landmarks.push(Landmark {
            id,
            point: Default::default(),
            features,
        });
    }
    let gate_px = params
        .association
        .agree_px
        .max(0.5 * params.first_radius_px);
    let params = MappingParams {
        min_features: 2,
        ..*params
    };
    prune(input.scene, input.poses, landmarks, gate_px, &params)
}

/// Gives new landmarks names, from `first_new` on.
pub(super) fn name(landmarks: &mut [Landmark], first_new: u32) {
    let new = landmarks
        .iter_mut()
        .filter(|landmark| landmark.id >= first_new);
    for (landmark, id) in new.zip(first_new..) {
        landmark.id = id;
    }
}

/// Triangulates every landmark; drops the features that are farther than `gate_px` from it, large ones that are farther
/// by more than their size explains, and the landmarks that have too few left or are seen along rays too much alike.
pub(super) fn prune(
    scene: &Scene,
    poses: &[Pose],
    landmarks: Vec<Landmark>,
    gate_px: f64,
    params: &MappingParams,
) -> Vec<Landmark> {
    let cameras = scene.map_from_cameras(poses);
    let pruned: Vec<Option<Landmark>> = landmarks
        .into_par_iter()
        .map(|landmark| pruned(scene, &cameras, landmark, gate_px, params))
        .collect();
    pruned.into_iter().flatten().collect()
}

fn pruned(
    scene: &Scene,
    cameras: &[Pose],
    mut landmark: Landmark,
    gate_px: f64,
    params: &MappingParams,
) -> Option<Landmark> {
    let drop_px2 = params.drop_px().powi(2);
    // Dropping the worst moves the point, which may free others; twice is nearly always enough.
    for _ in 0..3 {
        if landmark.features.len() < params.min_features {
            return None;
        }
        let before = landmark.features.len();
        let seen = landmark.features.iter();
        let seen = seen.filter_map(|feature| Some((*feature, scene.sight(cameras, *feature)?)));
        let (features, sights): (Vec<FeatureRef>, Vec<Sight>) = seen.unzip();
        let found = triangulate(&sights)?;
        let near = |sight: &Sight| {
            let excess = drop_px2 * (sight.blur().powi(2) - 1.0);
            let off_px = sight.off_px(&found.point);
            off_px.is_some_and(|off_px| off_px.powi(2) <= gate_px * gate_px + excess)
        };
        let seen = features.into_iter().zip(&sights);
        let seen = seen.filter(|(_, sight)| near(sight));
        landmark.features = seen.map(|(feature, _)| feature).collect();
        landmark.point = found.point;
        if landmark.features.len() == before {
            return (found.parallax_rad >= params.min_parallax_rad).then_some(landmark);
        }
    }
    None
}
