//! Members learnt from samples, side by side, each from its own random numbers, by Adam (Kingma, Ba 2015).

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::prediction::forward;
use super::{Perceptron, softmax};
use crate::learning::samples::Samples;
use crate::solving::random::SplitMix64;

/// Samples of one step.
const BATCH: usize = 256;
/// Adam's mean rate over all steps, as its authors recommend. It falls from twice as much to nothing, so that weights come to
/// rest: with contiguous halves of CamVid, 0.6 and 0.3 % more of an average class are right than at an even rate.
const RATE: f32 = 1e-3;
/// Adam's, as its authors recommend.
const MOMENTUM: f32 = 0.9;
const SPREAD: f32 = 0.999;
const LEAST: f32 = 1e-8;

/// How a network is learnt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct NetworkOptions {
    /// Perceptrons that vote. On CamVid, four are 1 % better in an average class than one.
    #[schemars(range(min = 1, max = 1000))]
    pub members: u32,
    /// Hidden units of each; 64 are no better than 32 on CamVid.
    #[schemars(range(min = 1, max = 4096))]
    pub hidden: u32,
    /// How often each sees its samples, where that makes `least_steps` of 256 samples.
    #[schemars(range(min = 1, max = 1000))]
    pub epochs: u32,
    /// Few samples are seen more often, until there are as many steps: each moves a weight by about a thousandth.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub least_steps: u32,
    /// How much weights are drawn to 0: this times half their squares, of features of deviation 1, is added to a sample's
    /// loss. Three times as much is no better on CamVid.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub decay: f32,
    /// Where random numbers start.
    pub seed: u64,
}

impl Default for NetworkOptions {
    fn default() -> Self {
        Self {
            members: 4,
            hidden: 32,
            epochs: 10,
            least_steps: 2000,
            decay: 0.004,
            seed: 1,
        }
    }
}

/// The members of a network; the same for any number of threads. Each in turn sees no sample of one block, unless there is
/// only one. None from no samples, or where `values` and `labels` do not fit each other; samples whose class is out of range
/// are left out.
pub fn train(samples: &Samples<'_>, options: &NetworkOptions) -> Vec<Perceptron> {
    if samples.dimensions == 0 || samples.classes == 0 {
        return Vec::new();
    }
    samples
        .held_out(options.members)
        .into_par_iter()
        .enumerate()
        .map(|(member, held_out)| Learner::new(samples, options, held_out, member as u32).learn())
        .collect()
}

/// One member while it learns.
struct Learner<'a> {
    samples: &'a Samples<'a>,
    held_out: Option<u32>,
    /// Samples that it sees.
    open: Vec<u32>,
    random: SplitMix64,
    /// Of each feature: its mean, and one over its deviation.
    scale: Vec<[f32; 2]>,
    /// A row of features a hidden unit is a column here, and a row of hidden units a class.
    hidden: Layer,
    output: Layer,
    decay: f32,
    steps: i32,
    /// Steps that it will have taken.
    all_steps: i32,
}

impl<'a> Learner<'a> {
    fn new(
        samples: &'a Samples<'a>,
        options: &NetworkOptions,
        held_out: Option<u32>,
        member: u32,
    ) -> Self {
        let of_block = |at: &u32| {
            held_out.is_none_or(|block| samples.blocks[*at as usize] != block)
                && usize::from(samples.labels[*at as usize]) < samples.classes
        };
        let open: Vec<u32> = (0..samples.labels.len() as u32).filter(of_block).collect();
        let mut random =
            SplitMix64(options.seed ^ (u64::from(member) + 1).wrapping_mul(0xd134_2543_de82_ef95));
        let units = options.hidden as usize;
        let epoch = open.len().div_ceil(BATCH);
        let epochs = (options.least_steps as usize).div_ceil(epoch.max(1));
        let epochs = epochs.max(options.epochs as usize);
        Self {
            scale: scale(samples, &open),
            hidden: Layer::new(samples.dimensions, units, &mut random),
            output: Layer::new(units, samples.classes, &mut random),
            samples,
            held_out,
            open,
            random,
            decay: options.decay,
            steps: 0,
            all_steps: (epochs * epoch) as i32,
        }
    }

    fn learn(mut self) -> Perceptron {
        while self.steps < self.all_steps {
            for at in (1..self.open.len()).rev() {
                let other = self.random.below(at + 1);
                self.open.swap(at, other);
            }
            for from in (0..self.open.len()).step_by(BATCH) {
                let to = (from + BATCH).min(self.open.len());
                self.step(from, to);
            }
        }
        self.learnt()
    }

    /// Weights go down the slope of a batch's loss.
    fn step(&mut self, from: usize, to: usize) {
        let batch = &self.open[from..to];
        let values = self.features(batch);
        let inner = self.hidden.forward(&values).map(|value| value.max(0.0));
        let mut slope = self.output.forward(&inner);
        let share = (batch.len() as f32).recip();
        for (mut scores, at) in slope.column_iter_mut().zip(batch) {
            softmax(scores.as_mut_slice());
            scores[usize::from(self.samples.labels[*at as usize])] -= 1.0;
            scores *= share;
        }
        let mut inner_slope = &self.output.weights * &slope;
        inner_slope.zip_apply(&inner, |slope, inner| {
            if inner <= 0.0 {
                *slope = 0.0;
            }
        });
        let step = Step {
            number: self.steps + 1,
            rate: 2.0 * RATE * (1.0 - self.steps as f32 / self.all_steps as f32),
            decay: self.decay,
        };
        self.output.step(&inner, &slope, &step);
        self.hidden.step(&values, &inner_slope, &step);
        self.steps = step.number;
    }

    /// Features of some samples, a column each, of mean 0 and deviation 1 over all.
    fn features(&self, samples: &[u32]) -> DMatrix<f32> {
        let dimensions = self.samples.dimensions;
        let mut values = DMatrix::zeros(dimensions, samples.len());
        let columns = values.as_mut_slice().chunks_exact_mut(dimensions);
        for (column, at) in columns.zip(samples) {
            let bytes = &self.samples.values[*at as usize * dimensions..][..dimensions];
            for ((value, byte), [mean, sharpness]) in column.iter_mut().zip(bytes).zip(&self.scale)
            {
                *value = (f32::from(*byte) - mean) * sharpness;
            }
        }
        values
    }

    /// The scale of features goes into the weights, and what classes had of the samples out of them.
    fn learnt(self) -> Perceptron {
        let mut hidden = self.hidden;
        for (mut unit, bias) in hidden
            .weights
            .column_iter_mut()
            .zip(hidden.biases.iter_mut())
        {
            for (weight, [mean, sharpness]) in unit.iter_mut().zip(&self.scale) {
                *weight *= sharpness;
                *bias -= *weight * mean;
            }
        }
        let mut counts = vec![0_u32; self.samples.classes];
        for at in &self.open {
            counts[usize::from(self.samples.labels[*at as usize])] += 1;
        }
        let mut output_biases: Vec<f32> = self.output.biases.iter().copied().collect();
        for (bias, count) in output_biases.iter_mut().zip(counts) {
            if count > 0 {
                *bias -= (count as f32 / self.open.len() as f32).ln();
            }
        }
        Perceptron {
            hidden: hidden.weights.as_slice().to_vec(),
            hidden_biases: hidden.biases.as_slice().to_vec(),
            output: self.output.weights.as_slice().to_vec(),
            output_biases,
            held_out: self.held_out,
        }
    }
}

/// Mean of each feature over some samples, and one over its deviation; a feature that is always the same counts nothing.
fn scale(samples: &Samples<'_>, open: &[u32]) -> Vec<[f32; 2]> {
    let dimensions = samples.dimensions;
    let mut sums = vec![[0_u64; 2]; dimensions];
    for at in open {
        let bytes = &samples.values[*at as usize * dimensions..][..dimensions];
        for (sums, byte) in sums.iter_mut().zip(bytes) {
            let value = u64::from(*byte);
            sums[0] += value;
            sums[1] += value * value;
        }
    }
    let count = open.len().max(1) as f64;
    let scale = |[sum, squares]: [u64; 2]| {
        let mean = sum as f64 / count;
        let variance = squares as f64 / count - mean * mean;
        let sharpness = if variance > 1e-6 {
            variance.sqrt().recip()
        } else {
            0.0
        };
        [mean as f32, sharpness as f32]
    };
    sums.into_iter().map(scale).collect()
}

/// How far weights are moved.
struct Step {
    /// From 1.
    number: i32,
    rate: f32,
    decay: f32,
}

/// Weights of a layer, a column for each of its units, and how they have moved.
struct Layer {
    weights: DMatrix<f32>,
    biases: DVector<f32>,
    moved: DMatrix<[f32; 2]>,
    biases_moved: DVector<[f32; 2]>,
}

impl Layer {
    /// Random weights of the size that keeps signals as large as they are (Glorot, Bengio 2010).
    fn new(inputs: usize, units: usize, random: &mut SplitMix64) -> Self {
        let most = (6.0 / (inputs + units) as f64).sqrt();
        let weight = |_, _| ((2.0 * random.unit() - 1.0) * most) as f32;
        Self {
            weights: DMatrix::from_fn(inputs, units, weight),
            biases: DVector::zeros(units),
            moved: DMatrix::from_element(inputs, units, [0.0; 2]),
            biases_moved: DVector::from_element(units, [0.0; 2]),
        }
    }

    fn forward(&self, values: &DMatrix<f32>) -> DMatrix<f32> {
        let (weights, values) = (self.weights.as_view(), values.as_view());
        forward(&weights, self.biases.as_slice(), &values)
    }

    /// A step down a slope of what the layer gave, of these values.
    fn step(&mut self, values: &DMatrix<f32>, slope: &DMatrix<f32>, step: &Step) {
        let gradient = values * slope.transpose();
        // Both means began at 0, and are too small by this.
        let shares = [MOMENTUM, SPREAD].map(|kept| (1.0 - kept.powi(step.number)).recip());
        let adam = |weight: &mut f32, moved: &mut [f32; 2], gradient: f32| {
            moved[0] += (1.0 - MOMENTUM) * (gradient - moved[0]);
            moved[1] += (1.0 - SPREAD) * (gradient * gradient - moved[1]);
            *weight -= step.rate * moved[0] * shares[0] / ((moved[1] * shares[1]).sqrt() + LEAST);
        };
        let weights = self.weights.iter_mut().zip(self.moved.iter_mut());
        for ((weight, moved), gradient) in weights.zip(gradient.iter()) {
            let gradient = gradient + step.decay * *weight;
            adam(weight, moved, gradient);
        }
        let biases = self.biases.iter_mut().zip(self.biases_moved.iter_mut());
        for ((bias, moved), gradient) in biases.zip(slope.column_sum().iter()) {
            adam(bias, moved, *gradient);
        }
    }
}
