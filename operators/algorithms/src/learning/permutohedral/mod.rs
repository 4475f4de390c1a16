//! Gaussian filters in many dimensions, in time linear in the number of values: the permutohedral lattice.
//!
//! Andrew Adams, Jongmin Baek, Myers Abraham Davis: *Fast High-Dimensional Filtering Using the Permutohedral
//! Lattice*, Eurographics 2010. Values at scattered positions are *splatted* onto the corners of the simplex that they
//! lie in, the lattice is *blurred* along each of its axes, and the result is *sliced* out at the positions again:
//!
//! ```text
//! out(i) ≈ Σ_j exp(-|p_i - p_j|² / 2) in(j)        positions p in units of the filter's standard deviation
//! ```
//! The approximation is that of the reference implementation of dense random fields (Krähenbühl and Koltun 2011): the
//! same simplices, the same weights, the same order of axes, the same constant. Values differ by rounding alone.
//!
//! What depends on the positions alone is computed once ([`Lattice::new`]); any number of values can then be filtered.
//! All channels of a value are worked on at once, eight to a vector. Positions in one simplex share the entry that
//! says where its corners are, so that a lattice is small where positions lie densely.

#![allow(
    clippy::needless_range_loop,
    reason = "an index over lanes is what becomes one vector instruction"
)]

mod blur;
mod embedding;
mod grouping;
mod table;
#[cfg(test)]
mod tests;
mod value;

pub use blur::Buffer;
pub use value::{Eight, Value};

use embedding::{Embedding, LANES};
use grouping::Grouping;
use table::{Key, Keys, hashes};

use crate::processor::vectorised;

/// Positions that are splatted and sliced together: the n-th block is of the positions from `n · BLOCK` on. Positions of
/// one block that share a simplex are worked on one after the other, while its corners are at hand; it pays to give
/// positions in such an order that neighbours are in one block.
pub const BLOCK: usize = 256;

/// Lattice coordinates beyond this are refused: single precision would no longer tell neighbours apart.
const MOST_CELLS: f32 = 1e5;

/// Why positions make no lattice.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LatticeError {
    /// The coordinates do not go together.
    #[error(
        "expected {expected} coordinates of {positions} positions each, found {found} coordinates"
    )]
    Shape {
        /// Dimensions of the lattice.
        expected: usize,
        /// Positions that the first coordinate has.
        positions: usize,
        /// Coordinates given.
        found: usize,
    },
    /// A position is not finite, or farther away than the lattice can count.
    #[error("expected positions within ±{MOST_CELLS} standard deviations, found {found}")]
    Position {
        /// The coordinate.
        found: f32,
    },
    /// There are more positions than indices.
    #[error("expected fewer than 2³¹ positions, found {found}")]
    Count {
        /// Positions given.
        found: usize,
    },
}

/// The lattice around a set of positions. `V` is the number of a simplex's corners: the positions' dimensions and one.
#[derive(Debug, Clone, PartialEq)]
pub struct Lattice<const V: usize> {
    /// Which positions of each block are in which simplex, and where in it.
    grouping: Grouping<V>,
    /// Of each simplex: its corners. Corner 0 stands for "not in the lattice".
    corners: Vec<[u32; V]>,
    /// Along each axis, of each corner: the corners before and after it.
    neighbours: Vec<Vec<[u32; 2]>>,
}

impl<const V: usize> Lattice<V> {
    /// The lattice around positions, given as one list per coordinate, in units of the standard deviation.
    ///
    /// # Errors
    /// [`LatticeError`] for lists of other lengths or another number, and for positions that are not finite.
    pub fn new(coordinates: &[&[f32]]) -> Result<Self, LatticeError> {
        Self::build(coordinates, None)
    }

    /// The same, where the first coordinate runs around a circle of [`periods`](Self::period) cells. There must be two
    /// coordinates at least, and one cell.
    ///
    /// # Errors
    /// As [`Lattice::new`].
    pub fn periodic(coordinates: &[&[f32]], cells: u32) -> Result<Self, LatticeError> {
        Self::build(coordinates, (V > 2 && cells > 0).then_some(cells))
    }

    /// Length of a circle of `cells` cells, in units of the standard deviation: a translation of the first coordinate
    /// by it maps the lattice onto itself, so that the filter goes around without a seam.
    pub fn period(cells: u32) -> f64 {
        f64::from(cells) * 3f64.sqrt()
    }

    fn build(coordinates: &[&[f32]], cells: Option<u32>) -> Result<Self, LatticeError> {
        let positions = checked::<V>(coordinates)?;
        let period = cells.map(|cells| (cells.min(1 << 20) * V as u32) as i32);
        let (grouping, simplices) = embed(coordinates, positions, period);
        let mut lattice = Self {
            grouping,
            corners: Vec::new(),
            neighbours: Vec::new(),
        };
        let points = lattice.number(&simplices, period);
        lattice.neighbours = blur::neighbours(&points, period);
        Ok(lattice)
    }

    /// Numbers the corners of all simplices from 1.
    fn number(&mut self, simplices: &Keys<V>, period: Option<i32>) -> Keys<V> {
        let mut points = Keys::with_room(simplices.len());
        // Corner 0 is nobody: no corner of the lattice has coordinates that do not sum to zero.
        points.insert(&[1; V]);
        self.corners = (0..simplices.len())
            .map(|simplex| {
                let key = simplices.key(simplex);
                std::array::from_fn(|remainder| {
                    let mut corner = embedding::corner(key, remainder);
                    wrap_one(&mut corner, period);
                    points.insert(&corner)
                })
            })
            .collect();
        points
    }

    /// Number of positions.
    pub fn len(&self) -> usize {
        self.grouping.len()
    }

    /// Whether there are no positions.
    pub fn is_empty(&self) -> bool {
        self.grouping.len() == 0
    }

    /// Number of the lattice's corners, with the one that stands for none.
    pub fn corners(&self) -> usize {
        self.neighbours.first().map_or(1, Vec::len)
    }

    /// Number of simplices that hold a position.
    pub fn simplices(&self) -> usize {
        self.corners.len()
    }

    /// Multiplies the weights of each position by one over the root of what the filter makes of ones there: values then
    /// count that much when they are splatted, and again when they are sliced.
    pub fn normalise(&mut self) {
        let buffer = self.buffer();
        vectorised(
            #[inline(always)]
            || self.normalise_in(buffer),
        );
    }

    #[inline(always)]
    fn normalise_in(&mut self, mut ones: Buffer<f32>) {
        for block in 0..self.len().div_ceil(BLOCK) {
            self.splat(block, &[1.0; BLOCK], ones.values_mut());
        }
        self.blur(&mut ones, self.constant());
        for (simplex, members) in self.grouping.all_mut() {
            let corners = self.corners[simplex].map(|corner| ones.values()[corner as usize]);
            for (_, weights) in members {
                let mut sum = 0.0;
                for corner in 0..V {
                    sum.add_scaled(weights[corner], &corners[corner]);
                }
                let factor = 1.0 / (sum + 1e-20).sqrt();
                for weight in weights {
                    *weight *= factor;
                }
            }
        }
    }

    /// Filters one number per position; such that are missing are zero.
    pub fn filter(&self, values: &[f32]) -> Vec<f32> {
        let buffer = self.buffer();
        vectorised(
            #[inline(always)]
            move || self.filter_in(buffer, values),
        )
    }

    #[inline(always)]
    fn filter_in<T: Value>(&self, mut buffer: Buffer<T>, values: &[T]) -> Vec<T> {
        for (block, values) in values.chunks(BLOCK).enumerate() {
            self.splat(block, values, buffer.values_mut());
        }
        self.blur(&mut buffer, self.constant());
        let mut out = vec![T::ZERO; self.len()];
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            self.slice(block, buffer.values(), out);
        }
        out
    }

    /// The constant that makes the filter's height that of the Gaussian (Adams et al. 2010, in their code).
    pub fn constant(&self) -> f32 {
        1.0 / (1.0 + 0.5f32.powi(V as i32 - 1))
    }

    /// A buffer for values on the lattice.
    pub fn buffer<T: Value>(&self) -> Buffer<T> {
        Buffer::new(self.corners())
    }

    /// Blurs a buffer along all axes and multiplies it by a factor.
    #[inline(always)]
    pub fn blur<T: Value>(&self, buffer: &mut Buffer<T>, factor: f32) {
        buffer.blur(&self.neighbours, factor);
    }

    /// Adds the values of a block's positions to the lattice's.
    #[inline(always)]
    pub fn splat<T: Value>(&self, block: usize, values: &[T], lattice: &mut [T]) {
        for (simplex, members) in self.grouping.block(block) {
            let mut sums = [T::ZERO; V];
            for (lane, weights) in members {
                let Some(value) = values.get(usize::from(*lane)) else {
                    continue;
                };
                for corner in 0..V {
                    sums[corner].add_scaled(weights[corner], value);
                }
            }
            for (corner, sum) in self.corners[simplex].iter().zip(&sums) {
                lattice[*corner as usize].add_scaled(1.0, sum);
            }
        }
    }

    /// Adds the lattice's values at a block's positions to `values`.
    #[inline(always)]
    pub fn slice<T: Value>(&self, block: usize, lattice: &[T], values: &mut [T]) {
        for (simplex, members) in self.grouping.block(block) {
            let mut corners = [T::ZERO; V];
            for (value, corner) in corners.iter_mut().zip(&self.corners[simplex]) {
                *value = lattice[*corner as usize];
            }
            for (lane, weights) in members {
                let Some(value) = values.get_mut(usize::from(*lane)) else {
                    continue;
                };
                let mut sum = *value;
                for corner in 0..V {
                    sum.add_scaled(weights[corner], &corners[corner]);
                }
                *value = sum;
            }
        }
    }
}

/// Finds the simplex of every position; and the distinct ones, in the order of their first position.
fn embed<const V: usize>(
    coordinates: &[&[f32]],
    positions: usize,
    period: Option<i32>,
) -> (Grouping<V>, Keys<V>) {
    let grouping = Grouping::with_room(positions);
    let simplices = Keys::with_room(positions / 8);
    vectorised(
        #[inline(always)]
        move || embed_into(grouping, simplices, coordinates, positions, period),
    )
}

#[inline(always)]
fn embed_into<const V: usize>(
    mut grouping: Grouping<V>,
    mut simplices: Keys<V>,
    coordinates: &[&[f32]],
    positions: usize,
    period: Option<i32>,
) -> (Grouping<V>, Keys<V>) {
    let mut embedding = Embedding::<V>::default();
    let mut last = ([i32::MIN; V], 0);
    for first in (0..positions).step_by(LANES) {
        embedding.embed(coordinates, first);
        let mut keys = embedding.simplices();
        wrap(&mut keys, period);
        let hashes = hashes(&keys);
        for lane in 0..LANES.min(positions - first) {
            let key = keys.map(|coordinates| coordinates[lane]);
            if key != last.0 {
                last = (key, simplices.insert_hashed(&key, hashes[lane]));
            }
            grouping.push(last.1, embedding.weights(lane));
        }
    }
    grouping.close();
    (grouping, simplices)
}

/// The number of positions, all of which can be embedded.
fn checked<const V: usize>(coordinates: &[&[f32]]) -> Result<usize, LatticeError> {
    let positions = coordinates.first().map_or(0, |first| first.len());
    let equal = coordinates.iter().all(|list| list.len() == positions);
    if coordinates.len() + 1 != V || !equal {
        return Err(LatticeError::Shape {
            expected: V - 1,
            positions,
            found: coordinates.len(),
        });
    }
    if positions >= 1 << 31 {
        return Err(LatticeError::Count { found: positions });
    }
    let wild = |value: &&f32| value.is_nan() || value.abs() > MOST_CELLS;
    match coordinates.iter().copied().flatten().find(wild) {
        Some(&found) => Err(LatticeError::Position { found }),
        None => Ok(positions),
    }
}

/// Brings the first coordinate of keys, which are given coordinate by coordinate, into the first period.
#[inline(always)]
fn wrap<const V: usize, const KEYS: usize>(keys: &mut [[i32; KEYS]; V], period: Option<i32>) {
    if let Some(period) = period {
        for key in 0..KEYS {
            let around = keys[0][key].div_euclid(period) * period;
            keys[0][key] -= around;
            keys[1][key] += around;
        }
    }
}

/// The same of one key.
#[inline(always)]
fn wrap_one<const V: usize>(key: &mut Key<V>, period: Option<i32>) {
    let mut keys = key.map(|coordinate| [coordinate]);
    wrap(&mut keys, period);
    *key = keys.map(|[coordinate]| coordinate);
}
