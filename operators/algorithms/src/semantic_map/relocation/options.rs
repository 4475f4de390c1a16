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

/// The tree that compares two views.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TreeKind {
    /// Each area has one match, and counts by its size and by how small all its differences are.
    #[default]
    Weighted,
    /// The interpretation tree of paper 2, Algorithm 1: areas of one class whose shapes differ by no more than limits
    /// match, wherever they are, and the matched ones are counted.
    Interpretation,
}

/// By how much the shapes of areas that the tree `interpretation` matches differ, at most. The paper leaves the numbers out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ShapeLimits {
    /// The tree `interpretation` matches areas whose eccentricities, sqrt(1 - width² / length²), differ by no more than this;
    /// 1 accepts any.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_eccentricity: f64,
    /// And whose lengths over widths, which the paper calls eccentricity in another section, differ by no more than this. The
    /// default accepts any.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub max_length_over_width: f64,
    /// And whose longer axes differ in direction by no more than this (rad); half of π accepts any.
    #[schemars(range(min = 0.0, max = PI))]
    pub max_orientation_rad: f64,
}

impl Default for ShapeLimits {
    fn default() -> Self {
        Self {
            max_eccentricity: 0.1,
            max_length_over_width: 1e6,
            max_orientation_rad: 0.2,
        }
    }
}

/// How views are compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Options {
    /// The tree that compares two views: `weighted`, or `interpretation`, that of paper 2, which knows class, eccentricity,
    /// orientation and what touches what, and counts matches. Of the other parameters it reads `boundary_factor`,
    /// `field_of_view_rad`, `min_area_share` and `min_matched`.
    pub tree: TreeKind,
    /// What the tree `interpretation` takes for the same shape.
    #[serde(flatten)]
    pub shapes: ShapeLimits,
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
    /// Where two areas touch along more than this (rad), their matches touch, too, and where the matches do, the areas; 0 asks
    /// it of all, null of none.
    #[schemars(range(min = 0.0))]
    pub contact_rad: Option<f64>,
    /// Whether an area of the query may match two of the map's view that together are more like it than either: objects that
    /// are apart there and hide each other here.
    pub fused: bool,
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
            tree: TreeKind::default(),
            shapes: ShapeLimits::default(),
            scales: Scales::default(),
            limit: 4.0,
            max_bearing_rad: 0.75,
            boundary_factor: 8.0,
            contact_rad: None,
            fused: false,
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
