//! Algorithm 1, lines 13–25: cliques shrink to the node nearest their centre, until what is left
//! is a skeleton.
//!
//! Three additions of ours run only when drives were thinned:
//!
//! * *Ladders.* A cycle shorter than `min_loop_m` is an artefact of two passes that drift around
//!   d apart, no block one could drive around; it shrinks as a clique does.
//! * *Links.* Two intersections joined by less than `min_link_m` are one place: a crossing at an
//!   angle enters the other lane here and leaves it there. The link shrinks too.
//! * *Stubs.* A dead end shorter than `min_link_m` that hangs on an intersection goes, as the
//!   paper's set D does inside a clique's neighbourhood.

use super::cells::{CellIndex, distance, mean};
use super::cliques::maximal_cliques;
use super::graph::Graph;
use std::collections::BTreeMap;

/// How groups shrink.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rule {
    /// d, metres.
    pub(super) connect_m: f64,
    /// Whether dead ends beside a group go with it (the paper's set D). Representatives are as
    /// far apart as a short lane is long, so after thinning this would eat every lane's end anew
    /// in each round; stubs are then judged by their length instead.
    pub(super) drops_dead_ends: bool,
}

/// Rounds of clique pruning, fewer when no clique is left.
pub(super) fn prune_cliques(graph: &mut Graph, rounds: u32, rule: Rule) {
    for _ in 0..rounds {
        let cliques = maximal_cliques(graph);
        if cliques.is_empty() || !shrink(graph, &cliques, rule) {
            return;
        }
    }
}

/// One round: each group in turn becomes one node, unless its surroundings changed this round.
/// Gives whether any did.
fn shrink(graph: &mut Graph, groups: &[Vec<u32>], rule: Rule) -> bool {
    let index = index_nodes(graph, rule.connect_m);
    // Marked for removal, with the node that takes over.
    let mut marked: BTreeMap<u32, u32> = BTreeMap::new();
    for group in groups {
        let around = closed_neighbourhood(graph, group);
        if around.iter().any(|node| marked.contains_key(node)) {
            continue;
        }
        let centre = mean(group.iter().map(|&node| graph.position(node)));
        let stray = index.nearest(&centre, &graph.positions, |_, away_m| {
            away_m <= rule.connect_m
        });
        let kept = nearest(graph, &centre, group.iter().copied().chain(stray));
        if marked.contains_key(&kept) {
            continue;
        }
        for &node in &around {
            graph.connect(kept, node);
        }
        let dead_ends = around
            .iter()
            .copied()
            .filter(|&node| rule.drops_dead_ends && graph.degree(node) == 1);
        let gone: Vec<u32> = group
            .iter()
            .copied()
            .chain(dead_ends)
            .filter(|&node| node != kept)
            .collect();
        marked.extend(gone.into_iter().map(|node| (node, kept)));
    }
    for (&node, &heir) in &marked {
        graph.remove(node, heir);
    }
    !marked.is_empty()
}

fn index_nodes(graph: &Graph, cell_m: f64) -> CellIndex {
    let mut index = CellIndex::new(cell_m);
    for node in graph.nodes() {
        index.insert(node, graph.position(node));
    }
    index
}

/// The group and all who are adjacent to it, ascending.
fn closed_neighbourhood(graph: &Graph, group: &[u32]) -> Vec<u32> {
    let mut around: Vec<u32> = group
        .iter()
        .flat_map(|&node| graph.neighbours(node).iter().copied().chain([node]))
        .collect();
    around.sort_unstable();
    around.dedup();
    around
}

/// The existing node nearest to `centre`, the smaller number on a tie. A member of the group is
/// always a candidate; others matter only if closer still, so a small radius suffices.
fn nearest(graph: &Graph, centre: &[f64; 3], nodes: impl Iterator<Item = u32>) -> u32 {
    let by_distance = nodes.map(|node| (distance(centre, graph.position(node)), node));
    let closer = |a: (f64, u32), b: (f64, u32)| if b < a { b } else { a };
    by_distance.reduce(closer).map_or(0, |(_, node)| node)
}

/// Shrinks cycles shorter than `min_loop_m`; gives whether there were any.
pub(super) fn prune_ladders(graph: &mut Graph, min_loop_m: f64, rule: Rule) -> bool {
    shrink_shortest(graph, rule, |graph, node, next| {
        shortest_cycle(graph, node, next, min_loop_m)
    })
}

/// Shrinks what is found from intersections through their neighbours, by length and nodes, the shortest first; gives
/// whether there was anything.
fn shrink_shortest(
    graph: &mut Graph,
    rule: Rule,
    through: impl Fn(&Graph, u32, u32) -> Option<(f64, Vec<u32>)>,
) -> bool {
    let mut found: Vec<(f64, Vec<u32>)> = Vec::new();
    for node in graph.nodes().filter(|&node| graph.degree(node) > 2) {
        for &next in graph.neighbours(node) {
            found.extend(through(graph, node, next));
        }
    }
    found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
    found.dedup_by(|a, b| a.1 == b.1);
    let groups: Vec<Vec<u32>> = found.into_iter().map(|(_, nodes)| nodes).collect();
    !groups.is_empty() && shrink(graph, &groups, rule)
}

/// The shortest way round through the edge `(start, next)`, if under `limit_m` and connected to
/// anything else: length and nodes, ascending. (A small ring on its own is all that somebody
/// drove.)
fn shortest_cycle(graph: &Graph, start: u32, next: u32, limit_m: f64) -> Option<(f64, Vec<u32>)> {
    // Dijkstra from `next` to `start` without their common edge. Neighbourhoods are so small that
    // a sorted list is the fastest queue.
    let mut settled: Vec<(u32, u32)> = Vec::new();
    let mut queue = vec![(graph.length(start, next), next, start)];
    loop {
        let at = (0..queue.len()).min_by(|&a, &b| {
            queue[a]
                .0
                .total_cmp(&queue[b].0)
                .then_with(|| queue[a].1.cmp(&queue[b].1))
        })?;
        let (length, node, from) = queue.swap_remove(at);
        if settled.iter().any(|(done, _)| *done == node) {
            continue;
        }
        settled.push((node, from));
        if node == start {
            let mut nodes = vec![start];
            let mut back = from;
            while back != start {
                nodes.push(back);
                back = settled
                    .iter()
                    .find(|(done, _)| *done == back)
                    .map_or(start, |s| s.1);
            }
            nodes.sort_unstable();
            let junctions = nodes.iter().filter(|&&node| graph.degree(node) > 2).count();
            return (junctions >= 1).then_some((length, nodes));
        }
        for &other in graph.neighbours(node) {
            let further = length + graph.length(node, other);
            if further <= limit_m && !(node == next && other == start) {
                queue.push((further, other, node));
            }
        }
    }
}

/// Removes dead ends shorter than `min_link_m` that hang on an intersection, the shortest first;
/// gives whether there were any.
pub(super) fn prune_stubs(graph: &mut Graph, min_link_m: f64) -> bool {
    let mut stubs: Vec<(f64, Vec<u32>, u32)> = dead_ends(graph)
        .into_iter()
        .filter_map(|end| stub(graph, end, min_link_m))
        .collect();
    stubs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
    let mut any = false;
    for (_, nodes, junction) in stubs {
        // The junction may have become a plain lane node since.
        if graph.degree(junction) > 2 {
            for node in nodes {
                graph.remove(node, junction);
            }
            any = true;
        }
    }
    any
}

/// The nodes that lanes end at.
pub(super) fn dead_ends(graph: &Graph) -> Vec<u32> {
    let ends = graph.nodes().filter(|&node| graph.degree(node) == 1);
    ends.collect()
}

/// Length, nodes and junction of the chain from dead end `end`, if it is a short one.
pub(super) fn stub(graph: &Graph, end: u32, min_link_m: f64) -> Option<(f64, Vec<u32>, u32)> {
    let (mut nodes, mut length) = (vec![end], 0.0);
    let mut node = end;
    loop {
        let &next = graph
            .neighbours(node)
            .iter()
            .find(|next| !nodes.contains(next))?;
        length += graph.length(node, next);
        if length >= min_link_m {
            return None;
        }
        if graph.degree(next) > 2 {
            return Some((length, nodes, next));
        }
        nodes.push(next);
        node = next;
    }
}

/// Shrinks lanes between two intersections that are shorter than `min_link_m`, the shortest
/// first; gives whether there were any.
pub(super) fn prune_links(graph: &mut Graph, min_link_m: f64, rule: Rule) -> bool {
    shrink_shortest(graph, rule, |graph, junction, next| {
        link(graph, junction, next, min_link_m)
    })
}

/// Length and nodes, ascending, of the lane from `junction` through `next`, if it is a short one
/// to another intersection.
fn link(graph: &Graph, junction: u32, next: u32, min_link_m: f64) -> Option<(f64, Vec<u32>)> {
    let mut nodes = vec![junction, next];
    let mut length = graph.length(junction, next);
    let (mut from, mut node) = (junction, next);
    while length < min_link_m {
        if graph.degree(node) > 2 {
            nodes.sort_unstable();
            return (node != junction).then_some((length, nodes));
        }
        let onward = graph
            .neighbours(node)
            .iter()
            .copied()
            .find(|&other| other != from)?;
        length += graph.length(node, onward);
        nodes.push(onward);
        (from, node) = (node, onward);
    }
    None
}
