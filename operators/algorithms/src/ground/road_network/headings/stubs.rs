//! Dead ends too short to be driven to.

use super::super::graph::Graph;
use super::super::prune::{dead_ends, stub};
use super::plane::{ahead, dot};

/// Removes dead ends shorter than `shortest_m` beside a lane that goes on: a drive that began or ended a step off the
/// lane. Where the other two part, the dead end is what they have in common, and stays.
pub(super) fn remove(graph: &mut Graph, shortest_m: f64) {
    for end in dead_ends(graph) {
        if let Some((_, nodes, junction)) = stub(graph, end, shortest_m)
            && nodes
                .last()
                .is_some_and(|last| goes_on(graph, junction, *last))
        {
            for node in nodes {
                graph.remove(node, junction);
            }
        }
    }
}

/// Whether two of the other neighbours lie on opposite sides.
fn goes_on(graph: &Graph, junction: u32, without: u32) -> bool {
    let here = graph.position(junction);
    let others = graph
        .neighbours(junction)
        .iter()
        .filter(|node| **node != without);
    let ways: Vec<[f64; 2]> = others
        .map(|&node| ahead(here, graph.position(node)))
        .collect();
    ways.iter().any(|a| ways.iter().any(|b| dot(*a, *b) < 0.0))
}
