//! Positions block by block, those of one simplex together.

use super::BLOCK;

/// A position in its block, and its barycentric coordinates.
type Member<const V: usize> = (u8, [f32; V]);

/// Positions of one block that are in one simplex.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Run {
    simplex: u32,
    /// Where its members end; they begin where the run before ends.
    end: u32,
}

/// All positions, in blocks.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grouping<const V: usize> {
    members: Vec<Member<V>>,
    runs: Vec<Run>,
    /// Of each block: where its runs end.
    blocks: Vec<u32>,
    /// What is not grouped yet: simplices and barycentric coordinates.
    open: Vec<(u32, [f32; V])>,
    /// Of each simplex: the block that saw it last, counted from 1, and its place among that block's simplices.
    seen: Vec<(u32, u8)>,
}

impl<const V: usize> Grouping<V> {
    pub(super) fn with_room(positions: usize) -> Self {
        Self {
            members: Vec::with_capacity(positions),
            runs: Vec::with_capacity(positions / 4),
            blocks: Vec::with_capacity(positions.div_ceil(BLOCK)),
            open: Vec::with_capacity(BLOCK),
            seen: Vec::new(),
        }
    }

    /// The next position.
    #[inline(always)]
    pub(super) fn push(&mut self, simplex: u32, weights: [f32; V]) {
        self.open.push((simplex, weights));
        if self.open.len() == BLOCK {
            self.group();
        }
    }

    /// There are no more positions.
    pub(super) fn close(&mut self) {
        if !self.open.is_empty() {
            self.group();
        }
        self.seen = Vec::new();
        self.open = Vec::new();
    }

    /// Sorts what is open by its simplices, in the order in which these appear, by counting.
    fn group(&mut self) {
        let first = self.members.len();
        let block = self.blocks.len() as u32 + 1;
        let mut places = [0u8; BLOCK];
        let mut ends = [0u32; BLOCK];
        let first_run = self.runs.len();
        for (place, (simplex, _)) in places.iter_mut().zip(&self.open) {
            let number = *simplex as usize;
            if self.seen.len() <= number {
                self.seen.resize(2 * number + 1, (0, 0));
            }
            let seen = &mut self.seen[number];
            if seen.0 != block {
                *seen = (block, (self.runs.len() - first_run) as u8);
                self.runs.push(Run {
                    simplex: *simplex,
                    end: 0,
                });
            }
            *place = seen.1;
            ends[usize::from(seen.1)] += 1;
        }
        let mut end = 0;
        for (run, count) in self.runs[first_run..].iter_mut().zip(&mut ends) {
            let begin = end;
            end += *count;
            run.end = first as u32 + end;
            *count = begin;
        }
        self.members.resize(first + self.open.len(), (0, [0.0; V]));
        let members = &mut self.members[first..];
        for (lane, (place, (_, weights))) in places.iter().zip(&self.open).enumerate() {
            let next = &mut ends[usize::from(*place)];
            members[*next as usize] = (lane as u8, *weights);
            *next += 1;
        }
        self.blocks.push(self.runs.len() as u32);
        self.open.clear();
    }

    /// Number of positions.
    pub(super) fn len(&self) -> usize {
        self.members.len()
    }

    /// The simplices of a block, each with its members.
    #[inline(always)]
    pub(super) fn block(&self, block: usize) -> impl Iterator<Item = (usize, &[Member<V>])> {
        let end = self.blocks.get(block).map_or(0, |end| *end as usize);
        let first = match block.checked_sub(1) {
            Some(before) => self.blocks.get(before).map_or(end, |end| *end as usize),
            None => 0,
        };
        let mut begin = match first.checked_sub(1) {
            Some(before) => self.runs[before].end as usize,
            None => 0,
        };
        self.runs[first..end].iter().map(move |run| {
            let members = &self.members[begin..run.end as usize];
            begin = run.end as usize;
            (run.simplex as usize, members)
        })
    }

    /// The simplices of all blocks, each with its members.
    #[inline(always)]
    pub(super) fn all_mut(&mut self) -> impl Iterator<Item = (usize, &mut [Member<V>])> {
        let mut rest = &mut self.members[..];
        let mut begin = 0;
        self.runs.iter().map(move |run| {
            let (members, after) =
                std::mem::take(&mut rest).split_at_mut((run.end - begin) as usize);
            rest = after;
            begin = run.end;
            (run.simplex as usize, members)
        })
    }

    /// The barycentric coordinates of all positions, in some order.
    #[cfg(test)]
    pub(super) fn weights(&self) -> impl Iterator<Item = &[f32; V]> {
        self.members.iter().map(|(_, weights)| weights)
    }
}
