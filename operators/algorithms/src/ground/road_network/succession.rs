//! Which lanes drives went on to at a lane's ends.

use super::direction::Steps;
use super::graph::Graph;
use super::thinning::Visit;
use std::collections::BTreeSet;

/// Lanes that were entered next, by where the lane was left; numbers ascending.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Next {
    /// From its end.
    pub(super) from_end: BTreeSet<u32>,
    /// From its start.
    pub(super) from_start: BTreeSet<u32>,
}

/// For each of the lanes, those that some drive went on to without turning back.
pub(super) fn next(graph: &Graph, lanes: usize, steps: &Steps, drives: &[Vec<Visit>]) -> Vec<Next> {
    let mut next = vec![Next::default(); lanes];
    for drive in drives {
        let mut nodes: Vec<u32> = drive
            .iter()
            .map(|visit| graph.standing_for(visit.node))
            .collect();
        nodes.dedup();
        for three in nodes.windows(3) {
            let step = |k: usize| steps.get(&(three[k], three[k + 1]));
            let (Some(&(left, signed_m)), Some(&(entered, _))) = (step(0), step(1)) else {
                continue;
            };
            // Within a lane, or back where it came from; a lane that is left at one end and entered at the other is both.
            if graph.degree(three[1]) <= 2 || three[0] == three[2] {
                continue;
            }
            let side = if signed_m >= 0.0 {
                &mut next[left].from_end
            } else {
                &mut next[left].from_start
            };
            side.insert(entered as u32);
        }
    }
    next
}
