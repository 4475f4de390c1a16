//! The interpretation tree: the areas of two views matched one after the other, each fitting all before.

use std::cmp::Reverse;
use std::f32::consts::TAU;
use std::ops::Range;

use super::alike::AlikeAreas;
use super::description::{AreaCode, Areas, Description, LANES, Measure, UNIT};
use super::fused::ApartAreas;
use super::level::Span;
use super::options::{Options, divisor};
use crate::semantic_map::semantic_graph::Relation;

/// Two views' areas as far as they were matched.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Interpretation {
    /// Area of the query and area of the other view, in the order of the tree.
    pub(super) pairs: Vec<[u16; 2]>,
    /// What the pairs speak for being the same, each as much as it counts.
    pub(super) evidence: u32,
}

/// The tree's memory, used again and again.
#[derive(Debug, Clone, Default)]
pub(super) struct Tree {
    /// What is like the areas of the query.
    alike: AlikeAreas,
    /// By area of the other view: all bits set while it is not matched.
    free: Vec<u16>,
    /// By area of the query: its match.
    partners: Vec<Option<u16>>,
    found: Interpretation,
}

/// What a tree compares: a query turned by `turn` (`2^16` is a full turn) and one view of a map.
#[derive(Clone)]
pub(super) struct Pair<'a> {
    pub(super) query: &'a Description,
    pub(super) turn: u16,
    /// The areas of all views.
    pub(super) map: &'a Description,
    /// Which of their blocks are the view's.
    pub(super) blocks: Range<usize>,
    /// And which of those have areas of a class.
    pub(super) spans: &'a [Span],
    /// The view's areas as they are, in its blocks; `None` where none is joined to another.
    pub(super) apart: Option<&'a ApartAreas>,
}

impl Pair<'_> {
    /// The map's blocks that have the view's areas of an area's class.
    #[inline(always)]
    pub(super) fn like(&self, code: &AreaCode) -> Range<usize> {
        let first = self.blocks.start;
        for span in self.spans {
            if span.class == code.class {
                return first + usize::from(span.first)..first + usize::from(span.end);
            }
        }
        first..first
    }

    /// The turn at which matched areas are as often to the left of their matches as to the right, by their weights.
    pub(super) fn fitted_turn(&self, found: &Interpretation) -> u16 {
        let mut apart: Vec<(i16, u32)> = found
            .pairs
            .iter()
            .map(|[mine, other]| {
                let mine = usize::from(*mine);
                let other = self.blocks.start * LANES + usize::from(*other);
                let bearing = self.query.areas.at(mine).bearing.wrapping_add(self.turn);
                let apart = self.map.areas.at(other).bearing.wrapping_sub(bearing);
                (apart as i16, self.query.weights[mine])
            })
            .collect();
        apart.sort_unstable();
        let all: u32 = apart.iter().map(|(_, weight)| weight).sum();
        let mut left = 0;
        let median = apart.iter().find(|(_, weight)| {
            left += weight;
            2 * left >= all
        });
        self.turn
            .wrapping_add(median.map_or(0, |(apart, _)| *apart as u16))
    }
}

/// Which pairs of pairs fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Constraints {
    measure: Measure,
    boundary: f32,
    /// Logarithm of the length from which on boundaries are in both views or in none.
    contact: Option<f32>,
    direction_steps: u8,
    elevation_rad: f32,
}

impl Constraints {
    pub(super) fn new(options: &Options) -> Self {
        Self {
            measure: Measure::new(options),
            boundary: options.boundary_factor.max(1.0).ln() as f32,
            contact: options.contact_rad.map(|length| length.ln() as f32),
            direction_steps: options.direction_steps,
            elevation_rad: divisor(options.scales.elevation_rad) as f32 / UNIT,
        }
    }
}

impl Tree {
    /// Finds what the pair's areas could be, at its turn and at those beside it.
    #[inline(always)]
    pub(super) fn find(&mut self, pair: &Pair<'_>, rules: &Constraints, slack: u16) {
        self.alike.find(pair, &rules.measure, slack);
    }

    /// Whether what the tree has found of a view is all that there is at a turn.
    pub(super) fn knows(&self, turn: u16, rules: &Constraints) -> bool {
        self.alike.are_all(turn, &rules.measure)
    }

    /// Matches the query's areas, the largest first: each with the area of the view that speaks most for it, of those that
    /// are not matched and fit all matches before (paper 2, Algorithm 1).
    pub(super) fn grow(&mut self, pair: &Pair<'_>, rules: &Constraints) -> &Interpretation {
        self.found.pairs.clear();
        self.found.evidence = 0;
        self.partners.clear();
        self.partners.resize(pair.query.areas.len(), None);
        self.free.clear();
        self.free.resize(pair.blocks.len() * LANES, u16::MAX);
        for area in 0..pair.query.areas.len() {
            let mut tried = u32::MAX;
            while let Some((key, other, evidence)) = self.next(area, pair.turn, rules, tried) {
                if self.fits(pair, rules, area, other) {
                    let weight = pair.query.weights[area];
                    self.take(area, other, u32::from(evidence) * weight);
                    if let Some(apart) = pair.apart {
                        self.join(pair, rules, apart, [area, other], evidence);
                    }
                    break;
                }
                tried = key;
            }
        }
        &self.found
    }

    /// Of the areas that are not matched the one that speaks most for an area of the query, of equal ones the first; of those
    /// after what was tried.
    #[inline(always)]
    fn next(
        &self,
        area: usize,
        turn: u16,
        rules: &Constraints,
        tried: u32,
    ) -> Option<(u32, usize, u16)> {
        let mut best = 0;
        for alike in self.alike.of(area) {
            let apart = alike.apart.wrapping_add(turn);
            let evidence = rules.measure.at_bearing(alike.likeness, apart);
            let evidence = evidence & self.free[usize::from(alike.area)];
            let key = u32::from(evidence) << 16 | u32::from(!alike.area);
            if key < tried {
                best = best.max(key);
            }
        }
        let (evidence, other) = ((best >> 16) as u16, !(best as u16));
        (evidence > 0).then_some((best, usize::from(other), evidence))
    }

    fn take(&mut self, area: usize, other: usize, evidence: u32) {
        self.free[other] = 0;
        self.partners[area] = Some(other as u16);
        self.found.pairs.push([area as u16, other as u16]);
        self.found.evidence += evidence;
    }

    /// Joins to a match the area beside which it is most like the query's, where that is more than it is alone.
    #[cold]
    fn join(
        &mut self,
        pair: &Pair<'_>,
        rules: &Constraints,
        apart: &ApartAreas,
        [area, other]: [usize; 2],
        alone: u16,
    ) {
        let mut code = pair.query.areas.at(area);
        code.bearing = code.bearing.wrapping_add(pair.turn);
        let like = pair.like(&code);
        let first = (like.start - pair.blocks.start) * LANES;
        let end = (like.end - pair.blocks.start) * LANES;
        let free = |at: &usize| self.free[*at] != 0;
        let view = pair.blocks.start * LANES;
        let joined = |at: usize| {
            let both = apart.joined(view + other, view + at)?;
            let mut one = Areas::default();
            one.push(both);
            Some(rules.measure.evidence(&code, &one.blocks[0])[0])
        };
        let candidates = (first..end).filter(free);
        let more = candidates.filter_map(|at| Some((joined(at)?, at)));
        let best = more
            .filter(|(evidence, at)| *evidence > alone && self.fits(pair, rules, area, *at))
            .max_by_key(|(evidence, at)| (*evidence, Reverse(*at)));
        if let Some((evidence, at)) = best {
            self.free[at] = 0;
            self.found.evidence += u32::from(evidence - alone) * pair.query.weights[area];
        }
    }

    /// Whether two areas fit all pairs so far.
    fn fits(&self, pair: &Pair<'_>, rules: &Constraints, area: usize, other: usize) -> bool {
        self.boundaries_fit(pair, rules.boundary, area, other)
            && rules
                .contact
                .is_none_or(|least| self.contacts_fit(pair, least, area, other))
            && (rules.direction_steps >= 4 || self.directions_fit(pair, rules, area, other))
    }

    fn boundaries_fit(&self, pair: &Pair<'_>, most: f32, area: usize, other: usize) -> bool {
        let theirs = pair.map.neighbours(pair.blocks.start * LANES + other);
        pair.query
            .neighbours(area)
            .iter()
            .all(|(neighbour, length)| {
                let Some(partner) = self.partners[usize::from(*neighbour)] else {
                    return true;
                };
                // Neighbours are in order.
                let touching = theirs.get(theirs.partition_point(|(at, _)| *at < partner));
                let touching = touching.filter(|(at, _)| *at == partner);
                touching.is_none_or(|(_, other)| (length - other).abs() <= most)
            })
    }

    /// Whether what touches one of two areas along more than `least` is matched with what touches the other one, as far as
    /// it is matched.
    fn contacts_fit(&self, pair: &Pair<'_>, least: f32, area: usize, other: usize) -> bool {
        let (ours, theirs) = (
            pair.query.neighbours(area),
            pair.map.neighbours(pair.blocks.start * LANES + other),
        );
        let touches = |list: &[(u16, f32)], area: u16| list.iter().any(|(at, _)| *at == area);
        let long = |(_, length): &&(u16, f32)| *length > least;
        ours.iter().filter(long).all(|(neighbour, _)| {
            let partner = self.partners[usize::from(*neighbour)];
            partner.is_none_or(|partner| touches(theirs, partner))
        }) && theirs.iter().filter(long).all(|(neighbour, _)| {
            let mut pairs = self.found.pairs.iter();
            let partner = pairs.find(|[_, at]| at == neighbour);
            partner.is_none_or(|[partner, _]| touches(ours, *partner))
        })
    }

    fn directions_fit(&self, pair: &Pair<'_>, rules: &Constraints, a: usize, b: usize) -> bool {
        let direction = |areas: &Areas, from: usize, to: usize| {
            let (from, to) = (areas.at(from), areas.at(to));
            let right = to.bearing.wrapping_sub(from.bearing) as i16;
            let down = f32::from(to.elevation) - f32::from(from.elevation);
            let right = f32::from(right) * (TAU / 65536.0);
            Relation::direction([right, down * rules.elevation_rad])
        };
        self.found.pairs.iter().all(|[mine, other]| {
            let here = direction(&pair.query.areas, usize::from(*mine), a);
            let view = pair.blocks.start * LANES;
            let there = direction(&pair.map.areas, view + usize::from(*other), view + b);
            let (Some(here), Some(there)) = (here, there) else {
                return true;
            };
            let apart = (here as u8).abs_diff(there as u8);
            apart.min(8 - apart) <= rules.direction_steps
        })
    }
}
