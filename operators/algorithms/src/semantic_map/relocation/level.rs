//! All views' areas down to some size, and what a query has in common with one of them.

use std::cmp::Reverse;

use pulp::{Arch, Simd, WithSimd};

use super::description::{Description, Measure};
use super::options::Options;
use super::tree::{Constraints, Interpretation, Pair, Tree};
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
    pub(super) arch: Arch,
}

impl Level {
    pub(super) fn new<'a>(graphs: impl Iterator<Item = &'a Graph>, options: &Options) -> Self {
        let mut described = Description::default();
        let mut offsets = vec![0];
        let of_map = options.of_map();
        for graph in graphs {
            described.append(Description::new(graph, &of_map));
            offsets.push(described.areas.blocks.len() as u32);
        }
        Self {
            measure: Measure::new(options),
            rules: Constraints::new(options),
            described,
            offsets,
            arch: Arch::new(),
        }
    }

    /// `None` for a view that there is not.
    pub(super) fn pair<'a>(
        &'a self,
        query: &'a Description,
        view: u32,
        turn: u16,
    ) -> Option<Pair<'a>> {
        let bounds = self.offsets.get(view as usize..)?.get(..2)?;
        Some(Pair {
            query,
            turn,
            map: &self.described,
            blocks: bounds[0] as usize..bounds[1] as usize,
        })
    }

    pub(super) fn grown<'a>(&self, pair: &Pair<'_>, tree: &'a mut Tree) -> &'a Interpretation {
        let rules = &self.rules;
        self.arch.dispatch(Growing { pair, rules, tree })
    }

    pub(super) fn found(&self, pair: Pair<'_>, view: u32, tree: &mut Tree) -> Found {
        let grown = self.grown(&pair, tree);
        Found {
            rank: (Reverse(grown.evidence), Reverse(grown.pairs.len() as u32)),
            view,
            turn: pair.turn,
        }
    }
}

/// A hit before it is reported; the best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Found {
    rank: (Reverse<u32>, Reverse<u32>),
    pub(super) view: u32,
    /// `2^16` is a full turn.
    pub(super) turn: u16,
}

impl Found {
    pub(super) fn evidence(&self) -> u32 {
        self.rank.0.0
    }

    pub(super) fn matched(&self) -> u32 {
        self.rank.1.0
    }
}

/// What is compiled for the widest registers there are.
struct Growing<'a, 'b> {
    pair: &'b Pair<'b>,
    rules: &'b Constraints,
    tree: &'a mut Tree,
}

impl<'a> WithSimd for Growing<'a, '_> {
    type Output = &'a Interpretation;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        self.tree.grow(self.pair, self.rules)
    }
}
