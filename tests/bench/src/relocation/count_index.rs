//! Views by how many areas of a class they show.

use std::cmp::Reverse;

use evermap_algorithms::semantic_map::relocation::ClassIndex;
use evermap_algorithms::semantic_map::semantic_graph::Graph;

/// All views, ordered by count for each class.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CountIndex {
    views: Vec<u32>,
    /// By class.
    by_count: Vec<ByCount>,
}

/// All views, those with the most areas of one class first.
#[derive(Debug, Clone, Default, PartialEq)]
struct ByCount {
    views: Vec<u32>,
    /// `above[n]` views have more than `n` areas.
    above: Vec<u32>,
}

impl CountIndex {
    /// Indexes views, numbered in their order, of classes below `classes`.
    pub fn new(graphs: &[Graph], classes: u8) -> Self {
        Self {
            views: (0..graphs.len() as u32).collect(),
            by_count: (0..classes)
                .map(|class| ByCount::new(graphs, class))
                .collect(),
        }
    }

    /// The views with exactly `areas` areas of a class; ascending.
    pub fn exactly(&self, class: u8, areas: usize) -> &[u32] {
        let Some(order) = self.by_count.get(usize::from(class)) else {
            return if areas == 0 { &self.views } else { &[] };
        };
        let end = areas
            .checked_sub(1)
            .map_or(order.views.len(), |less| order.above(less));
        &order.views[order.above(areas)..end]
    }

    /// The views with at least `areas` areas of a class, those with the most first.
    pub fn at_least(&self, class: u8, areas: usize) -> &[u32] {
        let Some(less) = areas.checked_sub(1) else {
            return &self.views;
        };
        let order = self.by_count.get(usize::from(class));
        order.map_or(&[], |order| &order.views[..order.above(less)])
    }

    /// The views without any area of a class.
    pub fn without(&self, class: u8) -> &[u32] {
        self.exactly(class, 0)
    }
}

impl ByCount {
    fn new(graphs: &[Graph], class: u8) -> Self {
        let counts: Vec<usize> = graphs.iter().map(|graph| graph.count(class)).collect();
        let count = |view: &u32| counts[*view as usize];
        let mut views: Vec<u32> = (0..graphs.len() as u32).collect();
        views.sort_by_key(|view| (Reverse(count(view)), *view));
        let most = views.first().map_or(0, count);
        let above = (0..=most).map(|n| views.partition_point(|view| count(view) > n) as u32);
        Self {
            above: above.collect(),
            views,
        }
    }

    fn above(&self, areas: usize) -> usize {
        self.above.get(areas).map_or(0, |views| *views as usize)
    }
}

/// The views with exactly this many areas of each class, ascending.
pub fn like<'a>(index: &'a ClassIndex, counts: &[u16]) -> &'a [u32] {
    let (mut low, mut high) = (0, index.len());
    while low < high {
        let middle = (low + high) / 2;
        if content(index.leaf(middle).0).lt(content(counts)) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    let (found, views) = index.leaf(low);
    if found == counts { views } else { &[] }
}

/// What leaves are ordered by: which classes are present, then how many areas of each.
fn content(counts: &[u16]) -> impl Iterator<Item = u16> + '_ {
    let present = counts.iter().map(|count| u16::from(*count == 0));
    present.chain(counts.iter().copied())
}
