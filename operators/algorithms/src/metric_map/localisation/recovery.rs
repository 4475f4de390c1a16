//! Where a keyframe could be when nothing is known: places that look alike, and the pose that their landmarks fix.

use super::drive::Recognise;
use super::{LandmarkMap, LocalisationParams};
use crate::geometry::pose::Pose;
use crate::geometry::resection::{Correspondence, ResectionOptions, inliers_beyond_chance, resect};
use crate::geometry::rig::{Rig, RigCamera};
use crate::metric_map::features::{Descriptor, Feature, KeyframeFeatures};
use crate::metric_map::matching::{Descriptors, MatchLimits};
use crate::metric_map::places::{PlaceIndex, Vocabulary, VocabularyOptions};
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Places whose landmarks are tried. Neighbours in the map look alike, so that several of the best are one place.
const TRIED_PLACES: usize = 6;
/// Of two places that share more than this part of their landmarks only the better is tried.
const SAME_PLACE: f64 = 0.5;
/// Poses that chance offers in less than this share of the tries. Verification by projection comes on top.
const FALSE_ALARMS: f64 = 1e-3;
/// Bearings are as uncertain as this many pixels: a feature seen from elsewhere, and the map's own errors nearby.
const BEARING_PX: f64 = 2.0;

/// The map's keyframes as places: what landmarks each saw, and which look alike.
#[derive(Debug, Clone)]
pub struct Places<'a> {
    rig: &'a Rig,
    map: &'a LandmarkMap,
    match_bits: u32,
    vocabulary: Vocabulary,
    index: PlaceIndex,
    /// Landmarks by place, ascending.
    landmarks: Vec<Vec<usize>>,
}

impl<'a> Places<'a> {
    /// Trains the vocabulary on the map's own descriptors.
    pub fn new(rig: &'a Rig, map: &'a LandmarkMap, params: &LocalisationParams) -> Self {
        let descriptors: Vec<&Descriptor> = map
            .landmarks()
            .iter()
            .flat_map(|known| &known.descriptors)
            .collect();
        let vocabulary = Vocabulary::train(descriptors.into_iter(), &VocabularyOptions::default());
        let mut by_place: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (index, landmark) in map.landmarks().iter().enumerate() {
            for place in &landmark.seen_from {
                by_place.entry(*place).or_default().push(index);
            }
        }
        let landmarks: Vec<Vec<usize>> = by_place.into_values().collect();
        let bags: Vec<_> = landmarks
            .par_iter()
            .map(|seen| {
                vocabulary.bag(
                    seen.iter()
                        .flat_map(|index| &map.landmarks()[*index].descriptors),
                )
            })
            .collect();
        Self {
            index: PlaceIndex::new(vocabulary.words(), &bags),
            rig,
            map,
            match_bits: params.limits.match_bits,
            vocabulary,
            landmarks,
        }
    }

    /// The places that look most alike, the best first, no two of them nearly the same.
    fn alike(&self, features: &KeyframeFeatures) -> Vec<usize> {
        let all = features.images.iter().flat_map(|image| &image.features);
        let bag = self.vocabulary.bag(all.map(|feature| &feature.descriptor));
        let mut chosen: Vec<usize> = Vec::new();
        for hit in self.index.best(&bag, 10 * TRIED_PLACES, |_| true) {
            let known = |other: &usize| {
                shared(&self.landmarks[*other], &self.landmarks[hit.document]) > SAME_PLACE
            };
            if !chosen.iter().any(known) {
                chosen.push(hit.document);
            }
            if chosen.len() == TRIED_PLACES {
                break;
            }
        }
        chosen
    }

    /// The pose that a place's landmarks fix, with the number of landmarks that agree.
    fn pose(&self, place: usize, features: &KeyframeFeatures) -> Option<(usize, Pose)> {
        let landmarks = &self.landmarks[place];
        let count = |index: &usize| self.map.landmarks()[*index].descriptors.len();
        let each = landmarks.iter().map(|index| vec![*index; count(index)]);
        let owners: Vec<usize> = each.flatten().collect();
        let descriptors: Descriptors = landmarks
            .iter()
            .flat_map(|index| &self.map.landmarks()[*index].descriptors)
            .collect();
        let mut pairs = Vec::new();
        for (camera, (mounted, image)) in self.rig.cameras.iter().zip(&features.images).enumerate()
        {
            // No ratio test: a landmark's own other descriptors would fail it.
            let limits = MatchLimits {
                match_bits: self.match_bits,
                match_ratio: 1.0,
            };
            let seen: Descriptors = image
                .features
                .iter()
                .map(|feature| &feature.descriptor)
                .collect();
            for found in seen.mutual(&descriptors, &limits) {
                let feature = &image.features[found.query as usize];
                let landmark = owners[found.found as usize];
                pairs.extend(self.pair(camera, mounted, feature, landmark, found.distance));
            }
        }
        let mounts: Vec<Pose> = self
            .rig
            .cameras
            .iter()
            .map(|mounted| mounted.vehicle_from_camera)
            .collect();
        // A ray of a few degrees' gate out of the half sphere that a lens sees.
        let gate = 9.21
            * pairs
                .iter()
                .map(|pair| pair.sigma_rad * pair.sigma_rad)
                .fold(0.0, f64::max);
        let options = ResectionOptions {
            min_inliers: inliers_beyond_chance(pairs.len(), 0.5 * gate, FALSE_ALARMS),
            ..ResectionOptions::default()
        };
        let found = resect(&mounts, &pairs, &options)?;
        Some((found.inliers.len(), found.world_from_vehicle))
    }

    fn pair(
        &self,
        camera: usize,
        mounted: &RigCamera,
        feature: &Feature,
        landmark: usize,
        distance: u32,
    ) -> Option<Correspondence> {
        let known = &self.map.landmarks()[landmark];
        let bearing = mounted.camera.unproject(feature.pixel)?;
        let [u, v] = feature.pixel;
        let beside = mounted
            .camera
            .unproject([u + 1.0, v])
            .or_else(|| mounted.camera.unproject([u - 1.0, v]))?;
        Some(Correspondence {
            camera,
            bearing,
            sigma_rad: BEARING_PX * bearing.angle(&beside).max(1e-6),
            point: known.position,
            // Mostly along the line of sight.
            point_covariance: known.view * known.view.transpose() * known.sigma_m.powi(2)
                + Matrix3::identity() * 1e-6,
            quality: -f64::from(distance),
        })
    }
}

impl Recognise for Places<'_> {
    fn propose(&self, features: &KeyframeFeatures) -> Vec<Pose> {
        let places = self.alike(features);
        let found: Vec<_> = places
            .par_iter()
            .map(|place| self.pose(*place, features))
            .collect();
        let mut found: Vec<(usize, Pose)> = found.into_iter().flatten().collect();
        found.sort_by_key(|(inliers, _)| std::cmp::Reverse(*inliers));
        found.into_iter().map(|(_, pose)| pose).collect()
    }
}

/// Of the smaller of two ascending lists, the share that the other has too.
fn shared(a: &[usize], b: &[usize]) -> f64 {
    let (few, many) = if a.len() < b.len() { (a, b) } else { (b, a) };
    let common = few
        .iter()
        .filter(|index| many.binary_search(index).is_ok())
        .count();
    common as f64 / few.len().max(1) as f64
}
