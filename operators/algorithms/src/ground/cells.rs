//! Square cells of the ground, by column and row.

use std::ops::RangeInclusive;

use crate::ground::segment::nearest_share;

/// Column and row: cell (i, j) covers `[i, i + 1) * cell_m` along x and `[j, j + 1) * cell_m` along y.
pub type Cell = [i32; 2];

/// Cells of one area at most: what a person draws by mistake must not fill the memory.
pub const MOST_CELLS: usize = 1 << 22;

/// The cell that a place is in; `None` where cells cannot be counted.
pub fn cell_of([x, y]: [f64; 2], cell_m: f64) -> Option<Cell> {
    let number = |metres: f64| {
        let number = (metres / cell_m).floor();
        (number.abs() < f64::from(i32::MAX)).then_some(number as i32)
    };
    Some([number(x)?, number(y)?])
}

/// The middle of a cell, m.
pub fn middle(cell: Cell, cell_m: f64) -> [f64; 2] {
    cell.map(|number| (f64::from(number) + 0.5) * cell_m)
}

/// Neighbours along columns and rows, each pair once, as indices; `cells` are in ascending order.
pub fn neighbours(cells: &[Cell]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::with_capacity(2 * cells.len());
    for (index, [column, row]) in cells.iter().enumerate() {
        for next in [[*column, row + 1], [column + 1, *row]] {
            if let Ok(other) = cells.binary_search(&next) {
                pairs.push((index, other));
            }
        }
    }
    pairs
}

/// Cells between two corners; `None` where there are more than [`MOST_CELLS`].
pub fn between(low: [f64; 2], high: [f64; 2], cell_m: f64) -> Option<[RangeInclusive<i32>; 2]> {
    let (low, high) = (cell_of(low, cell_m)?, cell_of(high, cell_m)?);
    let count = |k: usize| (i64::from(high[k]) - i64::from(low[k]) + 1).max(0) as usize;
    let few = count(0).checked_mul(count(1))? <= MOST_CELLS;
    few.then(|| [low[0]..=high[0], low[1]..=high[1]])
}

/// Cells whose middles lie in a polygon; `None` for a polygon that is too large or not finite.
pub fn in_polygon(corners: &[[f64; 2]], cell_m: f64) -> Option<Vec<Cell>> {
    let [columns, rows] = around(corners, 0.0, cell_m)?;
    let mut found = Vec::new();
    for column in columns {
        for row in rows.clone() {
            if inside(corners, middle([column, row], cell_m)) {
                found.push([column, row]);
            }
        }
    }
    Some(found)
}

/// Cells whose middles are at most `reach_m` from a line, each once, in order; `None` for a line that is too long or not
/// finite.
pub fn along(points: &[[f64; 2]], reach_m: f64, cell_m: f64) -> Option<Vec<Cell>> {
    let mut found = Vec::new();
    for ends in points.windows(2) {
        let [columns, rows] = around(ends, reach_m, cell_m)?;
        for column in columns {
            for row in rows.clone() {
                if distance(middle([column, row], cell_m), [ends[0], ends[1]]) <= reach_m {
                    found.push([column, row]);
                }
            }
        }
        if found.len() > MOST_CELLS {
            return None;
        }
    }
    found.sort_unstable();
    found.dedup();
    Some(found)
}

fn around(points: &[[f64; 2]], reach_m: f64, cell_m: f64) -> Option<[RangeInclusive<i32>; 2]> {
    let finite = points.iter().flatten().all(|value| value.is_finite());
    if !finite || points.is_empty() {
        return None;
    }
    let bound = |k: usize, least: fn(f64, f64) -> f64, start: f64| {
        points
            .iter()
            .fold(start, |bound, point| least(bound, point[k]))
    };
    let low = [0, 1].map(|k| bound(k, f64::min, f64::INFINITY) - reach_m);
    let high = [0, 1].map(|k| bound(k, f64::max, f64::NEG_INFINITY) + reach_m);
    between(low, high, cell_m)
}

/// Whether a ray to the right crosses the outline an odd number of times.
fn inside(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let ends = corners.iter().zip(corners.iter().cycle().skip(1));
    let crossed = ends.filter(|([ax, ay], [bx, by])| {
        (*ay > y) != (*by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
    });
    crossed.count() % 2 == 1
}

/// From a place to a piece of a line.
fn distance([x, y]: [f64; 2], ends: [[f64; 2]; 2]) -> f64 {
    let along = nearest_share([x, y], ends);
    let [[ax, ay], [bx, by]] = ends;
    (x - ax - along * (bx - ax)).hypot(y - ay - along * (by - ay))
}
