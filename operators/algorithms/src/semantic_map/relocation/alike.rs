//! Which areas of a view are like those of a query: few of all, found once for trees at several turns.

use super::description::{LANES, Measure, UNIT};
use super::tree::Pair;

/// By how much bearings may differ more than at a turn for areas that are kept for turns beside it: half a scale. The turns
/// of a view's two trees of all areas are seldom farther apart.
pub(super) const SLACK: u16 = UNIT as u16 / 2;

/// Areas of a view that are like those of a query at a turn, and at turns beside it.
#[derive(Debug, Clone, Default)]
pub(super) struct AlikeAreas {
    found: Vec<Alike>,
    /// Where those of each area of the query begin, and the number of all.
    starts: Vec<u32>,
    turn: u16,
    slack: u16,
}

/// An area of a view that is like one of a query.
#[derive(Debug, Clone, Copy)]
pub(super) struct Alike {
    /// Its number in the view.
    pub(super) area: u16,
    /// [`Measure::likeness`].
    pub(super) likeness: u16,
    /// How far the query's lies to its right where nothing is turned: `2^16` is a full turn.
    pub(super) apart: u16,
}

impl AlikeAreas {
    /// Looks for all at the pair's turn, and at those at which bearings differ by less than `slack` more.
    #[inline(always)]
    pub(super) fn find(&mut self, pair: &Pair<'_>, measure: &Measure, slack: u16) {
        (self.turn, self.slack) = (pair.turn, slack);
        self.found.clear();
        self.starts.clear();
        self.starts.push(0);
        for area in 0..pair.query.areas.len() {
            let code = pair.query.areas.at(area);
            let like = pair.like(&code);
            let first = (like.start - pair.blocks.start) * LANES;
            for (at, block) in pair.map.areas.blocks[like].iter().enumerate() {
                let likeness = measure.likeness(&code, block);
                let (mut apart, mut bits) = ([0; LANES], [0; LANES]);
                for lane in 0..LANES {
                    apart[lane] = code.bearing.wrapping_sub(block.bearing[lane]);
                    let turned = measure.bearings(apart[lane].wrapping_add(pair.turn));
                    let near = likeness[lane].saturating_add(slack) > turned;
                    let like = near & (likeness[lane] > 0);
                    bits[lane] = u16::from(like).wrapping_neg() & (1 << lane);
                }
                let mut lanes: u16 = bits.iter().fold(0, |lanes, bit| lanes | bit);
                while lanes != 0 {
                    let lane = lanes.trailing_zeros() as usize % LANES;
                    lanes &= lanes - 1;
                    self.found.push(Alike {
                        area: (first + at * LANES + lane) as u16,
                        likeness: likeness[lane],
                        apart: apart[lane],
                    });
                }
            }
            self.starts.push(self.found.len() as u32);
        }
    }

    /// Whether what was found is all that there is at a turn.
    pub(super) fn are_all(&self, turn: u16, measure: &Measure) -> bool {
        let beside = turn.wrapping_sub(self.turn);
        // One more for what is rounded.
        beside == 0 || measure.bearings(beside) < self.slack
    }

    /// Those that are like an area of the query, in their order.
    #[inline(always)]
    pub(super) fn of(&self, area: usize) -> &[Alike] {
        let [start, end] = [self.starts[area], self.starts[area + 1]].map(|at| at as usize);
        &self.found[start..end]
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;

    use super::*;
    use crate::semantic_map::relocation::tests::graphs::graph;
    use crate::semantic_map::relocation::{Options, ViewMap};

    proptest! {
        #[test]
        fn what_is_kept_is_all_there_is_at_turns_beside(
            view in graph(),
            query in graph(),
            turn: u16,
            beside in -700_i16..700,
        ) {
            let options = Options::default();
            let (map, measure) = (ViewMap::new(std::iter::once(&view), options.clone()), Measure::new(&options));
            let asked = map.query(&query);
            let pair = map.large.pair(&asked.large, 0, turn).unwrap();
            let other = Pair { turn: turn.wrapping_add_signed(beside), ..pair.clone() };
            let told = |kept: &AlikeAreas| -> Vec<(usize, u16, u16)> {
                let areas = 0..asked.large.areas.len();
                let all = areas.flat_map(|area| kept.of(area).iter().map(move |alike| (area, *alike)));
                let evidence = |alike: &Alike| measure.at_bearing(alike.likeness, alike.apart.wrapping_add(other.turn));
                let told = all.map(|(area, alike)| (area, alike.area, evidence(&alike)));
                told.filter(|(_, _, evidence)| *evidence > 0).collect()
            };
            let [mut kept, mut there] = [AlikeAreas::default(), AlikeAreas::default()];
            kept.find(&pair, &measure, SLACK);
            there.find(&other, &measure, 0);
            prop_assert!(kept.are_all(other.turn, &measure) && there.are_all(other.turn, &measure));
            prop_assert!(!kept.are_all(turn.wrapping_add(800), &measure));
            prop_assert_eq!(told(&kept), told(&there));
            prop_assert!(there.found.len() == told(&there).len());
        }
    }
}
