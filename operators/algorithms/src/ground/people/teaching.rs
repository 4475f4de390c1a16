//! What answers of people teach about who is found in images, and what to ask.
//!
//! The detector that nobody taught foretells each answer: +1 for a person, -1 for none, so `2 p - 1` where it holds somebody to
//! be there with probability `p`. What is learnt is how far answers differ from that, by what windows show: a linear Gaussian
//! process with the untaught detector as its mean. So nothing changes before there are answers, where windows look like none
//! that was answered, and where answers are what was foretold.
//!
//! *Which answers.* Something is learnt as soon as both are there, people and what is none. Answers of one kind alone are as
//! well explained by a detector that is too bold, or too shy, everywhere.
//!
//! *Questions.* Worth asking is what an answer teaches about all, as with boxes ([`LinearProcess::questions`]).
//!
//! Source: *Integrating metric and semantic maps for vision-only automated parking*, sections V-A2 and VI-B; Rasmussen &
//! Williams, *Gaussian processes for machine learning* (2006), section 2.7, for the mean.

use crate::learning::gaussian_process::{LearningError, LinearProcess, QUESTIONS, UNCERTAIN};

/// Before any answer, how far an answer may differ at a window whose description has the length 1 (variance), and the noise
/// of an answer at even odds (variance).
const UNTAUGHT: [f64; 2] = [0.5, 1.0];

/// Descriptions are not longer than this: what is known of answers takes the square of it.
const LONGEST: usize = 1024;

/// What a person said of a window.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// What the window shows.
    pub description: Vec<f32>,
    /// Probability that it is a person, before anybody taught.
    pub probability: f64,
    /// What was said.
    pub is_person: bool,
}

/// What is held of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// Mean of the answer: 1 for a person, -1 for none. It may be beyond either where much speaks for it.
    pub mean: f64,
    /// Variance of the mean.
    pub variance: f64,
    /// Probability that it is a person.
    pub probability: f64,
}

/// Whether a window can be told apart from others by its description: it is there, not too long, and made of numbers.
pub fn is_described(description: &[f32]) -> bool {
    let is_finite = description.iter().all(|value| value.is_finite());
    (1..=LONGEST).contains(&description.len()) && is_finite
}

/// The answer that is foretold where somebody is with a probability.
pub fn foretold(probability: f64) -> f64 {
    2.0 * probability - 1.0
}

/// Learns how answers differ from what was foretold; `None` before somebody was said to be a person and something to be none.
///
/// # Errors
/// [`LearningError`].
pub fn learn(answers: &[Answer]) -> Result<Option<LinearProcess>, LearningError> {
    let people = answers.iter().filter(|answer| answer.is_person).count();
    if people == 0 || people == answers.len() {
        return Ok(None);
    }
    let surprise = |answer: &Answer| {
        let said = if answer.is_person { 1.0 } else { -1.0 };
        said - foretold(answer.probability)
    };
    let surprises: Vec<f64> = answers.iter().map(surprise).collect();
    let samples = answers.iter().map(|answer| answer.description.clone());
    LinearProcess::learn(&samples.collect::<Vec<_>>(), &surprises).map(Some)
}

/// What is known of answers before there are any, for descriptions of this length; `None` for 0, and above 1024.
pub fn untaught(length: usize) -> Option<LinearProcess> {
    if length > LONGEST {
        return None;
    }
    let mut spread = vec![0.0; length * length];
    let own = spread.iter_mut().step_by(length + 1);
    own.for_each(|value| *value = UNTAUGHT[0].sqrt() as f32);
    LinearProcess::from_parts(vec![0.0; length], UNTAUGHT, &spread)
}

/// What is held of a window that shows this, and is a person with this probability before anybody taught; `None` where the
/// description has not the length of those that were learnt from, or something is no number.
pub fn belief(process: &LinearProcess, description: &[f32], probability: f64) -> Option<Belief> {
    let is_like = is_described(description) && description.len() == process.weights().len();
    if !(is_like && probability.is_finite()) {
        return None;
    }
    let learnt = process.at(description);
    let mean = foretold(probability) + learnt.mean;
    Some(Belief {
        mean,
        variance: learnt.variance,
        probability: (0.5 * (1.0 + mean)).clamp(0.0, 1.0),
    })
}

/// What nobody has said anything of: the least certain of all that were added.
#[derive(Debug, Clone)]
pub struct LeastCertain<T> {
    kept: Vec<(f64, T)>,
}

impl<T> Default for LeastCertain<T> {
    fn default() -> Self {
        Self { kept: Vec::new() }
    }
}

impl<T> LeastCertain<T> {
    /// Adds one that is a person with this probability. Of those that are equally certain the first ones stay.
    pub fn add(&mut self, probability: f64, one: T) {
        self.kept.push((probability, one));
        if self.kept.len() >= 2 * UNCERTAIN {
            self.tidy();
        }
    }

    /// The least certain, first the one nearest to even odds.
    pub fn least_certain(mut self) -> Vec<T> {
        self.tidy();
        self.kept.into_iter().map(|(_, one)| one).collect()
    }

    fn tidy(&mut self) {
        let certainty = |one: &(f64, T)| (one.0 - 0.5).abs();
        self.kept
            .sort_by(|a, b| certainty(a).total_cmp(&certainty(b)));
        self.kept.truncate(UNCERTAIN);
    }
}

/// Which of some windows to ask about, the first first, with what each answer would teach. Of each: what it shows, and the
/// probability that is held of it.
pub fn questions(process: &LinearProcess, open: &[(&[f32], f64)]) -> Vec<(usize, f64)> {
    let shown: Vec<&[f32]> = open.iter().map(|(description, _)| *description).collect();
    let known = process.at_each(&shown);
    // A probability follows half of the mean, and the less the surer it is: of what is certain nothing is to be learnt.
    let slope = |(_, probability): &(&[f32], f64)| 2.0 * probability * (1.0 - probability);
    let slopes: Vec<f64> = open.iter().map(slope).collect();
    process.questions(&known, &slopes, QUESTIONS)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::solving::random::SplitMix64;

    /// Windows of eleven numbers: ten of noise, of length 1 together, of which the first is moved by so much for people, and
    /// a constant. The untaught detector is not sure of any.
    fn windows(count: usize, moved: f32, seed: u64) -> Vec<Answer> {
        let mut random = SplitMix64(seed);
        let mut window = |at: usize| {
            let is_person = at.is_multiple_of(2);
            let mut shown: Vec<f32> = (0..10).map(|_| random.unit() as f32 - 0.5).collect();
            shown[0] += if is_person { moved } else { -moved };
            let length = shown.iter().map(|value| value * value).sum::<f32>().sqrt();
            shown.iter_mut().for_each(|value| *value /= length);
            shown.push(1.0);
            Answer {
                description: shown,
                probability: 0.3 + 0.4 * random.unit(),
                is_person,
            }
        };
        (0..count).map(&mut window).collect()
    }

    /// The share of windows that are believed to be what they are: by what was learnt, and untaught.
    fn right(learnt: &LinearProcess, windows: &[Answer]) -> [f64; 2] {
        let share = |is_right: &dyn Fn(&Answer) -> bool| {
            windows.iter().filter(|one| is_right(one)).count() as f64 / windows.len() as f64
        };
        let taught = |one: &Answer| {
            let belief = belief(learnt, &one.description, one.probability).unwrap();
            (belief.probability >= 0.5) == one.is_person
        };
        let untaught = |one: &Answer| (one.probability >= 0.5) == one.is_person;
        [share(&taught), share(&untaught)]
    }

    #[test]
    fn twenty_answers_tell_apart_what_can_be_told_apart() {
        let learnt = learn(&windows(20, 1.0, 1)).unwrap().unwrap();
        let [taught, untaught] = right(&learnt, &windows(400, 1.0, 2));
        assert!(untaught < 0.6 && taught > 0.9, "{untaught} {taught}");
    }

    /// Where windows show nothing of what was said, the untaught detector's word is about what stays.
    #[test]
    fn answers_that_nothing_explains_take_little_away() {
        for seed in 1..6 {
            let learnt = learn(&windows(20, 0.0, seed)).unwrap().unwrap();
            let mut unseen = windows(400, 0.0, seed + 100);
            let sure = |one: &mut Answer| one.probability = if one.is_person { 0.9 } else { 0.1 };
            unseen.iter_mut().for_each(sure);
            let [taught, untaught] = right(&learnt, &unseen);
            assert!(untaught > 0.99 && taught > 0.85, "{seed}: {taught}");
        }
    }

    #[test]
    fn answers_that_were_foretold_change_nothing() {
        let mut answers = windows(20, 1.0, 1);
        let sure = |one: &mut Answer| one.probability = if one.is_person { 1.0 } else { 0.0 };
        answers.iter_mut().for_each(sure);
        let learnt = learn(&answers).unwrap().unwrap();
        for one in windows(50, 1.0, 3) {
            let belief = belief(&learnt, &one.description, one.probability).unwrap();
            assert!(
                (belief.probability - one.probability).abs() < 1e-6,
                "{belief:?}"
            );
        }
    }

    #[test]
    fn answers_of_one_kind_teach_nothing_yet() {
        assert_eq!(learn(&[]), Ok(None));
        let people = windows(20, 1.0, 1).into_iter();
        let people: Vec<Answer> = people.filter(|one| one.is_person).collect();
        assert_eq!(learn(&people), Ok(None));
    }

    #[test]
    fn what_was_answered_is_surer_than_what_was_not() {
        let answers = windows(20, 1.0, 1);
        let learnt = learn(&answers).unwrap().unwrap();
        // Before any answer: the variance of a weight, for a description of length 1 and a constant 1.
        let before = 2.0 * learnt.scale();
        for one in &answers {
            let belief = belief(&learnt, &one.description, 0.5).unwrap();
            assert!(belief.variance < 0.2 * before, "{belief:?}");
        }
        assert_eq!(belief(&learnt, &[1.0], 0.5), None);
        assert_eq!(belief(&learnt, &[f32::NAN; 11], 0.5), None);
        assert_eq!(belief(&learnt, &answers[0].description, f64::NAN), None);
    }

    #[test]
    fn what_is_sure_is_asked_last_and_nothing_twice() {
        let untaught = untaught(3).unwrap();
        let shown: [&[f32]; 4] = [
            &[1.0, 0.0, 1.0],
            &[1.0, 0.0, 1.0],
            &[0.0, 1.0, 1.0],
            &[0.0, -1.0, 1.0],
        ];
        let open = [
            (shown[0], 0.5),
            (shown[1], 0.5),
            (shown[2], 0.5),
            (shown[3], 1.0),
        ];
        let asked = questions(&untaught, &open);
        let order: Vec<usize> = asked.iter().map(|(at, _)| *at).collect();
        // The second shows what the first does: the third teaches more once the first is answered.
        assert_eq!(order[..2], [0, 2], "{asked:?}");
        assert!(asked.windows(2).all(|pair| pair[0].1 >= pair[1].1));
        assert!(super::untaught(0).is_none() && super::untaught(1_000_000).is_none());
    }

    #[test]
    fn the_least_certain_stay_in_order_whatever_comes_between() {
        let mut open = LeastCertain::default();
        let probability = |at: usize| (at * 7919 % 10_000) as f64 / 10_000.0;
        (0..10_000).for_each(|at| open.add(probability(at), at));
        let kept = open.least_certain();
        let mut all: Vec<usize> = (0..10_000).collect();
        all.sort_by(|a, b| {
            let certainty = |at: usize| (probability(at) - 0.5).abs();
            certainty(*a).total_cmp(&certainty(*b))
        });
        assert_eq!(kept, all[..UNCERTAIN]);
    }
}
