//! Writes the text format of g2o: one vertex or edge per line.
//!
//! ```text
//! VERTEX_SE3:QUAT id x y z qx qy qz qw
//! FIX id
//! EDGE_SE3:QUAT from to x y z qx qy qz qw  (upper triangle of the 6×6 information, row by row)
//! ```
//!
//! The information of an edge is that of translation, then rotation, as here.

use super::{Graph, Motion, SpatialGraph};

/// A spatial graph as text; `ids` by pose.
pub fn write_spatial(graph: &SpatialGraph, ids: &[u64]) -> String {
    write("SE3:QUAT", graph, ids, |pose| pose.to_array().to_vec())
}

/// A graph as text: `group` is how the format calls its motions, `numbers` what it writes of one.
pub fn write<M: Motion<D>, const D: usize>(
    group: &str,
    graph: &Graph<M, D>,
    ids: &[u64],
    numbers: impl Fn(&M) -> Vec<f64>,
) -> String {
    let mut text = String::new();
    let mut line = |tag: &str, ids: &[u64], numbers: &[f64]| {
        text.push_str(tag);
        let ids = ids.iter().map(u64::to_string);
        for word in ids.chain(numbers.iter().map(f64::to_string)) {
            text.push(' ');
            text.push_str(&word);
        }
        text.push('\n');
    };
    let (vertex, edge_tag) = (format!("VERTEX_{group}"), format!("EDGE_{group}"));
    for (pose, id) in graph.poses.iter().zip(ids) {
        line(&vertex, &[*id], &numbers(pose));
    }
    for (id, _) in ids.iter().zip(&graph.fixed).filter(|(_, fixed)| **fixed) {
        line("FIX", &[*id], &[]);
    }
    for edge in &graph.edges {
        if let (Some(from), Some(to)) = (ids.get(edge.from), ids.get(edge.to)) {
            let mut numbers = numbers(&edge.measured);
            for row in 0..D {
                numbers.extend((row..D).map(|column| edge.information[(row, column)]));
            }
            line(&edge_tag, &[*from, *to], &numbers);
        }
    }
    text
}
