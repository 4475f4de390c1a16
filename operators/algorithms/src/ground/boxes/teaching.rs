//! Examples in, hypotheses with their probability and questions out.
//!
//! *Examples.* Boxes that a person drew or accepted are examples of the kind; rejected ones are examples of what is not,
//! and so is what lies beside a box: a step to the side, ahead or turned, which teaches where exactly a box lies. Random
//! boxes stand for the rest of the floor, and an empty description for floor without anything on it.
//!
//! *Sizes* are those of the boxes drawn. People draw a box from either end: they are turned round until each looks more like
//! all the others than it does from its other end.
//!
//! *Questions.* Worth asking is what an answer teaches about all hypotheses: how far it would move their probabilities
//! ([`LinearProcess::questions`]).

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::GroundBox;
use super::box_index::BoxIndex;
use super::description::{LENGTH, describe};
use super::headings::Headings;
use super::lesson::{Lesson, is_looked_at, reach_of};
use super::mosaic::Mosaic;
use super::overhead::Gradients;
use super::rows::LaneLine;
use super::scan::{SAME, Scored, apart, scan};
use super::template::Template;
use crate::learning::calibration::Calibration;
use crate::learning::gaussian_process::{
    LearningError, LinearProcess, Posterior, QUESTIONS, UNCERTAIN,
};

/// A hypothesis that overlaps a rejected box by more than this was answered.
const ANSWERED: f64 = 0.8;

/// How boxes are found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct TeachingParams {
    /// Random boxes that stand for the rest of the floor: five times what a person who drew ten boxes has taught otherwise, with
    /// what lies beside them, as there is more floor. With a fifth, boxes are found where nothing is; with twice as many, fewer of
    /// the others are likely at first.
    #[schemars(range(min = 1, max = 2000))]
    pub random_boxes: usize,
}

impl Default for TeachingParams {
    fn default() -> Self {
        Self { random_boxes: 1000 }
    }
}

/// What a person said of a box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Judgement {
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
    pub judgement: Judgement,
}

impl Example {
    /// Is it one of the kind?
    pub fn is_one(&self) -> bool {
        self.judgement != Judgement::Rejected
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
        let lesson = Lesson::new(mosaic, examples, params);
        let sizes_m = lesson.sizes_m();
        if sizes_m.is_empty() {
            return Ok(None);
        }
        let process = LinearProcess::learn(&lesson.samples, &lesson.answers)?;
        let held = lesson.left_out(&process);
        let accepted = examples
            .iter()
            .filter(|one| one.judgement == Judgement::Accepted);
        let accepted = accepted.count();
        let calibration =
            Calibration::learn(&held).unwrap_or_else(|| untaught(&held, &process, accepted));
        Ok(Some(Self {
            calibration,
            process,
            sizes_m,
            accepted: lesson.count(true),
            rejected: lesson.count(false),
            template: lesson.template,
        }))
    }

    /// Which tiles [`Taught::learn`] reads of an image that counts its parts from all of them ([`Mosaic::count_from`]), whether
    /// it has them yet or not.
    pub fn reads(mosaic: &Mosaic, examples: &[Example]) -> impl Fn([i64; 2]) -> bool + use<> {
        is_looked_at(mosaic, examples)
    }

    /// Whether it knows as many numbers as a description has.
    pub fn is_sound(&self) -> bool {
        self.process.weights().len() == LENGTH
    }

    /// Boxes that look like the examples, apart from each other and from those that are known: the likeliest first, no more
    /// than there is room for.
    pub fn find(&self, mosaic: &Mosaic, examples: &[Example]) -> Vec<Hypothesis> {
        self.weigh(&self.search(mosaic, examples, &[]))
    }

    /// Boxes that look like the examples, anywhere in the image: the first half of [`Taught::find`], which takes most of its
    /// time. Near lanes, those that lie to them as examples do.
    pub fn search(&self, mosaic: &Mosaic, examples: &[Example], lanes: &[LaneLine]) -> Candidates {
        let room = self.sizes_m.iter().map(|[length, width]| length * width);
        let room = mosaic.covered_m2() / room.fold(f64::INFINITY, f64::min);
        let known = AnsweredBoxes::new(examples);
        let headings = Headings::learn(examples, lanes);
        let found = mosaic.parts().into_iter().flat_map(|part| {
            let is_here = |place: &GroundBox| mosaic.part(place.centre) == part;
            let gradients = mosaic.gradients(part, reach_of(&self.sizes_m));
            let corners = mosaic.corners(part);
            let weights = self.process.weights();
            let (sizes_m, most) = (&self.sizes_m, room as usize);
            let found = scan(
                &gradients, corners, weights, sizes_m, &headings, is_here, most,
            );
            self.described(&gradients, found, &known)
        });
        let scored = |one: &ScoredSample| one.scored;
        Candidates(apart(found.collect(), room as usize, scored))
    }

    /// What is left of candidates that were found when less was known, the likeliest first: not moved, none added.
    pub fn look_again(&self, Candidates(found): &Candidates, examples: &[Example]) -> Candidates {
        let known = AnsweredBoxes::new(examples);
        let open = found
            .par_iter()
            .filter(|one| known.leaves_open(&one.scored.place));
        let scored = open.map(|one| {
            let score = self.process.mean(&one.sample);
            let scored = Scored {
                score,
                ..one.scored
            };
            let sample = one.sample.clone();
            ScoredSample { scored, sample }
        });
        let scored: Vec<ScoredSample> = scored.collect();
        let most = scored.len();
        Candidates(apart(scored, most, |one| one.scored))
    }

    /// What candidates are worth: the second half of [`Taught::find`].
    pub fn weigh(&self, Candidates(found): &Candidates) -> Vec<Hypothesis> {
        let known = self.process.at_each(found);
        let hypotheses = found.iter().zip(&known).map(|(one, known)| Hypothesis {
            place: one.scored.place,
            mean: known.mean,
            variance: known.variance,
            probability: self.calibration.probability(known.mean),
            question: None,
        });
        let mut hypotheses: Vec<Hypothesis> = hypotheses.collect();
        self.ask(&mut hypotheses, &known);
        hypotheses
    }

    /// Those of which nothing was said, laid on the template.
    fn described(
        &self,
        gradients: &Gradients,
        found: Vec<Scored>,
        known: &AnsweredBoxes,
    ) -> Vec<ScoredSample> {
        let open = found
            .into_iter()
            .filter(|one| known.leaves_open(&one.place));
        let open: Vec<Scored> = open.collect();
        let described = open.into_par_iter().filter_map(|found| {
            let place = self.template.laid_on(gradients, found.place, &self.sizes_m);
            let sample = describe(gradients, &place)?;
            let scored = Scored { place, ..found };
            Some(ScoredSample { scored, sample })
        });
        described.collect()
    }

    /// Numbers the least certain by what answers would teach.
    fn ask(&self, hypotheses: &mut [Hypothesis], known: &[Posterior]) {
        let slope =
            |one: &Hypothesis| self.calibration.slope * one.probability * (1.0 - one.probability);
        let mut open: Vec<usize> = (0..hypotheses.len()).collect();
        open.sort_by(|a, b| slope(&hypotheses[*b]).total_cmp(&slope(&hypotheses[*a])));
        open.truncate(UNCERTAIN);
        let known: Vec<Posterior> = open.iter().map(|at| known[*at].clone()).collect();
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

/// Before anything was rejected nothing tells what a mean is worth. As likely as not is then what looks so little like the boxes
/// of the kind to those who have not seen them that the next one, with this chance, would be none: a half before anything was
/// asked, and with each that was `accepted` less, one of so many and two more (Laplace's rule of succession). The chance that the
/// next looks less like them than the `k`th of `n` is `k / (n + 1)`.
fn untaught(held: &[(f64, bool)], process: &LinearProcess, accepted: usize) -> Calibration {
    let ones = held.iter().filter(|(_, is_one)| *is_one);
    let mut ones: Vec<f64> = ones.map(|(mean, _)| *mean).collect();
    ones.sort_by(f64::total_cmp);
    let rank = (ones.len() + 1) as f64 / (accepted + 2) as f64 - 1.0;
    let below = rank.max(0.0) as usize;
    let middle = ones.get(below).map(|low| {
        let high = ones.get(below + 1).unwrap_or(low);
        low + (rank - below as f64).max(0.0) * (high - low)
    });
    Calibration {
        middle: middle.map_or(0.0, |mean| mean.max(0.0)),
        slope: PROBIT / process.noise().sqrt().max(f64::MIN_POSITIVE),
    }
}

/// Slope of the logistic curve that is closest to the normal distribution's.
const PROBIT: f64 = 1.702;

/// Boxes that a person said something of.
struct AnsweredBoxes {
    ones: BoxIndex,
    others: BoxIndex,
}

impl AnsweredBoxes {
    fn new(examples: &[Example]) -> Self {
        let boxes = |is_one: bool| {
            let boxes = examples.iter().filter(|one| one.is_one() == is_one);
            BoxIndex::of(&boxes.map(|one| one.place).collect::<Vec<_>>())
        };
        Self {
            ones: boxes(true),
            others: boxes(false),
        }
    }

    /// Whether nothing was said of a box.
    fn leaves_open(&self, place: &GroundBox) -> bool {
        self.ones.overlap(place) <= SAME && self.others.overlap(place) <= ANSWERED
    }
}

/// Boxes with what the image shows in them.
#[derive(Debug, Clone, Default)]
pub struct Candidates(Vec<ScoredSample>);

#[derive(Debug, Clone)]
struct ScoredSample {
    scored: Scored,
    sample: Vec<f32>,
}

impl AsRef<[f32]> for ScoredSample {
    fn as_ref(&self) -> &[f32] {
        &self.sample
    }
}
