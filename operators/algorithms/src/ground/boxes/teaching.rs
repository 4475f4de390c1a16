//! Examples in, hypotheses with their probability and questions out.
//!
//! *Examples.* Boxes that a person drew or accepted are examples of the kind; rejected ones are examples of what is not,
//! and so is what lies beside a box: a step to the side, ahead or turned, which teaches where exactly a box lies. Random
//! boxes stand for the rest of the floor, and an empty description for floor without anything on it.
//!
//! *Sizes* are those of the boxes drawn. People draw a box from either end: each is taken the way round in which it looks
//! more like those before.
//!
//! *Questions.* Worth asking is what an answer teaches about all hypotheses: how far it would move their probabilities
//! ([`LinearProcess::questions`]).

use std::collections::BTreeMap;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::GroundBox;
use super::calibration::Calibration;
use super::description::{LENGTH, describe, reach_m};
use super::mosaic::{Mosaic, Part};
use super::overhead::Gradients;
use super::scan::{BoxIndex, Scored, apart, scan};
use super::template::{Template, laid_out};
use crate::learning::gaussian_process::{LearningError, LinearProcess, Posterior};
use crate::solving::random::SplitMix64;

/// Boxes whose sides differ by less than this part are of one size.
const ONE_SIZE: f64 = 0.15;
/// A random box that overlaps a known one by more than this is no example of the floor.
const CLEAR: f64 = 0.1;
/// A hypothesis that overlaps a rejected box by more than this was answered.
const ANSWERED: f64 = 0.8;
/// Hypotheses that are weighed as questions: the least certain. The time to weigh them takes the square of it.
const UNCERTAIN: usize = 500;
/// Questions, at most: more than a person answers at a sitting.
const QUESTIONS: usize = 50;

/// How boxes are found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct TeachingParams {
    /// Random boxes that stand for the rest of the floor: as many as a person who drew ten boxes has taught otherwise, with
    /// what lies beside them.
    #[schemars(range(min = 1, max = 2000))]
    pub random_boxes: usize,
}

impl Default for TeachingParams {
    fn default() -> Self {
        Self { random_boxes: 200 }
    }
}

/// What a person said of a box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Said {
    /// It lies exactly here.
    Drawn,
    /// It is one, about here.
    Accepted,
    /// It is none.
    Rejected,
}

/// A box that a person said something of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Example {
    /// The box.
    pub place: GroundBox,
    /// What was said.
    pub said: Said,
}

impl Example {
    /// Is it one of the kind?
    pub fn is_one(&self) -> bool {
        self.said != Said::Rejected
    }
}

/// A box that may be one of the kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hypothesis {
    /// The box.
    pub place: GroundBox,
    /// Mean of the answer, +1 for one of the kind, -1 for none.
    pub mean: f64,
    /// Variance of the mean.
    pub variance: f64,
    /// Probability that it is one.
    pub probability: f64,
    /// The question that it is; `None` where others are more worth asking about.
    pub question: Option<Question>,
}

/// Whether a hypothesis is one of the kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Question {
    /// From 1, which is to be asked first.
    pub number: usize,
    /// What an answer would teach when those before are answered: change of the probabilities of all, squares added up.
    pub gain: f64,
}

/// What was learnt of a kind of box.
#[derive(Debug, Clone, PartialEq)]
pub struct Taught {
    /// What the description of a box says of it.
    pub process: LinearProcess,
    /// What that is worth.
    pub calibration: Calibration,
    /// What it shows in detail.
    pub template: Template,
    /// Lengths and widths of such boxes (m).
    pub sizes_m: Vec<[f64; 2]>,
    /// Examples of the kind that the image shows.
    pub accepted: u32,
    /// Examples of what is not that it shows.
    pub rejected: u32,
}

impl Taught {
    /// Learns from examples; `None` where no example of the kind lies where the image shows anything.
    ///
    /// # Errors
    /// [`LearningError::NoEigenvalues`].
    pub fn learn(
        mosaic: &Mosaic,
        examples: &[Example],
        params: &TeachingParams,
    ) -> Result<Option<Self>, LearningError> {
        let mut seen = described(mosaic, examples, params);
        let template = Template::learn(seen.iter_mut().filter_map(|one| one.layout.take()));
        let lesson = Lesson::new(seen);
        if lesson.sizes.is_empty() {
            return Ok(None);
        }
        let process = LinearProcess::learn(&lesson.samples, &lesson.answers)?;
        let held = lesson.left_out(&process);
        let calibration = Calibration::learn(&held).unwrap_or_else(|| untaught(&held, &process));
        Ok(Some(Self {
            calibration,
            process,
            template,
            sizes_m: lesson.sizes.iter().map(|sizes| mean(sizes)).collect(),
            accepted: lesson.count(true),
            rejected: lesson.count(false),
        }))
    }

    /// Whether it knows as many numbers as a description has.
    pub fn is_sound(&self) -> bool {
        self.process.weights().len() == LENGTH
    }

    /// Boxes that look like the examples, apart from each other and from those that are known: the likeliest first, no more
    /// than there is room for.
    pub fn find(&self, mosaic: &Mosaic, examples: &[Example]) -> Vec<Hypothesis> {
        let room = self.sizes_m.iter().map(|[length, width]| length * width);
        let room = mosaic.covered_m2() / room.fold(f64::INFINITY, f64::min);
        let found = mosaic
            .parts()
            .into_iter()
            .flat_map(|part| self.find_in(mosaic, part, examples, room as usize));
        let mut found = apart(found.collect(), |one: &Described| one.scored);
        found.truncate(room as usize);
        let known = found.par_iter().map(|one| {
            let known = self.process.at(&one.sample);
            Hypothesis {
                place: one.scored.place,
                mean: known.mean,
                variance: known.variance,
                probability: self.calibration.probability(known.mean),
                question: None,
            }
        });
        let mut hypotheses: Vec<Hypothesis> = known.collect();
        self.ask(&mut hypotheses, &found);
        hypotheses
    }

    /// Those whose middle is in a part of the image.
    fn find_in(
        &self,
        mosaic: &Mosaic,
        part: Part,
        examples: &[Example],
        most: usize,
    ) -> Vec<Described> {
        let gradients = mosaic.gradients(part, reach_of(&self.sizes_m));
        let is_here = |point: [f64; 2]| mosaic.part(point) == part;
        let weights = self.process.weights();
        let found = scan(&gradients, weights, &self.sizes_m, is_here, most);
        let boxes = |is_one: bool| {
            let boxes = examples.iter().filter(|one| one.is_one() == is_one);
            BoxIndex::of(&boxes.map(|one| one.place).collect::<Vec<_>>())
        };
        let (ones, others) = (boxes(true), boxes(false));
        let is_open = |one: &Scored| {
            ones.overlap(&one.place) <= super::scan::SAME && others.overlap(&one.place) <= ANSWERED
        };
        let open: Vec<Scored> = found.into_iter().filter(is_open).collect();
        let described = open.into_par_iter().filter_map(|found| {
            let place = self.template.laid_on(&gradients, found.place);
            let sample = describe(&gradients, &place)?;
            let scored = Scored { place, ..found };
            Some(Described { scored, sample })
        });
        described.collect()
    }

    /// Numbers the least certain by what answers would teach.
    fn ask(&self, hypotheses: &mut [Hypothesis], found: &[Described]) {
        let slope =
            |one: &Hypothesis| self.calibration.slope * one.probability * (1.0 - one.probability);
        let mut open: Vec<usize> = (0..hypotheses.len()).collect();
        open.sort_by(|a, b| slope(&hypotheses[*b]).total_cmp(&slope(&hypotheses[*a])));
        open.truncate(UNCERTAIN);
        let known: Vec<Posterior> = open
            .par_iter()
            .map(|at| self.process.at(&found[*at].sample))
            .collect();
        let slopes: Vec<f64> = open.iter().map(|at| slope(&hypotheses[*at])).collect();
        let questions = self.process.questions(&known, &slopes, QUESTIONS);
        for (question, (at, gain)) in questions.into_iter().enumerate() {
            hypotheses[open[at]].question = Some(Question {
                number: question + 1,
                gain,
            });
        }
    }
}

/// Before anything was rejected nothing tells what a mean is worth: as likely as not is what looks like the boxes of the kind
/// do to those who have not seen them, at the median.
fn untaught(held: &[(f64, bool)], process: &LinearProcess) -> Calibration {
    let ones = held.iter().filter(|(_, is_one)| *is_one);
    let mut means: Vec<f64> = ones.map(|(mean, _)| *mean).collect();
    means.sort_by(f64::total_cmp);
    Calibration {
        middle: means.get(means.len() / 2).map_or(0.0, |mean| mean.max(0.0)),
        slope: PROBIT / process.noise().sqrt().max(f64::MIN_POSITIVE),
    }
}

/// Slope of the logistic curve that is closest to the normal distribution's.
const PROBIT: f64 = 1.702;

struct Described {
    scored: Scored,
    sample: Vec<f32>,
}

/// How far the largest of boxes is described from its middle (m).
fn reach_of(sizes_m: &[[f64; 2]]) -> f64 {
    let reach = sizes_m.iter().map(|[length_m, width_m]| {
        let [long, wide] = reach_m(&GroundBox {
            centre: [0.0; 2],
            yaw: 0.0,
            length_m: *length_m,
            width_m: *width_m,
        });
        0.5 * long.hypot(wide)
    });
    reach.fold(0.0, f64::max)
}

/// What is to be learnt from one example, or from the floor.
struct Seen {
    /// The example; `None` for random boxes.
    example: Option<Example>,
    /// What the image shows in it, as drawn and from its other end; one alone for random boxes.
    ways: Vec<Vec<f32>>,
    /// What it is worth: +1 for one of the kind.
    answer: f64,
    /// The same of what lies beside it.
    beside: Vec<(Vec<Vec<f32>>, f64)>,
    /// What the template is made of; `None` for what does not lie exactly where it is.
    layout: Option<Vec<[f32; 2]>>,
}

/// What the image shows in the examples, in their order, and in random boxes near them.
fn described(mosaic: &Mosaic, examples: &[Example], params: &TeachingParams) -> Vec<Seen> {
    let ones: Vec<GroundBox> = examples
        .iter()
        .filter(|one| one.is_one())
        .map(|one| one.place)
        .collect();
    let index = BoxIndex::of(&ones);
    let sizes: Vec<[f64; 2]> = examples
        .iter()
        .map(|one| [one.place.length_m, one.place.width_m])
        .collect();
    // Boxes beside one begin a width away from it at most.
    let reach_m = 2.0 * reach_of(&sizes);
    let mut parts: BTreeMap<Part, Vec<(usize, Example)>> = BTreeMap::new();
    for (at, example) in examples.iter().enumerate() {
        let part = parts.entry(mosaic.part(example.place.centre)).or_default();
        part.push((at, *example));
    }
    let random = params.random_boxes.div_ceil(parts.len().max(1));
    let mut seen: Vec<(usize, Seen)> = Vec::new();
    for (part, examples) in parts {
        let gradients = mosaic.gradients(part, reach_m);
        let found = examples.into_par_iter().filter_map(|(at, example)| {
            Some((at, described_example(&gradients, example, &index)?))
        });
        seen.extend(found.collect::<Vec<_>>());
        let floor = random_boxes(&gradients, &index, &ones, random).into_iter();
        let floor = floor.map(|sample| Seen {
            example: None,
            ways: vec![sample],
            answer: -1.0,
            beside: Vec::new(),
            layout: None,
        });
        seen.extend(floor.map(|seen| (usize::MAX, seen)));
    }
    seen.sort_by_key(|(at, _)| *at);
    seen.into_iter().map(|(_, seen)| seen).collect()
}

fn described_example(gradients: &Gradients, example: Example, ones: &BoxIndex) -> Option<Seen> {
    let ways = |place: &GroundBox| -> Option<Vec<Vec<f32>>> {
        let turned = describe(gradients, &place.turned())?;
        Some(vec![describe(gradients, place)?, turned])
    };
    let beside = |place: GroundBox| Some((ways(&place)?, answer(example.place.overlap(&place))));
    Some(Seen {
        example: Some(example),
        ways: ways(&example.place)?,
        answer: if example.is_one() {
            1.0
        } else {
            answer(ones.overlap(&example.place))
        },
        beside: if example.is_one() {
            beside_of(&example.place)
                .into_iter()
                .filter_map(beside)
                .collect()
        } else {
            Vec::new()
        },
        layout: (example.said == Said::Drawn)
            .then(|| laid_out(gradients, &example.place))
            .flatten(),
    })
}

/// What there is to learn from.
#[derive(Default)]
struct Lesson {
    samples: Vec<Vec<f32>>,
    answers: Vec<f64>,
    /// By example: its samples, how many of them are of the box itself, and whether it is one of the kind.
    examples: Vec<(std::ops::Range<usize>, usize, bool)>,
    /// Boxes of one size together.
    sizes: Vec<Vec<[f64; 2]>>,
}

impl Lesson {
    fn new(seen: Vec<Seen>) -> Self {
        let mut lesson = Self::default();
        let mut ones: Vec<f32> = vec![0.0; LENGTH];
        for one in seen {
            let begin = lesson.samples.len();
            match one.example {
                Some(example) if example.is_one() => {
                    let GroundBox {
                        length_m, width_m, ..
                    } = example.place;
                    let own = likest(one.ways, &ones);
                    ones.iter_mut()
                        .zip(&own)
                        .for_each(|(sum, value)| *sum += value);
                    lesson.add(own, 1.0);
                    for (ways, answer) in one.beside {
                        if answer == -1.0 {
                            ways.into_iter().for_each(|way| lesson.add(way, -1.0));
                        } else {
                            lesson.add(likest(ways, &ones), answer);
                        }
                    }
                    add_size(&mut lesson.sizes, [length_m, width_m]);
                    lesson.examples.push((begin..lesson.samples.len(), 1, true));
                }
                example => {
                    let count = one.ways.len();
                    one.ways
                        .into_iter()
                        .for_each(|way| lesson.add(way, one.answer));
                    if example.is_some() {
                        lesson.examples.push((begin..begin + count, count, false));
                    }
                }
            }
        }
        let mut empty = vec![0.0; LENGTH];
        empty[LENGTH - 1] = 1.0;
        lesson.add(empty, -1.0);
        lesson
    }

    fn count(&self, are_ones: bool) -> u32 {
        let examples = self.examples.iter();
        examples
            .filter(|(_, _, is_one)| *is_one == are_ones)
            .count() as u32
    }

    fn add(&mut self, sample: Vec<f32>, answer: f64) {
        self.samples.push(sample);
        self.answers.push(answer);
    }

    /// By example: what would be held of it, had it not been learnt from, the better way round, and whether it is one.
    fn left_out(&self, process: &LinearProcess) -> Vec<(f64, bool)> {
        let held = self.examples.par_iter().map(|(range, own, is_one)| {
            let samples = self.samples[range.clone()].iter().map(Vec::as_slice);
            let means =
                process.left_out(&samples.collect::<Vec<_>>(), &self.answers[range.clone()]);
            let best = means[..*own]
                .iter()
                .copied()
                .fold(f64::NEG_INFINITY, f64::max);
            (best, *is_one)
        });
        held.collect()
    }
}

/// The way round in which a box looks more like others, all added up.
fn likest(ways: Vec<Vec<f32>>, others: &[f32]) -> Vec<f32> {
    let like = |way: &Vec<f32>| -> f32 { way.iter().zip(others).map(|(a, b)| a * b).sum() };
    let best = ways.into_iter().reduce(
        |best, way| {
            if like(&way) > like(&best) { way } else { best }
        },
    );
    best.unwrap_or_default()
}

fn add_size(sizes: &mut Vec<Vec<[f64; 2]>>, size: [f64; 2]) {
    let like = |known: &&mut Vec<[f64; 2]>| {
        let mean = mean(known);
        (0..2).all(|side| (size[side] / mean[side]).ln().abs() < ONE_SIZE)
    };
    match sizes.iter_mut().find(like) {
        Some(known) => known.push(size),
        None => sizes.push(vec![size]),
    }
}

fn mean(sizes: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|side| sizes.iter().map(|size| size[side]).sum::<f64>() / sizes.len() as f64)
}

/// What a box is worth that overlaps one of the kind by so much: all where it is the same, nothing where it lies half a
/// width aside (an overlap of a third).
fn answer(overlap: f64) -> f64 {
    (3.0 * overlap - 2.0).max(-1.0)
}

/// Boxes beside one: a tenth, a quarter and half of its width to the sides, a quarter, half and a whole width ahead and
/// behind, turned by 5, 10, 45 and 90 degrees.
fn beside_of(place: &GroundBox) -> Vec<GroundBox> {
    let aside = [0.1, 0.25, 0.5].map(|part| [0.0, part * place.width_m]);
    let ahead = [0.25, 0.5, 1.0].map(|part| [part * place.width_m, 0.0]);
    let moved = aside.into_iter().chain(ahead);
    let moved = moved.flat_map(|[along, left]| [[along, left], [-along, -left]]);
    let moved = moved.map(|by| GroundBox {
        centre: place.point(by),
        ..*place
    });
    let turned = [5.0_f64, -5.0, 10.0, -10.0, 45.0, -45.0, 90.0];
    let turned = turned.into_iter().map(|by| GroundBox {
        yaw: place.yaw + by.to_radians(),
        ..*place
    });
    moved.chain(turned).collect()
}

/// Descriptions of boxes anywhere in the image, clear of those of the kind; the same for the same image.
fn random_boxes(
    gradients: &Gradients,
    index: &BoxIndex,
    ones: &[GroundBox],
    count: usize,
) -> Vec<Vec<f32>> {
    if ones.is_empty() {
        return Vec::new();
    }
    let mut random = SplitMix64(1);
    let mut unit = move || (random.next() >> 11) as f64 / (1_u64 << 53) as f64;
    let mut tried = (0..20 * count).map(|at| GroundBox {
        centre: gradients.within([unit(), unit()]),
        yaw: std::f64::consts::TAU * unit(),
        ..ones[at % ones.len()]
    });
    let mut found = Vec::new();
    while found.len() < count
        && let Some(place) = tried.next()
    {
        if index.overlap(&place) < CLEAR
            && let Some(described) = describe(gradients, &place)
        {
            found.push(described);
        }
    }
    found
}
