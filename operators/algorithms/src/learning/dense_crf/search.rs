//! Kernels chosen by how well they label images whose classes are known.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ColourView, CrfError, Kernels, MeanField, RandomField, Unary};

/// An image whose classes are known, with costs from a classifier that has not learnt from it.
#[derive(Debug, Clone)]
pub struct Example<'a> {
    /// The image.
    pub image: ColourView<'a>,
    /// What its pixels are by themselves.
    pub unary: Unary,
    /// Whether its last column is next to its first one, as in a full panorama.
    pub wraps: bool,
    /// The classes of its pixels, row by row; values that are no class (255) are not scored.
    pub truth: &'a [u8],
}

/// How kernels are searched.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SearchOptions {
    /// The most kernels that are tried; a round that has begun is finished. By default each of the five parameters is
    /// tried on both sides a few times.
    #[schemars(range(min = 1))]
    pub trials: u32,
    /// How images are labelled.
    #[serde(flatten)]
    pub mean_field: MeanField,
    /// Where the search begins.
    #[serde(skip)]
    pub start: Kernels,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self {
            trials: 60,
            mean_field: MeanField::default(),
            start: Kernels::default(),
        }
    }
}

/// Which classes were found where: pixels by true and found class.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Confusion {
    classes: usize,
    pixels: Vec<u64>,
}

impl Confusion {
    /// Of no pixels.
    pub fn new(classes: usize) -> Self {
        Self {
            classes,
            pixels: vec![0; classes * classes],
        }
    }

    /// Counts pixels; those whose truth is no class are left out.
    pub fn add(&mut self, truth: &[u8], found: &[u8]) {
        for (truth, found) in truth.iter().zip(found) {
            let (truth, found) = (usize::from(*truth), usize::from(*found));
            if truth < self.classes && found < self.classes {
                self.pixels[truth * self.classes + found] += 1;
            }
        }
    }

    /// Adds another's counts, of as many classes.
    pub fn merge(&mut self, other: &Self) {
        for (own, other) in self.pixels.iter_mut().zip(&other.pixels) {
            *own += other;
        }
    }

    /// The share of the pixels that are right; 0 without pixels.
    pub fn pixel_accuracy(&self) -> f64 {
        let right: u64 = (0..self.classes)
            .map(|class| self.pixels[class * self.classes + class])
            .sum();
        right as f64 / self.pixels.iter().sum::<u64>().max(1) as f64
    }

    /// The mean, over the classes that there are, of the share of their pixels that are right; 0 without pixels.
    pub fn class_accuracy(&self) -> f64 {
        let of_class = |(class, row): (usize, &[u64])| {
            let all = row.iter().sum::<u64>();
            (all > 0).then(|| row[class] as f64 / all as f64)
        };
        let rows = self.pixels.chunks_exact(self.classes.max(1));
        let shares: Vec<f64> = rows.enumerate().filter_map(of_class).collect();
        shares.iter().sum::<f64>() / shares.len().max(1) as f64
    }

    /// The mean of the two.
    pub fn score(&self) -> f64 {
        0.5 * (self.pixel_accuracy() + self.class_accuracy())
    }
}

/// Kernels and how they did.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The kernels.
    pub kernels: Kernels,
    /// What they found, over all examples.
    pub confusion: Confusion,
}

/// How often each parameter is multiplied by the square root of two, starting from the first kernels.
type Steps = [i32; 5];

/// Tries kernels on examples, and returns all that were tried, the best first, by the mean of pixel and class accuracy;
/// of equals, the one that was nearer the beginning.
///
/// One parameter after the other is doubled and halved, and the better of the three kept, until none changes any more;
/// then the same with the square root of two. Appearance and smoothness begin anywhere reasonable: accuracy changes
/// slowly with all five (Krähenbühl and Koltun 2011, section 4), and factors of two are what it can tell apart.
///
/// # Errors
/// [`CrfError`] for kernels that cannot be used, and examples whose image, costs and truth do not have the same pixels.
pub fn search(examples: &[Example<'_>], options: &SearchOptions) -> Result<Vec<Trial>, CrfError> {
    let mut tried: BTreeMap<Steps, Trial> = BTreeMap::new();
    let mut here = [0; 5];
    tried.insert(here, trial(examples, options, here)?);
    for step in [2, 1] {
        let mut still = 0;
        for parameter in (0..here.len()).cycle() {
            if still == here.len() || tried.len() >= options.trials as usize {
                break;
            }
            let mut best = here;
            for direction in [step, -step] {
                let mut there = here;
                there[parameter] += direction;
                if let Entry::Vacant(untried) = tried.entry(there) {
                    untried.insert(trial(examples, options, there)?);
                }
                if tried[&there].confusion.score() > tried[&best].confusion.score() {
                    best = there;
                }
            }
            still = if best == here { still + 1 } else { 0 };
            here = best;
        }
    }
    Ok(sorted(tried))
}

fn sorted(tried: BTreeMap<Steps, Trial>) -> Vec<Trial> {
    let mut trials: Vec<(Steps, Trial)> = tried.into_iter().collect();
    let far = |steps: &Steps| steps.iter().map(|step| step.unsigned_abs()).sum::<u32>();
    trials.sort_by(|(a_steps, a), (b_steps, b)| {
        let by_score = b.confusion.score().total_cmp(&a.confusion.score());
        by_score.then_with(|| far(a_steps).cmp(&far(b_steps)))
    });
    trials.into_iter().map(|(_, trial)| trial).collect()
}

fn trial(
    examples: &[Example<'_>],
    options: &SearchOptions,
    steps: Steps,
) -> Result<Trial, CrfError> {
    let scaled =
        |value: f64, parameter: usize| value * 2f64.powf(0.5 * f64::from(steps[parameter]));
    let start = &options.start;
    let kernels = Kernels {
        appearance_px: scaled(start.appearance_px, 0),
        appearance_colour: scaled(start.appearance_colour, 1),
        appearance_weight: scaled(start.appearance_weight, 2),
        smoothness_px: scaled(start.smoothness_px, 3),
        smoothness_weight: scaled(start.smoothness_weight, 4),
    };
    let classes = examples
        .iter()
        .map(|example| example.unary.classes())
        .max()
        .unwrap_or(1);
    let of_examples: Vec<Confusion> = examples
        .par_iter()
        .map(|example| evaluate(example, &kernels, options, classes))
        .collect::<Result<_, _>>()?;
    let mut confusion = Confusion::new(classes);
    of_examples
        .iter()
        .for_each(|of_example| confusion.merge(of_example));
    Ok(Trial { kernels, confusion })
}

fn evaluate(
    example: &Example<'_>,
    kernels: &Kernels,
    options: &SearchOptions,
    classes: usize,
) -> Result<Confusion, CrfError> {
    let MeanField { iterations } = options.mean_field;
    let field = RandomField::new(&example.image, kernels, example.wraps)?;
    field.fits(field.pixels(), example.truth.len())?;
    let found = field.infer(&example.unary, iterations)?.labels();
    let mut confusion = Confusion::new(classes);
    confusion.add(example.truth, &found);
    Ok(confusion)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::learning::dense_crf::tests::of_labels;

    #[test]
    fn accuracies_are_shares() {
        let mut confusion = Confusion::new(3);
        confusion.add(&[0, 0, 0, 0, 1, 1, 255], &[0, 0, 0, 1, 1, 0, 0]);
        assert!((confusion.pixel_accuracy() - 4.0 / 6.0).abs() < 1e-12);
        assert!((confusion.class_accuracy() - 0.5 * (0.75 + 0.5)).abs() < 1e-12);
        assert_eq!(Confusion::new(2).score(), 0.0);
    }

    /// A start that smoothes everything away is left behind.
    #[test]
    fn finds_better_kernels_than_it_began_with() {
        let (width, height) = (48, 36);
        let truth: Vec<u8> = (0..width * height)
            .map(|i| u8::from((i % width / 6 + i / width / 6) % 2 == 0))
            .collect();
        let colours: Vec<u8> = truth
            .iter()
            .zip(0..)
            .flat_map(|(class, i): (&u8, u32)| [100 + 40 * class, 90 + (i * 7 % 13) as u8, 120])
            .collect();
        let chance = |i: usize| (i.wrapping_mul(2_654_435_761) >> 7) % 10 < 3;
        let noisy: Vec<u8> = truth
            .iter()
            .enumerate()
            .map(|(i, class)| class ^ u8::from(chance(i)))
            .collect();
        let example = Example {
            image: ColourView::new(width as u32, height as u32, &colours).unwrap(),
            unary: of_labels(2, &noisy, 0.7),
            wraps: false,
            truth: &truth,
        };
        let start = Kernels {
            appearance_colour: 40.0,
            ..Kernels::default()
        };
        let options = SearchOptions {
            start,
            ..SearchOptions::default()
        };
        let trials = search(&[example], &options).unwrap();
        let first = trials.iter().find(|trial| trial.kernels == start).unwrap();
        assert!(first.confusion.score() < 0.7, "{}", first.confusion.score());
        assert!(trials[0].confusion.score() > 0.95, "{:?}", trials[0]);
        assert!(trials.len() <= options.trials as usize + 1);
        assert!(trials.is_sorted_by(|a, b| a.confusion.score() >= b.confusion.score()));
    }
}
