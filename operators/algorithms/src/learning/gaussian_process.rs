//! A linear Gaussian process on answers of +1 and -1, in closed form.
//!
//! The function is `f(x) = wᵀx` with `w ~ N(0, s² I)`; an answer is `f(x)` with noise of variance `ρ s²`. Both are
//! those that make the answers likeliest (*marginal likelihood*): nothing is tuned. With the eigenvalues of `Xᵀ X` the
//! likelihood of every `ρ` costs no more than a sum, and the best `s²` for it is known.
//!
//! A classifier proper has no closed form; regression on ±1 has, and ranks as well where it is used here.
//!
//! Source: Rasmussen & Williams, *Gaussian processes for machine learning* (2006), sections 2.1, 2.3, 3.7 and 5.4.

use faer::{Mat, MatRef, Side};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Values of `ρ` that are tried, relative to the mean eigenvalue: from almost no noise to almost nothing else.
const NOISE_DECADES: [i32; 2] = [-4, 2];
/// Values by decade.
const STEPS: i32 = 8;

/// Samples that are multiplied with the covariance's root together: each by itself reads all of it.
const TOGETHER: usize = 64;

/// Samples that are weighed as questions, at most: the least certain. The time to weigh them takes the square of it.
pub(crate) const UNCERTAIN: usize = 500;
/// Questions, at most: more than a person answers at a sitting.
pub(crate) const QUESTIONS: usize = 50;

/// Why nothing was learnt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LearningError {
    /// There is nothing to learn from.
    #[error("expected examples, found none")]
    NoExamples,
    /// Samples of different lengths, not as many answers as samples, or numbers that are none.
    #[error("expected finite samples of one length with an answer each")]
    Misshapen,
    /// The decomposition did not converge.
    #[error("the samples' products have no eigenvalues")]
    NoEigenvalues,
}

/// What was learnt.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearProcess {
    /// Mean of `w`.
    weights: Vec<f64>,
    /// `s²`.
    scale: f64,
    /// `ρ s²`.
    noise: f64,
    /// A root of the covariance of `w`, row by row.
    spread: Vec<f64>,
}

/// What is known of `f` at a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    /// Mean.
    pub mean: f64,
    /// Variance, without the noise of an answer.
    pub variance: f64,
    /// A root of the variance: products of two are covariances.
    spread: Vec<f64>,
}

impl LinearProcess {
    /// Learns from samples (all of one length) with answers of +1 and -1.
    ///
    /// # Errors
    /// [`LearningError`].
    pub fn learn(samples: &[Vec<f32>], answers: &[f64]) -> Result<Self, LearningError> {
        let count = samples.len();
        let length = samples.first().ok_or(LearningError::NoExamples)?.len();
        let finite = |sample: &Vec<f32>| sample.iter().all(|value| value.is_finite());
        let sound = samples.iter().all(|it| it.len() == length && finite(it));
        if !sound || answers.len() != count || answers.iter().any(|it| !it.is_finite()) {
            return Err(LearningError::Misshapen);
        }
        let columns = Mat::from_fn(count, length, |row, at| f64::from(samples[row][at]));
        let eigen = (columns.transpose() * &columns).self_adjoint_eigen(Side::Lower);
        let eigen = eigen.map_err(|_| LearningError::NoEigenvalues)?;
        let values = eigen.S().column_vector();
        let values: Vec<f64> = (0..length).map(|at| values[at].max(0.0)).collect();
        let axes: Vec<Vec<f64>> = (0..length)
            .map(|at| eigen.U().col(at).iter().copied().collect())
            .collect();
        let answer = |at: usize| -> f64 {
            let answers = samples.iter().zip(answers);
            answers
                .map(|(sample, answer)| answer * f64::from(sample[at]))
                .sum()
        };
        let pull: Vec<f64> = (0..length).map(answer).collect();
        let pull: Vec<f64> = axes.iter().map(|axis| product(axis, &pull)).collect();
        let evidence = Evidence {
            count,
            squares: answers.iter().map(|answer| answer * answer).sum(),
            values: &values,
            pull: &pull,
        };
        let (ratio, scale) = evidence.likeliest();
        let mut weights = vec![0.0; length];
        for ((axis, value), pull) in axes.iter().zip(&values).zip(&pull) {
            for (weight, part) in weights.iter_mut().zip(axis) {
                *weight += part * pull / (value + ratio);
            }
        }
        let noise = ratio * scale;
        let root = |value: f64| (noise / (value + ratio)).sqrt();
        let spread = axes.iter().zip(&values).flat_map(|(axis, value)| {
            let root = root(*value);
            axis.iter().map(move |part| part * root)
        });
        Ok(Self {
            spread: spread.collect(),
            weights,
            scale,
            noise,
        })
    }

    /// From what [`Self::weights`], [`Self::scale`], [`Self::noise`] and [`Self::spread`] gave; `None` where they do not fit
    /// each other or are no numbers.
    pub fn from_parts(weights: Vec<f64>, [scale, noise]: [f64; 2], spread: &[f32]) -> Option<Self> {
        let is_whole = !weights.is_empty() && spread.len().is_multiple_of(weights.len());
        let is_finite = spread.iter().all(|value| value.is_finite())
            && weights.iter().all(|value| value.is_finite());
        let is_variance = |value: f64| value >= 0.0 && value.is_finite();
        let is_sound = is_whole && is_finite && is_variance(scale) && is_variance(noise);
        is_sound.then(|| Self {
            spread: spread.iter().map(|value| f64::from(*value)).collect(),
            weights,
            scale,
            noise,
        })
    }

    /// Variance of each weight before any answer.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// A root of the covariance of `w`, row by row: `covariance = spreadᵀ spread`.
    pub fn spread(&self) -> Vec<f32> {
        self.spread.iter().map(|value| *value as f32).collect()
    }

    /// Mean of `w`: the mean of `f` at a sample is their product.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Variance of the noise of an answer.
    pub fn noise(&self) -> f64 {
        self.noise
    }

    /// The mean of `f` at a sample.
    pub fn mean(&self, sample: &[f32]) -> f64 {
        let products = self.weights.iter().zip(sample);
        products
            .map(|(weight, value)| weight * f64::from(*value))
            .sum()
    }

    /// What is known of `f` at a sample.
    pub fn at(&self, sample: &[f32]) -> Posterior {
        let spread = self.spread.chunks(self.weights.len().max(1));
        let value = |row: &[f64]| {
            let products = row.iter().zip(sample);
            products.map(|(x, y)| x * f64::from(*y)).sum::<f64>()
        };
        self.known(sample, spread.map(value).collect())
    }

    /// What is known of `f` at samples, in their order.
    pub fn at_each<S: AsRef<[f32]> + Sync>(&self, samples: &[S]) -> Vec<Posterior> {
        let known = samples.par_chunks(TOGETHER).flat_map_iter(|samples| {
            let spreads = self.spreads(samples);
            samples.iter().enumerate().map(move |(at, sample)| {
                let spread = spreads.col(at).iter().copied();
                self.known(sample.as_ref(), spread.collect())
            })
        });
        known.collect()
    }

    /// Products of the covariance's root with samples, one in each column.
    fn spreads<S: AsRef<[f32]>>(&self, samples: &[S]) -> Mat<f64> {
        let length = self.weights.len();
        let value = |at: usize, sample: usize| {
            let value = samples[sample].as_ref().get(at);
            value.map_or(0.0, |value| f64::from(*value))
        };
        let rows = self.spread.len() / length.max(1);
        let root = MatRef::from_row_major_slice(self.spread.as_slice(), rows, length);
        root * Mat::from_fn(length, samples.len(), value)
    }

    fn known(&self, sample: &[f32], spread: Vec<f64>) -> Posterior {
        Posterior {
            mean: self.mean(sample),
            variance: product(&spread, &spread),
            spread,
        }
    }

    /// Which samples to ask about, the first the one whose answer would teach most about all, each next one that would teach
    /// most when those before are answered; with what each teaches: by how much the change of `f` that it may bring moves
    /// the probabilities, all squares added up. `slopes`: by how much a probability changes with `f`.
    ///
    /// What an answer changes of the covariance does not depend on the answer (equation 2.26), so a whole list is made at
    /// once.
    pub fn questions(&self, known: &[Posterior], slopes: &[f64], most: usize) -> Vec<(usize, f64)> {
        let count = known.len();
        let between = covariances(known);
        let row = |a: usize| -> Vec<f64> { between.col(a).iter().copied().collect() };
        let mut covariances: Vec<Vec<f64>> = (0..count).map(row).collect();
        let mut open: Vec<usize> = (0..count).collect();
        let mut questions = Vec::new();
        while questions.len() < most && !open.is_empty() {
            let gain = |asked: &usize| {
                let row = &covariances[*asked];
                let moved = slopes
                    .iter()
                    .zip(row)
                    .map(|(slope, with)| (slope * with).powi(2));
                moved.sum::<f64>() / (row[*asked] + self.noise).max(f64::MIN_POSITIVE)
            };
            let gains: Vec<f64> = open.par_iter().map(gain).collect();
            let best =
                (0..open.len()).reduce(|best, at| if gains[at] > gains[best] { at } else { best });
            let Some(best) = best else { break };
            let (asked, gain) = (open.remove(best), gains[best]);
            questions.push((asked, gain));
            let told = covariances[asked].clone();
            let spread = (told[asked] + self.noise).max(f64::MIN_POSITIVE);
            covariances
                .par_iter_mut()
                .enumerate()
                .for_each(|(at, row)| {
                    let part = told[at] / spread;
                    row.iter_mut()
                        .zip(&told)
                        .for_each(|(value, told)| *value -= part * told);
                });
        }
        questions
    }

    /// What would be held of some samples that it learnt from, had it not seen them and their answers: means, with the same
    /// noise and scale (equation 5.12, for more than one).
    pub fn left_out(&self, samples: &[&[f32]], answers: &[f64]) -> Vec<f64> {
        let known = self.at_each(samples);
        let count = samples.len();
        let covariances = covariances(&known);
        let rest = |row: usize, column: usize| {
            let own = if row == column { 1.0 } else { 0.0 };
            own - covariances[(row, column)] / self.noise
        };
        let rest = DMatrix::from_fn(count, count, rest);
        let short = DVector::from_fn(count, |at, _| answers[at] - known[at].mean);
        let short = rest.lu().solve(&short).unwrap_or(DVector::zeros(count));
        answers
            .iter()
            .zip(short.iter())
            .map(|(answer, short)| answer - short)
            .collect()
    }
}

/// What the answers say of noise and scale.
struct Evidence<'a> {
    count: usize,
    /// The answers' sum of squares.
    squares: f64,
    /// Eigenvalues of `Xᵀ X`.
    values: &'a [f64],
    /// `Xᵀ y` along its eigenvectors.
    pull: &'a [f64],
}

impl Evidence<'_> {
    /// The ratio of noise to scale, and the scale, that make the answers likeliest (Rasmussen & Williams, equation 5.8).
    fn likeliest(&self) -> (f64, f64) {
        let count = self.count as f64;
        let mean = (self.values.iter().sum::<f64>() / self.values.len() as f64).max(1e-12);
        let tried = (NOISE_DECADES[0] * STEPS..=NOISE_DECADES[1] * STEPS).map(|step| {
            let ratio = mean * 10_f64.powf(f64::from(step) / f64::from(STEPS));
            let pairs = self.values.iter().zip(self.pull);
            let told: f64 = pairs
                .map(|(value, pull)| pull * pull / (value + ratio))
                .sum();
            let scale = ((self.squares - told) / ratio / count).max(1e-12);
            let above = self
                .values
                .iter()
                .map(|value| (value / ratio).ln_1p())
                .sum::<f64>();
            (-0.5 * (count * (scale * ratio).ln() + above), ratio, scale)
        });
        let best = tried.max_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or((1.0, 1.0), |(_, ratio, scale)| (ratio, scale))
    }
}

/// The covariances of what is known at samples.
fn covariances(known: &[Posterior]) -> Mat<f64> {
    let rows = known.iter().map(|one| one.spread.len()).min().unwrap_or(0);
    let roots = Mat::from_fn(rows, known.len(), |row, at| known[at].spread[row]);
    roots.transpose() * &roots
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests;
