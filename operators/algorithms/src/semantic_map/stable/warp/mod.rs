//! What stands behind moving things, as other views saw it.
//!
//! Paper 3 (map update with an occlusion model), section II-C1. Its equation 3 lifts a pixel of the reference by the
//! range that was measured there, which on a moving thing is the thing's own: under parallax it hits another place than
//! the one behind the thing. Here the static points of all other views, those of the same drive too, are projected into
//! the reference. The nearest surface that lies behind the moving thing is what it hides, and points of that surface
//! vote, the more the closer to the pixel's centre they fall. Where they do not agree, or one surface ends in front of
//! another, the pixel has no class; what nobody saw stays as it is.

mod near;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::classes::Kinds;
use super::sphere::Lens;
use crate::geometry::pose::Pose;
use crate::semantic_map::semantic_graph::VOID;
use near::Near;

/// What is believed of what other views saw.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Options {
    /// Inverse ranges that differ by no more than this are of one surface (1/m), as votes of neighbouring views have it.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub same_per_m: f64,
    /// A pixel is not clear where the second class has more than this share of the votes of the first: where two areas
    /// meet, while what a labeller mistakes now and then is spread over several classes.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_runner_up: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            same_per_m: 0.005,
            max_runner_up: 0.2,
        }
    }
}

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
/// Of a surface in front of another, a footprint is only this large, as all of its edge would otherwise be as much wider.
/// Many views together leave few gaps, which are filled by the larger one.
const FRONT: f64 = 0.5;
/// Votes fall off from a pixel's centre with this standard deviation, in pixels as the other view sees them.
const SPREAD: f64 = 0.35;
/// What the other view saw so many times more coarsely than the reference would, as it was farther away or has fewer pixels,
/// is too coarse to fill in. A footprint is never larger than this, whatever a lens claims.
const COARSEST: f64 = 6.0;

/// From the pixel that a point appears in no footprint reaches farther (px): half of its size from the point, which is half a
/// pixel from the pixel's centre at most.
const REACH_PX: usize = (0.5 * FOOTPRINT * COARSEST + 0.5) as usize;

/// A static point of another view, in the reference.
#[derive(Debug, Clone, Copy)]
struct Point {
    /// Where it appears (px).
    at: [f32; 2],
    /// One over its range (1/m), 0 for the sky.
    inverse: f32,
    /// Pixels of the reference per pixel of the view that saw it, at least 1.
    coarse: f32,
    class: u8,
}

/// The labels of a view with its moving things replaced by what other views saw behind them, [`VOID`] where that is not
/// clear. Static labels, and what nobody saw, stay. Each other view comes with its pose in the reference's frame.
///
/// A pixel of a far class without range, such as the sky, is at infinity; any other without range is a hole and says
/// nothing, as does a far class where something was measured.
pub fn replaced(
    reference: &LabelledView<'_>,
    others: &[(LabelledView<'_>, Pose)],
    kinds: &Kinds,
    options: &Options,
) -> Vec<u8> {
    let mut labels = reference.labels.to_vec();
    let hidden = Hidden::new(reference, kinds, options.same_per_m as f32);
    let Some(hidden) = hidden else {
        return labels;
    };
    let mut surface = Surface::new(hidden.pixels.len());
    let mut seen = Vec::new();
    for (other, pose) in others {
        hidden.look_through(other, pose, kinds, &mut surface, &mut seen);
    }
    let surface = surface.nearest();
    let told = hidden.told(&seen, &surface, kinds.len(), options.max_runner_up as f32);
    let found = Background {
        hidden: &hidden,
        surface: &surface,
        told: &told,
    };
    for (number, pixel) in hidden.pixels.iter().enumerate() {
        if surface[number] >= 0.0 {
            labels[*pixel] = if found.is_edge(number) {
                VOID
            } else {
                told[number]
            };
        }
    }
    labels
}

/// The pixels of a view's moving things, numbered in order.
struct Hidden<'a> {
    reference: &'a LabelledView<'a>,
    pixels: Vec<usize>,
    /// Number of each pixel of the image; [`STATIC`] for those that do not move.
    numbers: Vec<u32>,
    /// One over the range (1/m) that what is behind each pixel has at most.
    bounds: Vec<f32>,
    same_per_m: f32,
    /// Whether a pixel is one of them or so near to one that a footprint may reach it.
    around: Vec<bool>,
}

const STATIC: u32 = u32::MAX;
/// Of a pixel behind which nothing was seen.
const UNSEEN: f32 = -1.0;

impl<'a> Hidden<'a> {
    /// `None` where nothing moves.
    fn new(reference: &'a LabelledView<'a>, kinds: &Kinds, same_per_m: f32) -> Option<Self> {
        let labels = reference.labels.iter().enumerate();
        let moving = labels.filter(|(_, label)| kinds.is_dynamic(**label));
        let pixels: Vec<usize> = moving.map(|(pixel, _)| pixel).collect();
        pixels.first()?;
        let mut numbers = vec![STATIC; reference.labels.len()];
        for (pixel, number) in pixels.iter().zip(0..) {
            numbers[*pixel] = number;
        }
        let bound = |pixel: &usize| {
            let inverse = reference.inverse(*pixel);
            inverse.map_or(f32::INFINITY, |inverse| inverse + same_per_m)
        };
        let around = near::around(reference.lens, &pixels, REACH_PX);
        Some(Self {
            bounds: pixels.iter().map(bound).collect(),
            reference,
            pixels,
            numbers,
            same_per_m,
            around,
        })
    }

    /// Adds the static points of another view that may be behind something, and the surfaces that they are of.
    fn look_through(
        &self,
        other: &LabelledView<'_>,
        reference_from_other: &Pose,
        kinds: &Kinds,
        surface: &mut Surface,
        seen: &mut Vec<Point>,
    ) {
        let scale = (self.reference.lens.focal[0] / other.lens.focal[0]) as f32;
        let mut near = Near::new(other, reference_from_other, kinds);
        for row in 0..other.lens.height {
            for spot in near.spots(row, self.reference.lens, &self.around) {
                let ranges_m = spot.ranges_m.map(|[there, here]| [there, here.max(1e-6)]);
                let coarse = scale * ranges_m.map_or(1.0, |[there, here]| (there / here).max(1.0));
                if coarse > COARSEST as f32 {
                    continue;
                }
                let point = Point {
                    at: spot.at,
                    inverse: ranges_m.map_or(0.0, |[_, here]| 1.0 / here),
                    coarse: coarse.max(1.0),
                    class: other.labels[row * other.lens.width + spot.column],
                };
                let mut is_behind = false;
                self.splat(&point, |number, away_px| {
                    is_behind = true;
                    surface.add(number, &point, away_px);
                });
                if is_behind {
                    seen.push(point);
                }
            }
        }
    }

    /// What points of that surface say of each pixel; [`VOID`] where there are none, or the
    /// second class has more than this share of the votes of the first.
    fn told(&self, seen: &[Point], surface: &[f32], classes: usize, max_runner_up: f32) -> Vec<u8> {
        let mut votes = vec![0.0_f32; self.pixels.len() * classes];
        for point in seen {
            let spread = SPREAD as f32 * point.coarse;
            self.splat(point, |number, [right, down]| {
                let squared_px = right * right + down * down;
                // Nothing is known at all where there is no surface, and all is in front of that.
                let behind = surface[number] - point.inverse;
                if surface[number] >= 0.0 && behind <= self.same_per_m {
                    let vote = (-0.5 * squared_px / (spread * spread)).exp();
                    votes[number * classes + usize::from(point.class)] +=
                        vote / (point.coarse * point.coarse);
                }
            });
        }
        let winner = |votes: &[f32]| {
            let (mut first, mut second, mut class) = (0.0, 0.0, VOID);
            for (votes, of_class) in votes.iter().copied().zip(0..=u8::MAX) {
                if votes > first {
                    (second, first, class) = (first, votes, of_class);
                } else {
                    second = votes.max(second);
                }
            }
            match second <= max_runner_up * first {
                true => class,
                false => VOID,
            }
        };
        votes.chunks_exact(classes).map(winner).collect()
    }

    /// The hidden pixels in a point's footprint, as far as the point can be behind what hides them, with how far to the right
    /// and below it they are (px).
    fn splat(&self, point: &Point, mut at: impl FnMut(usize, [f32; 2])) {
        let half = (0.5 * FOOTPRINT) as f32 * point.coarse;
        let span = |x: f32| (x - half).ceil() as i64..=(x + half).floor() as i64;
        let [u, v] = point.at;
        for row in span(v) {
            for column in span(u) {
                let Some(pixel) = self.reference.lens.index(column, row) else {
                    continue;
                };
                let number = self.numbers[pixel];
                if number == STATIC || point.inverse > self.bounds[number as usize] {
                    continue;
                }
                at(number as usize, [column as f32 - u, row as f32 - v]);
            }
        }
    }
}

/// One over the range (1/m) of the nearest surface behind each pixel; [`UNSEEN`] where there is none.
struct Surface {
    /// Of points close to its centre.
    close: Vec<f32>,
    /// Of those not far off.
    around: Vec<f32>,
}

impl Surface {
    fn new(pixels: usize) -> Self {
        Self {
            close: vec![UNSEEN; pixels],
            around: vec![UNSEEN; pixels],
        }
    }

    fn add(&mut self, number: usize, point: &Point, away_px: [f32; 2]) {
        let raise = |nearest: &mut f32| *nearest = nearest.max(point.inverse);
        raise(&mut self.around[number]);
        let half = (0.5 * FRONT) as f32 * point.coarse;
        if away_px.iter().all(|away| away.abs() <= half) {
            raise(&mut self.close[number]);
        }
    }

    fn nearest(self) -> Vec<f32> {
        let both = self.close.into_iter().zip(self.around);
        both.map(|(close, around)| if close < 0.0 { around } else { close })
            .collect()
    }
}

/// What is behind pixels, as far as points tell.
struct Background<'a> {
    hidden: &'a Hidden<'a>,
    surface: &'a [f32],
    told: &'a [u8],
}

impl Background<'_> {
    /// Whether a surface ends here in front of another one: the neighbour to some side is of another class, and farther
    /// away. Where exactly it ends, points do not tell to a pixel.
    fn is_edge(&self, number: usize) -> bool {
        let lens = self.hidden.reference.lens;
        let pixel = self.hidden.pixels[number];
        let (column, row) = ((pixel % lens.width) as i64, (pixel / lens.width) as i64);
        let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)];
        beside.into_iter().any(|(right, down)| {
            let Some(next) = lens.index(column + right, row + down) else {
                return false;
            };
            let (class, inverse) = self.at(next);
            let farther = self.surface[number] - inverse > self.hidden.same_per_m;
            class != VOID && class != self.told[number] && farther
        })
    }

    /// What is at a pixel when moving things are gone: its class, and one over its range (1/m).
    fn at(&self, pixel: usize) -> (u8, f32) {
        let reference = self.hidden.reference;
        match self.hidden.numbers[pixel] {
            STATIC => (
                reference.labels[pixel],
                reference.inverse(pixel).unwrap_or(0.0),
            ),
            number => (self.told[number as usize], self.surface[number as usize]),
        }
    }
}
