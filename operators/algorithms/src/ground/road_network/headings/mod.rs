//! Algorithm 1 with headings: passes of one lane are near each other *and* go the same way.
//!
//! ```text
//! drives ─▶ samples ─▶ laying: candidates of the net, matching ─▶ bending ─▶ crossings ─▶ the skeleton, for Alg. 2
//! ```
//!
//! Positions alone cannot tell two lanes beside each other from two passes of one lane, and a clique around a fork shrinks
//! to one node of one of its branches. Here poses of different passes are one lane where the drives go along together:
//! near each other, the same way, and neither coming nor leaving. What Algorithm 1 connects and shrinks clique by clique
//! is laid onto representatives drive by drive, so that no clique is ever there; a lane has as many nodes after a thousand
//! drives as after one. Lanes are then moved to the middle of their passes.

mod bending;
mod crossings;
mod laying;
mod matching;
mod middle;
mod net;
mod plane;
mod samples;
mod stubs;

use super::explore;
use super::graph::Graph;
use super::thinning;
use super::{RoadNetworkParams, Skeleton, Trace};

/// The lengths that decide, metres.
#[derive(Debug, Clone, Copy)]
struct Reach {
    /// Passes nearer than this that go the same way are one lane.
    connect_m: f64,
    /// Passes towards each other that are nearer are on one line.
    same_line_m: f64,
    /// Between representatives.
    spacing_m: f64,
    /// A drive does not meet itself within this path.
    min_loop_m: f64,
}

/// The skeleton of drives in the order given.
pub(super) fn skeleton(drives: &[Trace<'_>], params: &RoadNetworkParams) -> Skeleton {
    let reach = Reach {
        connect_m: params.connect_m,
        same_line_m: params.same_line_m(),
        spacing_m: params.spacing_m(),
        min_loop_m: params.min_loop_m(),
    };
    let mut layer = laying::Layer::new(net::Net::new(reach));
    for (number, drive) in drives.iter().enumerate() {
        for part in thinning::parts(drive) {
            for samples in samples::samples(&part, &reach) {
                layer.lay(number, &samples);
            }
        }
    }
    let laying::Layer {
        mut net, visits, ..
    } = layer;
    let mut graph = Graph::new(net.nodes.iter().map(|node| node.position).collect());
    for (a, b) in net.edges() {
        graph.connect(a, b);
    }
    let middles: Vec<f64> = net
        .nodes
        .iter_mut()
        .map(|node| middle::middle(&mut node.offsets, reach.same_line_m))
        .collect();
    let scatter_m = net
        .nodes
        .iter()
        .zip(&middles)
        .map(|(node, middle)| middle::scatter(&node.offsets, *middle))
        .collect();
    stubs::remove(&mut graph, reach.connect_m);
    let chains = explore::chains(&graph);
    bending::bend(&mut graph, &net, &chains, &middles);
    crossings::join(&mut graph, &reach);
    Skeleton {
        graph,
        visits: visits.drives,
        of: visits.of,
        scatter_m,
    }
}
