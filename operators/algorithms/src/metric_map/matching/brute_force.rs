//! All descriptors of one set against all of another.

use super::MatchLimits;
use crate::metric_map::features::{Descriptor, Words, distance, words};
use crate::processor::vectorised;

/// Descriptors laid out for many distances. Named by their index.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Descriptors {
    words: Vec<Words>,
}

/// A pair of descriptors that belong together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Match {
    /// Index in the set that asks.
    pub query: u32,
    /// Index in the set that is searched.
    pub found: u32,
    /// Bits that differ, of 512.
    pub distance: u32,
}

/// The two nearest of a set: index and distance of the first, distance of the second.
#[derive(Clone, Copy)]
struct Best {
    index: u32,
    first: u32,
    second: u32,
}

impl Best {
    const NONE: Self = Self {
        index: u32::MAX,
        first: u32::MAX,
        second: u32::MAX,
    };

    #[inline(always)]
    fn offer(&mut self, index: usize, distance: u32) {
        if distance < self.first {
            self.second = self.first;
            (self.index, self.first) = (index as u32, distance);
        } else if distance < self.second {
            self.second = distance;
        }
    }

    fn accepted(&self, limits: &MatchLimits) -> bool {
        let runner_up = (self.second != u32::MAX).then_some(self.second);
        self.first != u32::MAX && limits.accept(self.first, runner_up)
    }
}

impl<'a> FromIterator<&'a Descriptor> for Descriptors {
    fn from_iter<I: IntoIterator<Item = &'a Descriptor>>(descriptors: I) -> Self {
        Self {
            words: descriptors.into_iter().map(words).collect(),
        }
    }
}

impl Descriptors {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.words.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// The pairs that are each other's nearest and pass the limits on both sides, by query. Of
    /// equally near ones the first counts. Cost: one distance per pair.
    pub fn mutual(&self, other: &Self, limits: &MatchLimits) -> Vec<Match> {
        let (rows, columns) = self.both_ways(other, limits);
        let pairs = (0..).zip(&rows).filter(|(query, best)| {
            let back = columns.get(best.index as usize);
            best.accepted(limits)
                && back.is_some_and(|back| back.index == *query && back.accepted(limits))
        });
        pairs
            .map(|(query, best)| Match {
                query,
                found: best.index,
                distance: best.first,
            })
            .collect()
    }

    fn both_ways(&self, other: &Self, limits: &MatchLimits) -> (Vec<Best>, Vec<Best>) {
        let unlike = limits.unlike_bits();
        vectorised(
            #[inline(always)]
            || both_ways(&self.words, &other.words, unlike),
        )
    }

    /// For each of these descriptors its nearest in `other`, where it passes the limits.
    pub fn nearest(&self, other: &Self, limits: &MatchLimits) -> Vec<Option<Match>> {
        let (rows, _) = self.both_ways(other, limits);
        let found = (0..).zip(rows).map(|(query, best)| {
            best.accepted(limits).then_some(Match {
                query,
                found: best.index,
                distance: best.first,
            })
        });
        found.collect()
    }
}

/// The best of each row and each column of the distance table, of distances below `unlike`, in blocks that stay in the
/// cache.
#[inline(always)]
fn both_ways(a: &[Words], b: &[Words], unlike: u32) -> (Vec<Best>, Vec<Best>) {
    const BLOCK: usize = 64;
    let mut rows = vec![Best::NONE; a.len()];
    let mut columns = vec![Best::NONE; b.len()];
    for start in (0..b.len()).step_by(BLOCK) {
        let end = b.len().min(start + BLOCK);
        for (query, (a, row)) in a.iter().zip(&mut rows).enumerate() {
            for (index, b) in (start..end).zip(&b[start..end]) {
                let distance = distance(a, b);
                // Few are: most descriptors have nothing to do with each other.
                if distance < unlike {
                    row.offer(index, distance);
                    columns[index].offer(query, distance);
                }
            }
        }
    }
    (rows, columns)
}
