//! How views are compared.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::semantic_map::semantic_graph::VOID;

/// How much areas of one thing differ between two views of one place: mean absolute differences. A difference counts in
/// units of its scale; a scale of 0 takes the property out of the comparison.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Scales {
    /// Scale of differences of bearing, the direction of the centre around the vertical (rad): their mean between views of
    /// one place. 0 leaves bearing out.
    #[schemars(range(min = 0.0))]
    pub bearing_rad: f64,
    /// Scale of differences of elevation, the direction of the centre above the horizontal (rad). 0 leaves it out.
    #[schemars(range(min = 0.0))]
    pub elevation_rad: f64,
    /// Scale of differences of the natural logarithm of the size. 0 leaves it out.
    #[schemars(range(min = 0.0))]
    pub log_size: f64,
    /// Scale of differences of the natural logarithm of length over width, which still tells long areas apart where the
    /// eccentricity of all is nearly 1. 0 leaves it out.
    #[schemars(range(min = 0.0))]
    pub log_elongation: f64,
    /// Scale of differences of the longer axis's orientation (rad), which count as much as the rounder area's squared
    /// eccentricity says that it has one. 0 leaves it out.
    #[schemars(range(min = 0.0))]
    pub orientation_rad: f64,
}

impl Default for Scales {
    /// Rounded from what areas differ by between views of a simulated street some 3 m apart, its labels 18 % wrong; of
    /// bearing two thirds, as the heading is fitted first.
    fn default() -> Self {
        Self {
            bearing_rad: 0.15,
            elevation_rad: 0.06,
            log_size: 0.6,
            log_elongation: 0.5,
            orientation_rad: 0.5,
        }
    }
}

/// What a difference is divided by: a scale, or infinity where the property is left out.
pub(super) fn divisor(scale: f64) -> f64 {
    if scale > 0.0 { scale } else { f64::INFINITY }
}

/// How views are compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Options {
    /// What counts as a small difference.
    #[serde(flatten)]
    pub scales: Scales,
    /// Two areas may be the same while the sum of their differences, in scales, is below this.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub limit: f64,
    /// And while their bearings differ by no more than this (rad): by default three scales.
    #[schemars(range(min = 0.0, max = TAU))]
    pub max_bearing_rad: f64,
    /// The lengths of the boundaries of matched areas that touch differ by no more than this factor, which 95 in 100 do
    /// between views 3 m apart.
    #[schemars(range(min = 0.0))]
    pub boundary_factor: f64,
    /// Directions between matched areas differ by no more than so many eighths of a turn; 4 accepts any. Worth setting to 1
    /// where bearings are left out.
    pub direction_steps: u8,
    /// An area counts as much as its size to this power. 0 makes all equal, as in the paper.
    #[schemars(range(min = 0.0, max = 2.0))]
    pub size_power: f64,
    /// Headings of the query relative to the map's views that are tried, at equal steps of the full turn: 24 finds any, 1
    /// expects views to look the same way, 2 also the opposite one.
    #[schemars(range(min = 1, max = 360))]
    pub headings: u32,
    /// Horizontal field of view of views whose calibration is not known and that are no full panorama (rad).
    #[schemars(range(min = 0.0, max = TAU))]
    pub field_of_view_rad: f64,
    /// Areas that cover less of the image than this share take no part in the search: they are the first to be seen
    /// differently.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_area_share: f64,
    /// Of the views that the search finds, the best so many are compared again with areas of any size, which tell places
    /// apart, at the heading at which their areas fit best. 0: the search alone decides.
    #[schemars(range(min = 0, max = 10_000))]
    pub candidates: u32,
    /// Views with fewer matched areas are not given.
    pub min_matched: u32,
    /// Classes that are left out.
    #[serde(skip)]
    pub ignored: Vec<u8>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            scales: Scales::default(),
            limit: 4.0,
            max_bearing_rad: 0.75,
            boundary_factor: 8.0,
            direction_steps: 4,
            size_power: 0.15,
            headings: 24,
            field_of_view_rad: FRAC_PI_2,
            min_area_share: 0.002,
            candidates: 32,
            min_matched: 1,
            ignored: Vec::new(),
        }
    }
}

impl Options {
    /// The headings that are tried, from straight ahead on (rad); in (-π, π].
    pub(super) fn turns_rad(&self) -> impl Iterator<Item = f64> {
        let step = TAU / f64::from(self.headings);
        let turn = move |heading: u32| f64::from(heading) * step;
        let wrapped = |turn: f64| if turn > PI { turn - TAU } else { turn };
        (0..self.headings).map(turn).map(wrapped)
    }

    /// With areas of any size.
    pub(super) fn of_any_size(&self) -> Self {
        Self {
            min_area_share: 0.0,
            ..self.clone()
        }
    }

    /// For the views of a map: areas of no class can be a query's, which nothing is like, but nobody's match.
    pub(super) fn of_map(&self) -> Self {
        let mut options = self.clone();
        options.ignored.push(VOID);
        options
    }
}
