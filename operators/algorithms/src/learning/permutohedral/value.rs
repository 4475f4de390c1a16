//! What can be filtered: numbers, and vectors of them.

/// A value of the filter. Implementations are inlined, so that loops over them are compiled for the instructions of
/// whoever calls.
pub trait Value: Copy + Send + Sync {
    /// Nothing.
    const ZERO: Self;

    /// Adds `weight` times another value.
    fn add_scaled(&mut self, weight: f32, other: &Self);

    /// This, half of two others added, and all of it times `factor`.
    fn blurred(&self, before: &Self, after: &Self, factor: f32) -> Self;
}

impl Value for f32 {
    const ZERO: Self = 0.0;

    #[inline(always)]
    fn add_scaled(&mut self, weight: f32, other: &Self) {
        *self = weight.mul_add(*other, *self);
    }

    #[inline(always)]
    fn blurred(&self, before: &Self, after: &Self, factor: f32) -> Self {
        (self + 0.5 * (before + after)) * factor
    }
}

/// Eight channels, as wide as a vector of the processor.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct Eight(pub [f32; 8]);

impl<const K: usize> Value for [Eight; K] {
    const ZERO: Self = [Eight([0.0; 8]); K];

    // By value, so that the compiler knows that nothing overlaps.
    #[inline(always)]
    fn add_scaled(&mut self, weight: f32, other: &Self) {
        let (own, other) = (*self, *other);
        *self = from_lanes(|i, lane| weight.mul_add(other[i].0[lane], own[i].0[lane]));
    }

    #[inline(always)]
    fn blurred(&self, before: &Self, after: &Self, factor: f32) -> Self {
        let (own, before, after) = (*self, *before, *after);
        from_lanes(|i, lane| {
            (own[i].0[lane] + 0.5 * (before[i].0[lane] + after[i].0[lane])) * factor
        })
    }
}

#[inline(always)]
fn from_lanes<const K: usize>(lane: impl Fn(usize, usize) -> f32) -> [Eight; K] {
    let mut eights = [Eight([0.0; 8]); K];
    for (i, eight) in eights.iter_mut().enumerate() {
        for (at, value) in eight.0.iter_mut().enumerate() {
            *value = lane(i, at);
        }
    }
    eights
}
