//! Where to drive slowly: cells of the ground, the denser the slower.

use crate::shown::SpeedCell;

/// Shades that are told apart.
pub const SHADES: u32 = 5;

/// A cell of the ground to be driven over more slowly than others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlowCell {
    /// Its south-western corner, m.
    pub corner: [f64; 2],
    /// Its side, m.
    pub side_m: f64,
    /// 1 where it is nearly as fast as anywhere, to the darkest shade for the slowest of the map.
    pub shade: u32,
}

impl SlowCell {
    /// Cells of a speed map, without those that are as fast as anywhere; the slowest has the densest shade.
    pub fn of(cells: &[SpeedCell]) -> Vec<Self> {
        let slower = |cell: &SpeedCell| (cell.max_mps - cell.speed_mps) / cell.max_mps;
        let most = cells.iter().map(slower).fold(0.0, f64::max);
        let shown = cells.iter().filter_map(|cell| {
            let shade = (slower(cell) / most * f64::from(SHADES)).round();
            (shade >= 1.0).then(|| Self {
                corner: [cell.column, cell.row].map(|at| f64::from(at) * cell.cell_m),
                side_m: cell.cell_m,
                shade: shade as u32,
            })
        });
        shown.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slowest_is_densest_and_what_is_as_fast_as_anywhere_is_not_shown() {
        let cell = |column: i32, speed_mps: f64| SpeedCell {
            site: "lot".into(),
            column,
            row: -1,
            cell_m: 0.5,
            speed_mps,
            max_mps: 3.0,
        };
        let shades = |cells: &[SpeedCell]| -> Vec<u32> {
            SlowCell::of(cells).iter().map(|cell| cell.shade).collect()
        };
        let found = SlowCell::of(&[cell(0, 3.0), cell(2, 1.0)]);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].corner, found[0].shade), ([1.0, -0.5], SHADES));
        assert_eq!(shades(&[cell(0, 1.0), cell(1, 2.0), cell(2, 2.95)]), [5, 3]);
        assert_eq!(shades(&[cell(0, 3.0)]), [] as [u32; 0]);
    }
}
