//! Drives laid onto the net one after the other: along lanes that are there, as new lanes where there are none.
//!
//! A drive that comes within `connect_m` of an earlier one that goes its way has not joined it yet, it may cross or
//! still be coming: it follows the earlier one from where the distance between the two stops changing until where it
//! begins to change again. Before and after it lays its own representatives, and so forks and merges bend as they were
//! driven. Drives that only cross, but at so small an angle that they are on one line for `connect_m`, are together there.
//! Drives towards each other are on one line where they are within `same_line_m` in the mean.

use std::ops::Range;

use super::super::thinning::Visits;
use super::matching::{Followed, follow};
use super::net::{Candidate, Net, Way};
use super::plane::{ahead, dot};
use super::samples::Sample;

/// Two paths part where the distance between them changes by more than this over `connect_m`: 3°, twice what noise of 5 cm
/// a pose leaves of a smoothed course.
const PARTING: f64 = 0.05;

/// Connections at most that a drive may skip from one sample to the next.
const SKIPPED: usize = 8;

/// The net while drives are laid, and what they visit.
pub(super) struct Layer {
    pub(super) net: Net,
    pub(super) visits: Visits,
    part: u32,
    /// Where the drive is.
    at: Option<u32>,
}

/// A sample with who is beside it.
struct Pending {
    sample: Sample,
    same: Vec<Candidate>,
    opposite: Vec<Candidate>,
}

impl Pending {
    fn of(&self, way: Way) -> &[Candidate] {
        match way {
            Way::Same => &self.same,
            Way::Opposite => &self.opposite,
        }
    }
}

impl Layer {
    pub(super) fn new(net: Net) -> Self {
        Self {
            net,
            visits: Visits::default(),
            part: 0,
            at: None,
        }
    }

    /// Lays an unbroken part of a drive.
    pub(super) fn lay(&mut self, drive: usize, samples: &[Sample]) {
        self.visits.begin(drive);
        self.part += 1;
        self.at = None;
        let mut pending: Vec<Pending> = Vec::new();
        let mut starts = true;
        for sample in samples {
            let [same, opposite] =
                [Way::Same, Way::Opposite].map(|way| self.net.candidates(sample, self.part, way));
            if same.is_empty() && opposite.is_empty() {
                self.settle(&pending, starts, false);
                pending.clear();
                starts = false;
                self.alone(sample, false);
            } else {
                pending.push(Pending {
                    sample: *sample,
                    same,
                    opposite,
                });
            }
        }
        self.settle(&pending, starts, true);
        if let Some(last) = samples.last() {
            self.alone_at_end(last);
        }
    }

    /// Decides for a run of samples beside the net where they are on it.
    fn settle(&mut self, pending: &[Pending], starts: bool, ends: bool) {
        let mut settled: Vec<Option<(Followed, Way)>> = vec![None; pending.len()];
        for way in [Way::Same, Way::Opposite] {
            let open = |at: usize| settled[at].is_none() && !pending[at].of(way).is_empty();
            for run in runs(0..pending.len(), open) {
                let candidates: Vec<&[Candidate]> =
                    pending[run.clone()].iter().map(|p| p.of(way)).collect();
                let followed = follow(&self.net, &candidates);
                for piece in pieces(&followed) {
                    let free = [
                        starts && run.start + piece.start == 0,
                        ends && run.start + piece.end == pending.len(),
                    ];
                    let samples = &pending[run.start + piece.start..run.start + piece.end];
                    let Some(kept) = self.kept(samples, &followed[piece.clone()], way, free) else {
                        continue;
                    };
                    for at in piece.start + kept.start..piece.start + kept.end {
                        settled[run.start + at] = Some((followed[at], way));
                    }
                }
            }
        }
        for (pending, settled) in pending.iter().zip(settled) {
            match settled {
                Some((followed, way)) => self.along(&pending.sample, followed, way),
                None => self.alone(&pending.sample, false),
            }
        }
    }

    /// The part of a piece over which the drive is on the strand that it follows.
    fn kept(
        &self,
        samples: &[Pending],
        followed: &[Followed],
        way: Way,
        free: [bool; 2],
    ) -> Option<Range<usize>> {
        let reach = &self.net.reach;
        let path: Vec<f64> = samples.iter().map(|p| p.sample.path_m).collect();
        let offset: Vec<f64> = followed.iter().map(|f| f.candidate.offset_m).collect();
        let line_m = reach.same_line_m * if way == Way::Same { 0.5 } else { 1.0 };
        let on_line = |at: usize| followed[at].candidate.aside_m <= line_m;
        let long = |kept: &Range<usize>| {
            let end = kept.end.checked_sub(1).filter(|end| *end >= kept.start);
            end.is_some_and(|end| {
                free.contains(&true) || path[end] - path[kept.start] >= reach.connect_m
            })
        };
        let parted = |at: usize| way == Way::Opposite && on_line(at);
        let beside = together(&path, &offset, reach.connect_m, free, parted);
        let crossing = || together(&path, &offset, reach.connect_m, free, on_line);
        let kept = Some(beside)
            .filter(long)
            .or_else(|| Some(crossing()).filter(long))?;
        let aside: f64 = followed[kept.clone()]
            .iter()
            .map(|f| f.candidate.aside_m)
            .sum();
        let one_line = aside <= reach.same_line_m * kept.len() as f64;
        (way == Way::Same || one_line).then_some(kept)
    }

    /// The sample is on the net.
    fn along(&mut self, sample: &Sample, followed: Followed, way: Way) {
        let Candidate { node, offset_m, .. } = followed.candidate;
        if let Some(at) = self.at.filter(|at| *at != node) {
            match self.net.way(at, node, SKIPPED) {
                Some(between) => {
                    for node in between {
                        self.visits.visit(node, sample.first, sample.last);
                    }
                }
                None => {
                    let to = &self.net.node(node).position;
                    let way = dot(ahead(&self.net.node(at).position, to), sample.course);
                    if way < 0.5 * self.net.reach.spacing_m {
                        return;
                    }
                    self.net.connect(at, node);
                }
            }
        }
        if self.at != Some(node) {
            self.net.pass(node, offset_m, way);
        }
        self.visits.visit(node, sample.first, sample.last);
        self.at = Some(node);
    }

    /// The sample is where nobody was before; `ends` where the drive does not go on.
    fn alone(&mut self, sample: &Sample, ends: bool) {
        let spacing_m = self.net.reach.spacing_m;
        if let Some(at) = self.at {
            let way = ahead(&self.net.node(at).position, &sample.position);
            let own = self.net.laid_by(at, self.part);
            let gone = if own {
                way[0].hypot(way[1])
            } else {
                dot(way, sample.course)
            };
            let enough = match (own, ends) {
                (true, false) => 0.95,
                (_, false) => 0.5,
                (_, true) => 0.25,
            };
            if gone < enough * spacing_m {
                if own {
                    self.visits.visit(at, sample.first, sample.last);
                }
                return;
            }
        }
        let crowded = self.net.crowded(sample);
        let node = crowded.unwrap_or_else(|| self.net.add(sample, self.part));
        if let Some(at) = self.at.replace(node) {
            self.net.connect(at, node);
        }
        self.visits.visit(node, sample.first, sample.last);
    }

    /// A drive's own lane goes on to its last sample.
    fn alone_at_end(&mut self, last: &Sample) {
        if self.at.is_some_and(|at| self.net.laid_by(at, self.part)) {
            self.alone(last, true);
        }
    }
}

/// Maximal runs of what counts.
fn runs(all: Range<usize>, counts: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for at in all.filter(|at| counts(*at)) {
        match runs.last_mut() {
            Some(run) if run.end == at => run.end += 1,
            _ => runs.push(at..at + 1),
        }
    }
    runs
}

/// Cut before every jump.
fn pieces(followed: &[Followed]) -> Vec<Range<usize>> {
    let mut starts: Vec<usize> = (0..followed.len())
        .filter(|at| followed[*at].jumped)
        .collect();
    starts.push(followed.len());
    starts.windows(2).map(|pair| pair[0]..pair[1]).collect()
}

/// The part without what leads to a strand and away from it: where the offset changes and the drive is not `on_line`.
/// Ends that are `free` are ends of the drive, which neither joins nor leaves there.
fn together(
    path: &[f64],
    offset: &[f64],
    window_m: f64,
    free: [bool; 2],
    on_line: impl Fn(usize) -> bool,
) -> Range<usize> {
    let moves = |at: usize, towards: usize| {
        !on_line(at) && (offset[at] - offset[towards]).abs() > PARTING * window_m
    };
    let mut end = path.len();
    while !free[1] && end > 0 {
        let at = end - 1;
        let inside = path[..at].partition_point(|m| *m < path[at] - window_m);
        if !moves(at, inside) {
            break;
        }
        end -= 1;
    }
    let mut start = 0;
    while !free[0] && start < end {
        let inside = path.partition_point(|m| *m <= path[start] + window_m);
        if !moves(start, inside.min(path.len()) - 1) {
            break;
        }
        start += 1;
    }
    start..end
}
