//! Documents by the words they share.

use super::vocabulary::Bag;

/// An inverted index of documents: keyframes with what all their cameras saw, or groups of landmarks.
///
/// A document is the vector of its words' counts, each weighted by the logarithm of how rare the word is, of sum one;
/// two documents score by what their vectors have in common, 0 to 1 (Sivic, Zisserman: Video Google, 2003; the L1 score
/// of Nistér, Stewénius, 2006).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlaceIndex {
    /// By word: documents, ascending, with the word's weight there.
    postings: Vec<Vec<(u32, f32)>>,
    /// By word.
    rarity: Vec<f32>,
    documents: usize,
}

/// A document that shares words.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Its index in the list that the index was made from.
    pub document: usize,
    /// What they have in common: 0 nothing, 1 all.
    pub score: f32,
}

impl PlaceIndex {
    /// Indexes documents of words below `words`.
    pub fn new(words: usize, documents: &[Bag]) -> Self {
        let mut holding = vec![0_u32; words];
        for (word, _) in documents.iter().flat_map(|bag| &bag.counts) {
            if let Some(count) = holding.get_mut(*word as usize) {
                *count += 1;
            }
        }
        let all = documents.len() as f32;
        let rarity = |count: &u32| {
            if *count == 0 {
                0.0
            } else {
                (all / *count as f32).ln()
            }
        };
        let mut index = Self {
            postings: holding
                .iter()
                .map(|count| Vec::with_capacity(*count as usize))
                .collect(),
            rarity: holding.iter().map(rarity).collect(),
            documents: documents.len(),
        };
        for (document, bag) in (0..).zip(documents) {
            for (word, weight) in index.weights(bag) {
                index.postings[word].push((document, weight));
            }
        }
        index
    }

    /// The scores of the documents before `end`.
    pub fn scores(&self, bag: &Bag, end: usize) -> Vec<f32> {
        let end = end.min(self.documents);
        let mut scores = vec![0.0; end];
        for (word, weight) in self.weights(bag) {
            for (document, other) in &self.postings[word] {
                let Some(score) = scores.get_mut(*document as usize) else {
                    break;
                };
                *score += weight.min(*other);
            }
        }
        scores
    }

    /// The `count` documents of the highest scores above zero among those that `accept` lets pass, the best first; of
    /// equal ones the first.
    pub fn best(&self, bag: &Bag, count: usize, accept: impl Fn(usize) -> bool) -> Vec<Hit> {
        let scores = self.scores(bag, self.documents);
        let hits = scores.into_iter().enumerate();
        let mut hits: Vec<Hit> = hits
            .filter(|(document, score)| *score > 0.0 && accept(*document))
            .map(|(document, score)| Hit { document, score })
            .collect();
        let better = |a: &Hit, b: &Hit| {
            let by_score = b.score.total_cmp(&a.score);
            by_score.then(a.document.cmp(&b.document))
        };
        if count < hits.len() {
            hits.select_nth_unstable_by(count, better);
            hits.truncate(count);
        }
        hits.sort_unstable_by(better);
        hits
    }

    /// Words that tell documents apart, with their weights.
    fn weights(&self, bag: &Bag) -> Vec<(usize, f32)> {
        let weighted = bag.counts.iter().filter_map(|(word, count)| {
            let rarity = *self.rarity.get(*word as usize)?;
            (rarity > 0.0).then_some((*word as usize, *count as f32 * rarity))
        });
        let mut weights: Vec<(usize, f32)> = weighted.collect();
        let sum: f32 = weights.iter().map(|(_, weight)| weight).sum();
        weights.iter_mut().for_each(|(_, weight)| *weight /= sum);
        weights
    }
}
