//! Horizontal runs of equal class, and union-find over those that touch.

use super::VOID;
use crate::solving::parts;

/// Pixels of one row and one class.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    /// First column.
    pub(super) start: u16,
    /// The column after the last.
    pub(super) end: u16,
    /// The class; [`VOID`] for none.
    pub(super) class: u8,
}

impl Run {
    pub(super) fn len(self) -> u32 {
        u32::from(self.end - self.start)
    }
}

/// Two runs of different classes that touch, and the pairs of pixels that do.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joint {
    pub(super) runs: [u32; 2],
    pub(super) pairs: u32,
}

/// The runs of an image.
pub(super) struct Runs {
    runs: Vec<Run>,
    /// The first run of each row, and the number of runs.
    rows: Vec<u32>,
    /// Union-find, then the region of each run: numbered by first pixel.
    regions: Vec<u32>,
    /// Number of regions; 0 before [`Runs::connect`].
    number: u32,
}

impl Runs {
    /// Cuts rows into runs. Values from `classes` on are void.
    pub(super) fn new(values: &[u8], width: usize, classes: u8) -> Self {
        let mut runs = Vec::with_capacity(values.len() / 32);
        let mut rows = vec![0];
        for row in values.chunks_exact(width.max(1)) {
            let mut start = 0;
            while start < row.len() {
                let value = row[start];
                let end = start + run_length(&row[start..], value);
                runs.push(Run {
                    start: start as u16,
                    end: end as u16,
                    class: if value < classes { value } else { VOID },
                });
                start = end;
            }
            rows.push(runs.len() as u32);
        }
        let regions = (0..runs.len() as u32).collect();
        Self {
            runs,
            rows,
            regions,
            number: 0,
        }
    }

    /// Joins touching runs of one class into regions; returns what else touches.
    pub(super) fn connect(&mut self, wraps: bool) -> Vec<Joint> {
        let mut joints = Vec::with_capacity(self.runs.len() * 2);
        for row in 0..self.rows.len() - 1 {
            self.connect_row(row, wraps, &mut joints);
            if row > 0 {
                self.connect_rows(row - 1, &mut joints);
            }
        }
        self.number_regions();
        joints
    }

    fn row(&self, row: usize) -> std::ops::Range<u32> {
        self.rows[row]..self.rows[row + 1]
    }

    fn connect_row(&mut self, row: usize, wraps: bool, joints: &mut Vec<Joint>) {
        let range = self.row(row);
        for right in range.start + 1..range.end {
            self.join([right - 1, right], 1, joints);
        }
        if wraps && range.len() > 1 {
            self.join([range.start, range.end - 1], 1, joints);
        }
    }

    /// A row and the next.
    fn connect_rows(&mut self, above: usize, joints: &mut Vec<Joint>) {
        let (uppers, lowers) = (self.row(above), self.row(above + 1));
        let (mut upper, mut lower) = (uppers.start, lowers.start);
        while upper < uppers.end && lower < lowers.end {
            let (a, b) = (self.runs[upper as usize], self.runs[lower as usize]);
            let overlap = a.end.min(b.end) - a.start.max(b.start);
            self.join([upper, lower], u32::from(overlap), joints);
            upper += u32::from(a.end <= b.end);
            lower += u32::from(b.end <= a.end);
        }
    }

    fn join(&mut self, runs: [u32; 2], pairs: u32, joints: &mut Vec<Joint>) {
        let [a, b] = runs.map(|run| self.runs[run as usize].class);
        if a == VOID || b == VOID {
            return;
        }
        if a != b {
            joints.push(Joint { runs, pairs });
            return;
        }
        parts::join(&mut self.regions, runs);
    }

    /// A root is never after what hangs on it, so one pass in order numbers all.
    fn number_regions(&mut self) {
        for run in 0..self.runs.len() {
            let parent = self.regions[run] as usize;
            self.regions[run] = if parent == run {
                self.number += 1;
                self.number - 1
            } else {
                self.regions[parent]
            };
        }
    }

    /// The runs, row by row.
    pub(super) fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// The region of each run.
    pub(super) fn regions(&self) -> &[u32] {
        &self.regions
    }

    /// Number of regions.
    pub(super) fn number(&self) -> usize {
        self.number as usize
    }

    /// Rows: the indices of their runs.
    pub(super) fn rows(&self) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        let ends = self.rows.windows(2);
        ends.map(|pair| pair[0] as usize..pair[1] as usize)
    }
}

/// How many of the first values are equal to `value`, eight at a time.
fn run_length(row: &[u8], value: u8) -> usize {
    let pattern = u64::from_le_bytes([value; 8]);
    let mut length = 0;
    for chunk in row.chunks_exact(8) {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(chunk);
        let differs = u64::from_le_bytes(bytes) ^ pattern;
        if differs != 0 {
            return length + differs.trailing_zeros() as usize / 8;
        }
        length += 8;
    }
    let rest = row[length..].iter();
    length + rest.take_while(|other| **other == value).count()
}
