//! Views by what they show.

use std::collections::BinaryHeap;

use crate::semantic_map::semantic_graph::Graph;

/// Leaves that [`ClassIndex::near`] looks at, at most.
const NEAR_LEAVES: usize = 1024;
/// Counts are kept in blocks of as many classes.
const BLOCK: usize = 16;

/// Views by which classes they show and how many areas of each: the tree that the paper indexes sub-maps with, laid out as
/// a sorted list of its leaves (by presence, then by counts).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ClassIndex {
    classes: usize,
    /// Counts of each leaf, one leaf after the other.
    counts: Vec<u16>,
    /// Where each leaf's views begin, and their number.
    starts: Vec<u32>,
    /// Views, leaf by leaf, ascending within each.
    views: Vec<u32>,
    /// Leaves by their number of areas.
    by_total: Totals,
}

/// Leaves by how many areas they have.
#[derive(Debug, Clone, Default, PartialEq)]
struct Totals {
    /// Number of areas and leaf, ascending.
    leaves: Vec<(u32, u32)>,
    /// Counts in that order, each leaf's filled up to whole blocks.
    blocks: Vec<[u16; BLOCK]>,
}

impl ClassIndex {
    /// Indexes views, numbered in their order, of classes below `classes`. Areas of other classes do not count.
    pub fn new<'a>(graphs: impl Iterator<Item = &'a Graph>, classes: u8) -> Self {
        let counts: Vec<Vec<u16>> = graphs.map(|graph| counts(graph, classes)).collect();
        let mut order: Vec<u32> = (0..counts.len() as u32).collect();
        let key = |view: &u32| content(&counts[*view as usize]);
        order.sort_by(|a, b| key(a).cmp(key(b)).then(a.cmp(b)));
        let mut index = Self {
            classes: usize::from(classes),
            ..Self::default()
        };
        for leaf in order.chunk_by(|a, b| counts[*a as usize] == counts[*b as usize]) {
            index.starts.push(index.views.len() as u32);
            index.views.extend_from_slice(leaf);
            index.counts.extend_from_slice(&counts[leaf[0] as usize]);
        }
        index.starts.push(index.views.len() as u32);
        index.by_total = Totals::new(&index);
        index
    }

    /// Number of leaves.
    pub fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// True without views.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A leaf: the number of areas of each class, and the views that have them, ascending. Both are empty for a leaf that
    /// there is not.
    pub fn leaf(&self, leaf: usize) -> (&[u16], &[u32]) {
        if leaf >= self.len() {
            return (&[], &[]);
        }
        let [start, end] = [self.starts[leaf], self.starts[leaf + 1]].map(|at| at as usize);
        (self.leaf_counts(leaf), &self.views[start..end])
    }

    fn leaf_counts(&self, leaf: usize) -> &[u16] {
        &self.counts[leaf * self.classes..][..self.classes]
    }

    /// At least `wanted` of the views that `allowed` lets pass, where there are as many, of the leaves whose counts differ
    /// least in sum, the nearest first; of equally near ones the first. Only the 1024 leaves nearest in the number of all
    /// areas are looked at.
    pub fn near(&self, counts: &[u16], wanted: usize, allowed: impl Fn(u32) -> bool) -> Vec<u32> {
        let blocks = blocks(counts, self.classes);
        let total = counts.iter().map(|count| u32::from(*count)).sum();
        // Distance, leaf, and its views.
        let mut nearest: BinaryHeap<(u32, u32, usize)> = BinaryHeap::new();
        let mut views = 0;
        for (apart, place) in self.by_total.around(total).take(NEAR_LEAVES) {
            let farthest = nearest.peek().filter(|_| views >= wanted);
            if farthest.is_some_and(|(most, _, _)| apart > *most) {
                break;
            }
            let (distance, leaf) = (
                self.by_total.distance(place, &blocks),
                self.by_total.leaves[place].1,
            );
            if farthest.is_some_and(|(most, last, _)| (distance, leaf) >= (*most, *last)) {
                continue;
            }
            let of_leaf = self.leaf(leaf as usize).1.iter();
            let number = of_leaf.filter(|view| allowed(**view)).count();
            if number > 0 {
                nearest.push((distance, leaf, number));
                views += number;
            }
            while let Some((_, _, number)) = nearest.peek()
                && views - number >= wanted
            {
                views -= number;
                nearest.pop();
            }
        }
        let leaves = nearest.into_sorted_vec();
        let views = leaves
            .iter()
            .flat_map(|(_, leaf, _)| self.leaf(*leaf as usize).1);
        views.copied().filter(|view| allowed(*view)).collect()
    }
}

impl Totals {
    fn new(index: &ClassIndex) -> Self {
        let total = |leaf: u32| {
            let counts = index.leaf_counts(leaf as usize).iter();
            counts.map(|count| u32::from(*count)).sum::<u32>()
        };
        let mut leaves: Vec<(u32, u32)> = (0..index.len() as u32)
            .map(|leaf| (total(leaf), leaf))
            .collect();
        leaves.sort_unstable();
        let of = |(_, leaf): &(u32, u32)| blocks(index.leaf_counts(*leaf as usize), index.classes);
        Self {
            blocks: leaves.iter().flat_map(of).collect(),
            leaves,
        }
    }

    /// Places of the leaves with how far their totals are from one, the nearest first.
    fn around(&self, total: u32) -> impl Iterator<Item = (u32, usize)> + '_ {
        let mut above = self.leaves.partition_point(|(of, _)| *of < total);
        let mut below = above;
        std::iter::from_fn(move || {
            let up = self.leaves.get(above).map(|(of, _)| of - total);
            let down = below
                .checked_sub(1)
                .map(|place| total - self.leaves[place].0);
            if up.is_some_and(|up| down.is_none_or(|down| up <= down)) {
                above += 1;
                up.map(|apart| (apart, above - 1))
            } else {
                down.map(|apart| {
                    below -= 1;
                    (apart, below)
                })
            }
        })
    }

    fn distance(&self, place: usize, counts: &[[u16; BLOCK]]) -> u32 {
        let of = &self.blocks[place * counts.len()..][..counts.len()];
        let apart = |(a, b): (&[u16; BLOCK], &[u16; BLOCK])| {
            let pairs = a.iter().zip(b);
            pairs.map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>()
        };
        of.iter().zip(counts).map(apart).sum()
    }
}

/// What leaves are ordered by: which classes are present, then how many areas of each.
fn content(counts: &[u16]) -> impl Iterator<Item = u16> + '_ {
    let present = counts.iter().map(|count| u16::from(*count == 0));
    present.chain(counts.iter().copied())
}

/// The number of areas of each class below `classes`; more than 65535 are as many.
pub(super) fn counts(graph: &Graph, classes: u8) -> Vec<u16> {
    let mut counts = vec![0_u16; usize::from(classes)];
    for area in &graph.areas {
        if let Some(count) = counts.get_mut(usize::from(area.class)) {
            *count = count.saturating_add(1);
        }
    }
    counts
}

fn blocks(counts: &[u16], classes: usize) -> Vec<[u16; BLOCK]> {
    let mut blocks = vec![[0; BLOCK]; classes.div_ceil(BLOCK)];
    for (at, count) in counts.iter().enumerate().take(classes) {
        blocks[at / BLOCK][at % BLOCK] = *count;
    }
    blocks
}
