//! One panorama laid onto another at one size: Gauss–Newton on brightness and inverse range.

use nalgebra::{SMatrix, SVector, Vector3, Vector6};

use super::pyramid::Level;
use crate::geometry::lie::se3;
use crate::geometry::pose::Pose;
use crate::solving::least_squares::Loss;

/// Six of the motion, then gain and offset of brightness.
pub(super) type Normal = SMatrix<f64, 8, 8>;
pub(super) type Unknowns = SVector<f64, 8>;

/// Of normal residuals this Geman–McClure loss loses a fifth of the precision of least squares, and one of ten standard
/// deviations counts a six-hundredth. Huber's, which the paper has, does not do: things that moved are on one side of where
/// they were, and pull together.
const LOSS: Loss = Loss::GemanMcClure(2.0);
/// The median of a normal variable's size is this share of its standard deviation.
const MEDIAN: f64 = 0.674_490;

/// Residuals of inverse range scatter by at least so many pixels' worth of it, which is `1/d` per radian on a plane at a
/// distance d, of 1 m here: most are of the ground, which fits wherever along the street one is, and says nothing.
const LEAST: f64 = 0.05;
/// Inverse ranges of one surface differ by at most so many of these deviations.
const SAME: f64 = 3.0;
/// And those of brightness by one step of it.
const LEAST_GREY: f64 = 1.0;
/// What brightness counts where it is not asked: enough to know gain and offset.
const FAINT: f64 = 1e-6;

/// A point of the reference.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    /// In the reference's optical frame (m).
    pub at: Vector3<f64>,
    pub grey: f32,
    /// Number of the tile of the image that it is in.
    pub tile: u16,
}

/// Tiles along each side of an image, at most.
const TILES: usize = 16;
/// A tile is at least so many pixels high: fewer have no structure of their own.
const TILE_PX: usize = 8;

/// Points of a level, at most about `most`: at equal steps of columns and rows.
pub(super) fn points(level: &Level, most: usize) -> Vec<Point> {
    let (width, height) = (level.lens.width, level.lens.height);
    let step = ((width * height) as f64 / most.max(1) as f64)
        .sqrt()
        .ceil()
        .max(1.0) as usize;
    let tiles = (height / TILE_PX).clamp(1, TILES);
    let mut points = Vec::new();
    for row in (step / 2..height).step_by(step) {
        for column in (step / 2..width).step_by(step) {
            let pixel = row * width + column;
            let inverse = level.inverse[pixel];
            if inverse > 0.0 {
                let tile = row * tiles / height * tiles + column * tiles / width;
                points.push(Point {
                    at: level.lens.ray(column, row) / f64::from(inverse),
                    grey: level.grey[pixel],
                    tile: tile as u16,
                });
            }
        }
    }
    points
}

/// Where the other panorama is thought to be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    pub other_from_reference: Pose,
    /// Brightness there is the first times brightness here, and the second.
    pub brightness: [f64; 2],
}

impl Estimate {
    pub(super) fn moved(&self, step: &Unknowns) -> Self {
        let motion = Vector6::from_fn(|row, _| step[row]);
        let [gain, offset] = self.brightness;
        Self {
            other_from_reference: se3::exp(&motion).compose(&self.other_from_reference),
            brightness: [gain + step[6], offset + step[7]],
        }
    }
}

/// A point as the other panorama sees it.
struct ProjectedPoint {
    /// In the other's optical frame (m).
    at: Vector3<f64>,
    /// Derivatives of the residuals by that point.
    brighter: Vector3<f64>,
    nearer: Vector3<f64>,
    /// Residuals: brightness, inverse range (1/m).
    grey: f64,
    inverse: f64,
    reference_grey: f64,
    tile: u16,
}

/// What residuals are like at an estimate.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fit {
    /// Points that the other sees, of all.
    pub overlap: f64,
    /// Of what those tell of the place on the ground, the share that is as it should be: each counts by how much its
    /// inverse range would change per metre, which for a wall is the more the nearer it is, and for the ground nothing.
    pub inliers: f64,
    /// Correlation of brightness over the points that the other sees, within tiles of the image: light and shade of large
    /// things are alike in many places. `None` where an image has no structure.
    pub correlation: Option<f64>,
    /// Standard deviations of most residuals: brightness, inverse range (1/m).
    pub deviations: [f64; 2],
}

impl Fit {
    /// How well an estimate fits.
    pub fn share(&self) -> f64 {
        self.overlap * self.inliers * self.correlation.map_or(1.0, |alike| alike.max(0.0))
    }
}

/// Room that is used again, and what is asked for.
pub(super) struct Aligner<'a> {
    points: &'a [Point],
    other: &'a Level,
    by_brightness: bool,
    seen: Vec<ProjectedPoint>,
    sizes: Vec<f64>,
}

impl<'a> Aligner<'a> {
    pub fn new(points: &'a [Point], other: &'a Level, by_brightness: bool) -> Self {
        Self {
            points,
            other,
            by_brightness,
            seen: Vec::with_capacity(points.len()),
            sizes: Vec::with_capacity(points.len()),
        }
    }

    /// Looks every point up.
    pub(super) fn see(&mut self, estimate: &Estimate) {
        let (rotation, translation) = (
            estimate.other_from_reference.rotation.to_rotation_matrix(),
            estimate.other_from_reference.translation,
        );
        let [gain, offset] = estimate.brightness;
        let [fx, fy] = self.other.lens.focal;
        self.seen.clear();
        for point in self.points {
            let at = rotation * point.at + translation;
            let level2 = at.x * at.x + at.z * at.z;
            let range2 = level2 + at.y * at.y;
            if level2 < 1e-12 {
                continue;
            }
            let Some(sample) = self.other.sample(self.other.lens.pixel(&at)) else {
                continue;
            };
            let (level, range) = (level2.sqrt(), range2.sqrt());
            let around = Vector3::new(at.z, 0.0, -at.x) * (fx / level2);
            let up =
                Vector3::new(-at.y * at.x / level, level, -at.y * at.z / level) * (fy / range2);
            let along = |[_, du, dv]: [f32; 3]| around * f64::from(du) + up * f64::from(dv);
            let reference_grey = f64::from(point.grey);
            self.seen.push(ProjectedPoint {
                at,
                brighter: along(sample.grey),
                nearer: along(sample.inverse) + at / (range2 * range),
                grey: f64::from(sample.grey[0]) - gain * reference_grey - offset,
                inverse: f64::from(sample.inverse[0]) - 1.0 / range,
                reference_grey,
                tile: point.tile,
            });
        }
    }

    /// What the points are like, seen so.
    fn look(&mut self, estimate: &Estimate) -> Option<Fit> {
        self.see(estimate);
        let least = LEAST * self.pixel_rad();
        let deviations = [
            self.deviation(|seen| seen.grey)?.max(LEAST_GREY),
            self.deviation(|seen| seen.inverse)?.max(least),
        ];
        Some(Fit {
            overlap: self.seen.len() as f64 / self.points.len().max(1) as f64,
            inliers: self.inliers(SAME * least),
            correlation: self.correlation(estimate.brightness),
            deviations,
        })
    }

    /// Of what the points tell of the place, the share whose inverse range is off by no more than this (1/m).
    fn inliers(&self, most: f64) -> f64 {
        let (mut told, mut right) = (0.0, 0.0);
        for seen in &self.seen {
            let tells = seen.nearer.x.hypot(seen.nearer.z);
            told += tells;
            if seen.inverse.abs() <= most {
                right += tells;
            }
        }
        right / told.max(f64::MIN_POSITIVE)
    }

    /// Correlation of brightness within the tiles of the reference; `None` where one of the two has no structure there.
    fn correlation(&self, [gain, offset]: [f64; 2]) -> Option<f64> {
        let mut tiles = vec![(0.0, [0.0; 2], [0.0; 3]); TILES * TILES];
        for seen in &self.seen {
            let here = seen.reference_grey;
            let there = seen.grey + gain * here + offset;
            let (count, sums, products) = &mut tiles[usize::from(seen.tile)];
            *count += 1.0;
            sums[0] += here;
            sums[1] += there;
            products[0] += here * here;
            products[1] += there * there;
            products[2] += here * there;
        }
        let [mut here, mut there, mut both] = [0.0; 3];
        for (count, [first, second], products) in tiles.into_iter().filter(|tile| tile.0 > 1.0) {
            here += products[0] - first * first / count;
            there += products[1] - second * second / count;
            both += products[2] - first * second / count;
        }
        let least = LEAST_GREY * LEAST_GREY * self.seen.len() as f64;
        (here > least && there > least).then(|| both / (here * there).sqrt())
    }

    /// The standard deviation of a residual, from the median of its size.
    fn deviation(&mut self, residual: impl Fn(&ProjectedPoint) -> f64) -> Option<f64> {
        self.sizes.clear();
        self.sizes
            .extend(self.seen.iter().map(|seen| residual(seen).abs()));
        let middle = self.sizes.len() / 2;
        if self.sizes.len() < 16 {
            return None;
        }
        let (_, median, _) = self.sizes.select_nth_unstable_by(middle, f64::total_cmp);
        Some((*median / MEDIAN).max(1e-9))
    }

    /// Both residuals of a point with their derivatives: `(row, residual, weight)`.
    fn rows(&self, seen: &ProjectedPoint, deviations: [f64; 2]) -> [(Unknowns, f64, f64); 2] {
        let row = |by_point: &Vector3<f64>, by_brightness: [f64; 2]| {
            let turn = seen.at.cross(by_point);
            let [gain, offset] = by_brightness;
            Unknowns::from([
                by_point.x, by_point.y, by_point.z, turn.x, turn.y, turn.z, gain, offset,
            ])
        };
        let weight = |residual: f64, deviation: f64| {
            let scaled = residual / deviation;
            LOSS.weight(scaled * scaled) / (deviation * deviation)
        };
        let brightness = if self.by_brightness { 1.0 } else { FAINT };
        [
            (
                row(&seen.brighter, [-seen.reference_grey, -1.0]),
                seen.grey,
                brightness * weight(seen.grey, deviations[0]),
            ),
            (
                row(&seen.nearer, [0.0, 0.0]),
                seen.inverse,
                weight(seen.inverse, deviations[1]),
            ),
        ]
    }

    pub(super) fn normal(&self, deviations: [f64; 2]) -> (Normal, Unknowns) {
        let (mut normal, mut right) = (Normal::zeros(), Unknowns::zeros());
        for seen in &self.seen {
            for (row, residual, weight) in self.rows(seen, deviations) {
                let weighted = row * weight;
                normal.ger(1.0, &weighted, &row, 1.0);
                right -= weighted * residual;
            }
        }
        (normal, right)
    }

    /// Moves an estimate until it rests, at most so many times. Says how it fits then, and whether it rests; `None` where
    /// too little is seen.
    pub fn align(&mut self, mut estimate: Estimate, steps: usize) -> Option<(Estimate, Fit, bool)> {
        // A tenth of a pixel at 1 m.
        let still = 0.1 * self.pixel_rad();
        for _ in 0..steps {
            let fit = self.look(&estimate)?;
            let (normal, right) = self.normal(fit.deviations);
            let step = solved(normal, &right)?;
            estimate = estimate.moved(&step);
            let (rho, phi) = (step.fixed_rows::<3>(0), step.fixed_rows::<3>(3));
            if rho.norm() < still && phi.norm() < 0.1 * still {
                let fit = self.look(&estimate)?;
                return Some((estimate, fit, true));
            }
        }
        let fit = self.look(&estimate)?;
        Some((estimate, fit, false))
    }

    /// What each tile of the image pulls the estimate with; together, the derivative of the loss.
    pub(super) fn pulls(&self, deviations: [f64; 2]) -> Vec<Unknowns> {
        let mut pulls = vec![Unknowns::zeros(); TILES * TILES];
        for seen in &self.seen {
            for (row, residual, weight) in self.rows(seen, deviations) {
                pulls[usize::from(seen.tile)] += row * (weight * residual);
            }
        }
        pulls
    }

    /// What all points would pull with if each inverse range were too large by this share of itself.
    pub(super) fn pull_of_range(&self, deviations: [f64; 2], share: f64) -> Unknowns {
        let mut pull = Unknowns::zeros();
        for seen in &self.seen {
            let [_, (row, _, weight)] = self.rows(seen, deviations);
            pull += row * (weight * share / seen.at.norm());
        }
        pull
    }

    /// The angle between neighbouring pixels of the other (rad).
    pub(super) fn pixel_rad(&self) -> f64 {
        self.other.lens.pixel_rad()
    }
}

/// Units apart by orders of magnitude: scaled to ones on the diagonal first. A brightness without any structure leaves gain
/// and offset undetermined; a millionth keeps them.
pub(super) fn scaled(normal: &Normal) -> Option<(Normal, Unknowns)> {
    let scale = Unknowns::from_fn(|row, _| {
        let diagonal = normal[(row, row)];
        if diagonal > 0.0 {
            1.0 / diagonal.sqrt()
        } else {
            1.0
        }
    });
    let mut ones =
        Normal::from_fn(|row, column| normal[(row, column)] * scale[row] * scale[column]);
    for row in 0..8 {
        ones[(row, row)] += 1e-6;
    }
    ones.iter()
        .all(|value| value.is_finite())
        .then_some((ones, scale))
}

fn solved(normal: Normal, right: &Unknowns) -> Option<Unknowns> {
    let (ones, scale) = scaled(&normal)?;
    let step = ones.cholesky()?.solve(&right.component_mul(&scale));
    Some(step.component_mul(&scale))
}
