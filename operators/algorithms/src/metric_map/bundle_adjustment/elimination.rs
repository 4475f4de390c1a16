//! The inner loops of the elimination of landmarks: numbers of one observation, of one landmark,
//! and one row of the reduced system.
//!
//! Every loop is written over arrays whose lengths the compiler knows, so that what is vectorised
//! is compiled once more for processors with wider vectors.

use rayon::prelude::*;

use super::blocks::{Blocks, Row};
use super::schur::{FIXED, Linear, Sight};
use crate::processor::vectorised;
use crate::solving::least_squares::damped_diagonal;

/// One observation's numbers, in the order of landmarks.
#[derive(Clone, Copy)]
pub(super) struct Sighted<const C: usize> {
    pub(super) linear: Linear<C>,
    /// `B = Jₗ L⁻ᵀ`.
    pub(super) eliminated: [[f64; 3]; 2],
}

/// One landmark's numbers. Symmetric and triangular 3 × 3 are `[00, 10, 11, 20, 21, 22]`.
#[derive(Clone, Copy, Default)]
pub(super) struct Point {
    hessian: [f64; 6],
    pub(super) gradient: [f64; 3],
    /// `L`.
    factor: [f64; 6],
    /// `L⁻¹ g`.
    forward: [f64; 3],
    pub(super) step: [f64; 3],
    /// `½ ρ` of its observations.
    pub(super) cost: f64,
}

/// Who sees whom.
pub(super) struct Layout {
    /// By landmark, then by rank of the block; fixed ones last.
    pub(super) sights: Vec<Sight>,
    /// `first[l]..first[l + 1]` are the sights of landmark `l`.
    first: Vec<usize>,
    /// For each block its sights, ascending.
    pub(super) by_block: Vec<Vec<u32>>,
}

impl Layout {
    /// Sights in the order of landmarks, and within one of `rank`, which is given for each block.
    pub(super) fn new(landmarks: usize, mut sights: Vec<Sight>, rank: &[u32]) -> Self {
        sights.par_sort_unstable_by_key(|sight| {
            let rank = rank.get(sight.block as usize).unwrap_or(&FIXED);
            (sight.landmark, *rank, sight.observation)
        });
        let mut first = vec![0; landmarks + 1];
        for sight in &sights {
            first[sight.landmark as usize + 1] += 1;
        }
        for landmark in 0..landmarks {
            first[landmark + 1] += first[landmark];
        }
        let mut by_block = vec![Vec::new(); rank.len()];
        for (place, sight) in sights.iter().enumerate() {
            if let Some(list) = by_block.get_mut(sight.block as usize) {
                list.push(place as u32);
            }
        }
        Self {
            sights,
            first,
            by_block,
        }
    }

    /// Places of the sights of one landmark.
    #[inline]
    pub(super) fn of_landmark(&self, landmark: usize) -> std::ops::Range<usize> {
        self.first[landmark]..self.first[landmark + 1]
    }

    /// Places of the sights of a sight's landmark, from the first of the same block on.
    #[inline]
    fn onward_of_block(&self, place: usize) -> std::ops::Range<usize> {
        let sight = self.sights[place];
        let all = self.of_landmark(sight.landmark as usize);
        let own = self.sights[all.start..place].iter().rev();
        let same = own.take_while(|other| other.block == sight.block).count();
        place - same..all.end
    }

    /// Pairs of observations of one landmark.
    pub(super) fn pairs_of_sights(&self) -> f64 {
        let counts = self.first.windows(2);
        counts
            .map(|range| 0.5 * ((range[1] - range[0]) as f64).powi(2))
            .sum()
    }

    /// Pairs of blocks that see a common landmark or meet in `terms`; smaller first, sorted.
    pub(super) fn meeting<const C: usize>(&self, terms: &Blocks<C>) -> Vec<(u32, u32)> {
        let blocks = self.by_block.len();
        let rows: Vec<Vec<(u32, u32)>> = (0..blocks as u32)
            .into_par_iter()
            .map_init(
                || vec![u32::MAX; blocks],
                |seen, block| {
                    let mut row = Vec::new();
                    for place in &self.by_block[block as usize] {
                        for other in &self.sights[self.onward_of_block(*place as usize)] {
                            if other.block > block
                                && let Some(mark) = seen.get_mut(other.block as usize)
                                && *mark != block
                            {
                                *mark = block;
                                row.push((block, other.block));
                            }
                        }
                    }
                    row
                },
            )
            .collect();
        let given = terms.iter().filter(|(a, b, _)| a != b);
        let given = given.map(|(a, b, _)| (a as u32, b as u32));
        let mut all: Vec<(u32, u32)> = rows.into_iter().flatten().chain(given).collect();
        all.par_sort_unstable();
        all.dedup();
        all
    }
}

/// Landmarks handed to a thread at a time, whatever threads there are.
const CHUNK: usize = 128;

/// Some landmarks, and what is known of each of their observations.
pub(super) struct Piece<'a, T> {
    landmark: usize,
    layout: &'a Layout,
    points: &'a mut [Point],
    sighted: &'a mut [T],
}

/// All landmarks and observations, in pieces for threads to take.
pub(super) fn pieces<'a, T>(
    layout: &'a Layout,
    points: &'a mut [Point],
    mut sighted: &'a mut [T],
) -> Vec<Piece<'a, T>> {
    let mut pieces = Vec::with_capacity(points.len() / CHUNK + 1);
    for (index, points) in points.chunks_mut(CHUNK).enumerate() {
        let landmark = index * CHUNK;
        let count = layout.first[landmark + points.len()] - layout.first[landmark];
        let (own, rest) = std::mem::take(&mut sighted).split_at_mut(count);
        sighted = rest;
        pieces.push(Piece {
            landmark,
            layout,
            points,
            sighted: own,
        });
    }
    pieces
}

impl<T> Piece<'_, T> {
    /// Calls `visit` with each landmark's index, sights and numbers.
    #[inline(always)]
    pub(super) fn each(self, mut visit: impl FnMut(usize, &[Sight], &mut Point, &mut [T])) {
        let start = self.layout.first[self.landmark];
        for (index, point) in self.points.iter_mut().enumerate() {
            let landmark = self.landmark + index;
            let own = self.layout.of_landmark(landmark);
            let sights = &self.layout.sights[own.clone()];
            visit(
                landmark,
                sights,
                point,
                &mut self.sighted[own.start - start..own.end - start],
            );
        }
    }
}

impl<const C: usize> Sighted<C> {
    pub(super) const ZERO: Self = Self {
        linear: Linear::ZERO,
        eliminated: [[0.0; 3]; 2],
    };

    /// `B = Jₗ L⁻ᵀ`, row by row: `L bᵀ = jᵀ`.
    pub(super) fn eliminate(&mut self, point: &Point) {
        self.eliminated = self.linear.landmark.map(|row| forward(&point.factor, row));
    }
}

/// `L⁻¹ b`.
#[inline(always)]
fn forward(l: &[f64; 6], b: [f64; 3]) -> [f64; 3] {
    let x = b[0] / l[0];
    let y = (b[1] - l[1] * x) / l[2];
    [x, y, (b[2] - l[3] * x - l[4] * y) / l[5]]
}

impl Point {
    /// Diagonal of the Hessian.
    #[inline]
    pub(super) fn diagonal(&self) -> [f64; 3] {
        [self.hessian[0], self.hessian[2], self.hessian[5]]
    }

    /// Hessian and gradient from the observations.
    pub(super) fn gather<const C: usize>(&mut self, sighted: &[Sighted<C>]) {
        self.hessian = [0.0; 6];
        self.gradient = [0.0; 3];
        for sighted in sighted {
            let linear = &sighted.linear;
            for (j, r) in linear.landmark.iter().zip(linear.residual) {
                let products = [
                    j[0] * j[0],
                    j[1] * j[0],
                    j[1] * j[1],
                    j[2] * j[0],
                    j[2] * j[1],
                    j[2] * j[2],
                ];
                for (entry, product) in self.hessian.iter_mut().zip(products) {
                    *entry += product;
                }
                for (entry, j) in self.gradient.iter_mut().zip(j) {
                    *entry += j * r;
                }
            }
        }
    }

    /// `L` of the damped Hessian and `L⁻¹ g`. A direction that nothing observes gets a pivot of
    /// 1e-12 of its diagonal instead of one that rounding made negative.
    #[inline]
    pub(super) fn factorise(&mut self, damping: f64) {
        let [a, b, c, d, e, f] = self.hessian;
        let [p, q, r] = [a, c, f].map(|x| x + damping * damped_diagonal(x));
        let root = |pivot: f64, diagonal: f64| pivot.max(1e-12 * diagonal).max(1e-30).sqrt();
        let l00 = root(p, p);
        let (l10, l20) = (b / l00, d / l00);
        let l11 = root(q - l10 * l10, q);
        let l21 = (e - l10 * l20) / l11;
        let l22 = root(r - l20 * l20 - l21 * l21, r);
        self.factor = [l00, l10, l11, l20, l21, l22];
        self.forward = forward(&self.factor, self.gradient);
    }

    /// `J δ - B Σ Bᵀ J δ` of its observations: what a step of the camera side leaves of their motion when the landmark
    /// follows.
    #[inline(always)]
    pub(super) fn follow<const C: usize>(
        sights: &[Sight],
        sighted: &[Sighted<C>],
        moved: &mut [[f64; 2]],
        steps: &[[f64; C]],
    ) {
        let mut sum = [0.0; 3];
        for ((sight, sighted), moved) in sights.iter().zip(sighted).zip(moved.iter_mut()) {
            *moved = [0.0; 2];
            let Some(step) = steps.get(sight.block as usize) else {
                // Fixed ones come last.
                break;
            };
            let rows = sighted.linear.camera.iter().zip(&sighted.eliminated);
            for (moved, (j, b)) in moved.iter_mut().zip(rows) {
                *moved = (0..C).fold(0.0, |sum, c| sum + j[c] * step[c]);
                for (sum, b) in sum.iter_mut().zip(b) {
                    *sum += b * *moved;
                }
            }
        }
        for (sighted, moved) in sighted.iter().zip(moved) {
            for (moved, b) in moved.iter_mut().zip(&sighted.eliminated) {
                *moved -= b[0] * sum[0] + b[1] * sum[1] + b[2] * sum[2];
            }
        }
    }

    /// `δ = -L⁻ᵀ (L⁻¹ g + Σ Bᵀ J δ_block)`.
    pub(super) fn substitute<const C: usize>(
        &mut self,
        sights: &[Sight],
        sighted: &[Sighted<C>],
        steps: &[[f64; C]],
    ) {
        let mut right = self.forward;
        for (sight, sighted) in sights.iter().zip(sighted) {
            let Some(step) = steps.get(sight.block as usize) else {
                continue;
            };
            for (j, b) in sighted.linear.camera.iter().zip(&sighted.eliminated) {
                let moved: f64 = j.iter().zip(step).map(|(j, step)| j * step).sum();
                for (entry, b) in right.iter_mut().zip(b) {
                    *entry += b * moved;
                }
            }
        }
        let l = &self.factor;
        let z = right[2] / l[5];
        let y = (right[1] - l[4] * z) / l[2];
        let x = (right[0] - l[1] * y - l[3] * z) / l[0];
        self.step = [-x, -y, -z];
    }
}

/// Fills one row of the reduced system, as far as it has columns. `places` is scratch, `u32::MAX` throughout before
/// and after: for each block of this row its place in it.
fn fill_row<const C: usize>(
    block: u32,
    row: Row<'_, C>,
    places: &mut [u32],
    layout: &Layout,
    sighted: &[Sighted<C>],
) {
    for (place, column) in row.columns.iter().enumerate() {
        places[*column as usize] = place as u32;
    }
    row.blocks.fill([[0.0; C]; C]);
    vectorised(
        #[inline(always)]
        || {
            for place in &layout.by_block[block as usize] {
                let place = *place as usize;
                let own = &sighted[place];
                for other in layout.onward_of_block(place) {
                    let slot = places.get(layout.sights[other].block as usize);
                    // Fixed ones come last, and before them those of other groups.
                    let Some(target) = slot.and_then(|slot| row.blocks.get_mut(*slot as usize))
                    else {
                        break;
                    };
                    subtract_pair(own, &sighted[other], other == place, target);
                }
            }
        },
    );
    for column in row.columns {
        places[*column as usize] = u32::MAX;
    }
}

/// The part of the reduced system that a matrix has places for: what landmarks say, the terms without them, and what
/// damping adds to the diagonal.
pub(super) fn fill<const C: usize>(
    matrix: &mut Blocks<C>,
    layout: &Layout,
    sighted: &[Sighted<C>],
    (terms, damping): (&Blocks<C>, &[[f64; C]]),
) {
    let blocks = layout.by_block.len();
    matrix
        .rows_mut()
        .into_par_iter()
        .enumerate()
        .with_max_len(8)
        .for_each_init(
            || vec![u32::MAX; blocks],
            |places, (block, row)| fill_row(block as u32, row, places, layout, sighted),
        );
    matrix.add(terms);
    matrix.add_diagonal(damping);
}

/// The landmarks' part of the right-hand side for one block.
pub(super) fn right_of_block<const C: usize>(
    block: usize,
    layout: &Layout,
    sighted: &[Sighted<C>],
    points: &[Point],
) -> [f64; C] {
    let mut right = [0.0; C];
    for place in &layout.by_block[block] {
        let place = *place as usize;
        let point = &points[layout.sights[place].landmark as usize];
        subtract_right(&sighted[place], point, &mut right);
    }
    right
}

/// `b -= Jᵀ (r - B L⁻¹ g)`.
#[inline(always)]
fn subtract_right<const C: usize>(own: &Sighted<C>, point: &Point, right: &mut [f64; C]) {
    let Linear {
        residual, camera, ..
    } = &own.linear;
    for row in 0..2 {
        let b = &own.eliminated[row];
        let moved = b[0] * point.forward[0] + b[1] * point.forward[1] + b[2] * point.forward[2];
        let left = residual[row] - moved;
        for c in 0..C {
            right[c] -= camera[row][c] * left;
        }
    }
}

/// `S -= Jᵒᵀ (Bᵒ Bᵖᵀ - [o = p]) Jᵖ`.
#[inline(always)]
fn subtract_pair<const C: usize>(
    own: &Sighted<C>,
    other: &Sighted<C>,
    same: bool,
    target: &mut [[f64; C]; C],
) {
    let (a, b) = (&own.eliminated, &other.eliminated);
    let one = f64::from(u8::from(same));
    let dot = |x: &[f64; 3], y: &[f64; 3]| x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    let (m00, m01) = (one - dot(&a[0], &b[0]), -dot(&a[0], &b[1]));
    let (m10, m11) = (-dot(&a[1], &b[0]), one - dot(&a[1], &b[1]));
    let (j, k) = (&other.linear.camera[0], &other.linear.camera[1]);
    let top: [f64; C] = std::array::from_fn(|c| m00 * j[c] + m01 * k[c]);
    let bottom: [f64; C] = std::array::from_fn(|c| m10 * j[c] + m11 * k[c]);
    let (j, k) = (&own.linear.camera[0], &own.linear.camera[1]);
    for r in 0..C {
        let entries = &mut target[r];
        for c in 0..C {
            entries[c] += j[r] * top[c] + k[r] * bottom[c];
        }
    }
}
