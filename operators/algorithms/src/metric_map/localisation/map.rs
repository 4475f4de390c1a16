//! The landmarks of a map, found by place.

use crate::metric_map::features::Descriptor;
use nalgebra::Vector3;
use rstar::primitives::GeomWithData;
use rstar::{PointDistance, RTree};

/// A landmark to be recognised.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLandmark {
    /// Its position in the map, metres.
    pub position: Vector3<f64>,
    /// Largest standard deviation of the position, metres; mostly along `view`.
    pub sigma_m: f64,
    /// Mean direction from the landmark to the cameras that saw it; a unit vector.
    pub view: Vector3<f64>,
    /// Cosine of the largest angle between `view` and a direction it was seen from.
    pub view_cos: f64,
    /// Nearest range it was seen at, metres.
    pub near_m: f64,
    /// Farthest range it was seen at, metres.
    pub far_m: f64,
    /// What it looks like: one or more.
    pub descriptors: Vec<Descriptor>,
    /// The map's keyframes that saw it, in any numbering that names them apart; each once.
    pub seen_from: Vec<u32>,
}

impl MapLandmark {
    fn is_sound(&self) -> bool {
        let finite = self.position.iter().chain(self.view.iter());
        finite
            .chain([&self.sigma_m, &self.view_cos, &self.near_m, &self.far_m])
            .all(|x| x.is_finite())
            && self.far_m >= self.near_m
            && self.sigma_m >= 0.0
            && !self.descriptors.is_empty()
    }

    /// Whether a camera at `eye` may recognise it: from a direction and a range not far outside those it was seen
    /// from.
    pub(super) fn visible_from(
        &self,
        eye: &Vector3<f64>,
        slack_rad: f64,
        range_slack: f64,
    ) -> bool {
        let away = eye - self.position;
        let range = away.norm();
        if !(range * range_slack >= self.near_m && range <= self.far_m * range_slack) {
            return false;
        }
        // cos(opening + slack); the cone may reach all around.
        let (cos, slack) = (
            self.view_cos.clamp(-1.0, 1.0),
            slack_rad.min(std::f64::consts::PI),
        );
        let edge = cos * slack.cos() - (1.0 - cos * cos).sqrt() * slack.sin();
        cos <= -slack.cos() || away.dot(&self.view) >= range * edge
    }
}

type Entry = GeomWithData<[f64; 3], usize>;

/// All landmarks of a map, with a spatial index.
#[derive(Debug, Clone)]
pub struct LandmarkMap {
    landmarks: Vec<MapLandmark>,
    index: RTree<Entry>,
}

impl LandmarkMap {
    /// Landmarks are named by their place in the list. Those with numbers that are not finite, or with no
    /// descriptor, are never found.
    pub fn new(landmarks: Vec<MapLandmark>) -> Self {
        let sound = landmarks
            .iter()
            .enumerate()
            .filter(|(_, landmark)| landmark.is_sound());
        let entries: Vec<Entry> = sound
            .map(|(index, landmark)| Entry::new(landmark.position.into(), index))
            .collect();
        Self {
            index: RTree::bulk_load(entries),
            landmarks,
        }
    }

    /// The landmarks, as given.
    pub fn landmarks(&self) -> &[MapLandmark] {
        &self.landmarks
    }

    /// Landmarks that can be found.
    pub fn len(&self) -> usize {
        self.index.size()
    }

    /// Whether no landmark can be found.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Indices of the landmarks within `reach_m` of a place, ascending.
    pub(super) fn near(&self, place: &Vector3<f64>, reach_m: f64) -> Vec<usize> {
        let place: [f64; 3] = (*place).into();
        let within = self.index.locate_within_distance(place, reach_m * reach_m);
        let mut found: Vec<usize> = within
            .filter(|entry| entry.distance_2(&place).is_finite())
            .map(|entry| entry.data)
            .collect();
        found.sort_unstable();
        found
    }
}
