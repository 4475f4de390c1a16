//! Cells of the ground plane as a raster: columns along x, rows along y, the southernmost first.

/// The least rectangle of cells around some.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Raster {
    /// The first column and the first row.
    pub first: [i64; 2],
    /// How many columns and rows.
    pub size: [i64; 2],
}

impl Raster {
    /// Around cells by column and row; `None` around nothing.
    pub fn around(cells: impl IntoIterator<Item = [i32; 2]>) -> Option<Self> {
        let cells = cells.into_iter().map(|cell| cell.map(i64::from));
        let (first, last) = cells.fold(None, |found: Option<([i64; 2], [i64; 2])>, cell| {
            let (first, last) = found.unwrap_or((cell, cell));
            let least = [0, 1].map(|k| first[k].min(cell[k]));
            Some((least, [0, 1].map(|k| last[k].max(cell[k]))))
        })?;
        let size = [0, 1].map(|k| last[k] - first[k] + 1);
        Some(Self { first, size })
    }

    /// How many cells it has.
    pub fn cells(&self) -> i64 {
        self.size[0].saturating_mul(self.size[1])
    }

    /// The place of one of its cells among all, row by row.
    pub fn place(&self, [column, row]: [i32; 2]) -> usize {
        let [column, row] = [
            i64::from(column) - self.first[0],
            i64::from(row) - self.first[1],
        ];
        (row * self.size[0] + column) as usize
    }

    /// The corner of the first cell, m: where x and y are least.
    pub fn corner(&self, cell_m: f64) -> [f64; 2] {
        self.first.map(|first| first as f64 * cell_m)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn it_reaches_from_the_least_cell_to_the_greatest() {
        let raster = Raster::around([[3, -1], [-2, 4], [0, 0]]).unwrap();
        assert_eq!((raster.size, raster.cells()), ([6, 6], 36));
        assert_eq!(raster.corner(0.5), [-1.0, -0.5]);
        assert_eq!(
            [[-2, -1], [3, -1], [-2, 0]].map(|cell| raster.place(cell)),
            [0, 5, 6]
        );
        assert_eq!(Raster::around([]), None);
        let all = Raster::around([[i32::MIN; 2], [i32::MAX; 2]]).unwrap();
        assert_eq!(all.cells(), i64::MAX);
    }
}
