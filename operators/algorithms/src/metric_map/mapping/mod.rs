//! From tracks and rough poses to an accurate map.
//!
//! ```text
//!        tracks, poses of the relaxed graph
//!                     │
//!   ┌─▶ associate ─▶ triangulate, prune ─▶ bundle adjustment ─▶ prune ─┐   the search radius shrinks
//!   └──────────────────────────────────────────────────────────────────┘   from round to round
//!                     │
//!        bundle adjustment once more: poses, landmarks, residuals
//! ```
//!
//! The first round sees poses that are off by what drift the relaxed graph has left: near landmarks appear many
//! pixels away from where they are predicted. Each adjustment brings tracks of different cameras, loops and sessions
//! together, so the next round finds more of them in a smaller circle. Features that do not fit the adjusted map are
//! taken from their landmark; the next round may give them back.
//!
//! Metric scale comes from the rig: what two cameras see at one instant, or one after the other, is some metres of
//! baseline apart, known from calibration. Odometry has one unknown scale per session, held near 1 with a tolerance.

mod adjust;
mod datum;
mod prune;
mod summary;
#[cfg(test)]
mod tests;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::pose::Pose;
use crate::metric_map::association::{
    AssociationParams, DescriptorSource, FeatureRef, Landmark, Scene, associate,
};

pub use adjust::{AdjustParams, Until};
pub use summary::{Candidate, SummaryParams, Touch, summary, touched};

/// How maps are made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MappingParams {
    /// Rounds of association and adjustment, in which the radius falls by equal factors. A fourth one gains nothing: on the
    /// car parks of two programs, with and without revisits, poses were off by 0.33 to 0.42 cm with three rounds, by 0.35 to
    /// 0.45 with four, and by 0.44 to 0.54 with two.
    pub rounds: u32,
    /// Radius around a predicted pixel that the first round searches (px).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub first_radius_px: f64,
    /// Radius that the last round searches (px): some standard deviations of a feature and its prediction.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub last_radius_px: f64,
    /// The rest of association's choices; its radius is not used.
    #[serde(flatten)]
    pub association: AssociationParams,
    /// Features farther from their adjusted landmark than this, in standard deviations, are wrong.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub drop_sigmas: f64,
    /// Landmarks need so many features.
    #[serde(skip)]
    pub min_features: usize,
    /// Rays to a landmark differ by at least this angle (rad).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub min_parallax_rad: f64,
    /// Weights of adjustment.
    #[serde(flatten)]
    pub adjust: AdjustParams,
    /// What is kept of the drives before.
    #[serde(flatten)]
    pub summary: SummaryParams,
}

impl Default for MappingParams {
    fn default() -> Self {
        Self {
            rounds: 3,
            first_radius_px: 12.0,
            last_radius_px: 4.0,
            association: AssociationParams::default(),
            drop_sigmas: 4.0,
            min_features: 3,
            min_parallax_rad: 0.03,
            adjust: AdjustParams::default(),
            summary: SummaryParams::default(),
        }
    }
}

/// What a map is made from.
#[derive(Debug, Clone, Copy)]
pub struct MapInput<'a> {
    /// All that was seen.
    pub scene: &'a Scene,
    /// `map_from_vehicle` of its keyframes, off by less than about half a metre and two degrees.
    pub poses: &'a [Pose],
    /// Landmarks of the version before: names and features; the points are found again.
    pub landmarks: &'a [Landmark],
    /// Features that show one point each, sorted by image. Those that landmarks have already are left to them.
    pub tracks: &'a [Vec<FeatureRef>],
    /// The keyframes whose poses stay, sorted.
    pub fixed: &'a [usize],
    /// Keyframes that say together where the map lies: as one body it is moved until most of them are where they were, the
    /// fixed ones too. Without any, the fixed ones say it.
    pub datum: &'a [usize],
    /// New landmarks are named from here on.
    pub first_new: u32,
}

/// A feature as the adjusted map explains it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapObservation {
    /// The feature.
    pub feature: FeatureRef,
    /// Index of the landmark.
    pub landmark: u32,
    /// Distance to the projected landmark, pixels.
    pub residual_px: f64,
    /// 1 where it counted fully, near 0 where it was found to be false.
    pub weight: f64,
}

/// An accurate map.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Map {
    /// `map_from_vehicle` of the scene's keyframes.
    pub poses: Vec<Pose>,
    /// The landmarks, those of the version before first.
    pub landmarks: Vec<Landmark>,
    /// Their features, in the order of landmarks and images.
    pub observations: Vec<MapObservation>,
    /// By session: true length over the odometry's.
    pub odometry_scales: Vec<f64>,
}

/// Makes a map of a scene whose features are described elsewhere. Without landmarks that can be triangulated the poses stay as
/// they are.
///
/// # Errors
/// As [`DescriptorSource::descriptors`].
pub fn map<E: Send>(
    input: &MapInput<'_>,
    described: &dyn DescriptorSource<E>,
    params: &MappingParams,
) -> Result<Map, E> {
    let MapInput { scene, .. } = *input;
    let mut poses = input.poses.to_vec();
    let mut landmarks = prune::first(input, params);
    for round in 0..params.rounds {
        let radius_px = radius_px(params, round);
        let association = AssociationParams {
            radius_px,
            ..params.association
        };
        let found = associate(scene, described, &poses, &landmarks, &association)?;
        let gate_px = association.agree_px.max(0.75 * radius_px);
        landmarks = prune::prune(scene, &poses, found, gate_px, params);
        let until = params.adjust.between;
        poses = adjust::adjust(input, &poses, &landmarks, &params.adjust, until).poses;
        landmarks = prune::prune(scene, &poses, landmarks, params.drop_px(), params);
    }
    prune::name(&mut landmarks, input.first_new);
    let last = adjust::adjust(
        input,
        &poses,
        &landmarks,
        &params.adjust,
        params.adjust.last,
    );
    let observations = last.observations(&landmarks);
    for (landmark, point) in landmarks.iter_mut().zip(last.points) {
        landmark.point = point;
    }
    let mut map = Map {
        poses: last.poses,
        landmarks,
        observations,
        odometry_scales: last.odometry_scales,
    };
    if !input.datum.is_empty() {
        let of_datum =
            |poses: &[Pose]| -> Vec<Pose> { input.datum.iter().map(|at| poses[*at]).collect() };
        let motion = datum::motion_back(&of_datum(input.poses), &of_datum(&map.poses));
        map.moved(&motion);
    }
    Ok(map)
}

/// From the first to the last radius in equal factors.
impl MappingParams {
    /// How far off the smallest features are dropped, pixels.
    fn drop_px(&self) -> f64 {
        self.drop_sigmas * self.adjust.features.sigma_px
    }
}

fn radius_px(params: &MappingParams, round: u32) -> f64 {
    let steps = params.rounds.saturating_sub(1).max(1);
    let factor = params.last_radius_px / params.first_radius_px;
    params.first_radius_px * factor.powf(f64::from(round) / f64::from(steps))
}
