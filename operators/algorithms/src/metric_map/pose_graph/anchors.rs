//! What holds a graph in its frame.

use super::Graph;

/// By pose: does everything else hang off it? The fixed poses do, and the first pose of each connected part that has
/// no fixed one.
pub(super) fn anchors<M, const D: usize>(graph: &Graph<M, D>) -> Vec<bool> {
    let n = graph.poses.len();
    let mut neighbours = vec![Vec::new(); n];
    for edge in graph.edges.iter().filter(|edge| graph.joins(edge)) {
        neighbours[edge.from].push(edge.to);
        neighbours[edge.to].push(edge.from);
    }
    let fixed = |pose: &usize| graph.fixed.get(*pose).copied().unwrap_or(false);
    let mut anchors: Vec<bool> = (0..n).map(|pose| fixed(&pose)).collect();
    let mut reached = anchors.clone();
    let mut waiting: Vec<usize> = (0..n).filter(fixed).collect();
    for first in 0..=n {
        while let Some(pose) = waiting.pop() {
            for other in &neighbours[pose] {
                if !std::mem::replace(&mut reached[*other], true) {
                    waiting.push(*other);
                }
            }
        }
        if first < n && !reached[first] {
            (anchors[first], reached[first]) = (true, true);
            waiting.push(first);
        }
    }
    anchors
}
