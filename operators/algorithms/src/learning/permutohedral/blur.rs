//! The lattice's values and their blur.

use super::table::{Key, Keys};
use super::{Value, wrap_one};

/// Along each axis, of each corner: the corners before and after it, 0 where the lattice has none.
pub(super) fn neighbours<const V: usize>(
    points: &Keys<V>,
    period: Option<i32>,
) -> Vec<Vec<[u32; 2]>> {
    (0..V)
        .map(|axis| {
            let mut along = vec![[0; 2]; points.len()];
            for point in 1..points.len() {
                let mut after: Key<V> = *points.key(point);
                after.iter_mut().for_each(|coordinate| *coordinate += 1);
                after[axis] -= V as i32;
                wrap_one(&mut after, period);
                if let Some(after) = points.find(&after) {
                    along[point][1] = after;
                    along[after as usize][0] = point as u32;
                }
            }
            along
        })
        .collect()
}

/// Values on a lattice, and as much room again.
pub struct Buffer<T> {
    values: Vec<T>,
    other: Vec<T>,
}

impl<T: Value> Buffer<T> {
    pub(super) fn new(corners: usize) -> Self {
        Self {
            values: vec![T::ZERO; corners],
            other: vec![T::ZERO; corners],
        }
    }

    /// The values, corner 0 being zero.
    #[inline(always)]
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// The values. Corner 0 must stay zero.
    #[inline(always)]
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// Where the next values are gathered, while the present ones are still read. Corner 0 must stay zero.
    #[inline(always)]
    pub fn next_mut(&mut self) -> &mut [T] {
        &mut self.other
    }

    /// Makes the next values the present ones.
    #[inline(always)]
    pub fn advance(&mut self) {
        std::mem::swap(&mut self.values, &mut self.other);
    }

    /// Blurs along all axes, and multiplies by a factor. The next values are zero then.
    #[inline(always)]
    pub(super) fn blur(&mut self, neighbours: &[Vec<[u32; 2]>], factor: f32) {
        for (axis, along) in neighbours.iter().enumerate() {
            let factor = if axis + 1 == neighbours.len() {
                factor
            } else {
                1.0
            };
            blur(&self.values, along, factor, &mut self.other);
            std::mem::swap(&mut self.values, &mut self.other);
        }
        self.other.fill(T::ZERO);
    }
}

#[inline(always)]
fn blur<T: Value>(values: &[T], along: &[[u32; 2]], factor: f32, out: &mut [T]) {
    for ((value, [before, after]), out) in values.iter().zip(along).zip(out).skip(1) {
        *out = value.blurred(&values[*before as usize], &values[*after as usize], factor);
    }
}
