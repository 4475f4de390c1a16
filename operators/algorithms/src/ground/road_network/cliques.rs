//! Maximal cliques of three nodes and more (Bron & Kerbosch 1973, with a pivot).

use super::graph::Graph;

/// All of them, largest first, equal sizes by their node numbers: the paper's ordered list
/// (Algorithm 1, lines 14–15) with its ties broken.
pub(super) fn maximal_cliques(graph: &Graph) -> Vec<Vec<u32>> {
    let mut found = Vec::new();
    for node in graph.nodes() {
        let neighbours = graph.neighbours(node);
        let split = neighbours.partition_point(|&other| other < node);
        let (before, after) = neighbours.split_at(split);
        if after.len() >= 2 {
            grow(
                graph,
                &mut vec![node],
                after.to_vec(),
                before.to_vec(),
                &mut found,
            );
        }
    }
    found.sort_unstable_by(|a: &Vec<u32>, b| b.len().cmp(&a.len()).then_with(|| a.cmp(b)));
    found
}

/// Extends `clique` by `candidates`; `excluded` are those whose cliques were found before.
fn grow(
    graph: &Graph,
    clique: &mut Vec<u32>,
    mut candidates: Vec<u32>,
    mut excluded: Vec<u32>,
    found: &mut Vec<Vec<u32>>,
) {
    if candidates.is_empty() {
        if excluded.is_empty() && clique.len() > 2 {
            let mut sorted = clique.clone();
            sorted.sort_unstable();
            found.push(sorted);
        }
        return;
    }
    let common = |pivot: &&u32| {
        candidates
            .iter()
            .filter(|c| graph.adjacent(**pivot, **c))
            .count()
    };
    let Some(&pivot) = candidates.iter().chain(&excluded).max_by_key(common) else {
        return;
    };
    let branches: Vec<u32> = candidates
        .iter()
        .copied()
        .filter(|&c| !graph.adjacent(pivot, c))
        .collect();
    for node in branches {
        let adjacent = |list: &[u32]| {
            list.iter()
                .copied()
                .filter(|&other| graph.adjacent(node, other))
                .collect()
        };
        clique.push(node);
        grow(
            graph,
            clique,
            adjacent(&candidates),
            adjacent(&excluded),
            found,
        );
        clique.pop();
        candidates.retain(|&other| other != node);
        excluded.push(node);
    }
}
