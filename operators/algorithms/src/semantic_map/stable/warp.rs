//! What stands behind moving things, as other views saw it.
//!
//! Paper 3 (map update with an occlusion model), section II-C1. Its equation 3 lifts a pixel of the reference by the
//! range that was measured there, which on a moving thing is the thing's own: under parallax it hits another place than
//! the one behind the thing. Here the static points of the other view are projected into the reference instead, the
//! nearest one that lies behind the moving thing is what it hides, and what nobody saw stays as it is.

use nalgebra::Vector3;

use super::classes::Kinds;
use super::sphere::Lens;
use crate::geometry::pose::Pose;

/// A view with its labels and ranges, of its lens's size, row by row.
#[derive(Debug, Clone, Copy)]
pub struct LabelledView<'a> {
    /// Where its pixels look.
    pub lens: &'a Lens,
    /// Class of each pixel, as [`Kinds`] numbers them.
    pub labels: &'a [u8],
    /// Distance along the ray, in units of `unit_m`; 0 where nothing was measured.
    pub range: &'a [u16],
    /// Metres per unit.
    pub unit_m: f64,
}

impl LabelledView<'_> {
    /// Whether images have the lens's size and range a unit.
    pub fn is_sound(&self) -> bool {
        let pixels = self.lens.width * self.lens.height;
        let sized = self.labels.len() == pixels && self.range.len() == pixels;
        sized && self.unit_m > 0.0 && self.unit_m.is_finite()
    }

    /// One over the range of a pixel (1/m); `None` where nothing was measured.
    fn inverse(&self, pixel: usize) -> Option<f32> {
        let units = self.range[pixel];
        (units > 0).then(|| (1.0 / (f64::from(units) * self.unit_m)) as f32)
    }
}

/// A point's footprint is its pixel as seen from the reference, this much larger: neighbours then leave no gaps where the
/// grid is turned or stretched by less than half.
const FOOTPRINT: f64 = 1.5;
/// What the other view saw so many times more coarsely than the reference would, as it was farther away or has fewer pixels,
/// is too coarse to fill in. A footprint is never larger than this, whatever a lens claims.
const COARSEST: f64 = 6.0;

/// What is behind one pixel: one over its range (1/m, 0 for the sky), and its class.
#[derive(Debug, Clone, Copy)]
struct Behind {
    inverse: f32,
    class: u8,
}

/// The labels of a view with its moving things replaced by what other views saw behind them: by the class of the nearest
/// surface, as most views that see it have it (of equal numbers, the first class). Static labels, and what nobody saw,
/// stay. Each other view comes with its pose in the reference's frame; `same_per_m` is by how much inverse ranges of one
/// surface may differ (1/m).
///
/// A pixel of a far class without range, such as the sky, is at infinity; any other without range is a hole and says
/// nothing, as does a far class where something was measured.
pub fn replaced(
    reference: &LabelledView<'_>,
    others: &[(LabelledView<'_>, Pose)],
    kinds: &Kinds,
    same_per_m: f64,
) -> Vec<u8> {
    let mut labels = reference.labels.to_vec();
    let moving: Vec<bool> = labels
        .iter()
        .map(|label| kinds.is_dynamic(*label))
        .collect();
    if !moving.contains(&true) {
        return labels;
    }
    let seen: Vec<Vec<Option<Behind>>> = others
        .iter()
        .map(|(other, pose)| behind(reference, &moving, other, pose, kinds, same_per_m as f32))
        .collect();
    let mut votes = [0_u32; 256];
    for (pixel, label) in labels
        .iter_mut()
        .enumerate()
        .filter(|(pixel, _)| moving[*pixel])
    {
        let at = || seen.iter().filter_map(|view| view[pixel]);
        let Some(nearest) = at().map(|behind| behind.inverse).reduce(f32::max) else {
            continue;
        };
        votes.fill(0);
        at().filter(|behind| nearest - behind.inverse <= same_per_m as f32)
            .for_each(|behind| votes[usize::from(behind.class)] += 1);
        let most = votes.iter().copied().max().unwrap_or(0);
        if let Some(class) = votes.iter().position(|count| *count == most) {
            *label = class as u8;
        }
    }
    labels
}

/// The other view's nearest static point at each pixel of the reference, behind the moving thing that is there.
fn behind(
    reference: &LabelledView<'_>,
    moving: &[bool],
    other: &LabelledView<'_>,
    reference_from_other: &Pose,
    kinds: &Kinds,
    same_per_m: f32,
) -> Vec<Option<Behind>> {
    let mut nearest: Vec<Option<Behind>> = vec![None; moving.len()];
    // Nothing nearer than this can be behind the thing.
    let bounds: Vec<f32> = (0..moving.len())
        .map(|pixel| {
            reference
                .inverse(pixel)
                .map_or(f32::INFINITY, |inverse| inverse + same_per_m)
        })
        .collect();
    let rotation = reference_from_other.rotation.to_rotation_matrix();
    let from = reference_from_other.translation;
    let scale = reference.lens.focal[0] / other.lens.focal[0];
    for row in 0..other.lens.height {
        for column in 0..other.lens.width {
            let pixel = row * other.lens.width + column;
            let class = other.labels[pixel];
            if !kinds.is_static(class) {
                continue;
            }
            let ray: Vector3<f64> = rotation * other.lens.ray(column, row);
            let (point, range, stretch) = match (other.inverse(pixel), kinds.is_far(class)) {
                (Some(inverse), false) => {
                    let range = 1.0 / f64::from(inverse);
                    let point = ray * range + from;
                    let here = point.norm();
                    (point, here, range / here.max(1e-6))
                }
                (None, true) => (ray, f64::INFINITY, 1.0),
                _ => continue,
            };
            let coarse = scale * stretch.max(1.0);
            if coarse > COARSEST {
                continue;
            }
            let found = Behind {
                inverse: (1.0 / range) as f32,
                class,
            };
            let half = 0.5 * FOOTPRINT * coarse;
            splat(reference.lens, reference.lens.pixel(&point), half, |at| {
                let free = nearest[at].is_none_or(|known| known.inverse < found.inverse);
                if moving[at] && free && found.inverse <= bounds[at] {
                    nearest[at] = Some(found);
                }
            });
        }
    }
    nearest
}

/// The pixels around a place.
fn splat(lens: &Lens, [u, v]: [f64; 2], half: f64, mut at: impl FnMut(usize)) {
    let span = |x: f64| (x - half).ceil() as i64..=(x + half).floor() as i64;
    for row in span(v) {
        for column in span(u) {
            if let Some(pixel) = lens.index(column, row) {
                at(pixel);
            }
        }
    }
}
