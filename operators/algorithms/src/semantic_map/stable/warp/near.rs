//! Which points of another view may appear near a hidden pixel, quickly: most do not.

use std::f32::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;

use super::LabelledView;
use crate::geometry::pose::Pose;
use crate::semantic_map::stable::classes::Kinds;
use crate::semantic_map::stable::sphere::Lens;

/// What a class's pixels say.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Says {
    Nothing,
    /// Where a surface is, if its range was measured.
    Surface,
    /// That there is nothing, if no range was measured.
    Far,
}

/// Points of another view, a row of its image at a time: arrays by column, so that several are computed at once.
pub(super) struct Near<'a> {
    other: &'a LabelledView<'a>,
    says: [Says; 256],
    /// What each column looks along at latitude zero, turned into the reference: x, y, z.
    ahead: [Vec<f32>; 3],
    /// What is below, turned as well.
    below: Vector3<f32>,
    from: Vector3<f32>,
    /// Range of each column's point (m), 1 at infinity and 0 without any.
    range: Vec<f32>,
    /// What the translation counts there: 1, or 0 at infinity.
    counts: Vec<f32>,
    /// Where each column's point appears (px): column and row.
    u: Vec<f32>,
    v: Vec<f32>,
    /// How far it is from the reference (m).
    away: Vec<f32>,
}

/// A point of a row that appears near a hidden pixel.
pub(super) struct Spot {
    pub(super) column: usize,
    /// Where it appears (px): to a thousandth, as columns and rows are small numbers of single precision.
    pub(super) at: [f32; 2],
    /// How far it is from the view that saw it and from the reference (m); `None` at infinity.
    pub(super) ranges_m: Option<[f32; 2]>,
}

impl<'a> Near<'a> {
    pub(super) fn new(
        other: &'a LabelledView<'a>,
        reference_from_other: &Pose,
        kinds: &Kinds,
    ) -> Self {
        let says = |class: u8| match (kinds.is_static(class), kinds.is_far(class)) {
            (false, _) => Says::Nothing,
            (true, false) => Says::Surface,
            (true, true) => Says::Far,
        };
        let rotation = reference_from_other.rotation;
        let lens = other.lens;
        let ahead: Vec<Vector3<f32>> = (0..lens.width)
            .map(|column| (rotation * lens.ahead(column)).cast())
            .collect();
        let empty = || vec![0.0; lens.width];
        Self {
            other,
            says: std::array::from_fn(|class| says(class as u8)),
            ahead: std::array::from_fn(|axis| ahead.iter().map(|ray| ray[axis]).collect()),
            below: (rotation * Vector3::y()).cast(),
            from: reference_from_other.translation.cast(),
            range: empty(),
            counts: empty(),
            u: empty(),
            v: empty(),
            away: empty(),
        }
    }

    /// The points of a row that appear, in an image of this lens, where `around` is true; of points beyond its edge, at the
    /// edge.
    pub(super) fn spots(
        &mut self,
        row: usize,
        lens: &Lens,
        around: &[bool],
    ) -> impl Iterator<Item = Spot> {
        self.measure(row);
        self.place(row, lens);
        let (width, height) = (lens.width as i32, lens.height as i32);
        let round = if lens.wraps { width } else { 0 };
        let places = self.u.iter().zip(&self.v).zip(&self.away);
        let points = self.range.iter().zip(&self.counts).zip(places);
        let found = points.enumerate();
        found.filter_map(move |(column, ((range, counts), ((u, v), away)))| {
            let right = match nearest(*u) {
                left @ ..0 => left + round,
                right if right >= width => right - round,
                right => right,
            };
            // A footprint reaches in from beyond the edge.
            let (right, down) = (right.clamp(0, width - 1), nearest(*v).clamp(0, height - 1));
            let is_near = *range > 0.0 && around[(down * width + right) as usize];
            let at = [*u, *v];
            (is_near && at.iter().all(|x| x.is_finite())).then(|| Spot {
                column,
                at,
                ranges_m: (*counts > 0.0).then_some([*range, *away]),
            })
        })
    }

    fn measure(&mut self, row: usize) {
        let (view, width) = (self.other, self.other.lens.width);
        let unit_m = view.unit_m as f32;
        let pixels = row * width..(row + 1) * width;
        let seen = view.labels[pixels.clone()].iter().zip(&view.range[pixels]);
        let points = self.range.iter_mut().zip(&mut self.counts).zip(seen);
        for ((range, counts), (label, units)) in points {
            (*range, *counts) = match (self.says[usize::from(*label)], units) {
                (Says::Surface, 1..) => (f32::from(*units) * unit_m, 1.0),
                (Says::Far, 0) => (1.0, 0.0),
                _ => (0.0, 0.0),
            };
        }
    }

    fn place(&mut self, row: usize, lens: &Lens) {
        let [up, level] = self.other.lens.latitude(row).map(|x| x as f32);
        let (below, from) = (self.below * up, self.from);
        let [cx, cy] = lens.centre.map(|x| x as f32);
        let [fx, fy] = lens.focal.map(|x| x as f32);
        let [xs, ys, zs] = &self.ahead;
        let rays = xs.iter().zip(ys).zip(zs);
        let points = rays.zip(self.range.iter().zip(&self.counts));
        let places = self.u.iter_mut().zip(&mut self.v).zip(&mut self.away);
        for ((((x, y), z), (range, counts)), ((u, v), away)) in points.zip(places) {
            let x = (x * level + below.x) * range + from.x * counts;
            let y = (y * level + below.y) * range + from.y * counts;
            let z = (z * level + below.z) * range + from.z * counts;
            *u = cx + fx * angle(x, z);
            let level2 = x * x + z * z;
            *v = cy + fy * angle(y, level2.sqrt());
            *away = (level2 + y * y).sqrt();
        }
    }
}

/// Of the arctangent's powers 3, 5 … 17, over the first.
const TERMS: [f32; 8] = [
    -0.333_331_45,
    0.199_935_51,
    -0.142_089,
    0.106_562_64,
    -0.075_289_64,
    0.042_909_614,
    -0.016_165_737,
    0.002_866_225_7,
];

/// The whole number nearest to one that is at least -1.5; some negative number below that.
fn nearest(x: f32) -> i32 {
    ((x + 1.5) as i32).saturating_sub(1)
}

/// The angle whose tangent is `y` over `x`, in all four quadrants, as exactly as single precision has it, without a branch, so
/// that several are computed at once. M. Abramowitz, I. Stegun: *Handbook of Mathematical Functions*, 1964, 4.4.49: the
/// polynomial is wrong by 2·10⁻⁸ rad at most.
fn angle(y: f32, x: f32) -> f32 {
    let (least, most) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    let ratio = least / most.max(f32::MIN_POSITIVE);
    let squared = ratio * ratio;
    let behind = TERMS
        .iter()
        .rev()
        .fold(0.0, |sum, term| squared * (term + sum));
    let eighth = ratio + ratio * behind;
    let quarter = if y.abs() > x.abs() {
        FRAC_PI_2 - eighth
    } else {
        eighth
    };
    let half = if x < 0.0 { PI - quarter } else { quarter };
    half.copysign(y)
}

/// Whether each pixel is at most so many columns and rows from one of these.
pub(super) fn around(lens: &Lens, pixels: &[usize], reach: usize) -> Vec<bool> {
    let (width, height) = (lens.width, lens.height);
    let mut beside = vec![false; width * height];
    for pixel in pixels {
        let (row, column) = (pixel / width, (pixel % width) as i64);
        for column in column - reach as i64..=column + reach as i64 {
            if let Some(pixel) = lens.index(column, row as i64) {
                beside[pixel] = true;
            }
        }
    }
    let mut around = vec![false; width * height];
    for row in 0..height {
        let rows = row.saturating_sub(reach)..(row + reach + 1).min(height);
        let here = &mut around[row * width..(row + 1) * width];
        for other in rows {
            let there = &beside[other * width..(other + 1) * width];
            for (here, there) in here.iter_mut().zip(there) {
                *here |= there;
            }
        }
    }
    around
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::f32::consts::FRAC_PI_4;

    use super::*;

    /// Points of the first row appear a row above the image; and a forged lens shows them nowhere, without a panic.
    #[test]
    fn points_beyond_the_edge_may_reach_in() {
        let lens = |cy: f64| Lens::new([8, 4], [1.27, 1.27], [3.5, cy]).unwrap();
        let kinds = Kinds::new(&["wall".to_owned()], &[], &[]).unwrap();
        let (labels, range) = ([0; 32], [2000; 32]);
        let other = LabelledView {
            lens: &lens(1.5),
            labels: &labels,
            range: &range,
            unit_m: 0.001,
        };
        let mut near = Near::new(&other, &Pose::identity(), &kinds);
        let top: Vec<bool> = (0..32).map(|pixel| pixel < 8).collect();
        assert_eq!(near.spots(0, &lens(0.5), &top).count(), 8);
        assert_eq!(near.spots(3, &lens(0.5), &top).count(), 0);
        for centre in [-1e300, -1e30, 1e30, 1e300] {
            assert_eq!(near.spots(0, &lens(centre), &[false; 32]).count(), 0);
        }
    }

    #[test]
    fn angles_are_those_of_the_arctangent() {
        for step in -1000..=1000 {
            let exact = step as f32 / 1000.0 * PI;
            let found = angle(3.0 * exact.sin(), 3.0 * exact.cos());
            let off = (found - exact).abs().min(2.0 * PI - (found - exact).abs());
            assert!(off < 1e-6, "{exact}: {found}");
        }
        assert_eq!(angle(0.0, 0.0), 0.0);
        assert!((angle(1.0, 1.0) - FRAC_PI_4).abs() < 1e-6);
    }
}
