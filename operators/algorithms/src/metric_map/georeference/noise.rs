//! Errors of a receiver: white noise, and a drift that forgets itself in time.
//!
//! What satellites and atmosphere do to a receiver changes within minutes, so that neighbouring fixes err alike: ten fixes
//! a second do not know ten times as much as one. The drift is taken for a first-order Gauss–Markov process; a Kalman
//! filter over it turns errors that depend on each other into innovations that do not, in one pass.

use nalgebra::{DMatrix, DVector};

use crate::solving::median::median;

/// Weight of a fix that is off by this many standard deviations: half. 95 % efficient where noise is normal (Holland and
/// Welsch, *Robust regression using iteratively reweighted least-squares*, 1977).
const CAUCHY: f64 = 2.3849;

/// No receiver is better than this, metres: where fixes agree to less, they are not of a receiver.
const LEAST_NOISE_M: f64 = 0.01;

/// Rounds of reweighting from a guess.
const ROUNDS: usize = 15;

/// The drift's standard deviation over the white noise's, as tried.
const DRIFTS: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];

/// Times in which the drift forgets itself, as tried, seconds.
const TIMES_S: [f64; 7] = [3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0];

/// Log-likelihood by which a drift, two parameters more, must be better than none (Akaike: two; and a margin).
const MARGIN: f64 = 6.0;

/// What is off by more standard deviations than this is no noise, and says nothing about drifts.
pub(super) const OUTLIER: f64 = 5.0;

/// When a measurement was made, and how it is weighed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Drifts of two sessions have nothing in common.
    pub(super) session: usize,
    pub(super) seconds: f64,
    /// Variance of its white noise, over that of the others.
    pub(super) variance: f64,
}

/// The drift beside white noise of one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drift {
    pub(super) sd: f64,
    pub(super) seconds: f64,
}

const NONE: Drift = Drift {
    sd: 0.0,
    seconds: 1.0,
};

/// A linearised problem: for each sample and axis a residual, then its derivatives by the state.
pub(super) struct Linear {
    pub(super) axes: usize,
    pub(super) width: usize,
    pub(super) rows: Vec<f64>,
}

/// What a state's fit is.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) state: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Standard deviation of white noise, metres.
    pub(super) noise_m: f64,
    pub(super) drift: Drift,
    /// How far off each sample is, in its standard deviations.
    pub(super) misfits: Vec<f64>,
    log_likelihood: f64,
}

/// A model: residuals and derivatives at a state.
pub(super) type Model<'a> = &'a dyn Fn(&DVector<f64>) -> Linear;

/// How far off each sample is, in its standard deviations, were there no drift.
pub(super) fn misfits(
    samples: &[Sample],
    start: DVector<f64>,
    model: Model<'_>,
) -> Option<Vec<f64>> {
    Some(fit(samples, start, NONE, model, ROUNDS)?.misfits)
}

/// The state that fits best, with the drift that explains best how neighbours err alike. `None` where the samples do not
/// say what the state is.
pub(super) fn fitted(samples: &[Sample], start: DVector<f64>, model: Model<'_>) -> Option<Fit> {
    let plain = fit(samples, start, NONE, model, ROUNDS)?;
    let mut best: Option<Fit> = None;
    for seconds in TIMES_S {
        for sd in DRIFTS {
            let drift = Drift { sd, seconds };
            let found = fit(samples, plain.state.clone(), drift, model, 3);
            let better = |found: &Fit| {
                let known = best.as_ref();
                known.is_none_or(|known| found.log_likelihood > known.log_likelihood)
            };
            if let Some(found) = found.filter(better) {
                best = Some(found);
            }
        }
    }
    let enough = |found: &Fit| found.log_likelihood > plain.log_likelihood + MARGIN;
    match best.filter(enough) {
        Some(best) => fit(samples, best.state, best.drift, model, ROUNDS),
        None => Some(plain),
    }
}

/// The state that fits best with this drift, from a guess.
pub(super) fn fit(
    samples: &[Sample],
    mut state: DVector<f64>,
    drift: Drift,
    model: Model<'_>,
    rounds: usize,
) -> Option<Fit> {
    let mut weights = vec![1.0; samples.len()];
    let mut found = None;
    for round in 0..=rounds {
        let linear = model(&state);
        let white = whitened(samples, drift, &weights, &linear);
        let noise_m = white.noise_m(linear.axes);
        let (information, gradient) = white.normal_equations(&linear);
        let solver = information.cholesky()?;
        let step = solver.solve(&gradient);
        if round == rounds {
            let misfits: Vec<f64> = white.misfits.iter().map(|off| off / noise_m).collect();
            found = Some(Fit {
                covariance: solver.inverse() * noise_m.powi(2),
                log_likelihood: white.log_likelihood(linear.axes),
                noise_m,
                drift,
                misfits,
                state: state.clone(),
            });
        } else {
            let weight = |off: &f64| 1.0 / (1.0 + (off / noise_m / CAUCHY).powi(2));
            weights = white.misfits.iter().map(weight).collect();
            state += step;
        }
    }
    found
}

/// Independent rows of unit variance, if white noise has.
struct White {
    rows: Vec<f64>,
    /// Length of each sample's innovation over its standard deviation, were its weight one.
    misfits: Vec<f64>,
    /// Sum of the logarithms of those variances.
    log_variances: f64,
}

fn whitened(samples: &[Sample], drift: Drift, weights: &[f64], linear: &Linear) -> White {
    let columns = linear.axes * linear.width;
    let mut white = White {
        rows: Vec::with_capacity(linear.rows.len()),
        misfits: Vec::with_capacity(samples.len()),
        log_variances: 0.0,
    };
    let mut means = vec![0.0; columns];
    let mut before: Option<&Sample> = None;
    let stationary = drift.sd * drift.sd;
    let mut variance = stationary;
    let given = samples.iter().zip(weights);
    for ((sample, weight), row) in given.zip(linear.rows.chunks_exact(columns)) {
        let kept = match before {
            Some(before) if before.session == sample.session => {
                (-(sample.seconds - before.seconds).max(0.0) / drift.seconds).exp()
            }
            _ => 0.0,
        };
        before = Some(sample);
        variance = kept * kept * variance + (1.0 - kept * kept) * stationary;
        let nominal = variance + sample.variance;
        let total = variance + sample.variance / weight;
        let gain = variance / total;
        let scale = 1.0 / total.sqrt();
        let mut off = 0.0;
        for (column, (mean, value)) in means.iter_mut().zip(row).enumerate() {
            let foretold = kept * *mean;
            let innovation = value - foretold;
            if column % linear.width == 0 {
                off += innovation * innovation;
            }
            *mean = foretold + gain * innovation;
            white.rows.push(innovation * scale);
        }
        variance *= 1.0 - gain;
        white.misfits.push((off / nominal).sqrt());
        white.log_variances += nominal.ln();
    }
    white
}

impl White {
    /// Standard deviation of white noise: the median of misfits over that of a normal one.
    fn noise_m(&self, axes: usize) -> f64 {
        let middle = median(self.misfits.clone()).unwrap_or_default();
        // Medians of the half-normal and of the Rayleigh distribution.
        let normal = if axes == 1 { 0.674_49 } else { 1.177_41 };
        (middle / normal).max(LEAST_NOISE_M)
    }

    fn normal_equations(&self, linear: &Linear) -> (DMatrix<f64>, DVector<f64>) {
        let state = linear.width - 1;
        let mut information = DMatrix::zeros(state, state);
        let mut gradient = DVector::zeros(state);
        for row in self.rows.chunks_exact(linear.width) {
            let Some((residual, derivatives)) = row.split_first() else {
                continue;
            };
            for (i, a) in derivatives.iter().enumerate() {
                gradient[i] += a * residual;
                for (j, b) in derivatives.iter().enumerate() {
                    information[(i, j)] += a * b;
                }
            }
        }
        (information, gradient)
    }

    /// The largest, over all scales of noise, for misfits whose tails are as heavy as the weights say.
    fn log_likelihood(&self, axes: usize) -> f64 {
        let count = axes as f64 * self.misfits.len() as f64;
        let mut noise_m = self.noise_m(axes);
        for _ in 0..20 {
            let squared = |off: &f64| off * off / (1.0 + (off / noise_m / CAUCHY).powi(2));
            let sum: f64 = self.misfits.iter().map(squared).sum();
            noise_m = (sum / count).sqrt().max(LEAST_NOISE_M);
        }
        let rho = |off: &f64| (off / noise_m / CAUCHY).powi(2).ln_1p() * CAUCHY * CAUCHY / 2.0;
        let tails: f64 = self.misfits.iter().map(rho).sum();
        -count * noise_m.ln() - 0.5 * axes as f64 * self.log_variances - tails
    }
}
