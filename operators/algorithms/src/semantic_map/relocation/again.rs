//! The views that large areas speak for, compared again with areas of any size at the heading that fits best.
//!
//! Large areas are few and are seen again from anywhere near; small ones, a sign or a lamp, tell a place from the next. A
//! bound on the evidence of large areas chooses the candidates and their headings, of which there are few; where matched
//! areas lie then tells the heading more closely.

use std::cmp::Reverse;

use super::bounds;
use super::description::Description;
use super::level::{Found, Level};
use super::tree::Tree;
use super::view_map::{Best, Hit, Query, ViewMap};

/// A query that is compared with views of a map.
pub(super) struct Again<'a> {
    pub(super) map: &'a ViewMap,
    pub(super) query: &'a Query,
    /// Areas of any size: the map's.
    pub(super) level: &'a Level,
    /// And the query's.
    pub(super) all: &'a Description,
}

/// A view with the highest bound of all headings.
pub(super) struct Bounded {
    bound: u32,
    view: u32,
    turn: u16,
}

impl Again<'_> {
    /// A view by its bounds, one for each heading; `None` without headings.
    pub(super) fn bounded(&self, view: u32, bounds: impl Iterator<Item = u32>) -> Option<Bounded> {
        let turns = bounds.zip(&self.map.turns);
        let of_turn = turns.map(|(bound, turn)| Bounded {
            bound,
            view,
            turn: *turn,
        });
        of_turn.reduce(|best, other| {
            if other.bound > best.bound {
                other
            } else {
                best
            }
        })
    }

    /// The same for one view; `None` for a view that there is not.
    pub(super) fn bound(&self, view: u32) -> Option<Bounded> {
        let (large, query) = (&self.map.large, &self.query.large);
        large.pair(query, view, 0)?;
        let pairs = self.map.turns.iter();
        let pairs = pairs.filter_map(|turn| large.pair(query, view, *turn));
        self.bounded(
            view,
            pairs.map(|pair| bounds::of_pair(&pair, &large.measure)),
        )
    }

    /// The best of the candidates among these.
    pub(super) fn best(&self, mut among: Vec<Bounded>, top: usize) -> Vec<Hit> {
        let options = &self.map.options;
        among.sort_unstable_by_key(|bounded| (Reverse(bounded.bound), bounded.view));
        among.truncate(top.max(options.candidates as usize));
        let (mut best, mut tree) = (Best::new(top, options), Tree::default());
        for bounded in &among {
            best.add(self.compared(bounded, &mut tree));
        }
        best.hits(self.map, self.query)
    }

    /// With areas of any size, at the heading that matches tell: of large areas, then of all.
    pub(super) fn compared(&self, bounded: &Bounded, tree: &mut Tree) -> Option<Found> {
        let (view, large) = (bounded.view, &self.map.large);
        let pair = large.pair(&self.query.large, view, bounded.turn)?;
        let turn = pair.fitted_turn(large.grown(&pair, tree));
        let pair = self.level.pair(self.all, view, turn)?;
        let turn = pair.fitted_turn(self.level.grown(&pair, tree));
        let pair = self.level.pair(self.all, view, turn)?;
        Some(self.level.found(pair, view, tree))
    }
}
