//! The net of representatives with their courses: who is near a sample and goes its way.

use std::f64::consts::FRAC_1_SQRT_2;

use super::super::cells::{CellIndex, distance};
use super::Reach;
use super::plane::{ahead, dot, left};
use super::samples::Sample;

/// A sample and a representative go the same way up to half of a right angle, beyond which they cross.
const SAME_WAY: f64 = FRAC_1_SQRT_2;

/// Representatives that go the same way within a spacing of each other: more are a scribble, which gets no more of them.
const CROWD: usize = 16;

/// Candidates at most: a sample has one for each strand beside it, and more only in a scribble.
const MOST_CANDIDATES: usize = 6;

/// Representatives at most that a way is looked for among; a scribble connects all with all.
const MOST_REACHED: usize = 64;

/// A representative: a place of the first drive that came along here.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) position: [f64; 3],
    /// Its drive's direction of travel, a unit vector from above.
    pub(super) course: [f64; 2],
    /// Whether drives the other way are on the same line.
    pub(super) both: bool,
    /// How far to the left of it each pass was, metres; its own is 0.
    pub(super) offsets: Vec<f64>,
    /// The offsets' sum.
    sum: f64,
    /// The part of a drive that it is of, and where along it.
    part: u32,
    path_m: f64,
}

impl Node {
    fn mean_offset(&self) -> f64 {
        self.sum / self.offsets.len() as f64
    }
}

/// Which drives a sample is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// Those that went its way.
    Same,
    /// Those that came towards it.
    Opposite,
}

/// A representative beside a sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub(super) node: u32,
    /// How far to the left of the representative the sample is, metres.
    pub(super) offset_m: f64,
    /// How far it is beside the mean of the passes so far, metres.
    pub(super) aside_m: f64,
}

/// Representatives, connected as they were driven.
pub(super) struct Net {
    pub(super) reach: Reach,
    pub(super) nodes: Vec<Node>,
    neighbours: Vec<Vec<u32>>,
    index: CellIndex,
}

impl Net {
    pub(super) fn new(reach: Reach) -> Self {
        Self {
            reach,
            nodes: Vec::new(),
            neighbours: Vec::new(),
            index: CellIndex::new(reach.connect_m),
        }
    }

    /// A new representative.
    pub(super) fn add(&mut self, sample: &Sample, part: u32) -> u32 {
        let id = self.nodes.len() as u32;
        self.nodes.push(Node {
            position: sample.position,
            course: sample.course,
            both: false,
            offsets: vec![0.0],
            sum: 0.0,
            part,
            path_m: sample.path_m,
        });
        self.neighbours.push(Vec::new());
        self.index.insert(id, &sample.position);
        id
    }

    /// Another pass along a representative.
    pub(super) fn pass(&mut self, id: u32, offset_m: f64, way: Way) {
        let node = &mut self.nodes[id as usize];
        node.offsets.push(offset_m);
        node.sum += offset_m;
        node.both |= way == Way::Opposite;
    }

    pub(super) fn node(&self, id: u32) -> &Node {
        &self.nodes[id as usize]
    }

    /// Whether this part of a drive was the first there.
    pub(super) fn laid_by(&self, id: u32, part: u32) -> bool {
        self.node(id).part == part
    }

    pub(super) fn connect(&mut self, a: u32, b: u32) {
        if a != b && !self.neighbours[a as usize].contains(&b) {
            self.neighbours[a as usize].push(b);
            self.neighbours[b as usize].push(a);
        }
    }

    /// All connections, each once.
    pub(super) fn edges(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let ends = (0_u32..).zip(&self.neighbours);
        ends.flat_map(|(a, near)| near.iter().filter(move |b| a < **b).map(move |b| (a, *b)))
    }

    /// The way from one representative to another along connections, at most `hops` of them; without its start.
    pub(super) fn way(&self, from: u32, to: u32, hops: usize) -> Option<Vec<u32>> {
        let mut reached = vec![(from, usize::MAX)];
        let mut begin = 0;
        for _ in 0..=hops {
            let end = reached.len();
            if end > MOST_REACHED {
                break;
            }
            for at in begin..end {
                if reached[at].0 == to {
                    let mut way = Vec::new();
                    let mut back = at;
                    while reached[back].1 != usize::MAX {
                        way.push(reached[back].0);
                        back = reached[back].1;
                    }
                    way.reverse();
                    return Some(way);
                }
                for &next in &self.neighbours[reached[at].0 as usize] {
                    if reached.iter().all(|(known, _)| *known != next) {
                        reached.push((next, at));
                    }
                }
            }
            begin = end;
        }
        None
    }

    /// Representatives beside the sample, the nearest of each strand, in the order of their numbers. What the same part of
    /// the drive has laid just now does not count, as Algorithm 1 disconnects temporal neighbours.
    pub(super) fn candidates(&self, sample: &Sample, part: u32, way: Way) -> Vec<Candidate> {
        let mut near: Vec<(u32, f64)> = Vec::new();
        self.index.near(&sample.position, |id| {
            if let Some(away) = self.beside(sample, id, part, way) {
                near.push((id, away));
            }
        });
        near.sort_unstable_by_key(|(id, _)| *id);
        let away = |id: u32| {
            let at = near.binary_search_by_key(&id, |(id, _)| *id).ok()?;
            Some(near[at].1)
        };
        let nearest = |&&(id, here): &&(u32, f64)| {
            let mut others = self.neighbours[id as usize].iter();
            others.all(|&other| away(other).is_none_or(|there| (here, id) < (there, other)))
        };
        let candidate = |&(node, _): &(u32, f64)| {
            let offset_m = self.offset(sample, node);
            Candidate {
                node,
                offset_m,
                aside_m: (offset_m - self.node(node).mean_offset()).abs(),
            }
        };
        let mut found: Vec<Candidate> = near.iter().filter(nearest).map(candidate).collect();
        if found.len() > MOST_CANDIDATES {
            found
                .sort_unstable_by(|a, b| a.aside_m.total_cmp(&b.aside_m).then(a.node.cmp(&b.node)));
            found.truncate(MOST_CANDIDATES);
        }
        found
    }

    /// The nearest representative that goes the sample's way, where there is a crowd of them.
    pub(super) fn crowded(&self, sample: &Sample) -> Option<u32> {
        let mut crowd: Vec<(f64, u32)> = Vec::new();
        self.index.near(&sample.position, |id| {
            let node = self.node(id);
            let away = distance(&node.position, &sample.position);
            if away < self.reach.spacing_m && dot(node.course, sample.course) >= SAME_WAY {
                crowd.push((away, id));
            }
        });
        let nearer = |a: (f64, u32), b: (f64, u32)| if b < a { b } else { a };
        (crowd.len() >= CROWD).then(|| crowd.into_iter().reduce(nearer).map(|(_, id)| id))?
    }

    fn offset(&self, sample: &Sample, id: u32) -> f64 {
        let node = self.node(id);
        dot(ahead(&node.position, &sample.position), left(node.course))
    }

    /// Distance of a representative that is a candidate.
    fn beside(&self, sample: &Sample, id: u32, part: u32, way: Way) -> Option<f64> {
        let node = self.node(id);
        let alike = dot(node.course, sample.course);
        let goes = match way {
            Way::Same => alike >= SAME_WAY || (node.both && alike <= -SAME_WAY),
            Way::Opposite => alike <= -SAME_WAY,
        };
        let just_laid = way == Way::Same
            && node.part == part
            && sample.path_m - node.path_m < self.reach.min_loop_m;
        let away = distance(&node.position, &sample.position);
        let along = dot(ahead(&node.position, &sample.position), node.course);
        let beside = away < self.reach.connect_m && along.abs() <= self.reach.spacing_m;
        let on_line =
            way == Way::Same || self.offset(sample, id).abs() < 2.0 * self.reach.same_line_m;
        (goes && !just_laid && beside && on_line).then_some(away)
    }
}
