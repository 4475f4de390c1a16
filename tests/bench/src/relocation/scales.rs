//! How much areas of one thing differ between views, from data: where the default scales come from.

use std::f32::consts::{PI, TAU};

use evermap_algorithms::semantic_map::relocation::{Options, Scales, matched_areas};
use evermap_algorithms::semantic_map::semantic_graph::{Area, Graph};

/// Areas are matched with scales as many times wider than those that are asked for, so that these hardly decide.
const WIDER: f64 = 2.0;
/// Fewer matched areas say nothing.
const LEAST: usize = 20;
/// No scale is smaller.
const SMALLEST: f64 = 1e-3;

/// The scales of pairs of views of the same places, such as consecutive views of a drive or views of two drives: areas are
/// matched by the interpretation tree, with the options' scales twice as wide, and the differences of the matched ones
/// measured. `None` when fewer than 20 areas match.
///
/// The scale of a property is its mean absolute difference, which is what makes a Laplace distribution fit best; the sum of
/// differences in scales is then the negative logarithm of the probability that the two areas show one thing, but for a
/// constant.
pub fn estimate_scales(pairs: &[[&Graph; 2]], options: &Options) -> Option<Scales> {
    let mut wide = options.clone();
    wide.scales.bearing_rad *= WIDER;
    wide.scales.elevation_rad *= WIDER;
    wide.scales.log_size *= WIDER;
    wide.scales.log_elongation *= WIDER;
    wide.scales.orientation_rad *= WIDER;
    let mut sums = [0.0_f64; 5];
    let mut number = 0;
    for [query, view] in pairs {
        for [a, b] in matched_areas(query, view, &wide) {
            let (a, b) = (&query.areas[a], &view.areas[b]);
            let found = [seen(query, a, &wide), seen(view, b, &wide)];
            for (sum, difference) in sums.iter_mut().zip(apart(&found)) {
                *sum += f64::from(difference);
            }
            number += 1;
        }
    }
    let mean = |sum: f64| (sum / number as f64).max(SMALLEST);
    (number >= LEAST).then(|| Scales {
        bearing_rad: mean(sums[0]),
        elevation_rad: mean(sums[1]),
        log_size: mean(sums[2]),
        log_elongation: mean(sums[3]),
        orientation_rad: mean(sums[4]),
    })
}

/// An area as it is seen: angles in radians.
struct Seen {
    bearing: f32,
    elevation: f32,
    log_size: f32,
    log_elongation: f32,
    eccentricity: f32,
    orientation: f32,
}

fn seen(graph: &Graph, area: &Area, options: &Options) -> Seen {
    let rad_per_px = rad_per_px(graph, options);
    Seen {
        bearing: (area.u - (graph.width as f32 - 1.0) / 2.0) * rad_per_px,
        elevation: (area.v - (graph.height as f32 - 1.0) / 2.0) * rad_per_px,
        log_size: (area.pixels.max(1) as f32 * rad_per_px * rad_per_px).ln(),
        log_elongation: area.log_elongation(),
        eccentricity: area.eccentricity,
        orientation: area.orientation_rad,
    }
}

/// The angle between neighbouring columns (rad).
fn rad_per_px(graph: &Graph, options: &Options) -> f32 {
    graph.rad_per_px(options.field_of_view_rad as f32)
}

/// Bearing, elevation, size, elongation, orientation.
fn apart([a, b]: &[Seen; 2]) -> [f32; 5] {
    let turn = (a.bearing - b.bearing).rem_euclid(TAU);
    let tilt = (a.orientation - b.orientation).rem_euclid(PI);
    [
        turn.min(TAU - turn),
        (a.elevation - b.elevation).abs(),
        (a.log_size - b.log_size).abs(),
        (a.log_elongation - b.log_elongation).abs(),
        tilt.min(PI - tilt) * a.eccentricity.min(b.eccentricity).powi(2),
    ]
}
