//! Algorithm 2: from the skeleton graph to lanes and intersections.
//!
//! The paper starts "at some" dead end or intersection and lets degrees sink as lanes are taken
//! away, so an intersection may turn into the middle of a later lane depending on what was picked
//! first. Here the intersections are those of the untouched graph throughout (the paper's I*),
//! which is the only reading whose answer does not depend on the picks: a lane is a maximal chain
//! between nodes whose degree is not two, or a closed ring. Every edge is taken exactly once, so
//! the walk ends.

use super::graph::Graph;
use std::collections::BTreeSet;

/// Nodes of a lane from end to end; for a ring the first node is repeated at the end.
pub(super) struct Chain {
    pub(super) nodes: Vec<u32>,
    pub(super) ring: bool,
}

/// All chains: those with ends first, by their first two nodes, then the rings.
pub(super) fn chains(graph: &Graph) -> Vec<Chain> {
    let mut taken: BTreeSet<(u32, u32)> = BTreeSet::new();
    let mut chains = Vec::new();
    for start in graph.nodes().filter(|&node| graph.degree(node) != 2) {
        for &next in graph.neighbours(start) {
            if !taken.contains(&(start, next)) {
                chains.push(Chain {
                    nodes: walk(graph, start, next, &mut taken),
                    ring: false,
                });
            }
        }
    }
    for start in graph.nodes().filter(|&node| graph.degree(node) == 2) {
        // In a chain with ends both edges of a node of degree two are taken by now.
        if let Some(&next) = graph.neighbours(start).first()
            && !taken.contains(&(start, next))
            && !taken.contains(&(next, start))
            && !in_chain(graph, start, &taken)
        {
            chains.push(Chain {
                nodes: walk(graph, start, next, &mut taken),
                ring: true,
            });
        }
    }
    chains
}

fn in_chain(graph: &Graph, node: u32, taken: &BTreeSet<(u32, u32)>) -> bool {
    graph
        .neighbours(node)
        .iter()
        .any(|&next| taken.contains(&(node, next)))
}

/// Follows the lane until a node where it ends, taking both directions' first and last edges.
fn walk(graph: &Graph, start: u32, next: u32, taken: &mut BTreeSet<(u32, u32)>) -> Vec<u32> {
    let mut nodes = vec![start];
    let (mut from, mut at) = (start, next);
    loop {
        taken.insert((from, at));
        taken.insert((at, from));
        nodes.push(at);
        if at == start || graph.degree(at) != 2 {
            return nodes;
        }
        let onward = graph
            .neighbours(at)
            .iter()
            .copied()
            .find(|&other| other != from);
        let Some(onward) = onward else { return nodes };
        (from, at) = (at, onward);
    }
}
