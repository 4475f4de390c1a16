//! Which representatives a run of samples followed.
//!
//! Of all ways from candidate to candidate the cheapest is taken (Viterbi): being beside the passes so far costs by its
//! square, and going to a representative that is not connected costs as much as `JUMP` samples at the greatest distance.
//! A drive that goes straight on past a fork is thus not taken along the branch for the first metres.

use super::net::{Candidate, Net};

/// Cost of a step between representatives that are not connected.
const JUMP: f64 = 4.0;

/// Connections at most between the representatives of two successive samples, which are less than one apart.
const HOPS: usize = 4;

/// A sample's candidate, and whether it follows from the one before.
#[derive(Debug, Clone, Copy)]
pub(super) struct Followed {
    pub(super) candidate: Candidate,
    pub(super) jumped: bool,
}

/// The cheapest way through the candidates of successive samples; each has one at least.
pub(super) fn follow(net: &Net, candidates: &[&[Candidate]]) -> Vec<Followed> {
    let mut costs: Vec<f64> = Vec::new();
    let mut from: Vec<Vec<(usize, bool)>> = Vec::new();
    for (at, here) in candidates.iter().enumerate() {
        let before = at.checked_sub(1).map_or(&[][..], |at| candidates[at]);
        let reached = here.iter().map(|candidate| {
            let beside = (candidate.aside_m / net.reach.connect_m).powi(2);
            let came = (0..before.len()).map(|k| {
                let jumped = net.way(before[k].node, candidate.node, HOPS).is_none();
                (costs[k] + if jumped { JUMP } else { 0.0 }, (k, jumped))
            });
            let (cost, way) = came
                .reduce(|best, next| if next.0 < best.0 { next } else { best })
                .unwrap_or((0.0, (0, true)));
            (cost + beside, way)
        });
        let (reached, ways) = reached.unzip();
        costs = reached;
        from.push(ways);
    }
    let best = (0..costs.len()).reduce(|a, b| if costs[b] < costs[a] { b } else { a });
    let Some(mut chosen) = best else {
        return Vec::new();
    };
    let mut followed = Vec::with_capacity(candidates.len());
    for at in (0..candidates.len()).rev() {
        let (before, jumped) = from[at][chosen];
        followed.push(Followed {
            candidate: candidates[at][chosen],
            jumped,
        });
        chosen = before;
    }
    followed.reverse();
    followed
}
