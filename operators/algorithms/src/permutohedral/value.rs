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
        *self += weight * other;
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

    #[inline(always)]
    fn add_scaled(&mut self, weight: f32, other: &Self) {
        for (own, other) in self.iter_mut().zip(other) {
            for (own, other) in own.0.iter_mut().zip(&other.0) {
                *own += weight * other;
            }
        }
    }

    #[inline(always)]
    fn blurred(&self, before: &Self, after: &Self, factor: f32) -> Self {
        let mut out = *self;
        for ((out, before), after) in out.iter_mut().zip(before).zip(after) {
            for ((out, before), after) in out.0.iter_mut().zip(&before.0).zip(&after.0) {
                *out = (*out + 0.5 * (before + after)) * factor;
            }
        }
        out
    }
}
