//! Road networks from nothing but where vehicles have been.
//!
//! Source: paper 1, section V-B, Algorithms 1 and 2. Poses are nodes; poses of different passes
//! that are near each other are connected; cliques shrink to one node each until a skeleton is
//! left; the skeleton's chains are lanes and its branch points intersections.
//!
//! ```text
//!          ┌▶ headings: samples, laying, bending, crossings ─┐
//! drives ──┤  (ours)                                         ├▶ explore ─▶ direction, attribution, succession
//!          └▶ thinning ─▶ graph ─▶ prune, positions alone ───┘  Alg. 2     (ours)            ─▶ lanes, intersections
//!             (ours)      Alg. 1   Alg. 1
//! ```
//!
//! By default headings join positions: see `headings/mod.rs` for what Algorithm 1 becomes then. `headings: false` is the
//! paper's way. With `spacing_m = 0` as well the paper is followed to the letter (a test compares it with an all-pairs
//! transcription). That is exponential in the number of passes, so drives are thinned first otherwise: see `thinning.rs`
//! for what that means, `prune.rs` for the two clean-ups it makes necessary and `explore.rs` for the one ambiguity
//! resolved.
//!
//! The answer depends on the positions and on the drives' keys alone: drives are sorted by key,
//! every tie is broken by node number, and nodes are numbered in driven order.

mod attribution;
mod cells;
mod cliques;
mod direction;
mod explore;
mod graph;
mod headings;
mod params;
mod prune;
mod succession;
#[cfg(test)]
mod tests;
mod thinning;

pub use params::{RoadNetworkError, RoadNetworkParams};

use crate::solving::median::median;
use explore::Chain;
use graph::Graph;
use prune::Rule;
use thinning::Visit;

/// Clean-up rounds at most; each removes a node, and a handful suffices.
const MOST_CLEANUPS: u32 = 64;

/// Visits ahead that are looked at for temporal neighbours after thinning: more than
/// representatives fit along the way through a radius.
const MOST_FOLLOWERS: usize = 64;

/// One drive: a session's poses in the order driven.
#[derive(Debug, Clone, Copy)]
pub struct Trace<'a> {
    /// Orders the drives; the name of the session.
    pub key: &'a str,
    /// Positions in the map frame, metres. Those that are not finite are skipped.
    pub positions: &'a [[f64; 3]],
    /// Indices of positions, ascending, that nobody knows the way to from the position before: what the drive went along
    /// is cut there.
    pub breaks: &'a [usize],
}

/// What a lane's end is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndKind {
    /// It meets other lanes.
    Intersection,
    /// Nobody drove on.
    DeadEnd,
    /// The lane is a ring of its own: both ends are the same, arbitrary node.
    Ring,
}

/// One end of a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LaneEnd {
    /// Node number; intersections use the same numbers.
    pub node: u32,
    /// What is there.
    pub kind: EndKind,
}

/// How a lane was driven, relative to the order of its points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Travel {
    /// From start to end only.
    Forward,
    /// From end to start only.
    Reverse,
    /// Both ways.
    Both,
    /// Along no more than half of it: it only joins places that are near each other.
    Unknown,
}

/// The part of a drive that passed along a lane. It may have left the lane in between.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Passage {
    /// The drive's key.
    pub drive: String,
    /// First of its positions on the lane, as counted in [`Trace::positions`].
    pub first: usize,
    /// Last of its positions on the lane; never before `first`.
    pub last: usize,
}

/// A lane: a chain of places between two ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Lane {
    /// Positions from start to end, metres, at least two. A ring repeats its first at the end.
    pub points: Vec<[f64; 3]>,
    /// Where the points begin; never a larger node number than `end`.
    pub start: LaneEnd,
    /// Where they end.
    pub end: LaneEnd,
    /// Which way it is driven.
    pub travel: Travel,
    /// Metres driven from start to end over the lane's length, rounded: the number of passes.
    pub forward_passes: u32,
    /// The same from end to start.
    pub reverse_passes: u32,
    /// Length of the points' polyline, metres.
    pub length_m: f64,
    /// The vehicle's width and what its passes scatter by, metres.
    pub width_m: f64,
    /// Lanes, by their index, that drives went on to from the end; ascending.
    pub next: Vec<u32>,
    /// The same from the start, for drives that came from the end.
    pub next_backward: Vec<u32>,
    /// The drives that the lane was made from, in the order of their keys; at least one. A lane
    /// that no drive followed has those that came by its ends.
    pub passages: Vec<Passage>,
}

/// A place where more than two lane ends meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intersection {
    /// Node number.
    pub node: u32,
    /// Position, metres.
    pub position: [f64; 3],
    /// Number of lane ends that meet.
    pub degree: u32,
}

/// Lanes and intersections, in the order of their node numbers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RoadNetwork {
    /// The lanes.
    pub lanes: Vec<Lane>,
    /// The intersections.
    pub intersections: Vec<Intersection>,
}

/// Finds the road network that the drives of one site have in common.
///
/// # Errors
/// [`RoadNetworkError`] when a parameter makes no sense or there are more than 2³² poses.
pub fn road_network(
    drives: &[Trace<'_>],
    params: &RoadNetworkParams,
) -> Result<RoadNetwork, RoadNetworkError> {
    check(drives, params)?;
    let mut sorted = drives.to_vec();
    sorted.sort_by(|a, b| a.key.cmp(b.key));
    let Skeleton {
        graph,
        visits: visited,
        of,
        scatter_m,
    } = if params.headings {
        headings::skeleton(&sorted, params)
    } else {
        positions_alone(&sorted, params)
    };
    let keys: Vec<&str> = of.iter().map(|drive| sorted[*drive].key).collect();
    let chains = explore::chains(&graph);
    let steps = direction::steps(&graph, &chains);
    let driven = direction::replay(&graph, chains.len(), &steps, &visited, params.connect_m);
    let passages = attribution::passages(&graph, &chains, &steps, &visited, &keys);
    let next = succession::next(&graph, chains.len(), &steps, &visited);
    let names = Names::new(&graph);
    let about = driven.into_iter().zip(passages).zip(next);
    let lanes = chains
        .iter()
        .zip(about)
        .map(|(chain, ((driven, passages), next))| Lane {
            passages,
            width_m: params.vehicle_width_m + median_scatter(chain, &scatter_m),
            next: next.from_end.into_iter().collect(),
            next_backward: next.from_start.into_iter().collect(),
            ..lane(&graph, &names, chain, driven)
        });
    Ok(RoadNetwork {
        lanes: lanes.collect(),
        intersections: intersections(&graph, &names),
    })
}

/// The skeleton, what each unbroken part of a drive visited of it, and whose part it is.
struct Skeleton {
    graph: Graph,
    visits: Vec<Vec<Visit>>,
    of: Vec<usize>,
    /// By node: how far the passes there scatter sideways, metres.
    scatter_m: Vec<f64>,
}

/// Algorithm 1 as the paper has it.
fn positions_alone(drives: &[Trace<'_>], params: &RoadNetworkParams) -> Skeleton {
    let (visits, most_followers) = if params.spacing_m() > 0.0 {
        let visits = thinning::thinned(drives, params.spacing_m(), params.connect_m);
        (visits, MOST_FOLLOWERS)
    } else {
        (thinning::literal(drives), usize::MAX)
    };
    let of = visits.of.clone();
    let (mut graph, visits) = graph::connect(visits, params.connect_m, most_followers);
    prune(&mut graph, params);
    Skeleton {
        scatter_m: vec![0.0; graph.positions.len()],
        graph,
        visits,
        of,
    }
}

/// How far the passes of a lane scatter in the middle of its places.
fn median_scatter(chain: &Chain, scatter_m: &[f64]) -> f64 {
    let scatter = chain.nodes.iter().map(|&node| scatter_m[node as usize]);
    median(scatter.collect()).unwrap_or_default()
}

fn check(drives: &[Trace<'_>], params: &RoadNetworkParams) -> Result<(), RoadNetworkError> {
    params.check()?;
    let found = drives.iter().map(|drive| drive.positions.len()).sum();
    // Thinning fills steps with at most 128 samples each, but merges more than it adds.
    if found > u32::MAX as usize / 128 {
        return Err(RoadNetworkError::TooMany { found });
    }
    Ok(())
}

fn prune(graph: &mut Graph, params: &RoadNetworkParams) {
    // Without a limit: each round removes a node at least, so it ends by itself.
    let rounds = params.prune_loops.unwrap_or(u32::MAX);
    let rule = Rule {
        connect_m: params.connect_m,
        drops_dead_ends: params.spacing_m() == 0.0,
    };
    prune::prune_cliques(graph, rounds, rule);
    if params.spacing_m() == 0.0 || rounds == 0 {
        return;
    }
    for _ in 0..MOST_CLEANUPS {
        let ladders = prune::prune_ladders(graph, params.min_loop_m(), rule);
        let links = prune::prune_links(graph, params.min_link_m(), rule);
        let stubs = prune::prune_stubs(graph, params.min_link_m());
        if !ladders && !links && !stubs {
            return;
        }
    }
}

/// Nodes that are left, numbered without gaps in driven order.
struct Names {
    numbers: Vec<u32>,
}

impl Names {
    fn new(graph: &Graph) -> Self {
        let mut numbers = vec![0; graph.positions.len()];
        for (number, node) in graph.nodes().enumerate() {
            numbers[node as usize] = number as u32;
        }
        Self { numbers }
    }

    fn of(&self, node: u32) -> u32 {
        self.numbers[node as usize]
    }
}

fn lane(graph: &Graph, names: &Names, chain: &Chain, driven: direction::Driven) -> Lane {
    let end = |node: Option<&u32>| {
        let node = node.copied().unwrap_or_default();
        let kind = match graph.degree(node) {
            _ if chain.ring => EndKind::Ring,
            1 => EndKind::DeadEnd,
            _ => EndKind::Intersection,
        };
        LaneEnd {
            node: names.of(node),
            kind,
        }
    };
    let length_m: f64 = chain
        .nodes
        .windows(2)
        .map(|pair| graph.length(pair[0], pair[1]))
        .sum();
    let passes = |metres: f64| {
        if length_m > 0.0 {
            (metres / length_m).round() as u32
        } else {
            0
        }
    };
    let (forward_passes, reverse_passes) = (passes(driven.forward_m), passes(driven.reverse_m));
    let travel = match (forward_passes > 0, reverse_passes > 0) {
        (true, false) => Travel::Forward,
        (false, true) => Travel::Reverse,
        (true, true) => Travel::Both,
        (false, false) => Travel::Unknown,
    };
    Lane {
        points: chain
            .nodes
            .iter()
            .map(|&node| *graph.position(node))
            .collect(),
        start: end(chain.nodes.first()),
        end: end(chain.nodes.last()),
        travel,
        forward_passes,
        reverse_passes,
        length_m,
        width_m: 0.0,
        next: Vec::new(),
        next_backward: Vec::new(),
        passages: Vec::new(),
    }
}

fn intersections(graph: &Graph, names: &Names) -> Vec<Intersection> {
    let meeting = graph.nodes().filter(|&node| graph.degree(node) > 2);
    meeting
        .map(|node| Intersection {
            node: names.of(node),
            position: *graph.position(node),
            degree: graph.degree(node) as u32,
        })
        .collect()
}
