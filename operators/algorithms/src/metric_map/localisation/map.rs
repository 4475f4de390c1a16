//! The landmarks of a map.

use super::LocalisationParams;
use crate::metric_map::features::Descriptor;
use crate::metric_map::visibility::{ViewCone, Visibility};
use nalgebra::Vector3;

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
    pub(super) fn is_sound(&self) -> bool {
        let finite = self.position.iter().chain(self.view.iter());
        finite
            .chain([&self.sigma_m, &self.view_cos, &self.near_m, &self.far_m])
            .all(|x| x.is_finite())
            && self.far_m >= self.near_m
            && self.sigma_m >= 0.0
            && !self.descriptors.is_empty()
    }

    /// From where it may be recognised.
    pub(super) fn visibility(&self, params: &LocalisationParams) -> Visibility {
        let seen = ViewCone {
            view: self.view,
            view_cos: self.view_cos,
            ranges_m: [self.near_m, self.far_m],
        };
        let visibility = Visibility::new(
            self.position,
            &seen,
            params.view_slack_rad,
            params.range_slack,
        );
        visibility.within(params.reach_m)
    }
}

/// All landmarks of a map.
#[derive(Debug, Clone)]
pub struct LandmarkMap {
    landmarks: Vec<MapLandmark>,
    sound: usize,
}

impl LandmarkMap {
    /// Landmarks are named by their place in the list. Those with numbers that are not finite, or with no
    /// descriptor, are never found.
    pub fn new(landmarks: Vec<MapLandmark>) -> Self {
        Self {
            sound: landmarks
                .iter()
                .filter(|landmark| landmark.is_sound())
                .count(),
            landmarks,
        }
    }

    /// The landmarks, as given.
    pub fn landmarks(&self) -> &[MapLandmark] {
        &self.landmarks
    }

    /// Landmarks that can be found.
    pub fn len(&self) -> usize {
        self.sound
    }

    /// Whether no landmark can be found.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
