//! Which regions touch, and small ones given to their neighbours.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::runs::{Joint, Runs};
use super::{Edge, VOID};
use crate::solving::parts;

/// A region that is left.
#[derive(Debug, Clone, Copy)]
pub(super) struct Region {
    /// Its number: of its first pixel, in the order of the first pixels of all.
    pub(super) id: u32,
    pub(super) class: u8,
    pub(super) pixels: u32,
}

/// Regions with their sizes and neighbours.
pub(super) struct Boundaries {
    /// Union-find: the region that holds this one's first pixel; itself where it is left.
    parents: Vec<u32>,
    classes: Vec<u8>,
    pixels: Vec<u32>,
    /// Pairs of regions, the smaller first, and the pairs of pixels between them; as they were before any was given away.
    touching: Vec<([u32; 2], u32)>,
}

impl Boundaries {
    pub(super) fn new(runs: &Runs, joints: &[Joint]) -> Self {
        let number = runs.number();
        let mut classes = vec![VOID; number];
        let mut pixels = vec![0; number];
        for (run, region) in runs.runs().iter().zip(runs.regions()) {
            classes[*region as usize] = run.class;
            pixels[*region as usize] += run.len();
        }
        let pair = |joint: &Joint| {
            let [a, b] = joint.runs.map(|run| runs.regions()[run as usize]);
            ([a.min(b), a.max(b)], joint.pairs)
        };
        let touching = summed(joints.iter().map(pair).collect());
        Self {
            parents: (0..number as u32).collect(),
            classes,
            pixels,
            touching,
        }
    }

    /// Number of regions before any was given away.
    pub(super) fn len(&self) -> usize {
        self.parents.len()
    }

    fn root(&self, mut region: u32) -> u32 {
        while self.parents[region as usize] != region {
            region = self.parents[region as usize];
        }
        region
    }

    /// The region that a region has become part of; none for void.
    pub(super) fn find(&self, region: u32) -> Option<u32> {
        let root = self.root(region);
        (self.classes[root as usize] != VOID).then_some(root)
    }

    /// Gives regions below `min_px` away; see [`super::Graph::from_labels`].
    pub(super) fn absorb(&mut self, min_px: u32) {
        let small = |(pixels, class): &(&u32, &u8)| **pixels < min_px && **class != VOID;
        if !self.pixels.iter().zip(&self.classes).any(|of| small(&of)) {
            return;
        }
        let mut neighbours = vec![Vec::new(); self.len()];
        for ([a, b], pairs) in &self.touching {
            neighbours[*a as usize].push((*b, *pairs));
            neighbours[*b as usize].push((*a, *pairs));
        }
        let sizes = (0_u32..).zip(self.pixels.iter().zip(&self.classes));
        let mut queue: BinaryHeap<Reverse<(u32, u32)>> = sizes
            .filter(|(_, of)| small(of))
            .map(|(region, (pixels, _))| Reverse((*pixels, region)))
            .collect();
        while let Some(Reverse((pixels, region))) = queue.pop() {
            let at = region as usize;
            if self.parents[at] != region || self.pixels[at] != pixels {
                continue;
            }
            if let Some(grown) = self.give_away(region, &mut neighbours)
                && self.pixels[grown as usize] < min_px
            {
                queue.push(Reverse((self.pixels[grown as usize], grown)));
            }
        }
        // Shallow paths for all lookups to come: parents are never after their children.
        for region in 0..self.len() {
            self.parents[region] = self.parents[self.parents[region] as usize];
        }
    }

    /// Makes a region part of the neighbour with the longest boundary, which is returned. A region without neighbours
    /// becomes void.
    fn give_away(&mut self, region: u32, neighbours: &mut [Vec<(u32, u32)>]) -> Option<u32> {
        let of = std::mem::take(&mut neighbours[region as usize]);
        let current = of
            .iter()
            .map(|(other, pairs)| ([region, parts::first(&mut self.parents, *other)], *pairs));
        let mut current: Vec<_> = current.collect();
        current.retain(|([_, other], _)| *other != region);
        let current = summed(current);
        let longest = current.iter().max_by_key(|([_, other], pairs)| {
            (*pairs, self.pixels[*other as usize], Reverse(*other))
        });
        let Some(([_, heir], _)) = longest else {
            self.classes[region as usize] = VOID;
            return None;
        };
        let class = self.classes[*heir as usize];
        neighbours[region as usize] = of;
        let mut whole = self.unite(region, *heir, neighbours);
        for ([_, other], _) in &current {
            if other != heir && self.classes[*other as usize] == class {
                whole = self.unite(whole, *other, neighbours);
            }
        }
        self.classes[whole as usize] = class;
        Some(whole)
    }

    /// The one with the first pixel is left. The shorter list of neighbours goes to the longer.
    fn unite(&mut self, a: u32, b: u32, neighbours: &mut [Vec<(u32, u32)>]) -> u32 {
        let (first, second) = (a.min(b) as usize, a.max(b) as usize);
        self.parents[second] = first as u32;
        self.pixels[first] += self.pixels[second];
        let mut long = std::mem::take(&mut neighbours[first]);
        let mut short = std::mem::take(&mut neighbours[second]);
        if long.len() < short.len() {
            std::mem::swap(&mut long, &mut short);
        }
        long.append(&mut short);
        neighbours[first] = long;
        first as u32
    }

    /// The regions that are left and have a class.
    pub(super) fn kept(&self) -> Vec<Region> {
        let regions = (0_u32..).zip(&self.parents);
        let left = regions.filter(|(region, parent)| region == *parent);
        left.map(|(id, _)| Region {
            id,
            class: self.classes[id as usize],
            pixels: self.pixels[id as usize],
        })
        .filter(|region| region.class != VOID)
        .collect()
    }

    /// The edges between areas, given the area of each region that is left.
    pub(super) fn edges(&self, area_of: &[Option<u16>]) -> Vec<Edge> {
        let area = |region| area_of[self.root(region) as usize];
        let pairs = self.touching.iter().filter_map(|([a, b], pairs)| {
            let (a, b) = (area(*a)?, area(*b)?);
            (a != b).then(|| ([a.min(b), a.max(b)].map(u32::from), *pairs))
        });
        let edge = |([a, b], boundary_px): ([u32; 2], u32)| Edge {
            a: a as u16,
            b: b as u16,
            boundary_px,
        };
        summed(pairs.collect()).into_iter().map(edge).collect()
    }
}

/// One entry for each pair, in order, with the sum of its counts.
fn summed(mut pairs: Vec<([u32; 2], u32)>) -> Vec<([u32; 2], u32)> {
    pairs.sort_unstable_by_key(|(pair, _)| *pair);
    pairs.dedup_by(|later, first| {
        let equal = later.0 == first.0;
        if equal {
            first.1 += later.1;
        }
        equal
    });
    pairs
}
