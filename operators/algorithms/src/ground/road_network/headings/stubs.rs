//! Dead ends too short to be driven to.

use super::super::graph::Graph;
use super::plane::{ahead, dot};

/// Removes dead ends shorter than `shortest_m` beside a lane that goes on: a drive that began or ended a step off the
/// lane. Where the other two part, the dead end is what they have in common, and stays.
pub(super) fn remove(graph: &mut Graph, shortest_m: f64) {
    let ends: Vec<u32> = graph
        .nodes()
        .filter(|&node| graph.degree(node) == 1)
        .collect();
    for end in ends {
        if let Some((stub, junction)) = stub(graph, end, shortest_m) {
            for node in stub {
                graph.remove(node, junction);
            }
        }
    }
}

/// The nodes of the dead end, and where it meets the others.
fn stub(graph: &Graph, end: u32, shortest_m: f64) -> Option<(Vec<u32>, u32)> {
    let (mut nodes, mut length) = (vec![end], 0.0);
    let mut at = end;
    loop {
        let next = *graph
            .neighbours(at)
            .iter()
            .find(|next| !nodes.contains(next))?;
        length += graph.length(at, next);
        if length >= shortest_m {
            return None;
        }
        if graph.degree(next) > 2 {
            return goes_on(graph, next, at).then_some((nodes, next));
        }
        nodes.push(next);
        at = next;
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
