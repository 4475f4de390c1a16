//! How views are compared.

use std::f64::consts::FRAC_PI_2;

use crate::semantic_map::semantic_graph::VOID;

/// How much areas of one thing differ between two views of one place: mean absolute differences. A difference counts in
/// units of its scale; an infinite scale takes the property out of the comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// Direction of the centre around the vertical, once the views' headings are taken to be equal (rad).
    pub bearing_rad: f64,
    /// Direction of the centre above the horizontal (rad).
    pub elevation_rad: f64,
    /// Natural logarithm of the size.
    pub log_size: f64,
    /// Eccentricity.
    pub eccentricity: f64,
    /// Orientation of the longer axis (rad); counts as much as the rounder area's squared eccentricity says that it has
    /// one.
    pub orientation_rad: f64,
}

impl Default for Scales {
    /// Rounded from what areas differ by between views of a simulated street some 3 m apart, its labels 18 % wrong.
    fn default() -> Self {
        Self {
            bearing_rad: 0.25,
            elevation_rad: 0.06,
            log_size: 0.6,
            eccentricity: 0.15,
            orientation_rad: 0.5,
        }
    }
}

/// How views are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// What counts as a small difference.
    pub scales: Scales,
    /// Two areas may be the same thing while the sum of their differences, in scales, is below this.
    pub limit: f64,
    /// And while their bearings differ by no more than this (rad).
    pub max_bearing_rad: f64,
    /// Two pairs of matched areas that both touch fit while the lengths of their boundaries differ by no more than this
    /// factor; infinite to accept any.
    pub boundary_factor: f64,
    /// Directions from one matched area to another fit while they differ by no more than this many eighths of a turn; 4 to
    /// accept any.
    pub direction_steps: u8,
    /// An area counts as much as its size to this power: 0 makes all equal, as in the paper.
    pub size_power: f64,
    /// Headings of the query relative to the map's views that are tried (rad).
    pub turns_rad: Vec<f64>,
    /// Horizontal field of view of images that are no full panorama (rad).
    pub field_of_view_rad: f64,
    /// Classes that are left out.
    pub ignored: Vec<u8>,
    /// Areas that cover less of the image than this share take no part: the smallest are the least sure to be seen again.
    pub min_area_share: f64,
    /// Matches of fewer areas are not reported.
    pub min_matched: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            scales: Scales::default(),
            limit: 6.0,
            max_bearing_rad: 0.75,
            boundary_factor: 8.0,
            direction_steps: 4,
            size_power: 0.25,
            turns_rad: vec![0.0],
            field_of_view_rad: FRAC_PI_2,
            ignored: Vec::new(),
            min_area_share: 0.002,
            min_matched: 1,
        }
    }
}

impl Options {
    /// For the views of a map: areas of no class can be a query's, which nothing is like, but nobody's match.
    pub(super) fn of_map(&self) -> Self {
        let mut options = self.clone();
        options.ignored.push(VOID);
        options
    }
}
