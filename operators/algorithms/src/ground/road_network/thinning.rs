//! Fewer nodes before the paper's algorithm, so that it stays near-linear.
//!
//! With many drives through the same lane the literal graph has about (2d / pose spacing)^drives
//! maximal cliques in every neighbourhood: four passes at 0.2 m already make 160 000, and they all
//! say that these passes are one lane. Thinning says it directly. Drives are resampled along
//! their path and, in the order of their keys, laid onto a net of representative poses:
//!
//! * a sample within d of a representative of an *earlier pass* is that representative (the
//!   nearest one). Algorithm 1 would connect the two and shrink them into one;
//! * representatives that the drive itself has laid without leaving the radius d since do not
//!   count, just as Algorithm 1 disconnects temporal neighbours;
//! * where there is no earlier pass, a new representative is laid every `spacing_m`.
//!
//! Representatives are poses of real drives and at least `spacing_m` apart, hence no
//! neighbourhood holds more than a constant number of them, however many drives there are, and a
//! lane driven a thousand times has as many nodes as one driven once. Each drive becomes the list
//! of representatives it visits, and the paper's algorithm runs on those lists as if they were
//! the poses.

use super::Trace;
use super::cells::{CellIndex, distance};

/// Steps longer than this many spacings are not filled with samples: nothing is known between.
pub(super) const LONGEST_FILLED_STEP: f64 = 64.0;

/// Samples per spacing along the path.
const SAMPLES_PER_SPACING: f64 = 2.0;

/// A drive at one node, and the poses that its samples there are, or lie between; as counted in
/// [`Trace::positions`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Visit {
    pub(super) node: u32,
    /// The first pose of all samples.
    pub(super) first: u32,
    /// The last pose of the first sample: it had arrived.
    pub(super) arrived: u32,
    /// The first pose of the last sample: it had not left.
    pub(super) leaving: u32,
    /// The last pose of all samples.
    pub(super) last: u32,
}

impl Visit {
    /// One sample between two poses, which are the same if it is a pose.
    fn new(node: u32, first: u32, last: u32) -> Self {
        Self {
            node,
            first,
            arrived: last,
            leaving: first,
            last,
        }
    }
}

/// Nodes and, for every unbroken part of a drive, the nodes it visits in order (no node twice in a row).
#[derive(Default)]
pub(super) struct Visits {
    pub(super) nodes: Vec<[f64; 3]>,
    /// A drive's parts in order, drive after drive.
    pub(super) drives: Vec<Vec<Visit>>,
    /// By part: the index of its drive.
    pub(super) of: Vec<usize>,
}

impl Visits {
    pub(super) fn begin(&mut self, drive: usize) {
        self.drives.push(Vec::new());
        self.of.push(drive);
    }

    /// The drive's next sample lies at this node, between two poses.
    pub(super) fn visit(&mut self, node: u32, first: u32, last: u32) {
        let Some(visited) = self.drives.last_mut() else {
            return;
        };
        match visited.last_mut() {
            Some(visit) if visit.node == node => (visit.leaving, visit.last) = (first, last),
            _ => visited.push(Visit::new(node, first, last)),
        }
    }
}

/// Every pose is a node, as in the paper.
pub(super) fn literal(drives: &[Trace<'_>]) -> Visits {
    let mut visits = Visits::default();
    for (number, drive) in drives.iter().enumerate() {
        for part in parts(drive) {
            visits.begin(number);
            for (at, position) in part {
                visits.nodes.push(position);
                visits.visit(visits.nodes.len() as u32 - 1, at, at);
            }
        }
    }
    visits
}

/// The net of representatives: at least `spacing_m` apart, one for all passes within
/// `connect_m` of each other.
pub(super) fn thinned(drives: &[Trace<'_>], spacing_m: f64, connect_m: f64) -> Visits {
    let mut net = Net {
        nodes: Vec::new(),
        index: CellIndex::new(connect_m),
        spacing_m,
        connect_m,
        fresh: Vec::new(),
    };
    let mut visits = Visits::default();
    for (number, drive) in drives.iter().enumerate() {
        for part in parts(drive) {
            visits.begin(number);
            net.fresh.clear();
            resample(&part, spacing_m, |sample, first, last| {
                visits.visit(net.lay(sample), first, last);
            });
        }
    }
    Visits {
        nodes: net.nodes,
        ..visits
    }
}

/// The unbroken parts of a drive: finite positions with their numbers.
pub(super) fn parts(drive: &Trace<'_>) -> Vec<Vec<(u32, [f64; 3])>> {
    let mut parts = vec![Vec::new()];
    let mut breaks = drive.breaks.iter().peekable();
    for (at, position) in (0_u32..).zip(drive.positions) {
        if breaks.next_if(|found| **found <= at as usize).is_some() {
            parts.push(Vec::new());
        }
        if let Some(part) = parts.last_mut()
            && finite(position)
        {
            part.push((at, *position));
        }
    }
    parts
}

struct Net {
    nodes: Vec<[f64; 3]>,
    index: CellIndex,
    spacing_m: f64,
    connect_m: f64,
    /// What this drive has laid without leaving the radius since, oldest first.
    fresh: Vec<u32>,
}

impl Net {
    /// The representative of a sample: an earlier pass, else the drive's own trail.
    fn lay(&mut self, sample: [f64; 3]) -> u32 {
        let away = |id: &u32| distance(&sample, &self.nodes[*id as usize]);
        let left = self.fresh.iter().rposition(|id| away(id) > self.connect_m);
        self.fresh.drain(..left.map_or(0, |last| last + 1));
        let index = &self.index;
        let earlier = index.nearest(&sample, &self.nodes, |id, away_m| {
            away_m < self.connect_m && !self.fresh.contains(&id)
        });
        let own = || index.nearest(&sample, &self.nodes, |_, away_m| away_m < self.spacing_m);
        if let Some(id) = earlier.or_else(own) {
            return id;
        }
        let id = self.nodes.len() as u32;
        self.nodes.push(sample);
        self.index.insert(id, &sample);
        self.fresh.push(id);
        id
    }
}

fn finite(position: &[f64; 3]) -> bool {
    position.iter().all(|x| x.is_finite())
}

/// The poses, with samples between those that are far apart; each sample with the numbers of the poses that it lies
/// between, which for a pose are its own.
fn resample(poses: &[(u32, [f64; 3])], spacing_m: f64, mut sample: impl FnMut([f64; 3], u32, u32)) {
    let mut before: Option<(u32, [f64; 3])> = None;
    for (at, position) in poses.iter().copied() {
        if let Some((left, from)) = before {
            let spacings = distance(&from, &position) / spacing_m;
            if spacings <= LONGEST_FILLED_STEP {
                let parts = (spacings * SAMPLES_PER_SPACING).ceil();
                for part in 1..parts as u32 {
                    let t = f64::from(part) / parts;
                    let between = [0, 1, 2].map(|k| from[k] + t * (position[k] - from[k]));
                    sample(between, left, at);
                }
            }
        }
        sample(position, at, at);
        before = Some((at, position));
    }
}
