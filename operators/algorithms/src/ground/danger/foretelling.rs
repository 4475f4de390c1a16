//! What is known of a site's ground, as its visits teach it: priors by kind of ground, and how much they and the ties count.
//!
//! Weights are not guessed: those are taken under which each visit is foretold best by the visits before it, by the
//! logarithm of the likelihood of what it then saw (the prequential likelihood, Dawid 1984). Looks of one visit are not
//! independent (whoever stands still is seen again, and the crossing that is used today is used all day), so it is whole
//! visits that are held out. Until people are found for the first time nothing says that anybody looked for them: then the
//! map is what was expected.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;

use super::field::{DangerField, LookCounts, Weights};
use crate::solving::least_squares::SystemError;

/// What one visit saw, by index of the cell; ascending.
pub type Visit = Vec<(usize, LookCounts)>;

/// Probabilities are kept this far from 0 and 1 where their logarithms are taken.
const LEAST: f64 = 1e-6;

/// The weights that are tried, as exponents of √2.
const HALVES: RangeInclusive<i64> = -12..=28;

/// The ground of a site, and its visits in the order of time.
pub struct Ground {
    /// Its cells.
    pub field: DangerField,
    /// Kind of each cell.
    pub kinds: Vec<usize>,
    /// What is thought of each kind before any visit: worth one visit.
    pub expected: Vec<f64>,
    /// The visits.
    pub visits: Vec<Visit>,
}

/// How well visits were foretold: logarithms of likelihoods.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Foretold {
    /// Looks in these visits.
    pub looks: f64,
    /// By the map.
    pub map: f64,
    /// By what was expected of each kind of ground before any visit.
    pub prior: f64,
    /// By the rate of each kind of ground in the visits before.
    pub kinds: f64,
    /// By people counted in each cell in the visits before, with the rate of all cells as one look beforehand.
    pub counts: f64,
}

/// What the visits teach.
#[derive(Debug, Clone, PartialEq)]
pub struct DangerModel {
    /// Probability of each kind.
    pub priors: Vec<f64>,
    /// Weights.
    pub weights: Weights,
    /// How well they foretell the visits that come after one in which people were found, each from those before it; `None`
    /// where there is none.
    pub foretold: Option<Foretold>,
}

impl Ground {
    /// All visits, by number.
    pub fn all(&self) -> Vec<usize> {
        (0..self.visits.len()).collect()
    }

    /// Whether people were found in one of these visits.
    pub fn peopled(&self, visits: &[usize]) -> bool {
        let mut seen = visits.iter().flat_map(|visit| &self.visits[*visit]);
        seen.any(|(_, seen)| seen.people > 0.0)
    }

    /// Priors by kind, after these visits: the mean of what was expected and of the rate in each visit that looked at such
    /// ground, as one visit's looks are of one day and crowd.
    pub fn priors(&self, visits: &[usize]) -> Vec<f64> {
        if !self.peopled(visits) {
            return self.expected.clone();
        }
        let mut rates: Vec<(f64, f64)> = self.expected.iter().map(|rate| (*rate, 1.0)).collect();
        for visit in visits {
            let mut of_kind = vec![LookCounts::default(); rates.len()];
            for (cell, seen) in &self.visits[*visit] {
                add(&mut of_kind[self.kinds[*cell]], seen);
            }
            for (rate, seen) in rates.iter_mut().zip(of_kind) {
                if seen.looks > 0.0 {
                    *rate = (rate.0 + seen.people / seen.looks, rate.1 + 1.0);
                }
            }
        }
        rates.into_iter().map(|(sum, count)| sum / count).collect()
    }

    /// What was seen of each cell in these visits.
    pub fn seen(&self, visits: &[usize]) -> Vec<LookCounts> {
        let mut seen = vec![LookCounts::default(); self.kinds.len()];
        for (cell, more) in visits.iter().flat_map(|visit| &self.visits[*visit]) {
            add(&mut seen[*cell], more);
        }
        seen
    }

    /// The map after these visits, with priors by kind. `None` as [`DangerField::solve`].
    pub fn danger(
        &mut self,
        visits: &[usize],
        priors: &[f64],
        weights: Weights,
    ) -> Option<Vec<f64>> {
        let priors: Vec<f64> = self.kinds.iter().map(|kind| priors[*kind]).collect();
        if !self.peopled(visits) {
            return Some(priors);
        }
        let seen = self.seen(visits);
        self.field.solve(&priors, &seen, weights)
    }

    /// Priors and weights by all visits. Where no visit could be foretold, what is known beforehand and what a neighbour
    /// shows count as much as one visit each.
    ///
    /// # Errors
    /// [`SystemError::TooLarge`] where the system has no solution.
    pub fn learn(&mut self) -> Result<DangerModel, SystemError> {
        let all = self.all();
        let one_visit = self.looks_of_a_visit();
        let mut weights = Weights {
            prior_looks: one_visit,
            tie_looks: one_visit,
        };
        let mut foretold = self.foretell_each(weights)?;
        if foretold.is_some() {
            weights = self.search(one_visit)?;
            foretold = self.foretell_each(weights)?;
        }
        Ok(DangerModel {
            priors: self.priors(&all),
            weights,
            foretold,
        })
    }

    /// How well each visit after the first with people is foretold by those before it; `None` where there is none.
    fn foretell_each(&mut self, weights: Weights) -> Result<Option<Foretold>, SystemError> {
        let all = self.all();
        let mut sum: Option<Foretold> = None;
        for next in 0..all.len() {
            if self.peopled(&all[..next]) {
                let found = self.foretell(&all[..next], next, weights)?;
                sum = Some(found.plus(sum.unwrap_or_default()));
            }
        }
        Ok(sum)
    }

    /// How well the visits `before` foretell another one.
    ///
    /// # Errors
    /// As [`Ground::learn`].
    pub fn foretell(
        &mut self,
        before: &[usize],
        next: usize,
        weights: Weights,
    ) -> Result<Foretold, SystemError> {
        let priors = self.priors(before);
        let map = self.danger(before, &priors, weights);
        let map = map.ok_or(SystemError::TooLarge)?;
        let seen = self.seen(before);
        let mut sum = LookCounts::default();
        seen.iter().for_each(|seen| add(&mut sum, seen));
        let rate = sum.people / sum.looks.max(1.0);
        let (visit, kinds) = (&self.visits[next], &self.kinds);
        Ok(Foretold {
            looks: visit.iter().map(|(_, seen)| seen.looks).sum::<f64>(),
            map: log_likelihood(visit, |cell| map[cell]),
            prior: log_likelihood(visit, |cell| self.expected[kinds[cell]]),
            kinds: log_likelihood(visit, |cell| priors[kinds[cell]]),
            counts: log_likelihood(visit, |cell| {
                (seen[cell].people + rate) / (seen[cell].looks + 1.0)
            }),
        })
    }

    /// Looks at a cell in one visit that looked at it, on average; 1 where nobody ever looked.
    fn looks_of_a_visit(&self) -> f64 {
        let looks = self.visits.iter().flatten().map(|(_, seen)| seen.looks);
        let (sum, count) = looks.fold((0.0, 0.0), |(sum, count), looks| (sum + looks, count + 1.0));
        if count > 0.0 { sum / count } else { 1.0 }
    }

    /// Steps by factors of four, two and √2 from one visit's looks, along one weight at a time, while they help.
    fn search(&mut self, one_visit: f64) -> Result<Weights, SystemError> {
        let mut tried: BTreeSet<[i64; 2]> = BTreeSet::new();
        let start = (2.0 * one_visit.log2()).round() as i64;
        let mut best = [start.clamp(*HALVES.start(), *HALVES.end()); 2];
        let mut best_score = self.score(best)?;
        for step in [4, 2, 1] {
            loop {
                let around = [[step, 0], [-step, 0], [0, step], [0, -step]];
                let around = around.map(|[a, t]| [best[0] + a, best[1] + t]);
                let mut better = false;
                for at in around {
                    if tried.contains(&at) || !at.iter().all(|half| HALVES.contains(half)) {
                        continue;
                    }
                    let score = self.score(at)?;
                    tried.insert(at);
                    if score > best_score {
                        (best, best_score, better) = (at, score, true);
                    }
                }
                if !better {
                    break;
                }
            }
        }
        Ok(weights_at(best))
    }

    fn score(&mut self, halves: [i64; 2]) -> Result<f64, SystemError> {
        let found = self.foretell_each(weights_at(halves))?;
        Ok(found.map_or(f64::NEG_INFINITY, |found| found.map))
    }
}

impl Foretold {
    fn plus(self, other: Self) -> Self {
        Self {
            looks: self.looks + other.looks,
            map: self.map + other.map,
            prior: self.prior + other.prior,
            kinds: self.kinds + other.kinds,
            counts: self.counts + other.counts,
        }
    }
}

fn weights_at(halves: [i64; 2]) -> Weights {
    let [prior_looks, tie_looks] = halves.map(|half| (half as f64 / 2.0).exp2());
    Weights {
        prior_looks,
        tie_looks,
    }
}

fn add(sum: &mut LookCounts, more: &LookCounts) {
    sum.looks += more.looks;
    sum.people += more.people;
}

/// Of what a visit saw, under a probability for each cell.
fn log_likelihood(visit: &Visit, probability: impl Fn(usize) -> f64) -> f64 {
    let of_cell = |(cell, seen): &(usize, LookCounts)| {
        let p = probability(*cell).clamp(LEAST, 1.0 - LEAST);
        seen.people * p.ln() + (seen.looks - seen.people) * (-p).ln_1p()
    };
    visit.iter().map(of_cell).sum()
}
