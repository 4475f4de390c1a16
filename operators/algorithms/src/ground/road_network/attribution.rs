//! Which drive passed along each lane, and with which of its poses.
//!
//! Nothing is guessed from distances: every node of the skeleton stands for nodes that drives have
//! visited, and every visit knows the poses it was sampled from. A drive passed along a lane where
//! it visited a place that belongs to this lane alone, and where it went from one place of the
//! lane to the next (which is all that a lane between two intersections side by side has). Linear
//! in the visits.

use super::Passage;
use super::direction::Steps;
use super::explore::Chain;
use super::graph::Graph;
use super::thinning::Visit;
use std::collections::BTreeMap;

/// A drive by its key, with its first and last pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Span<'a> {
    drive: &'a str,
    first: u32,
    last: u32,
}

/// For each chain the drives that passed along it, in order; never empty. A chain that no drive
/// followed only joins places that are near each other: it has the passages of its places. `keys` says for each list of
/// visits whose drive it is part of.
pub(super) fn passages(
    graph: &Graph,
    chains: &[Chain],
    steps: &Steps,
    drives: &[Vec<Visit>],
    keys: &[&str],
) -> Vec<Vec<Passage>> {
    let mut spans: Vec<Vec<Span<'_>>> = vec![Vec::new(); chains.len()];
    let places = own_places(graph, chains);
    for (drive, visits) in keys.iter().zip(drives) {
        let mut before: Option<(u32, Visit)> = None;
        for &visit in visits {
            let node = graph.standing_for(visit.node);
            if let Some(&lane) = places.get(&node) {
                extend(&mut spans[lane], drive, visit.first, visit.last);
            }
            if let Some((from, left)) = before.replace((node, visit))
                && let Some(&(lane, _)) = steps.get(&(from, node))
            {
                extend(&mut spans[lane], drive, left.leaving, visit.arrived);
            }
        }
    }
    attribute_joints(graph, chains, drives, keys, &mut spans);
    let passage = |span: Span<'_>| Passage {
        drive: span.drive.to_owned(),
        first: span.first as usize,
        last: span.last as usize,
    };
    let named = |spans: Vec<Span<'_>>| spans.into_iter().map(passage).collect();
    spans.into_iter().map(named).collect()
}

/// Nodes that lie on one chain only, with its number: all but intersections.
fn own_places(graph: &Graph, chains: &[Chain]) -> BTreeMap<u32, usize> {
    let mut places = BTreeMap::new();
    for (lane, chain) in chains.iter().enumerate() {
        let own = chain.nodes.iter().filter(|&&node| graph.degree(node) <= 2);
        places.extend(own.map(|&node| (node, lane)));
    }
    places
}

/// Gives chains without a passage those of all their nodes.
fn attribute_joints<'a>(
    graph: &Graph,
    chains: &[Chain],
    drives: &[Vec<Visit>],
    keys: &[&'a str],
    spans: &mut [Vec<Span<'a>>],
) {
    let mut joints: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (lane, chain) in chains.iter().enumerate() {
        for &node in chain.nodes.iter().filter(|_| spans[lane].is_empty()) {
            joints.entry(node).or_default().push(lane);
        }
    }
    if joints.is_empty() {
        return;
    }
    for (drive, visits) in keys.iter().zip(drives) {
        for visit in visits {
            let lanes = joints.get(&graph.standing_for(visit.node));
            for &lane in lanes.into_iter().flatten() {
                extend(&mut spans[lane], drive, visit.first, visit.last);
            }
        }
    }
}

/// Drives come one after the other, so that only the last span can be this drive's.
fn extend<'a>(spans: &mut Vec<Span<'a>>, drive: &'a str, first: u32, last: u32) {
    match spans.last_mut() {
        Some(span) if span.drive == drive => {
            span.first = span.first.min(first);
            span.last = span.last.max(last);
        }
        _ => spans.push(Span { drive, first, last }),
    }
}
