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
    /// 1 where it is nearly as fast as most of the map, to the darkest shade for the slowest.
    pub shade: u32,
}

impl SlowCell {
    /// Cells of a speed map, without those that are as fast as half of it; the slowest has the densest shade.
    pub fn of(cells: &[SpeedCell]) -> Vec<Self> {
        let slower = |cell: &SpeedCell| (cell.max_mps - cell.speed_mps) / cell.max_mps;
        let mut sorted: Vec<f64> = cells.iter().map(slower).collect();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted.get(cells.len().saturating_sub(1) / 2);
        let (Some(usual), Some(most)) = (usual, sorted.last()) else {
            return Vec::new();
        };
        let shown = cells.iter().filter_map(|cell| {
            let shade = ((slower(cell) - usual) / (most - usual) * f64::from(SHADES)).round();
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
    fn the_slowest_is_densest_and_what_is_as_fast_as_half_of_it_is_not_shown() {
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
        let usual = [3, 4, 5, 6].map(|column| cell(column, 2.9));
        let some = [cell(0, 1.0), cell(1, 2.0), cell(2, 2.95)];
        assert_eq!(shades(&[&some[..], &usual].concat()), [5, 2]);
        assert_eq!(shades(&[cell(0, 3.0)]), [] as [u32; 0]);
    }
}
