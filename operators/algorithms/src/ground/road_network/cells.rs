//! A hash grid over points: near neighbours without looking at all pairs.

use std::collections::HashMap;

/// Points by grid cell; the cell is as wide as the radius that will be asked for.
pub(super) struct CellIndex {
    cell_m: f64,
    cells: HashMap<[i64; 3], Vec<u32>>,
}

impl CellIndex {
    pub(super) fn new(cell_m: f64) -> Self {
        Self {
            cell_m,
            cells: HashMap::new(),
        }
    }

    fn cell(&self, point: &[f64; 3]) -> [i64; 3] {
        point.map(|x| (x / self.cell_m).floor() as i64)
    }

    pub(super) fn insert(&mut self, id: u32, point: &[f64; 3]) {
        self.cells.entry(self.cell(point)).or_default().push(id);
    }

    /// Calls `visit` with every point that may lie within a cell's width, in no useful order.
    pub(super) fn near(&self, point: &[f64; 3], mut visit: impl FnMut(u32)) {
        let [x, y, z] = self.cell(point);
        let around = |at: i64| at.saturating_sub(1)..=at.saturating_add(1);
        for x in around(x) {
            for y in around(y) {
                for z in around(z) {
                    for &id in self.cells.get(&[x, y, z]).into_iter().flatten() {
                        visit(id);
                    }
                }
            }
        }
    }

    /// The nearest point, about within a cell's width, that counts by its id and distance; the smaller id on a tie.
    pub(super) fn nearest(
        &self,
        point: &[f64; 3],
        points: &[[f64; 3]],
        counts: impl Fn(u32, f64) -> bool,
    ) -> Option<u32> {
        let mut best: Option<(f64, u32)> = None;
        self.near(point, |id| {
            let candidate = (distance(point, &points[id as usize]), id);
            if best.is_none_or(|best| candidate < best) && counts(id, candidate.0) {
                best = Some(candidate);
            }
        });
        best.map(|(_, id)| id)
    }
}

/// Euclidean, metres.
pub(super) fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let [x, y, z] = [0, 1, 2].map(|k| a[k] - b[k]);
    (x * x + y * y + z * z).sqrt()
}

/// Mean position, in the order given.
pub(super) fn mean<'a>(points: impl ExactSizeIterator<Item = &'a [f64; 3]>) -> [f64; 3] {
    let count = points.len().max(1) as f64;
    let sum = points.fold([0.0; 3], |sum, p| {
        [sum[0] + p[0], sum[1] + p[1], sum[2] + p[2]]
    });
    sum.map(|x| x / count)
}
