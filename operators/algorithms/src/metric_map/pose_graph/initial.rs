//! A first guess along a spanning tree.

use std::collections::VecDeque;

use super::{Graph, Motion};

/// The edges at each pose, in the order of the graph.
pub(super) fn incident<M, const D: usize>(graph: &Graph<M, D>) -> Vec<Vec<usize>> {
    let n = graph.poses.len();
    let mut incident = vec![Vec::new(); n];
    for (index, edge) in graph.edges.iter().enumerate() {
        if edge.from < n && edge.to < n && edge.from != edge.to {
            incident[edge.from].push(index);
            incident[edge.to].push(index);
        }
    }
    incident
}

/// Poses that everything else hangs off: the fixed ones, and the first pose of each connected part
/// that has no fixed one.
pub(super) fn anchors<M, const D: usize>(graph: &Graph<M, D>) -> Vec<bool> {
    let incident = incident(graph);
    let n = graph.poses.len();
    let mut anchors: Vec<bool> = (0..n)
        .map(|pose| graph.fixed.get(pose).copied().unwrap_or(false))
        .collect();
    let mut reached = anchors.clone();
    let mut queue: VecDeque<usize> = (0..n).filter(|pose| anchors[*pose]).collect();
    for first in 0..n {
        while let Some(pose) = queue.pop_front() {
            for edge in &incident[pose] {
                let edge = &graph.edges[*edge];
                let other = edge.from + edge.to - pose;
                if !reached[other] {
                    reached[other] = true;
                    queue.push_back(other);
                }
            }
        }
        if !reached[first] {
            (anchors[first], reached[first]) = (true, true);
            queue.push_back(first);
        }
    }
    anchors
}

/// Poses by the shortest chains of edges from the fixed ones; a connected part without a fixed
/// pose hangs off its first. Exact where nothing is noisy or false, drifting elsewhere.
pub fn spanning_tree<M: Motion<D>, const D: usize>(graph: &Graph<M, D>) -> Vec<M> {
    let incident = incident(graph);
    let mut poses = graph.poses.clone();
    let mut reached = anchors(graph);
    let mut queue: VecDeque<usize> = (0..poses.len()).filter(|pose| reached[*pose]).collect();
    while let Some(pose) = queue.pop_front() {
        for edge in &incident[pose] {
            let edge = &graph.edges[*edge];
            let other = edge.from + edge.to - pose;
            if !reached[other] {
                reached[other] = true;
                poses[other] = if edge.from == pose {
                    poses[pose].then(&edge.measured)
                } else {
                    poses[pose].then(&edge.measured.inverted())
                };
                queue.push_back(other);
            }
        }
    }
    poses
}
