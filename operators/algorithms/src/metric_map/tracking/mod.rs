//! Features followed through a camera's keyframes.
//!
//! ```text
//!  view a ─┐ odometry says how the camera moved; a feature's ray, at depths from near to infinite,
//!          ├► is an arc in the other image ──► the feature on the arc that looks most alike, mutually
//!  view b ─┘                                        │
//!        the motion refined by the matches ◄────────┘  (then again, on narrower arcs)
//!                    │
//!   links over one view, over gaps ──► chains ──► cut where no point of the world explains the rays
//! ```
//! All limits are angles, made of the lens's own resolution and of odometry's uncertainty, so that
//! they suit any lens and image size. Paper 1 (lifelong metric and semantic maps), section IV-B:
//! features are tracked "individually and independently for each camera".

mod arc;
mod chain;
mod motion;
mod pair;
#[cfg(test)]
mod tests;

use nalgebra::Vector3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::metric_map::features::{Blur, FeatureNoise, ImageFeatures};
use crate::metric_map::matching::{ImageIndex, MatchLimits};
use pair::{Pair, match_pair};

/// How features are followed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct TrackParams {
    /// When descriptors match, on the arc.
    #[serde(flatten)]
    pub limits: MatchLimits,
    /// Nothing is nearer to a camera than this (m): the ground below a low camera.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub min_depth_m: f64,
    /// Keyframes that a track may miss between two sightings.
    pub gap: u32,
    /// Tracks with fewer sightings are dropped; at least 2. Of two, any that are on each other's arcs agree; the third
    /// puts them to the test.
    pub min_points: u32,
    /// Tracks are cut after this many sightings, so that a vehicle that hardly moves gives no endless ones.
    pub max_points: u32,
    /// How exactly features lie.
    #[serde(flatten)]
    pub features: FeatureNoise,
    /// Standard deviation of odometry's way between two keyframes: share of the way.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub way_sigma: f64,
    /// Standard deviation of odometry's rotation between two keyframes (rad), with the tilt that planar odometry does
    /// not know: a third of a degree.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub turn_sigma_rad: f64,
    /// Keyframes farther apart than this (m) are not matched: images are missing.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_step_m: f64,
}

impl Default for TrackParams {
    fn default() -> Self {
        Self {
            limits: MatchLimits::default(),
            min_depth_m: 0.4,
            gap: 2,
            min_points: 3,
            max_points: 100,
            features: FeatureNoise::default(),
            way_sigma: 0.03,
            turn_sigma_rad: 0.006,
            max_step_m: 3.0,
        }
    }
}

/// One image of a camera, and where odometry says that it was taken.
#[derive(Debug, Clone)]
pub struct CameraFrame<'a> {
    /// The stretch of unbroken odometry that it lies in: nothing is followed from one to another.
    pub stretch: u32,
    /// The camera in the drifting odometry frame.
    pub odom_from_camera: Pose,
    /// What it saw; nothing where there is no image.
    pub features: &'a ImageFeatures,
}

/// One sighting of a track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Sighting {
    /// Index of the view.
    pub view: u32,
    /// Index of the feature in the view.
    pub feature: u32,
}

/// A view made ready.
struct Ready<'a> {
    features: &'a ImageFeatures,
    index: ImageIndex,
    /// The features' rays in the camera; `None` where the lens has none.
    rays: Vec<Option<Vector3<f64>>>,
    /// Standard deviations of the rays (rad).
    sigmas_rad: Vec<f64>,
}

/// What one camera's views share.
struct Tracker<'a> {
    camera: &'a Camera,
    params: &'a TrackParams,
    /// Angle that a pixel spans in the middle of the image.
    rad_per_px: f64,
    views: &'a [CameraFrame<'a>],
    ready: Vec<Ready<'a>>,
}

/// Tracks of two or more sightings each, in the order of first sight. A feature belongs to one track
/// at most.
///
/// Views without features, features without a ray, steps too long to match: all just end tracks.
/// The same input gives the same tracks on any number of threads. Cost: some ten distances per
/// feature and view.
pub fn tracks(
    camera: &Camera,
    views: &[CameraFrame<'_>],
    params: &TrackParams,
) -> Vec<Vec<Sighting>> {
    let rad_per_px = 1.0 / camera.px_per_rad();
    let ready = views
        .par_iter()
        .map(|view| Ready::new(camera, view, params, rad_per_px))
        .collect();
    let tracker = Tracker {
        camera,
        params,
        rad_per_px,
        views,
        ready,
    };
    let steps: Vec<Pair> = (1..views.len())
        .into_par_iter()
        .map(|to| tracker.step(to))
        .collect();
    tracker.chains(&steps)
}

impl<'a> Ready<'a> {
    fn new(camera: &Camera, view: &CameraFrame<'a>, params: &TrackParams, rad_per_px: f64) -> Self {
        let features = &view.features.features;
        let blur = Blur::of_image(view.features);
        let sigma_rad = params.features.sigma_px * rad_per_px;
        Self {
            features: view.features,
            index: ImageIndex::new(view.features),
            rays: features
                .iter()
                .map(|feature| camera.unproject(feature.pixel))
                .collect(),
            sigmas_rad: features
                .iter()
                .map(|feature| sigma_rad * blur.of(feature.size_px))
                .collect(),
        }
    }

    /// The largest standard deviation of its rays (rad).
    fn widest_rad(&self) -> f64 {
        self.sigmas_rad.iter().copied().fold(0.0, f64::max)
    }

    fn ray(&self, feature: u32) -> Option<(Vector3<f64>, f64)> {
        let at = feature as usize;
        Some(((*self.rays.get(at)?)?, *self.sigmas_rad.get(at)?))
    }
}

impl Tracker<'_> {
    /// `b_from_a` by odometry; `None` where it was broken, or the step is too long to be matched.
    fn odometry(&self, from: usize, to: usize) -> Option<Pose> {
        let (a, b) = (self.views.get(from)?, self.views.get(to)?);
        let b_from_a = b.odom_from_camera.inverse().compose(&a.odom_from_camera);
        let near = b_from_a.translation.norm() <= self.params.max_step_m;
        (a.stretch == b.stretch && near).then_some(b_from_a)
    }

    /// From the view before to this one: matches, and the motion that they refine.
    fn step(&self, to: usize) -> Pair {
        let Some(odometry) = self.odometry(to - 1, to) else {
            return Pair::apart();
        };
        let (a, b) = (&self.ready[to - 1], &self.ready[to]);
        let all = |_: u32| true;
        let rough = match_pair(self, (a, b), &odometry, self.params.turn_sigma_rad, &all);
        match motion::refine(a, b, &rough, &odometry, self.params) {
            Some(refined) => {
                let left_rad = motion::LEFT_OVER * self.params.turn_sigma_rad;
                let matches = match_pair(self, (a, b), &refined, left_rad, &all);
                Pair {
                    b_from_a: Some(refined),
                    matches,
                }
            }
            None => Pair {
                b_from_a: Some(odometry),
                matches: rough,
            },
        }
    }
}
