//! Words for binary descriptors: a tree of majorities.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::metric_map::features::{Descriptor, Words, distance, words};
use crate::processor::{each, vectorised};

/// Descriptors that one task of the assignment takes.
const CHUNK: usize = 2048;

/// How a vocabulary is made. How much it learns from is a parameter of those who make one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct VocabularyOptions {
    /// Branches at each node: looking a word up costs as many distances on each level.
    #[serde(skip)]
    pub branching: usize,
    /// A node with this many training descriptors or fewer is a word.
    #[serde(skip)]
    pub leaf: usize,
    /// Levels at most.
    #[serde(skip)]
    pub max_depth: usize,
    /// Descriptors that the vocabulary is trained with, at most; taken evenly from all.
    #[schemars(range(min = 1))]
    pub max_training: usize,
    /// Rounds of assignment and majority at each node.
    #[serde(skip)]
    pub rounds: usize,
}

impl Default for VocabularyOptions {
    /// A word for about every twenty descriptors of the sample: one landmark is seen ten to a hundred times in a drive
    /// or two, so that words are about as fine as landmarks, and coarser in maps whose sample is thinner.
    fn default() -> Self {
        Self {
            branching: 10,
            leaf: 40,
            max_depth: 7,
            max_training: 200_000,
            rounds: 5,
        }
    }
}

impl VocabularyOptions {
    /// Of so many descriptors one in how many is taken to train with.
    pub(super) fn step(&self, descriptors: usize) -> usize {
        descriptors.div_ceil(self.max_training.max(1)).max(1)
    }
}

/// Descriptors that look alike share a word. A tree of k-majority clusters (Grana et al.: A Fast Approach for
/// Integrating ORB Descriptors in the Bag of Words Model, 2013; Nistér, Stewénius: Scalable Recognition with a
/// Vocabulary Tree, 2006).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Vocabulary {
    /// The first is the root; the children of a node lie together.
    nodes: Vec<Node>,
    words: usize,
}

#[derive(Debug, Clone, PartialEq)]
struct Node {
    centre: Words,
    /// Its children, or none.
    children: std::ops::Range<u32>,
    /// The word, at a leaf.
    word: u32,
}

/// How often each word occurs: ascending by word, counts above zero.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Bag {
    /// Word and count.
    pub counts: Vec<(u32, u32)>,
}

impl Vocabulary {
    /// Trains on a set of descriptors; the order counts, chance does not.
    pub fn train<'a>(
        descriptors: impl ExactSizeIterator<Item = &'a Descriptor>,
        options: &VocabularyOptions,
    ) -> Self {
        let step = options.step(descriptors.len());
        let sample = descriptors.step_by(step).map(words);
        Self::of_sample(&sample.collect::<Vec<Words>>(), options)
    }

    /// Trains on descriptors that were chosen: of all, in their order, every [`VocabularyOptions::step`]th from the first on.
    pub(super) fn of_sample(sample: &[Words], options: &VocabularyOptions) -> Self {
        let all: Vec<u32> = (0..sample.len() as u32).collect();
        let mut vocabulary = Self::default();
        vocabulary.nodes.push(Node {
            centre: [0; 8],
            children: 0..0,
            word: 0,
        });
        vocabulary.grow(0, all, sample, options, options.max_depth);
        vocabulary
    }

    /// How many words there are.
    pub fn words(&self) -> usize {
        self.words
    }

    /// The words of descriptors, in their order.
    pub fn look_up<'a>(&self, descriptors: impl IntoIterator<Item = &'a Descriptor>) -> Vec<u32> {
        let wanted: Vec<Words> = descriptors.into_iter().map(words).collect();
        each(
            wanted.iter(),
            #[inline(always)]
            |wanted| self.word(wanted),
        )
    }

    /// Words with their counts.
    pub fn bag<'a>(&self, descriptors: impl IntoIterator<Item = &'a Descriptor>) -> Bag {
        let mut found = self.look_up(descriptors);
        found.sort_unstable();
        let runs = found.chunk_by(|a, b| a == b);
        Bag {
            counts: runs.map(|run| (run[0], run.len() as u32)).collect(),
        }
    }

    #[inline(always)]
    fn word(&self, wanted: &Words) -> u32 {
        let Some(mut node) = self.nodes.first() else {
            return 0;
        };
        while !node.children.is_empty() {
            let children = &self.nodes[node.children.start as usize..node.children.end as usize];
            let mut best = (u32::MAX, node);
            for child in children {
                let apart = distance(&child.centre, wanted);
                if apart < best.0 {
                    best = (apart, child);
                }
            }
            node = best.1;
        }
        node.word
    }

    fn grow(
        &mut self,
        node: usize,
        members: Vec<u32>,
        sample: &[Words],
        options: &VocabularyOptions,
        levels: usize,
    ) {
        let clusters = if members.len() <= options.leaf || levels == 0 {
            Vec::new()
        } else {
            clusters(&members, sample, options)
        };
        if clusters.len() < 2 {
            self.nodes[node].word = self.words as u32;
            self.words += 1;
            return;
        }
        let first = self.nodes.len();
        self.nodes[node].children = first as u32..(first + clusters.len()) as u32;
        let leaves = clusters.iter().map(|(centre, _)| Node {
            centre: *centre,
            children: 0..0,
            word: 0,
        });
        self.nodes.extend(leaves);
        for (i, (_, members)) in clusters.into_iter().enumerate() {
            self.grow(first + i, members, sample, options, levels - 1);
        }
    }
}

/// k-majority: assign to the nearest centre, take of each bit what most members have.
fn clusters(
    members: &[u32],
    sample: &[Words],
    options: &VocabularyOptions,
) -> Vec<(Words, Vec<u32>)> {
    let count = options.branching.clamp(2, members.len().max(2));
    // Evenly from the members, which lie in the order of their recording: neighbours look alike.
    let seed = |i: usize| sample[members[i * members.len() / count] as usize];
    let mut centres: Vec<Words> = (0..count).map(seed).collect();
    let mut clusters = Vec::new();
    for _ in 0..options.rounds.max(1) {
        centres.sort_unstable();
        centres.dedup();
        clusters = assigned(members, sample, &centres);
        let next: Vec<Words> = clusters
            .iter()
            .filter(|cluster: &&Vec<u32>| !cluster.is_empty())
            .map(|cluster| majority(cluster, sample))
            .collect();
        if next == centres {
            break;
        }
        centres = next;
    }
    // The last majorities and the members they were taken from.
    clusters.retain(|cluster| !cluster.is_empty());
    let of = |members: Vec<u32>| (majority(&members, sample), members);
    clusters.into_iter().map(of).collect()
}

fn assigned(members: &[u32], sample: &[Words], centres: &[Words]) -> Vec<Vec<u32>> {
    let nearest: Vec<Vec<u32>> = members
        .par_chunks(CHUNK)
        .map(|chunk| {
            each(
                chunk.iter(),
                #[inline(always)]
                |member| nearest(&sample[*member as usize], centres),
            )
        })
        .collect();
    let mut clusters = vec![Vec::new(); centres.len()];
    for (member, cluster) in members.iter().zip(nearest.into_iter().flatten()) {
        clusters[cluster as usize].push(*member);
    }
    clusters
}

#[inline(always)]
fn nearest(wanted: &Words, centres: &[Words]) -> u32 {
    let mut best = (u32::MAX, 0);
    for (i, centre) in centres.iter().enumerate() {
        let apart = distance(centre, wanted);
        if apart < best.0 {
            best = (apart, i as u32);
        }
    }
    best.1
}

/// Of each bit what more than half of the members have.
fn majority(members: &[u32], sample: &[Words]) -> Words {
    vectorised(
        #[inline(always)]
        || {
            let mut counts = BitCounts::default();
            for member in members {
                counts.add(sample[*member as usize]);
            }
            counts.above(members.len() / 2)
        },
    )
}

/// How often each of 512 bits was set, counted 64 at a time: a digit of all counts is one [`Words`], and numbers of a
/// digit's worth wait until there are two of them, which a full adder takes at once (Harley, Seal; in Warren: Hacker's
/// Delight, 2nd edition, section 5-1).
#[derive(Default)]
struct BitCounts {
    /// The least significant first.
    digits: Vec<Digit>,
}

#[derive(Default)]
struct Digit {
    sum: Words,
    waiting: Option<Words>,
}

impl BitCounts {
    #[inline(always)]
    fn add(&mut self, mut ones: Words) {
        for digit in &mut self.digits {
            let Some(other) = digit.waiting.take() else {
                digit.waiting = Some(ones);
                return;
            };
            ones = full_add(&mut digit.sum, &other, &ones);
        }
        self.digits.push(Digit {
            sum: [0; 8],
            waiting: Some(ones),
        });
    }

    /// The bits that were set more often.
    #[inline(always)]
    fn above(mut self, limit: usize) -> Words {
        self.settle();
        let (mut above, mut equal) = ([0; 8], [u64::MAX; 8]);
        let digits = self
            .digits
            .len()
            .max(limit.checked_ilog2().map_or(0, |top| top as usize + 1));
        for place in (0..digits).rev() {
            let sum = self.digits.get(place).map_or([0; 8], |digit| digit.sum);
            let wanted = if limit >> place & 1 == 1 { u64::MAX } else { 0 };
            for word in 0..8 {
                above[word] |= equal[word] & sum[word] & !wanted;
                equal[word] &= !(sum[word] ^ wanted);
            }
        }
        above
    }

    /// Adds what waits.
    #[inline(always)]
    fn settle(&mut self) {
        let mut carry = [0; 8];
        for digit in &mut self.digits {
            let waiting = digit.waiting.take().unwrap_or_default();
            carry = full_add(&mut digit.sum, &waiting, &carry);
        }
        self.digits.push(Digit {
            sum: carry,
            waiting: None,
        });
    }
}

/// Adds two bits to each of 512; the carries.
#[inline(always)]
fn full_add(sum: &mut Words, a: &Words, b: &Words) -> Words {
    let mut carry = [0; 8];
    for word in 0..8 {
        let either = a[word] ^ b[word];
        carry[word] = (a[word] & b[word]) | (either & sum[word]);
        sum[word] ^= either;
    }
    carry
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_majority_is_what_more_than_half_have(
            sample in prop::collection::vec(any::<Words>(), 0..70), one in any::<u64>(), copies in 0..600_usize,
        ) {
            let mut sample = sample;
            sample.extend(vec![[one; 8]; copies]);
            let members: Vec<u32> = (0..sample.len() as u32).step_by(2).collect();
            let found = majority(&members, &sample);
            for bit in 0..512 {
                let ones = members.iter().filter(|member| sample[**member as usize][bit / 64] >> (bit % 64) & 1 == 1);
                let set = found[bit / 64] >> (bit % 64) & 1 == 1;
                prop_assert_eq!(set, 2 * ones.count() > members.len());
            }
        }
    }
}
