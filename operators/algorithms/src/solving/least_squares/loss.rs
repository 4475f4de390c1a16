//! Robust losses: how much a residual counts that is larger than it should be.

/// A loss `ρ(s)` of the squared weighted residual `s = ‖r‖²`, with `ρ(s) ≈ s` near 0.
///
/// Scales are in units of standard deviations, as residuals are weighted by their information.
/// In the normal equations a residual counts with [`Loss::weight`] = ρ'(s), which is 1 for a good
/// one and goes to 0 for an outlier (iteratively reweighted least squares).
///
/// Sources: Huber (1964); Black & Rangarajan (1996) for Geman–McClure; Agarwal et al., *Robust
/// map optimization using dynamic covariance scaling* (ICRA 2013), equation 15; Barron (CVPR
/// 2019) compares them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Loss {
    /// `s`: every residual counts fully.
    #[default]
    Quadratic,
    /// `2k√s - k²` beyond `k` standard deviations: grows linearly, convex.
    Huber(f64),
    /// `c² ln(1 + s/c²)`: grows with the logarithm.
    Cauchy(f64),
    /// `c² s / (c² + s)`: never more than `c²`.
    GemanMcClure(f64),
    /// Dynamic covariance scaling with `Φ`: `s` below Φ, `Φ (3s - Φ) / (Φ + s)` beyond, never
    /// more than 3Φ. A residual at its expected size is not touched at all.
    DynamicCovarianceScaling(f64),
}

impl Loss {
    /// `ρ(s)`.
    pub fn cost(self, s: f64) -> f64 {
        match self {
            Loss::Quadratic => s,
            Loss::Huber(k) if s <= k * k => s,
            Loss::Huber(k) => k * (2.0 * s.sqrt() - k),
            Loss::Cauchy(c) => c * c * (s / (c * c)).ln_1p(),
            Loss::GemanMcClure(c) => c * c * s / (c * c + s),
            Loss::DynamicCovarianceScaling(phi) if s <= phi => s,
            Loss::DynamicCovarianceScaling(phi) => phi * (3.0 * s - phi) / (phi + s),
        }
    }

    /// `ρ'(s)`, in [0, 1].
    pub fn weight(self, s: f64) -> f64 {
        match self {
            Loss::Quadratic => 1.0,
            Loss::Huber(k) if s <= k * k => 1.0,
            Loss::Huber(k) => k / s.sqrt(),
            Loss::Cauchy(c) => 1.0 / (1.0 + s / (c * c)),
            Loss::GemanMcClure(c) => (c * c / (c * c + s)).powi(2),
            Loss::DynamicCovarianceScaling(phi) if s <= phi => 1.0,
            Loss::DynamicCovarianceScaling(phi) => (2.0 * phi / (phi + s)).powi(2),
        }
    }
}
