//! The views that large areas speak for, compared again with areas of any size at the heading that fits best.
//!
//! Large areas are few and are seen again from anywhere near; small ones, a sign or a lamp, tell a place from the next. A
//! bound on the evidence of large areas chooses the candidates and their headings, of which there are few; where matched
//! areas lie then tells the heading more closely.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::description::Description;
use super::level::{Level, RankedHit};
use super::tree::{Pair, Tree};
use super::view_map::{Best, Hit, Query, ViewMap};
use crate::processor::vectorised;

/// A query that is compared with views of a map.
pub(super) struct Again<'a> {
    pub(super) map: &'a ViewMap,
    pub(super) query: &'a Query,
    /// Areas of any size: the map's.
    pub(super) level: &'a Level,
    /// And the query's.
    pub(super) all: &'a Description,
}

/// A view with the highest bound of all headings; the best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Bounded {
    bound: Reverse<u32>,
    view: u32,
    turn: u16,
}

impl Again<'_> {
    /// The `top` views that the query fits best, of those that `allowed` lets pass.
    pub(super) fn search(&self, top: usize, allowed: impl Fn(u32) -> bool) -> Vec<Hit> {
        let number = self.number(top);
        let mut views = self.promising();
        // The worst on top.
        let mut among: BinaryHeap<Bounded> = BinaryHeap::new();
        while let Some((most, Reverse(view))) = views.pop() {
            let worst = among.peek().filter(|_| among.len() == number);
            if worst.is_some_and(|worst| worst.bound.0 > most) {
                break;
            }
            if allowed(view) {
                among.extend(self.bound(view));
            }
            if among.len() > number {
                among.pop();
            }
        }
        self.best(among.into_vec(), top)
    }

    /// All views by what their bounds are no higher than.
    fn promising(&self) -> BinaryHeap<(u32, Reverse<u32>)> {
        let (bounds, query) = (&self.map.bounds, &self.query.large);
        let mut views = Vec::with_capacity(self.map.len());
        let mut view = 0;
        vectorised(
            #[inline(always)]
            || {
                bounds.of_all(query, |of_turns| {
                    let most = of_turns
                        .iter()
                        .fold(0, |most: u16, of_turn| most.max(*of_turn));
                    views.push((bounds.most(most), Reverse(view)));
                    view += 1;
                });
            },
        );
        views.into()
    }

    /// `None` without headings, and for a view that there is not.
    pub(super) fn bound(&self, view: u32) -> Option<Bounded> {
        let pair = self.map.large.pair(&self.query.large, view, 0)?;
        let bounds = vectorised(
            #[inline(always)]
            || self.map.bounds.of_pair(&pair),
        );
        let of_turns = bounds.iter().zip(&self.map.turns);
        let of_turns = of_turns.zip(0_u32..).map(|((bound, turn), at)| {
            // The first of equal ones.
            (Reverse(*bound), at, *turn)
        });
        let (bound, _, turn) = of_turns.min()?;
        Some(Bounded { bound, view, turn })
    }

    /// Views that are compared again, where there are as many.
    fn number(&self, top: usize) -> usize {
        top.max(self.map.options.candidates as usize)
    }

    /// The best of the candidates among these.
    pub(super) fn best(&self, mut among: Vec<Bounded>, top: usize) -> Vec<Hit> {
        among.sort_unstable();
        among.truncate(self.number(top));
        let (mut best, mut tree) = (Best::new(top, &self.map.options), Tree::default());
        for bounded in &among {
            best.add(self.compared(bounded, &mut tree));
        }
        best.hits(self.map, self.query)
    }

    /// With areas of any size, at the heading that matches tell: of large areas, then of all.
    pub(super) fn compared(&self, bounded: &Bounded, tree: &mut Tree) -> Option<RankedHit> {
        let (view, large) = (bounded.view, &self.map.large);
        let pair = large.pair(&self.query.large, view, bounded.turn)?;
        let turn = pair.fitted_turn(large.grown(&pair, tree));
        let pair = self.level.pair(self.all, view, turn)?;
        let turn = pair.fitted_turn(self.level.grown_first(&pair, tree));
        let pair = Pair { turn, ..pair };
        Some(self.level.found_beside(&pair, view, tree))
    }
}
