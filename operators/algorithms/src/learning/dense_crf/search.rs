//! Kernels chosen by how well they label images whose classes are known.

use std::collections::BTreeMap;
use std::iter;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Confusion, CrfError, Example, Kernels, MeanField};

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

/// Examples that are labelled before kernels are judged again.
const HEAT: usize = 4;

/// Kernels and how they did.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The kernels.
    pub kernels: Kernels,
    /// Examples that they were tried on: all, or those after which they were clearly worse than others.
    pub examples: usize,
    /// What they found, over these examples.
    pub confusion: Confusion,
}

/// How often each parameter is multiplied by the square root of two, starting from the first kernels.
type Steps = [i32; 5];

/// Tries kernels on examples, and returns all that were tried, the best first: those with which the pixels and the average
/// class gain most on no field at all, whichever of the two gains less. No field is tried, too (kernels without weight), and
/// comes first where none gains. Of equals, the one that was nearer the beginning comes first; what was given up comes last.
///
/// One parameter after the other is doubled and halved, and what is better by a standard error kept, until none changes any
/// more; then the same with the square root of two. Appearance and smoothness begin anywhere reasonable: accuracy changes
/// slowly with all five (Krähenbühl and Koltun 2011, section 4), and factors of two are what it can tell apart.
///
/// Kernels race: they label a few examples, and no more where they are worse than the best by a standard error (Maron and
/// Moore, *Hoeffding races*, NIPS 1993). Differences are paired, and their errors by the jackknife, as an average class is no
/// mean of images. After each, `told` hears which share of the most trials is done.
///
/// # Errors
/// [`CrfError`] for kernels that cannot be used.
pub fn search(
    examples: &[Example],
    options: &SearchOptions,
    told: impl Fn(f64),
) -> Result<Vec<Trial>, CrfError> {
    let race = Race::new(examples, options)?;
    let mut tried: BTreeMap<Steps, Runner> = BTreeMap::new();
    let mut here = [0; 5];
    tried.insert(here, race.run(options.start, None)?);
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
                if !tried.contains_key(&there) {
                    let kernels = scaled(&options.start, there);
                    let runner = race.run(kernels, tried.get(&best))?;
                    tried.insert(there, runner);
                    told(tried.len() as f64 / f64::from(options.trials));
                }
                if race.is_better(&tried[&there].found, &tried[&best].found) {
                    best = there;
                }
            }
            still = if best == here { still + 1 } else { 0 };
            here = best;
        }
    }
    Ok(race.sorted(tried))
}

fn scaled(start: &Kernels, steps: Steps) -> Kernels {
    let scaled =
        |value: f64, parameter: usize| value * 2f64.powf(0.5 * f64::from(steps[parameter]));
    Kernels {
        appearance_px: scaled(start.appearance_px, 0),
        appearance_colour: scaled(start.appearance_colour, 1),
        appearance_weight: scaled(start.appearance_weight, 2),
        smoothness_px: scaled(start.smoothness_px, 3),
        smoothness_weight: scaled(start.smoothness_weight, 4),
    }
}

/// Kernels, and what they found in the first examples.
struct Runner {
    kernels: Kernels,
    found: Vec<Confusion>,
}

struct Race<'a> {
    /// In an order in which the first few are spread over all.
    examples: Vec<&'a Example>,
    options: &'a SearchOptions,
    classes: usize,
    /// What pixels are by themselves.
    alone: Runner,
}

impl<'a> Race<'a> {
    fn new(examples: &'a [Example], options: &'a SearchOptions) -> Result<Self, CrfError> {
        let classes = examples.iter().map(|example| example.classes()).max();
        let mut order: Vec<usize> = (0..examples.len()).collect();
        order.sort_by_key(|index| index.reverse_bits());
        let kernels = Kernels {
            appearance_weight: 0.0,
            smoothness_weight: 0.0,
            ..options.start
        };
        let mut race = Self {
            examples: order.into_iter().map(|index| &examples[index]).collect(),
            options,
            classes: classes.unwrap_or(1),
            alone: Runner {
                kernels,
                found: Vec::new(),
            },
        };
        race.alone = race.run(kernels, None)?;
        Ok(race)
    }

    /// Labels examples until the kernels are clearly worse than the best, or to the end.
    fn run(&self, kernels: Kernels, best: Option<&Runner>) -> Result<Runner, CrfError> {
        let mut found = Vec::with_capacity(self.examples.len());
        for heat in self.examples.chunks(HEAT) {
            let labelled: Vec<Confusion> = heat
                .par_iter()
                .map(|example| example.labelled(&kernels, self.options.mean_field, self.sum(&[])))
                .collect::<Result<_, _>>()?;
            found.extend(labelled);
            if best.is_some_and(|best| self.is_better(&best.found, &found)) {
                break;
            }
        }
        Ok(Runner { kernels, found })
    }

    /// Whether some kernels gain more than others on the examples that both have labelled, by more than a standard error.
    fn is_better(&self, one: &[Confusion], other: &[Confusion]) -> bool {
        let n = one.len().min(other.len());
        let found = [one, other, &self.alone.found].map(|found| &found[..n]);
        let all = found.map(|found| self.sum(found));
        let more = |[one, other, alone]: &[Confusion; 3]| one.gain_on(alone) - other.gain_on(alone);
        let without = |index: usize| {
            more(&std::array::from_fn(|which| {
                all[which].without(&found[which][index])
            }))
        };
        let without: Vec<f64> = (0..n).map(without).collect();
        let mean = without.iter().sum::<f64>() / n as f64;
        let squares: f64 = without.iter().map(|more| (more - mean).powi(2)).sum();
        let standard_error = (squares * (n as f64 - 1.0) / n as f64).sqrt();
        more(&all) > standard_error
    }

    fn sum(&self, found: &[Confusion]) -> Confusion {
        let mut sum = Confusion::new(self.classes);
        found.iter().for_each(|found| sum.merge(found));
        sum
    }

    fn sorted(self, tried: BTreeMap<Steps, Runner>) -> Vec<Trial> {
        let far = |steps: &Steps| steps.iter().map(|step| step.unsigned_abs()).sum::<u32>();
        let tried = tried.iter().map(|(steps, runner)| (1 + far(steps), runner));
        let runners = iter::once((0, &self.alone)).chain(tried);
        let judged = runners.map(|(far, runner)| {
            let examples = runner.found.len();
            let confusion = self.sum(&runner.found);
            let gain = confusion.gain_on(&self.sum(&self.alone.found[..examples]));
            let trial = Trial {
                kernels: runner.kernels,
                examples,
                confusion,
            };
            (trial, gain, far)
        });
        let mut judged: Vec<(Trial, f64, u32)> = judged.collect();
        judged.sort_by(|(a, a_gain, a_far), (b, b_gain, b_far)| {
            let by_gain = || b_gain.total_cmp(a_gain);
            let by_examples = b.examples.cmp(&a.examples);
            by_examples.then_with(by_gain).then(a_far.cmp(b_far))
        });
        judged.into_iter().map(|(trial, ..)| trial).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use std::cell::RefCell;

    use super::*;
    use crate::learning::dense_crf::ColourView;
    use crate::learning::dense_crf::tests::of_labels;

    /// A start that smoothes everything away is left behind.
    #[test]
    fn finds_better_kernels_than_it_began_with() {
        let board = Board::new(0.3, 40);
        let start = Kernels {
            appearance_colour: 40.0,
            ..Kernels::default()
        };
        let options = SearchOptions {
            start,
            ..SearchOptions::default()
        };
        let heard = RefCell::new(Vec::new());
        let tell = |share| heard.borrow_mut().push(share);
        let trials = search(&[board.example()], &options, tell).unwrap();
        let heard = heard.into_inner();
        assert_eq!(heard.len() + 2, trials.len());
        assert!(heard.is_sorted() && heard[0] > 0.0, "{heard:?}");
        let score = |trial: &Trial| {
            0.5 * (trial.confusion.pixel_accuracy() + trial.confusion.class_accuracy())
        };
        let first = trials.iter().find(|trial| trial.kernels == start).unwrap();
        assert!(score(first) < 0.7, "{first:?}");
        assert!(score(&trials[0]) > 0.95, "{:?}", trials[0]);
        // No field is one more.
        assert!(trials.len() <= options.trials as usize + 2);
        let alone = trials.iter().find(|trial| weightless(trial)).unwrap();
        let gain = |trial: &Trial| trial.confusion.gain_on(&alone.confusion);
        assert!(trials.is_sorted_by(|a, b| gain(a) >= gain(b)));
        assert!(trials.iter().all(|trial| trial.examples == 1));
    }

    /// Where scores are right but colours say nothing of classes, any field does harm.
    #[test]
    fn no_field_is_better_than_a_bad_one() {
        let board = Board::new(0.0, 0);
        let trials = search(&[board.example()], &SearchOptions::default(), |_| ()).unwrap();
        assert!(weightless(&trials[0]), "{:?}", trials[0]);
        assert_eq!(trials[0].confusion.pixel_accuracy(), 1.0);
    }

    /// What is far worse than the best does not label all examples, and comes behind what does.
    #[test]
    fn what_is_clearly_worse_is_given_up() {
        let board = Board::new(0.4, 20);
        let examples = vec![board.example(); 3 * HEAT];
        let trials = search(&examples, &SearchOptions::default(), |_| ()).unwrap();
        let given_up = trials.iter().filter(|trial| trial.examples < 3 * HEAT);
        let (given_up, all) = (given_up.count(), trials.len());
        assert!(given_up > 2, "{given_up} of {all}");
        assert!(trials.is_sorted_by(|a, b| a.examples >= b.examples));
        let one = search(&examples[..1], &SearchOptions::default(), |_| ()).unwrap();
        assert_eq!(trials[0].kernels, one[0].kernels);
    }

    fn weightless(trial: &Trial) -> bool {
        trial.kernels.appearance_weight + trial.kernels.smoothness_weight == 0.0
    }

    /// A chessboard whose fields differ in red.
    struct Board {
        truth: Vec<u8>,
        colours: Vec<u8>,
        /// The truth, wrong in a share of its pixels.
        noisy: Vec<u8>,
    }

    impl Board {
        const SIZE: [usize; 2] = [48, 36];

        fn new(wrong: f64, contrast: u8) -> Self {
            let [width, height] = Self::SIZE;
            let truth: Vec<u8> = (0..width * height)
                .map(|i| u8::from((i % width / 6 + i / width / 6) % 2 == 0))
                .collect();
            let colour =
                |(class, i): (&u8, u32)| [100 + contrast * class, 90 + (i * 7 % 13) as u8, 120];
            let chance = |i: usize| (i.wrapping_mul(2_654_435_761) >> 7) % 1000;
            let noisy =
                |(i, class): (usize, &u8)| class ^ u8::from((chance(i) as f64) < 1000.0 * wrong);
            Self {
                colours: truth.iter().zip(0..).flat_map(colour).collect(),
                noisy: truth.iter().enumerate().map(noisy).collect(),
                truth,
            }
        }

        fn example(&self) -> Example {
            let [width, height] = Self::SIZE.map(|side| side as u32);
            let image = ColourView::new(width, height, &self.colours).unwrap();
            let unary = of_labels(2, &self.noisy, 0.7);
            Example::new(&image, 1, unary, false, self.truth.clone()).unwrap()
        }
    }
}
