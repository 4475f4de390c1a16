//! Which simplex a position lies in, and where in it.

#![allow(
    clippy::needless_range_loop,
    reason = "an index over lanes is what becomes one vector instruction"
)]

use super::table::Key;

/// Positions that are embedded at once.
pub(super) const LANES: usize = 16;

/// The most corners that a simplex may have: its ranks take three bits each.
const MOST_CORNERS: usize = 8;

type Lanes = [f32; LANES];

/// A number of positions, coordinate by coordinate. Names as in Adams et al. 2010, section 3.
pub(super) struct Embedding<const V: usize> {
    /// The position in the plane of the lattice.
    elevated: [Lanes; V],
    /// The nearest remainder-0 point.
    origin: [Lanes; V],
    /// Which place each coordinate takes when differences from the remainder-0 point are sorted, largest first.
    rank: [Lanes; V],
    /// Barycentric coordinates.
    weights: [Lanes; V],
}

impl<const V: usize> Default for Embedding<V> {
    fn default() -> Self {
        let zero = [[0.0; LANES]; V];
        Self {
            elevated: zero,
            origin: zero,
            rank: zero,
            weights: zero,
        }
    }
}

/// 1.5 · 2²³: added to it, a float has no room for a fraction.
const ROOM: f32 = 12_582_912.0;

/// To the nearest integer, halves to even.
#[inline(always)]
fn round(value: f32) -> f32 {
    (value + ROOM) - ROOM
}

/// The same as an integer: the last bits of the sum.
#[inline(always)]
fn whole(value: f32) -> i32 {
    (value + ROOM).to_bits() as i32 - ROOM.to_bits() as i32
}

impl<const V: usize> Embedding<V> {
    const CORNERS: () = assert!(V >= 2 && V <= MOST_CORNERS);

    /// Embeds the positions from `first` on, as many as there are lanes or coordinates.
    #[inline(always)]
    pub(super) fn embed(&mut self, coordinates: &[&[f32]], first: usize) {
        let () = Self::CORNERS;
        self.elevate(coordinates, first);
        let sum = self.find_origin();
        self.sort();
        self.bring_back(&sum);
        self.weigh();
    }

    /// Onto the plane whose coordinates sum to zero, scaled so that the blur is a Gaussian of unit deviation.
    #[inline(always)]
    fn elevate(&mut self, coordinates: &[&[f32]], first: usize) {
        let deviation = f64::from(((2.0f64 / 3.0).sqrt() * V as f64) as f32);
        let mut sum = [0.0; LANES];
        for axis in (1..V).rev() {
            let scale = (deviation / ((axis + 1) as f64 * axis as f64).sqrt()) as f32;
            let mut values = [0.0; LANES];
            let given = &coordinates[axis - 1][first..];
            for (value, given) in values.iter_mut().zip(given) {
                *value = *given;
            }
            for lane in 0..LANES {
                let scaled = values[lane] * scale;
                self.elevated[axis][lane] = sum[lane] - axis as f32 * scaled;
                sum[lane] += scaled;
            }
        }
        self.elevated[0] = sum;
    }

    /// The nearest point whose coordinates are multiples of `V`; returns by how many of these it is off the plane.
    #[inline(always)]
    fn find_origin(&mut self) -> Lanes {
        let down = 1.0 / V as f32;
        let mut sum = [0.0; LANES];
        for axis in 0..V {
            for lane in 0..LANES {
                let cell = round(self.elevated[axis][lane] * down);
                self.origin[axis][lane] = cell * V as f32;
                sum[lane] += cell;
            }
        }
        sum
    }

    #[inline(always)]
    fn sort(&mut self) {
        self.rank = [[0.0; LANES]; V];
        for a in 0..V {
            for b in a + 1..V {
                for lane in 0..LANES {
                    let of_a = self.elevated[a][lane] - self.origin[a][lane];
                    let of_b = self.elevated[b][lane] - self.origin[b][lane];
                    let behind = if of_a < of_b { 1.0 } else { 0.0 };
                    self.rank[a][lane] += behind;
                    self.rank[b][lane] += 1.0 - behind;
                }
            }
        }
    }

    /// Moves the remainder-0 point onto the plane.
    #[inline(always)]
    fn bring_back(&mut self, sum: &Lanes) {
        let corners = V as f32;
        for axis in 0..V {
            for lane in 0..LANES {
                let rank = self.rank[axis][lane] + sum[lane];
                let up = if rank < 0.0 { corners } else { 0.0 };
                let down = if rank >= corners { corners } else { 0.0 };
                self.rank[axis][lane] = rank + (up - down);
                self.origin[axis][lane] += up - down;
            }
        }
    }

    /// The differences in sorted order are the barycentric coordinates' steps.
    #[inline(always)]
    fn weigh(&mut self) {
        let down = 1.0 / V as f32;
        let mut sorted = [[0.0; LANES]; V];
        for (place, sorted) in sorted.iter_mut().enumerate() {
            for axis in 0..V {
                for lane in 0..LANES {
                    let step = (self.elevated[axis][lane] - self.origin[axis][lane]) * down;
                    let here = self.rank[axis][lane] == place as f32;
                    sorted[lane] += if here { step } else { 0.0 };
                }
            }
        }
        for lane in 0..LANES {
            self.weights[0][lane] = sorted[V - 1][lane] + (1.0 - sorted[0][lane]);
        }
        for corner in 1..V {
            for lane in 0..LANES {
                self.weights[corner][lane] =
                    sorted[V - 1 - corner][lane] - sorted[V - corner][lane];
            }
        }
    }

    /// Barycentric coordinates of a position.
    #[inline(always)]
    pub(super) fn weights(&self, lane: usize) -> [f32; V] {
        std::array::from_fn(|corner| self.weights[corner][lane])
    }

    /// The simplices of all positions, coordinate by coordinate: their remainder-0 points, whose last coordinate follows
    /// from the others and makes room for the order of the ranks.
    #[inline(always)]
    pub(super) fn simplices(&self) -> [[i32; LANES]; V] {
        let mut keys = [[0; LANES]; V];
        for axis in 0..V {
            for lane in 0..LANES {
                if axis + 1 < V {
                    keys[axis][lane] = whole(self.origin[axis][lane]);
                }
                keys[V - 1][lane] = (keys[V - 1][lane] << 3) | whole(self.rank[axis][lane]);
            }
        }
        keys
    }
}

/// A corner of a simplex: the one whose coordinates leave this remainder.
#[inline(always)]
pub(super) fn corner<const V: usize>(simplex: &Key<V>, remainder: usize) -> Key<V> {
    let mut corner = *simplex;
    corner[V - 1] = 0;
    for (axis, coordinate) in corner.iter_mut().enumerate().take(V - 1) {
        let rank = (simplex[V - 1] >> (3 * (V - 1 - axis))) & 7;
        *coordinate += remainder as i32;
        if rank as usize > V - 1 - remainder {
            *coordinate -= V as i32;
        }
    }
    corner[V - 1] = -corner.iter().sum::<i32>();
    corner
}
