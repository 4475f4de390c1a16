//! All views of a map, and the search for those like a query.

use std::cmp::Reverse;
use std::f64::consts::TAU;
use std::ops::Range;

use super::again::Again;
use super::bounds::Bounds;
use super::counted::CountedViews;
use super::description::{Description, order, order_in_map};
use super::interpretation::Shapes;
use super::level::{Level, RankedHit};
use super::options::{Options, TreeKind};
use super::similarity;
use super::tree::Tree;
use crate::processor::vectorised;
use crate::semantic_map::semantic_graph::Graph;

/// Candidates are sorted and looked at in as many rounds, by their bounds.
const ROUNDS: u32 = 16;

/// The views of a map, ready to be searched.
#[derive(Debug, Clone)]
pub struct ViewMap {
    pub(super) options: Options,
    pub(super) turns: Vec<u16>,
    /// What is searched.
    pub(super) large: Level,
    pub(super) bounds: Bounds,
    /// What candidates are compared by again; `None` where the search alone decides.
    all: Option<Level>,
    /// What the tree `interpretation` compares; `None` where the other one does.
    counted: Option<CountedViews>,
}

/// A view that is looked for.
#[derive(Debug, Clone)]
pub struct Query {
    pub(super) large: Description,
    /// With areas of any size; `None` where the search alone decides.
    all: Option<Description>,
    /// For the tree `interpretation`.
    shapes: Option<Shapes>,
}

impl Query {
    /// Areas that take part: those of classes that are not ignored.
    pub fn areas(&self) -> usize {
        self.decisive().areas.len()
    }

    /// What a hit's score is of.
    fn decisive(&self) -> &Description {
        self.all.as_ref().unwrap_or(&self.large)
    }
}

/// A view that shows what a query shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Its number in the map.
    pub view: u32,
    /// Heading of the query relative to the view at which they fit best (rad), in (-π, π]. Of the search alone one of
    /// [`Options::headings`]; of the tree `interpretation` that of most matches.
    pub turn_rad: f64,
    /// Areas of the query that were matched.
    pub matched: u32,
    /// What speaks for the match, from 0 (nothing matched) to 1 (every area without any difference): each area of the
    /// query counts by its size, and each match by how small its differences are. Of the tree `interpretation` the share of
    /// the query's areas that were matched.
    pub score: f64,
    /// [`similarity`] of the numbers of areas.
    pub similarity: f64,
}

impl ViewMap {
    /// A map of views, numbered in their order.
    pub fn new<'a>(graphs: impl Iterator<Item = &'a Graph> + Clone, options: Options) -> Self {
        let code = |turn: f64| ((turn / TAU * 65536.0).round() as i64).rem_euclid(65536) as u16;
        let large = Level::new(graphs.clone(), &options);
        let counted = (options.tree == TreeKind::Interpretation)
            .then(|| CountedViews::new(graphs.clone(), &options));
        let again = options.candidates > 0 && counted.is_none();
        let turns: Vec<u16> = options.turns_rad().map(code).collect();
        Self {
            bounds: Bounds::new(&large.described, &large.offsets, &turns, &large.measure),
            turns,
            large,
            all: again.then(|| Level::new(graphs, &options.of_any_size())),
            counted,
            options,
        }
    }

    /// Number of views.
    pub fn len(&self) -> usize {
        self.large.offsets.len() - 1
    }

    /// True without views.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Prepares a view to be looked for.
    pub fn query(&self, graph: &Graph) -> Query {
        let described =
            |options: &Options| Description::new(graph, &order(graph, options), options);
        let again = self.all.is_some();
        Query {
            large: described(&self.options),
            all: again.then(|| described(&self.options.of_any_size())),
            shapes: self.counted.as_ref().map(|counted| counted.query(graph)),
        }
    }

    /// The `top` views that the query fits best, the best first (by score, then by number of matched areas, then by
    /// number), of those that `allowed` lets pass. Where the search alone decides, exactly those that comparing with every
    /// view would give, but for [`Options::fused`], which bounds do not know; else those of [`Options::candidates`].
    pub fn search(&self, query: &Query, top: usize, allowed: impl Fn(u32) -> bool) -> Vec<Hit> {
        if let Some((counted, shapes)) = self.counted(query) {
            let views = (0..self.len() as u32).filter(|view| allowed(*view));
            return counted.best(shapes, views, top);
        }
        if let Some(again) = self.again(query) {
            return again.search(top, allowed);
        }
        let bounds = self.bounded(query);
        let most = bounds.iter().max().copied().unwrap_or(0);
        let (mut best, mut tree) = (Best::new(top, &self.options), Tree::default());
        let mut end = u32::MAX;
        for round in 1..=ROUNDS {
            // Bounds from `start` up to those of the round before.
            let start = most - (u64::from(most) * u64::from(round) / u64::from(ROUNDS)) as u32;
            for candidate in candidates(&bounds, self.turns.len(), start..end) {
                if best.are_above(candidate.bound) {
                    return best.hits(self, query);
                }
                if allowed(candidate.view) {
                    let turn = self.turns[candidate.turn];
                    best.add(self.found(query, candidate.view, turn, &mut tree));
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
        if let Some((counted, shapes)) = self.counted(query) {
            return counted.best(shapes, views.iter().copied(), top);
        }
        if let Some(again) = self.again(query) {
            let bounded = views.iter().filter_map(|view| again.bound(*view));
            return again.best(bounded.collect(), top);
        }
        let (mut best, mut tree) = (Best::new(top, &self.options), Tree::default());
        for view in views {
            for turn in &self.turns {
                best.add(self.found(query, *view, *turn, &mut tree));
            }
        }
        best.hits(self, query)
    }

    /// One view, however little it fits, at the heading that fits best of those at which enough areas match; `None` for a
    /// view that there is not.
    pub fn compare(&self, query: &Query, view: u32) -> Option<Hit> {
        if let Some((counted, shapes)) = self.counted(query) {
            return counted.compare(shapes, view);
        }
        let mut tree = Tree::default();
        if let Some(again) = self.again(query) {
            let found = again.compared(&again.bound(view)?, &mut tree)?;
            return Some(self.hit(query, &found));
        }
        let turns = self.turns.iter();
        let found = turns.filter_map(|turn| self.found(query, view, *turn, &mut tree));
        let few = |found: &RankedHit| found.matched() < self.options.min_matched;
        let best = found.min_by_key(|found| (few(found), *found));
        best.map(|found| self.hit(query, &found))
    }

    /// What each view could be worth at each heading, at most, one view after the other.
    fn bounded(&self, query: &Query) -> Vec<u32> {
        let mut bounds = Vec::with_capacity(self.len() * self.turns.len());
        vectorised(
            #[inline(always)]
            || {
                let tell = |of_turns: &[u16]| {
                    bounds.extend(of_turns.iter().map(|told| self.bounds.most(*told)));
                };
                self.bounds.of_all(&query.large, tell);
            },
        );
        bounds
    }

    /// `None` where matches are weighed.
    fn counted<'a>(&'a self, query: &'a Query) -> Option<(&'a CountedViews, &'a Shapes)> {
        self.counted.as_ref().zip(query.shapes.as_ref())
    }

    /// `None` where the search alone decides.
    fn again<'a>(&'a self, query: &'a Query) -> Option<Again<'a>> {
        Some(Again {
            map: self,
            query,
            level: self.all.as_ref()?,
            all: query.all.as_ref()?,
        })
    }

    fn found(&self, query: &Query, view: u32, turn: u16, tree: &mut Tree) -> Option<RankedHit> {
        let pair = self.large.pair(&query.large, view, turn)?;
        Some(self.large.found(&pair, view, tree))
    }

    fn hit(&self, query: &Query, found: &RankedHit) -> Hit {
        let matched = found.matched();
        let weight = query.decisive().weight();
        let most = f64::from(weight) * f64::from(self.large.measure.limit);
        Hit {
            view: found.view,
            turn_rad: turn_rad(found.turn),
            matched,
            score: if most > 0.0 {
                f64::from(found.evidence()) / most
            } else {
                0.0
            },
            similarity: similarity(query.areas() as u32, matched),
        }
    }
}

/// A turn in (-π, π] (rad), of `2^16` for a full one.
pub(super) fn turn_rad(turn: u16) -> f64 {
    f64::from(turn as i16) / 65536.0 * TAU
}

/// A view that may be a hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Candidate {
    bound: u32,
    turn: usize,
    view: u32,
}

/// Of the bounds at so many headings of each view those in a range, the highest first; of equal ones the first view.
fn candidates(bounds: &[u32], headings: usize, range: Range<u32>) -> Vec<Candidate> {
    let mut found = Vec::new();
    let within = (0..).zip(bounds).filter(|(_, bound)| range.contains(bound));
    found.extend(within.map(|(at, bound): (usize, _)| Candidate {
        bound: *bound,
        turn: at % headings,
        view: (at / headings) as u32,
    }));
    found.sort_unstable_by_key(|candidate| {
        (Reverse(candidate.bound), candidate.view, candidate.turn)
    });
    found
}

/// The best views so far, sorted, each once.
pub(super) struct Best {
    found: Vec<RankedHit>,
    top: usize,
    min_matched: u32,
}

impl Best {
    pub(super) fn new(top: usize, options: &Options) -> Self {
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

    pub(super) fn add(&mut self, found: Option<RankedHit>) {
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

    pub(super) fn into_found(self) -> Vec<RankedHit> {
        self.found
    }

    pub(super) fn hits(&self, map: &ViewMap, query: &Query) -> Vec<Hit> {
        let hits = self.found.iter().map(|found| map.hit(query, found));
        hits.collect()
    }
}

/// Areas of two views that are taken for the same things: indices into the query's areas and into the view's. Of the
/// turns only the first counts.
pub fn matched_areas(query: &Graph, view: &Graph, options: &Options) -> Vec<[usize; 2]> {
    let map = ViewMap::new(std::iter::once(view), options.clone());
    let (asked, mut tree) = (map.query(query), Tree::default());
    let turn = map.turns.first();
    let pair = turn.and_then(|turn| map.large.pair(&asked.large, 0, *turn));
    let matched = match (map.counted(&asked), pair) {
        (Some((counted, shapes)), _) => counted.pairs(shapes, 0),
        (None, Some(pair)) => map.large.grown(&pair, &mut tree).pairs.clone(),
        (None, None) => Vec::new(),
    };
    let orders = [order(query, options), order_in_map(view, options)];
    let matched = matched.iter();
    matched
        .map(|[a, b]| [orders[0][usize::from(*a)], orders[1][usize::from(*b)]])
        .collect()
}
