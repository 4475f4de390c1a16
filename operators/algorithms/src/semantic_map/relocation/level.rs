//! All views' areas down to some size, and what a query has in common with one of them.

use std::cmp::Reverse;

use super::alike::SLACK;
use super::description::{Areas, Description, LANES, Measure, order_in_map};
use super::fused::ApartAreas;
use super::options::Options;
use super::tree::{Constraints, Interpretation, Pair, Tree};
use crate::processor::vectorised;
use crate::semantic_map::semantic_graph::Graph;

/// The areas of all views down to some size.
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub(super) measure: Measure,
    rules: Constraints,
    /// One view after the other.
    pub(super) described: Description,
    /// Where each view's blocks of areas begin, and the number of all.
    pub(super) offsets: Vec<u32>,
    /// Where the classes of each view lie, one view after the other.
    spans: Vec<Span>,
    /// Where each view's spans begin, and the number of all.
    starts: Vec<u32>,
    /// All areas as they are, where two may be one of a query's.
    apart: Option<ApartAreas>,
}

/// The blocks of a view that have areas of a class.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Span {
    pub(super) class: u16,
    /// From the view's first block on.
    pub(super) first: u16,
    pub(super) end: u16,
}

/// The spans of a view's areas, class by class.
fn spans(areas: &Areas) -> Vec<Span> {
    let mut spans: Vec<Span> = Vec::new();
    for area in 0..areas.len() {
        let (class, block) = (areas.at(area).class, (area / LANES) as u16);
        match spans.last_mut() {
            Some(span) if span.class == class => span.end = block + 1,
            _ => spans.push(Span {
                class,
                first: block,
                end: block + 1,
            }),
        }
    }
    spans
}

impl Level {
    pub(super) fn new<'a>(graphs: impl Iterator<Item = &'a Graph>, options: &Options) -> Self {
        let mut described = Description::default();
        let (mut offsets, mut starts) = (vec![0], vec![0]);
        let mut all_spans = Vec::new();
        let mut apart = options.fused.then(|| ApartAreas::new(options));
        for graph in graphs {
            let order = order_in_map(graph, options);
            let view = Description::new(graph, &order, options);
            if let Some(apart) = &mut apart {
                apart.append(graph, &order);
            }
            all_spans.append(&mut spans(&view.areas));
            starts.push(all_spans.len() as u32);
            described.append(view);
            offsets.push(described.areas.blocks.len() as u32);
        }
        Self {
            measure: Measure::new(options),
            rules: Constraints::new(options),
            described,
            offsets,
            spans: all_spans,
            starts,
            apart,
        }
    }

    /// `None` for a view that there is not.
    pub(super) fn pair<'a>(
        &'a self,
        query: &'a Description,
        view: u32,
        turn: u16,
    ) -> Option<Pair<'a>> {
        let of_view = |starts: &'a [u32]| {
            let ends = starts.get(view as usize..)?.get(..2)?;
            Some(ends[0] as usize..ends[1] as usize)
        };
        Some(Pair {
            query,
            turn,
            map: &self.described,
            blocks: of_view(&self.offsets)?,
            spans: self.spans.get(of_view(&self.starts)?)?,
            apart: self.apart.as_ref(),
        })
    }

    /// What is matched at the pair's turn.
    pub(super) fn grown<'a>(&self, pair: &Pair<'_>, tree: &'a mut Tree) -> &'a Interpretation {
        self.find(pair, tree, 0);
        tree.grow(pair, &self.rules)
    }

    /// The same where [`Level::found_beside`] follows.
    pub(super) fn grown_first<'a>(
        &self,
        pair: &Pair<'_>,
        tree: &'a mut Tree,
    ) -> &'a Interpretation {
        self.find(pair, tree, SLACK);
        tree.grow(pair, &self.rules)
    }

    pub(super) fn found(&self, pair: &Pair<'_>, view: u32, tree: &mut Tree) -> RankedHit {
        self.find(pair, tree, 0);
        self.found_beside(pair, view, tree)
    }

    /// What is found of a pair that the tree has grown of, at another turn.
    pub(super) fn found_beside(&self, pair: &Pair<'_>, view: u32, tree: &mut Tree) -> RankedHit {
        if !tree.knows(pair.turn, &self.rules) {
            self.find(pair, tree, 0);
        }
        let grown = tree.grow(pair, &self.rules);
        RankedHit::new(grown.evidence, grown.pairs.len() as u32, view, pair.turn)
    }

    fn find(&self, pair: &Pair<'_>, tree: &mut Tree, slack: u16) {
        vectorised(
            #[inline(always)]
            || tree.find(pair, &self.rules, slack),
        );
    }
}

/// A hit before it is reported; the best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RankedHit {
    rank: (Reverse<u32>, Reverse<u32>),
    pub(super) view: u32,
    /// `2^16` is a full turn.
    pub(super) turn: u16,
}

impl RankedHit {
    pub(super) fn new(evidence: u32, matched: u32, view: u32, turn: u16) -> Self {
        Self {
            rank: (Reverse(evidence), Reverse(matched)),
            view,
            turn,
        }
    }

    pub(super) fn evidence(&self) -> u32 {
        self.rank.0.0
    }

    pub(super) fn matched(&self) -> u32 {
        self.rank.1.0
    }
}
