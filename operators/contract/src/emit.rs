//! Where a kernel puts its rows, and where it says what it had to leave out.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_schemas::{Fault, LayerRow, batch};

use crate::Reason;

/// What was left out, and why: reason to count. Bad input is counted and skipped, never silently dropped.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Losses(pub BTreeMap<String, u64>);

/// Reasons that are told apart. Who makes a reason of each thing counts no more of them.
const MOST_REASONS: usize = 1000;

/// The reason that stands for all further ones.
const OTHER_REASONS: &str = "other reasons";

impl Losses {
    /// Adds to one reason's count, as far as numbers go: who counts may be a function of somebody else. Of many reasons, what
    /// comes for further ones is counted together.
    pub fn add(&mut self, reason: impl Into<String>, count: u64) {
        if count == 0 {
            return;
        }
        let mut reason = reason.into();
        if self.0.len() >= MOST_REASONS && !self.0.contains_key(&reason) {
            OTHER_REASONS.clone_into(&mut reason);
        }
        let sum = self.0.entry(reason).or_default();
        *sum = sum.saturating_add(count);
    }

    /// Adds another's counts.
    pub fn merge(&mut self, other: &Losses) {
        other
            .0
            .iter()
            .for_each(|(reason, count)| self.add(reason, *count));
    }

    /// All counts together.
    pub fn total(&self) -> u64 {
        let counts = self.0.values().copied();
        counts.fold(0, u64::saturating_add)
    }

    /// Whether nothing was lost.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// A kernel's outlet.
pub struct Emit<'a> {
    rows: &'a mut dyn FnMut(RecordBatch) -> Result<(), Fault>,
    losses: &'a mut Losses,
    told: Option<&'a (dyn Fn(f64) + Sync)>,
}

impl<'a> Emit<'a> {
    /// An outlet that hands every batch to `rows` and counts into `losses`.
    pub fn new(
        rows: &'a mut dyn FnMut(RecordBatch) -> Result<(), Fault>,
        losses: &'a mut Losses,
    ) -> Self {
        Self {
            rows,
            losses,
            told: None,
        }
    }

    /// The same, where it is told how far the kernel has come.
    pub fn told(self, told: &'a (dyn Fn(f64) + Sync)) -> Self {
        Self {
            told: Some(told),
            ..self
        }
    }

    /// Says which share (0 to 1) of the work is done on rows that were handed in and of which none came out yet.
    pub fn progress(&self, share: f64) {
        if let Some(told) = self.told {
            told(share);
        }
    }

    /// Emits typed rows of the output layer.
    ///
    /// # Errors
    /// When the rows do not fit Arrow, or the reader has gone.
    pub fn rows<T: LayerRow>(&mut self, rows: Vec<T>) -> Result<(), Fault> {
        if rows.is_empty() {
            Ok(())
        } else {
            (self.rows)(batch(rows)?)
        }
    }

    /// Emits the rows that inputs were made into, in order, and counts each input of which none could be made as skipped.
    ///
    /// # Errors
    /// As [`Emit::rows`].
    pub fn made<I>(&mut self, made: Vec<Result<I, Reason>>) -> Result<(), Fault>
    where
        I: IntoIterator<Item: LayerRow>,
    {
        let mut kept = Vec::with_capacity(made.len());
        for made in made {
            match made {
                Ok(rows) => kept.extend(rows),
                Err(reason) => self.skip(reason, 1),
            }
        }
        self.rows(kept)
    }

    /// Counts `count` inputs as skipped for `reason` (a short phrase, such as `image does not decode`).
    pub fn skip(&mut self, reason: impl AsRef<str>, count: u64) {
        self.losses.add(reason.as_ref(), count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_beyond_those_told_apart_are_counted_together() {
        let mut losses = Losses::default();
        for number in 0..3 * MOST_REASONS {
            losses.add(format!("message {number} makes no sense"), 2);
        }
        losses.add("message 1 makes no sense", 1);
        assert_eq!(losses.0.len(), MOST_REASONS + 1);
        assert_eq!(losses.total(), 6 * MOST_REASONS as u64 + 1);
        assert_eq!(losses.0["message 1 makes no sense"], 3);
        assert_eq!(losses.0[OTHER_REASONS], 4 * MOST_REASONS as u64);
        let mut both = losses.clone();
        both.merge(&losses);
        assert_eq!(both.0.len(), MOST_REASONS + 1);
        assert_eq!(both.total(), 2 * losses.total());
    }

    #[test]
    fn counts_stay_at_the_most_that_there_is() {
        let mut losses = Losses::default();
        losses.add("a", u64::MAX - 1);
        losses.add("a", 5);
        losses.merge(&losses.clone());
        losses.add("b", 3);
        losses.add("c", 0);
        let expected = [("a".to_owned(), u64::MAX), ("b".to_owned(), 3)];
        assert_eq!(losses.0, BTreeMap::from(expected));
        assert_eq!(losses.total(), u64::MAX);
    }
}
