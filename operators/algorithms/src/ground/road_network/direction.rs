//! Which way each lane was driven.
//!
//! Every drive is replayed over the lanes: each pose has become some node of the skeleton, and
//! the nodes of a drive walk along lanes. Odometry that trembles where the vehicle waits walks
//! to and fro between two nodes, so a change of direction counts only once the drive has come
//! back by more than `turn_m`; until then it is the same run.

use super::explore::Chain;
use super::graph::Graph;
use super::thinning::Visit;
use std::collections::HashMap;

/// Metres driven along a lane and against it, over all drives.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Driven {
    pub(super) forward_m: f64,
    pub(super) reverse_m: f64,
}

/// For each of the lanes, how far it was driven each way.
pub(super) fn replay(
    graph: &Graph,
    lanes: usize,
    steps: &Steps,
    drives: &[Vec<Visit>],
    turn_m: f64,
) -> Vec<Driven> {
    let mut driven = vec![Driven::default(); lanes];
    for drive in drives {
        let mut run: Option<Run> = None;
        let mut before: Option<u32> = None;
        for node in drive.iter().map(|visit| graph.standing_for(visit.node)) {
            let Some(from) = before.replace(node).filter(|&from| from != node) else {
                continue;
            };
            let Some(&(lane, signed_m)) = steps.get(&(from, node)) else {
                continue;
            };
            match &mut run {
                Some(run) if run.lane == lane => run.step(signed_m, turn_m, &mut driven),
                _ => {
                    let mut next = Run::new(lane);
                    next.step(signed_m, turn_m, &mut driven);
                    if let Some(done) = run.replace(next) {
                        done.end(&mut driven);
                    }
                }
            }
        }
        if let Some(done) = run {
            done.end(&mut driven);
        }
    }
    driven
}

/// Directed edge to lane and signed length. (Looked up only, never listed.)
pub(super) type Steps = HashMap<(u32, u32), (usize, f64)>;

/// The steps of all lanes.
pub(super) fn steps(graph: &Graph, chains: &[Chain]) -> Steps {
    let mut steps = HashMap::new();
    for (lane, chain) in chains.iter().enumerate() {
        for pair in chain.nodes.windows(2) {
            let length = graph.length(pair[0], pair[1]);
            steps.insert((pair[0], pair[1]), (lane, length));
            steps.insert((pair[1], pair[0]), (lane, -length));
        }
    }
    steps
}

/// A drive on one lane since it entered or turned.
struct Run {
    lane: usize,
    /// Where the run is, and its lowest and highest place so far, metres from where it began.
    at: f64,
    low: f64,
    high: f64,
}

impl Run {
    fn new(lane: usize) -> Self {
        Self {
            lane,
            at: 0.0,
            low: 0.0,
            high: 0.0,
        }
    }

    fn step(&mut self, signed_m: f64, turn_m: f64, driven: &mut [Driven]) {
        self.at += signed_m;
        let driven = &mut driven[self.lane];
        let (below, above) = (self.at - self.low, self.high - self.at);
        // A run up to `high` ends when it has come back down by turn_m, and the other way round.
        if self.high > -self.low && above > turn_m {
            driven.forward_m += self.high;
            *self = Self {
                at: -above,
                low: -above,
                high: 0.0,
                lane: self.lane,
            };
        } else if -self.low > self.high && below > turn_m {
            driven.reverse_m -= self.low;
            *self = Self {
                at: below,
                low: 0.0,
                high: below,
                lane: self.lane,
            };
        } else {
            self.low = self.low.min(self.at);
            self.high = self.high.max(self.at);
        }
    }

    /// The run leaves the lane where it is.
    fn end(self, driven: &mut [Driven]) {
        let driven = &mut driven[self.lane];
        driven.forward_m += self.at.max(0.0);
        driven.reverse_m += (-self.at).max(0.0);
    }
}
