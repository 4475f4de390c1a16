//! Lanes on the middle of their passes, bent to where they meet.
//!
//! Along a lane the middle is averaged over a few metres, for a pass more or less moves it at once. Where lanes meet they
//! meet at one point, the middle of all who pass there, and each comes to it from its own middle without a corner.

use super::super::explore::Chain;
use super::super::graph::Graph;
use super::net::Net;
use super::plane::{ahead, dot, left, shifted};

/// The middle is averaged over this many representatives on each side.
const AVERAGED: usize = 4;

/// Over how much of its length a lane bends to where it meets others, in `connect_m`: a car that keeps to its lane moves
/// sideways at a tenth of its way.
const BEND: f64 = 3.0;

/// Moves all nodes of the graph; `middles` are in the frames of the net's nodes.
pub(super) fn bend(graph: &mut Graph, net: &Net, chains: &[Chain], middles: &[f64]) {
    let moved = |node: u32, left_m: f64| {
        let node = net.node(node);
        shifted(&node.position, node.course, left_m)
    };
    let meets = |graph: &Graph, node: u32| graph.degree(node) > 2;
    let junctions: Vec<u32> = graph.nodes().filter(|&node| meets(graph, node)).collect();
    for node in junctions {
        graph.positions[node as usize] = moved(node, middles[node as usize]);
    }
    for chain in chains {
        let own: Vec<u32> = chain
            .nodes
            .iter()
            .copied()
            .filter(|&node| !meets(graph, node))
            .collect();
        let mut line: Vec<[f64; 3]> = (0..own.len())
            .map(|at| {
                let reach = AVERAGED.min(at).min(own.len() - 1 - at);
                let around = &own[at - reach..=at + reach];
                let sum: f64 = around.iter().map(|&node| middles[node as usize]).sum();
                moved(own[at], sum / around.len() as f64)
            })
            .collect();
        let ends = [chain.nodes.first(), chain.nodes.last()].map(|end| {
            let end = end.copied().filter(|&end| meets(graph, end));
            end.map(|end| *graph.position(end))
        });
        bend_ends(&mut line, &own, net, ends);
        for (&node, position) in own.iter().zip(line) {
            graph.positions[node as usize] = position;
        }
    }
}

/// Pulls the ends of a line to the points that it leads to: as far sideways as they are, less and less.
fn bend_ends(line: &mut [[f64; 3]], nodes: &[u32], net: &Net, ends: [Option<[f64; 3]>; 2]) {
    let along = distances(line);
    let Some(&length) = along.last() else { return };
    let reach = (BEND * net.reach.connect_m)
        .min(0.5 * length)
        .max(f64::MIN_POSITIVE);
    let straight = line.to_vec();
    for (end, first) in ends.into_iter().zip([true, false]) {
        let Some(point) = end else { continue };
        let at = if first { 0 } else { line.len() - 1 };
        let way = ahead(&straight[at], &point);
        let course = net.node(nodes[at]).course;
        let aside = dot(way, left(course));
        for k in 0..line.len() {
            let away = if first { along[k] } else { length - along[k] };
            let t = (1.0 - away / reach).max(0.0);
            let eased = t * t * (3.0 - 2.0 * t);
            let course = net.node(nodes[k]).course;
            line[k] = shifted(&line[k], course, aside * eased);
        }
    }
}

fn distances(line: &[[f64; 3]]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut before: Option<&[f64; 3]> = None;
    line.iter()
        .map(|point| {
            sum += before.map_or(0.0, |before| super::super::cells::distance(before, point));
            before = Some(point);
            sum
        })
        .collect()
}
