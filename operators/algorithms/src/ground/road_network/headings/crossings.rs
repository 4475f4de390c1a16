//! Lanes that cross without anybody having turned: they meet all the same.

use std::collections::BTreeMap;

use super::super::graph::Graph;
use super::Reach;
use super::plane::{ahead, unit};

/// Joins lanes at every point where they cross within `connect_m` of each other's height. Those that cross at so small an
/// angle that they are on the same line for `connect_m` are one lane there, or a fork.
pub(super) fn join(graph: &mut Graph, reach: &Reach) {
    for ([a, b], [c, d], point) in crossings(graph, reach) {
        let [kept, gone] = [[a, b], [c, d]].map(|edge| {
            let edge = edge.map(|node| graph.standing_for(node));
            let [near, far] = edge.map(|node| squared(graph.position(node), &point));
            if near <= far { edge[0] } else { edge[1] }
        });
        if kept == gone || graph.adjacent(kept, gone) {
            continue;
        }
        let (kept, gone) = (kept.min(gone), kept.max(gone));
        for other in graph.neighbours(gone).to_vec() {
            graph.connect(kept, other);
        }
        graph.remove(gone, kept);
        graph.positions[kept as usize] = point;
    }
}

fn squared(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let [dx, dy] = ahead(a, b);
    dx * dx + dy * dy
}

type Crossing = ([u32; 2], [u32; 2], [f64; 3]);

/// Pairs of edges without a common node that cross as seen from above, and where; in the order of their nodes.
fn crossings(graph: &Graph, reach: &Reach) -> Vec<Crossing> {
    let mut cells: BTreeMap<[i64; 2], Vec<[u32; 2]>> = BTreeMap::new();
    let mut found: Vec<Crossing> = Vec::new();
    for a in graph.nodes() {
        for &b in graph.neighbours(a).iter().filter(|b| a < **b) {
            for cell in touched(graph, [a, b], reach.connect_m) {
                let others = cells.entry(cell).or_default();
                for &other in others.iter() {
                    if let Some(point) = crossing(graph, other, [a, b], reach) {
                        found.push((other, [a, b], point));
                    }
                }
                others.push([a, b]);
            }
        }
    }
    found.sort_unstable_by_key(|found| (found.0, found.1));
    found.dedup_by_key(|found| (found.0, found.1));
    found
}

/// Cells under the box around an edge.
fn touched(graph: &Graph, edge: [u32; 2], cell_m: f64) -> Vec<[i64; 2]> {
    let [from, to] = edge.map(|node| graph.position(node));
    let range = |k: usize| {
        let [a, b] = [from[k], to[k]].map(|x| (x / cell_m).floor() as i64);
        // An edge is a few spacings long; one that is not is looked for at its ends.
        let (low, high) = (a.min(b), a.max(b));
        low..=high.min(low.saturating_add(64))
    };
    range(0)
        .flat_map(|x| range(1).map(move |y| [x, y]))
        .collect()
}

fn crossing(graph: &Graph, one: [u32; 2], other: [u32; 2], reach: &Reach) -> Option<[f64; 3]> {
    if one.iter().any(|node| other.contains(node)) {
        return None;
    }
    let [a, b] = one.map(|node| graph.position(node));
    let [c, d] = other.map(|node| graph.position(node));
    let (u, v, w) = (ahead(a, b), ahead(c, d), ahead(a, c));
    let cross = |a: [f64; 2], b: [f64; 2]| a[0] * b[1] - a[1] * b[0];
    if cross(unit(u), unit(v)).abs() < reach.same_line_m / reach.connect_m {
        return None;
    }
    let (s, t) = (cross(w, v) / cross(u, v), cross(w, u) / cross(u, v));
    let at = |p: &[f64; 3], q: &[f64; 3], t: f64| [0, 1, 2].map(|k| p[k] + t * (q[k] - p[k]));
    let (p, q) = (at(a, b, s), at(c, d, t));
    let inside = (0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t);
    (inside && (p[2] - q[2]).abs() < reach.connect_m).then_some([p[0], p[1], 0.5 * (p[2] + q[2])])
}
