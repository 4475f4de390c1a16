//! What holds a graph in its frame.

use super::Graph;
use crate::solving::parts::parts;

/// By pose: does everything else hang off it? The fixed poses do, and the first pose of each connected part that has
/// no fixed one.
pub(super) fn anchors<M, const D: usize>(graph: &Graph<M, D>) -> Vec<bool> {
    let n = graph.poses.len();
    let mut neighbours = vec![Vec::new(); n];
    for edge in graph.edges.iter().filter(|edge| graph.joins(edge)) {
        neighbours[edge.from].push(edge.to);
        neighbours[edge.to].push(edge.from);
    }
    let fixed = |pose: usize| graph.fixed.get(pose).copied().unwrap_or(false);
    let mut anchors: Vec<bool> = (0..n).map(fixed).collect();
    for part in parts(n, |_| true, |pose| neighbours[pose].iter().copied()) {
        let is_held = part.iter().any(|pose| anchors[*pose]);
        anchors[part[0]] |= !is_held;
    }
    anchors
}
