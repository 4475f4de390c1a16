//! All views of a map, and the search for those like a query.

use std::cmp::Reverse;
use std::f64::consts::TAU;
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use super::bounds::Bounds;
use super::description::{Description, Measure, order};
use super::options::Options;
use super::similarity;
use super::tree::{Constraints, Interpretation, Pair, Tree};
use crate::semantic_map::semantic_graph::Graph;

/// Candidates are sorted and looked at in as many rounds, by their bounds.
const ROUNDS: u32 = 16;

/// The views of a map, ready to be searched.
#[derive(Debug, Clone)]
pub struct ViewMap {
    options: Options,
    measure: Measure,
    rules: Constraints,
    turns: Vec<u16>,
    /// The areas of all views, one view after the other.
    described: Description,
    /// Where each view's blocks of areas begin, and the number of all.
    offsets: Vec<u32>,
    bounds: Bounds,
    arch: Arch,
}

/// A view that is looked for.
#[derive(Debug, Clone)]
pub struct Query {
    described: Description,
    weight: u32,
}

impl Query {
    /// Areas that take part: those of classes that are not ignored.
    pub fn areas(&self) -> usize {
        self.described.areas.len()
    }
}

/// A view that shows what a query shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Its number in the map.
    pub view: u32,
    /// Heading of the query relative to the view that fits best, one of [`Options::headings`] (rad).
    pub turn_rad: f64,
    /// Areas of the query that were matched.
    pub matched: u32,
    /// What speaks for the match, from 0 (nothing matched) to 1 (every area without any difference): each area of the
    /// query counts by its size, and each match by how small its differences are.
    pub score: f64,
    /// [`similarity`] of the numbers of areas.
    pub similarity: f64,
}

/// A hit before it is reported; the best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Found {
    rank: (Reverse<u32>, Reverse<u32>),
    view: u32,
    turn: usize,
}

impl Found {
    fn evidence(&self) -> u32 {
        self.rank.0.0
    }

    fn matched(&self) -> u32 {
        self.rank.1.0
    }
}

impl ViewMap {
    /// A map of views, numbered in their order.
    pub fn new<'a>(graphs: impl Iterator<Item = &'a Graph>, options: Options) -> Self {
        let mut described = Description::default();
        let mut offsets = vec![0];
        let of_map = options.of_map();
        for graph in graphs {
            described.append(Description::new(graph, &of_map));
            offsets.push(described.areas.blocks.len() as u32);
        }
        let code = |turn: f64| ((turn / TAU * 65536.0).round() as i64).rem_euclid(65536) as u16;
        Self {
            measure: Measure::new(&options),
            rules: Constraints::new(&options),
            turns: options.turns_rad().map(code).collect(),
            bounds: Bounds::new(&described, &offsets),
            described,
            offsets,
            options,
            arch: Arch::new(),
        }
    }

    /// Number of views.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// True without views.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Prepares a view to be looked for.
    pub fn query(&self, graph: &Graph) -> Query {
        let described = Description::new(graph, &self.options);
        Query {
            weight: described.weight(),
            described,
        }
    }

    /// The `top` views that the query fits best, the best first (by score, then by number of matched areas, then by
    /// number), of those that `allowed` lets pass. Exactly those that comparing with every view would give.
    pub fn search(&self, query: &Query, top: usize, allowed: impl Fn(u32) -> bool) -> Vec<Hit> {
        let bounds = self.arch.dispatch(Bounding { map: self, query });
        let most = bounds.iter().flatten().max().copied().unwrap_or(0);
        let mut best = Best::new(top, &self.options);
        let mut tree = Tree::default();
        let mut end = u32::MAX;
        for round in 1..=ROUNDS {
            // Bounds from `start` up to those of the round before.
            let start = most - (u64::from(most) * u64::from(round) / u64::from(ROUNDS)) as u32;
            for candidate in candidates(&bounds, start..end) {
                if best.are_above(candidate.bound) {
                    return best.hits(self, query);
                }
                if allowed(candidate.view) {
                    best.add(self.found(query, candidate.view, candidate.turn, &mut tree));
                }
            }
            if start == 0 || best.are_above(start) {
                break;
            }
            end = start;
        }
        best.hits(self, query)
    }

    /// Of the given views the `top` that the query fits best, as [`ViewMap::search`]. Views that there are not are passed
    /// over.
    pub fn among(&self, query: &Query, views: &[u32], top: usize) -> Vec<Hit> {
        let mut best = Best::new(top, &self.options);
        let mut tree = Tree::default();
        for view in views {
            for turn in 0..self.turns.len() {
                best.add(self.found(query, *view, turn, &mut tree));
            }
        }
        best.hits(self, query)
    }

    /// One view, however little it fits, at the heading that fits best of those at which enough areas match; `None` for a
    /// view that there is not.
    pub fn compare(&self, query: &Query, view: u32) -> Option<Hit> {
        let mut tree = Tree::default();
        let turns = 0..self.turns.len();
        let found = turns.filter_map(|turn| self.found(query, view, turn, &mut tree));
        let few = |found: &Found| found.matched() < self.options.min_matched;
        let best = found.min_by_key(|found| (few(found), *found));
        best.map(|found| self.hit(query, &found))
    }

    fn blocks(&self, view: u32) -> Option<Range<usize>> {
        let bounds = self.offsets.get(view as usize..)?.get(..2)?;
        Some(bounds[0] as usize..bounds[1] as usize)
    }

    fn pair<'a>(&'a self, query: &'a Query, view: u32, turn: u16) -> Option<Pair<'a>> {
        Some(Pair {
            query: &query.described,
            turn,
            map: &self.described,
            blocks: self.blocks(view)?,
        })
    }

    fn found(&self, query: &Query, view: u32, turn: usize, tree: &mut Tree) -> Option<Found> {
        let pair = self.pair(query, view, self.turns[turn])?;
        let rules = &self.rules;
        let grown = self.arch.dispatch(Growing { pair, rules, tree });
        Some(Found {
            rank: (Reverse(grown.evidence), Reverse(grown.pairs.len() as u32)),
            view,
            turn,
        })
    }

    fn hit(&self, query: &Query, found: &Found) -> Hit {
        let matched = found.matched();
        let most = f64::from(query.weight) * f64::from(self.measure.limit);
        Hit {
            view: found.view,
            turn_rad: self.options.turns_rad().nth(found.turn).unwrap_or(0.0),
            matched,
            score: if most > 0.0 {
                found.evidence() as f64 / most
            } else {
                0.0
            },
            similarity: similarity(query.areas() as u32, matched),
        }
    }
}

/// A view that may be a hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Candidate {
    bound: u32,
    turn: usize,
    view: u32,
}

/// Those with bounds in a range, the highest first; of equal ones the first view.
fn candidates(bounds: &[Vec<u32>], range: Range<u32>) -> Vec<Candidate> {
    let mut found = Vec::new();
    for (turn, bounds) in bounds.iter().enumerate() {
        let within = bounds
            .iter()
            .zip(0_u32..)
            .filter(|(bound, _)| range.contains(bound));
        found.extend(within.map(|(bound, view)| Candidate {
            bound: *bound,
            turn,
            view,
        }));
    }
    found.sort_unstable_by_key(|candidate| {
        (Reverse(candidate.bound), candidate.view, candidate.turn)
    });
    found
}

/// The best views so far, sorted, each once.
struct Best {
    found: Vec<Found>,
    top: usize,
    min_matched: u32,
}

impl Best {
    fn new(top: usize, options: &Options) -> Self {
        Self {
            found: Vec::new(),
            top,
            min_matched: options.min_matched.max(1),
        }
    }

    /// True when nothing with this bound can be among the best.
    fn are_above(&self, bound: u32) -> bool {
        self.top == 0
            || self.found.len() == self.top
                && self
                    .found
                    .last()
                    .is_some_and(|worst| worst.evidence() > bound)
    }

    fn add(&mut self, found: Option<Found>) {
        let Some(found) = found.filter(|found| found.matched() >= self.min_matched) else {
            return;
        };
        if let Some(known) = self.found.iter().position(|known| known.view == found.view) {
            if self.found[known] <= found {
                return;
            }
            self.found.remove(known);
        }
        let place = self.found.partition_point(|known| *known < found);
        self.found.insert(place, found);
        self.found.truncate(self.top);
    }

    fn hits(&self, map: &ViewMap, query: &Query) -> Vec<Hit> {
        self.found
            .iter()
            .map(|found| map.hit(query, found))
            .collect()
    }
}

/// What is compiled for the widest registers there are.
struct Bounding<'a> {
    map: &'a ViewMap,
    query: &'a Query,
}

impl WithSimd for Bounding<'_> {
    type Output = Vec<Vec<u32>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { map, query } = self;
        let turns = map.turns.iter();
        let bounds = turns.map(|turn| map.bounds.of(&query.described, *turn, &map.measure));
        bounds.collect()
    }
}

/// As [`Bounding`].
struct Growing<'a> {
    pair: Pair<'a>,
    rules: &'a Constraints,
    tree: &'a mut Tree,
}

impl<'a> WithSimd for Growing<'a> {
    type Output = &'a Interpretation;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        self.tree.grow(&self.pair, self.rules)
    }
}

/// Areas of two views that are taken for the same things: indices into the query's areas and into the view's. Of the
/// turns only the first counts.
pub fn matched_areas(query: &Graph, view: &Graph, options: &Options) -> Vec<[usize; 2]> {
    let map = ViewMap::new(std::iter::once(view), options.clone());
    let (asked, mut tree) = (map.query(query), Tree::default());
    let turn = map.turns.first();
    let Some(pair) = turn.and_then(|turn| map.pair(&asked, 0, *turn)) else {
        return Vec::new();
    };
    let orders = [order(query, options), order(view, &options.of_map())];
    let matched = tree.grow(&pair, &map.rules).pairs.iter();
    matched
        .map(|[a, b]| [orders[0][usize::from(*a)], orders[1][usize::from(*b)]])
        .collect()
}
