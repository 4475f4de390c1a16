//! Two areas of a view that are one in another: objects of a class that are apart here and hide each other there.
//!
//! Paper 2 (metric-topological-semantic map), section IV-A. Together they have the pixels of both, and the ellipse of their
//! second moments, as if they touched.

use super::description::{AreaCode, Image, LANES};
use super::options::Options;
use crate::semantic_map::semantic_graph::{Area, Graph, offset};

/// The areas of all views as they are, in the lanes of their blocks.
#[derive(Debug, Clone)]
pub(super) struct ApartAreas {
    options: Options,
    /// `None` in lanes without an area.
    areas: Vec<Option<Area>>,
    /// Of each block.
    images: Vec<Image>,
}

impl ApartAreas {
    pub(super) fn new(options: &Options) -> Self {
        Self {
            options: options.clone(),
            areas: Vec::new(),
            images: Vec::new(),
        }
    }

    /// Adds a view's areas, in some order, from a new block on.
    pub(super) fn append(&mut self, graph: &Graph, order: &[usize]) {
        let areas = order.iter().map(|area| Some(graph.areas[*area]));
        self.areas.extend(areas);
        let blocks = self.areas.len().div_ceil(LANES);
        self.areas.resize(blocks * LANES, None);
        self.images.resize(blocks, Image::new(graph, &self.options));
    }

    /// Two areas of one view as one.
    pub(super) fn joined(&self, a: usize, b: usize) -> Option<AreaCode> {
        let (first, second) = (self.areas[a]?, self.areas[b]?);
        let image = &self.images[a / LANES];
        let both = joined(&first, &second, image.circle_px);
        Some(image.code(&both, &self.options.scales))
    }
}

/// Two areas of a class as one.
fn joined(a: &Area, b: &Area, circle_px: Option<f32>) -> Area {
    let pixels = a.pixels.saturating_add(b.pixels);
    let share = b.pixels as f32 / pixels.max(1) as f32;
    let [right, down] = offset([a.u, a.v], [b.u, b.v], circle_px);
    let (of_a, of_b) = (moments(a), moments(b));
    let between = [right * right, right * down, down * down];
    let [uu, uv, vv] = [0, 1, 2].map(|at| {
        of_a[at] * (1.0 - share) + of_b[at] * share + between[at] * share * (1.0 - share)
    });
    let (mean, half) = ((uu + vv) / 2.0, ((uu - vv) / 2.0).hypot(uv));
    let (large, small) = (mean + half, (mean - half).max(0.0));
    Area {
        class: a.class,
        pixels,
        u: a.u + right * share,
        v: a.v + down * share,
        major_px: 2.0 * large.sqrt(),
        minor_px: 2.0 * small.sqrt(),
        orientation_rad: 0.5 * (2.0 * uv).atan2(uu - vv),
        eccentricity: if large > 0.0 {
            (1.0 - small / large).max(0.0).sqrt()
        } else {
            0.0
        },
    }
}

/// Central second moments: along the rows, mixed, and down the columns (px²). Half an axis is two deviations.
fn moments(area: &Area) -> [f32; 3] {
    let (large, small) = ((area.major_px / 2.0).powi(2), (area.minor_px / 2.0).powi(2));
    let (sin, cos) = area.orientation_rad.sin_cos();
    [
        large * cos * cos + small * sin * sin,
        (large - small) * sin * cos,
        large * sin * sin + small * cos * cos,
    ]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::semantic_map::semantic_graph::{GraphOptions, Labels};

    /// A labelled image's area of class 1, of which some columns may be no class.
    fn areas(hidden: std::ops::Range<usize>) -> Vec<Area> {
        let shape = |at: usize| {
            let (u, v) = ((at % 40) as i32, (at / 40) as i32);
            let inside = (8..30).contains(&u) && (v - u / 2 - 2).abs() < 5;
            u8::from(inside && !hidden.contains(&(u as usize)))
        };
        let values: Vec<u8> = (0..40 * 30).map(shape).collect();
        let labels = Labels {
            width: 40,
            height: 30,
            values: &values,
        };
        let options = GraphOptions {
            classes: 2,
            wraps: false,
            min_px: 1,
        };
        let graph = Graph::from_labels(&labels, &options).unwrap();
        let of_class = graph.areas.into_iter().filter(|area| area.class == 1);
        of_class.collect()
    }

    /// Two halves side by side are the whole: cut in two images, as they would be one area in one.
    #[test]
    fn halves_are_the_whole() {
        let [whole] = areas(0..0).try_into().unwrap();
        let [left] = areas(17..40).try_into().unwrap();
        let [right] = areas(0..17).try_into().unwrap();
        for both in [joined(&left, &right, None), joined(&right, &left, None)] {
            assert_eq!(both.pixels, whole.pixels);
            for (found, expected) in [
                (both.u, whole.u),
                (both.v, whole.v),
                (both.major_px, whole.major_px),
                (both.minor_px, whole.minor_px),
                (both.orientation_rad, whole.orientation_rad),
                (both.eccentricity, whole.eccentricity),
            ] {
                assert!((found - expected).abs() < 2e-2, "{both:?} {whole:?}");
            }
        }
        // Across the seam of a panorama of 40 columns.
        let mut turned = [left, right];
        turned
            .iter_mut()
            .for_each(|area| area.u = (area.u + 22.0) % 40.0);
        let both = joined(&turned[0], &turned[1], Some(40.0));
        assert!((both.major_px - whole.major_px).abs() < 2e-2, "{both:?}");
        let apart = (both.u - whole.u - 22.0 + 20.0).rem_euclid(40.0) - 20.0;
        assert!(apart.abs() < 2e-2, "{both:?}");
    }
}
