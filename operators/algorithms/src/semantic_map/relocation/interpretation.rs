//! The interpretation tree of paper 2 (metric-topological-semantic map), section IV-B and Algorithm 1, as it is printed.
//!
//! An area is its class and the shape of its ellipse, wherever it is and however large it looks. Each area of the query is
//! paired with every area of the view whose shape is within limits, the most alike first, as long as what touches what is
//! compatible with all pairs before. So an area may have several matches, as objects that hide each other are one area
//! (section IV-A). The score is the number of areas that have any.
//!
//! What the paper leaves open: areas go the largest first; pairs are sorted by the sum of their differences, each in its
//! limit; two boundaries are compatible while their lengths, as angles, differ by no more than a factor, and none is
//! compatible with none alone.

use std::f32::consts::PI;

use super::description::{Description, order, order_in_map};
use super::options::{Options, ShapeLimits};
use crate::semantic_map::semantic_graph::Graph;

/// What the tree knows of an area.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shape {
    class: u8,
    eccentricity: f32,
    length_over_width: f32,
    orientation_rad: f32,
}

/// The areas of a query or of a view, with what touches what.
#[derive(Debug, Clone)]
pub(super) struct Shapes {
    shapes: Vec<Shape>,
    described: Description,
}

impl Shapes {
    pub(super) fn of_query(graph: &Graph, options: &Options) -> Self {
        Self::new(graph, &order(graph, options), options)
    }

    pub(super) fn of_view(graph: &Graph, options: &Options) -> Self {
        Self::new(graph, &order_in_map(graph, options), options)
    }

    fn new(graph: &Graph, order: &[usize], options: &Options) -> Self {
        let shape = |area: &usize| {
            let area = &graph.areas[*area];
            Shape {
                class: area.class,
                eccentricity: area.eccentricity,
                length_over_width: area.log_elongation().exp(),
                orientation_rad: area.orientation_rad,
            }
        };
        Self {
            shapes: order.iter().map(shape).collect(),
            described: Description::new(graph, order, options),
        }
    }

    /// Number of areas.
    pub(super) fn len(&self) -> usize {
        self.shapes.len()
    }

    /// The logarithm of the length of the boundary of two areas (rad); `None` where they do not touch.
    fn boundary(&self, a: usize, b: u16) -> Option<f32> {
        let neighbours = self.described.neighbours(a);
        let at = neighbours.binary_search_by_key(&b, |(other, _)| *other);
        at.ok().map(|at| neighbours[at].1)
    }
}

/// The paper's thresholds.
#[derive(Debug, Clone, Copy)]
struct Limits {
    eccentricity: f32,
    length_over_width: f32,
    orientation_rad: f32,
    /// Of the logarithms of lengths of boundaries.
    boundary: f32,
}

impl Limits {
    fn new(options: &Options) -> Self {
        let ShapeLimits {
            max_eccentricity,
            max_length_over_width,
            max_orientation_rad,
        } = options.shapes;
        Self {
            eccentricity: max_eccentricity as f32,
            length_over_width: max_length_over_width as f32,
            orientation_rad: max_orientation_rad as f32,
            boundary: options.boundary_factor.max(1.0).ln() as f32,
        }
    }

    /// The unary constraint: by how much two areas differ, each difference in its limit; `None` where one is beyond it.
    fn difference(&self, a: &Shape, b: &Shape) -> Option<f32> {
        if a.class != b.class {
            return None;
        }
        let tilt = (a.orientation_rad - b.orientation_rad).rem_euclid(PI);
        let apart = [
            (a.eccentricity - b.eccentricity).abs(),
            (a.length_over_width - b.length_over_width).abs(),
            tilt.min(PI - tilt),
        ];
        let limits = [
            self.eccentricity,
            self.length_over_width,
            self.orientation_rad,
        ];
        let within = apart.iter().zip(&limits).all(|(apart, most)| apart <= most);
        // A limit of 0 has let only 0 pass.
        let shares = apart
            .iter()
            .zip(&limits)
            .map(|(apart, most)| if *most > 0.0 { apart / most } else { 0.0 });
        within.then(|| shares.sum())
    }

    /// The pairwise constraint, of the boundaries between two areas and between their matches.
    fn compatible(&self, here: Option<f32>, there: Option<f32>) -> bool {
        match (here, there) {
            (Some(here), Some(there)) => (here - there).abs() <= self.boundary,
            (None, None) => true,
            _ => false,
        }
    }
}

/// The tree and its memory, used again and again.
#[derive(Debug, Clone)]
pub(super) struct InterpretationTree {
    limits: Limits,
    /// Areas of the view that an area of the query may be, with how much they differ.
    candidates: Vec<(f32, u16)>,
    /// By area of the query: its matches.
    matches: Vec<Vec<u16>>,
    /// By area of the view: the query's areas that it matches.
    matched_by: Vec<Vec<u16>>,
}

impl InterpretationTree {
    pub(super) fn new(options: &Options) -> Self {
        Self {
            limits: Limits::new(options),
            candidates: Vec::new(),
            matches: Vec::new(),
            matched_by: Vec::new(),
        }
    }

    /// Matches the areas of a query, in their order; the number of those that have a match.
    pub(super) fn grow(&mut self, query: &Shapes, view: &Shapes) -> u32 {
        empty(&mut self.matches, query.shapes.len());
        empty(&mut self.matched_by, view.shapes.len());
        for (area, shape) in query.shapes.iter().enumerate() {
            self.candidates.clear();
            for (other, of_view) in (0_u16..).zip(&view.shapes) {
                let difference = self.limits.difference(shape, of_view);
                let candidate = difference.map(|difference| (difference, other));
                self.candidates.extend(candidate);
            }
            self.candidates
                .sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for at in 0..self.candidates.len() {
                let other = self.candidates[at].1;
                if self.fits([query, view], area as u16, other) {
                    self.matches[area].push(other);
                    self.matched_by[usize::from(other)].push(area as u16);
                }
            }
        }
        let matched = self.matches.iter().filter(|matches| !matches.is_empty());
        matched.count() as u32
    }

    /// Each matched area of the query with the match that is most like it.
    pub(super) fn pairs(&self) -> Vec<[u16; 2]> {
        let best = |(area, matches): (u16, &Vec<u16>)| Some([area, *matches.first()?]);
        (0..).zip(&self.matches).filter_map(best).collect()
    }

    /// Whether the boundaries of two areas are compatible with all pairs so far. Areas that touch neither here nor there
    /// are, so only those are asked that touch one of the two. Where one area stands for both, it has no boundary.
    fn fits(&self, [query, view]: [&Shapes; 2], area: u16, other: u16) -> bool {
        let (mine, theirs) = (usize::from(area), usize::from(other));
        let here = query.described.neighbours(mine).iter();
        let mut here = here.flat_map(|(near, length)| {
            let matches = self.matches[usize::from(*near)].iter();
            matches.map(|matching| (*matching, *length))
        });
        let there = view.described.neighbours(theirs).iter();
        let mut there = there.flat_map(|(near, length)| {
            let matched = self.matched_by[usize::from(*near)].iter();
            matched.map(|matched| (*matched, *length))
        });
        here.all(|(matching, length)| {
            let boundary = view.boundary(theirs, matching);
            matching == other || self.limits.compatible(Some(length), boundary)
        }) && there.all(|(matched, length)| {
            let boundary = query.boundary(mine, matched);
            matched == area || self.limits.compatible(boundary, Some(length))
        })
    }

    /// The turn at which the most of the last pairs lie in one direction, within a sixteenth of a turn either way: `2^16` is
    /// a full turn. The paper's tree does not know headings; those who register what it finds want one.
    pub(super) fn turn(&self, query: &Shapes, view: &Shapes) -> u16 {
        let bearing = |of: &Shapes, area: u16| of.described.areas.at(usize::from(area)).bearing;
        let pairs = self.pairs();
        let turns: Vec<u16> = pairs
            .iter()
            .map(|[mine, other]| bearing(view, *other).wrapping_sub(bearing(query, *mine)))
            .collect();
        let near = |turn: &u16| {
            let apart = |other: &&u16| other.wrapping_sub(*turn).min(turn.wrapping_sub(**other));
            turns.iter().filter(|other| apart(other) <= 4096).count()
        };
        let most = turns.iter().rev().max_by_key(|turn| near(turn));
        most.copied().unwrap_or(0)
    }
}

/// So many empty lists.
fn empty(lists: &mut Vec<Vec<u16>>, number: usize) {
    lists.iter_mut().for_each(Vec::clear);
    lists.resize(number, Vec::new());
}
