//! From a score to a probability.
//!
//! What a score is worth is learnt from answers, each left out of what its score comes from: a logistic curve by maximum
//! likelihood, with the targets that keep it from being surer than so many answers can make it.
//!
//! Source: Platt, *Probabilistic outputs for support vector machines* (1999); Newton's method as by Lin, Lin & Weng (2007).

/// Rounds of Newton's method, more than it takes.
const ROUNDS: usize = 50;

/// A logistic curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// The score that is as likely right as wrong.
    pub middle: f64,
    /// Change of the logarithm of the odds with the score; positive.
    pub slope: f64,
}

impl Calibration {
    /// From scores and whether they were right; `None` where either is missing or a higher score does not make it
    /// likelier.
    pub fn learn(known: &[(f64, bool)]) -> Option<Self> {
        let ones = known.iter().filter(|(_, is_one)| *is_one).count() as f64;
        let others = known.len() as f64 - ones;
        if ones == 0.0 || others == 0.0 {
            return None;
        }
        let target = |is_one: bool| {
            if is_one {
                (ones + 1.0) / (ones + 2.0)
            } else {
                1.0 / (others + 2.0)
            }
        };
        let cost = |[slope, constant]: [f64; 2]| -> f64 {
            let costs = known.iter().map(|(mean, is_one)| {
                let odds = slope * mean + constant;
                odds.max(0.0) - target(*is_one) * odds + (-odds.abs()).exp().ln_1p()
            });
            costs.sum()
        };
        let mut at = [0.0, ((ones + 1.0) / (others + 1.0)).ln()];
        for _ in 0..ROUNDS {
            let (mut pull, mut bend) = ([0.0; 2], [1e-12, 0.0, 1e-12]);
            for (mean, is_one) in known {
                let chance = logistic(at[0] * mean + at[1]);
                let (off, spread) = (chance - target(*is_one), chance * (1.0 - chance));
                pull[0] += off * mean;
                pull[1] += off;
                bend[0] += spread * mean * mean;
                bend[1] += spread * mean;
                bend[2] += spread;
            }
            let determinant = bend[0] * bend[2] - bend[1] * bend[1];
            let step = [
                (bend[2] * pull[0] - bend[1] * pull[1]) / determinant,
                (bend[0] * pull[1] - bend[1] * pull[0]) / determinant,
            ];
            let halves = (0..40).map(|half| 0.5_f64.powi(half));
            let moved = |part: f64| [at[0] - part * step[0], at[1] - part * step[1]];
            let before = cost(at);
            let Some(better) = halves.map(moved).find(|to| cost(*to) < before) else {
                break;
            };
            at = better;
        }
        let [slope, constant] = at;
        let middle = -constant / slope;
        (slope > 0.0 && middle.is_finite()).then_some(Self { middle, slope })
    }

    /// The probability that a score is worth.
    pub fn probability(&self, mean: f64) -> f64 {
        logistic(self.slope * (mean - self.middle))
    }
}

fn logistic(odds: f64) -> f64 {
    1.0 / (1.0 + (-odds).exp())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_middle_lies_between_what_is_and_what_is_not() {
        let known = [
            (0.9, true),
            (0.7, true),
            (0.6, true),
            (0.3, false),
            (-0.2, false),
        ];
        let found = Calibration::learn(&known).unwrap();
        assert!(found.middle > 0.3 && found.middle < 0.6, "{found:?}");
        assert!(found.probability(0.9) > 0.7 && found.probability(0.9) < 0.9);
        assert!(found.probability(-0.2) < 0.3);
    }

    #[test]
    fn as_many_say_so_are_as_sure_as_they_say() {
        let mut known = vec![(1.0, true); 80];
        known.extend([(1.0, false); 20]);
        known.extend([(0.0, true); 20]);
        known.extend([(0.0, false); 80]);
        let found = Calibration::learn(&known).unwrap();
        assert!((found.probability(1.0) - 0.8).abs() < 0.01);
        assert!((found.middle - 0.5).abs() < 1e-6);
    }

    #[test]
    fn what_says_nothing_is_no_calibration() {
        assert_eq!(Calibration::learn(&[]), None);
        assert_eq!(Calibration::learn(&[(0.5, true), (0.7, true)]), None);
        assert_eq!(Calibration::learn(&[(0.1, true), (0.9, false)]), None);
        assert_eq!(Calibration::learn(&[(0.5, true), (0.5, false)]), None);
    }
}
