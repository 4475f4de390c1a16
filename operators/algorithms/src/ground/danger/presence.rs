//! In how many looks somebody was in a cell.
//!
//! A person is found in several images of one look, and not exactly in one cell. So in each look a cell is given the
//! probability that at least one of those found was there, as if they erred independently; over looks these
//! probabilities add up.

use std::collections::BTreeMap;

use crate::ground::cells::{Cell, between, middle};

/// A person found in one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoundPerson {
    /// When, ns.
    pub stamp: i64,
    /// Where the feet are in the map, m.
    pub position: [f64; 2],
    /// Variance of x, covariance of x and y, variance of y, m².
    pub covariance: [f64; 3],
    /// How probably it is a person.
    pub probability: f64,
}

/// Standard deviations within which a person may be.
const REACH: f64 = 3.0;

/// The farthest that a person may be from where they were found, m: beyond it a position says nothing.
const FARTHEST_M: f64 = 5.0;

/// Number of the look that an instant belongs to; looks are `look_ns` long, counted from 0.
pub fn look(stamp: i64, look_ns: i64) -> i64 {
    stamp.div_euclid(look_ns.max(1))
}

/// How those found in one session share out to cells, and the number of those that make no sense.
pub fn presence(found: &[FoundPerson], cell_m: f64, look_ns: i64) -> (BTreeMap<Cell, f64>, u64) {
    let mut absent: BTreeMap<(i64, Cell), f64> = BTreeMap::new();
    let mut senseless = 0;
    for person in found {
        let Some(shares) = shares(person, cell_m) else {
            senseless += 1;
            continue;
        };
        let look = look(person.stamp, look_ns);
        for (cell, share) in shares {
            *absent.entry((look, cell)).or_insert(1.0) *= 1.0 - person.probability * share;
        }
    }
    let mut people = BTreeMap::new();
    for ((_, cell), absent) in absent {
        *people.entry(cell).or_default() += 1.0 - absent;
    }
    (people, senseless)
}

/// The probability of each cell that the person is in it, by the density at the cell's middle; they add up to 1.
fn shares(person: &FoundPerson, cell_m: f64) -> Option<Vec<(Cell, f64)>> {
    // A place within a cell is uniform on it.
    let within = cell_m * cell_m / 12.0;
    let [xx, xy, yy] = person.covariance;
    let (xx, yy) = (xx + within, yy + within);
    let determinant = xx * yy - xy * xy;
    let sound = xx >= within && yy >= within && determinant > 0.0 && determinant.is_finite();
    if !sound || !(0.0..=1.0).contains(&person.probability) {
        return None;
    }
    let [x, y] = person.position;
    let [reach_x, reach_y] = [xx, yy].map(|v| (REACH * v.sqrt()).min(FARTHEST_M));
    let low = [x - reach_x, y - reach_y];
    let [columns, rows] = between(low, [x + reach_x, y + reach_y], cell_m)?;
    let mut shares = Vec::new();
    for column in columns {
        for row in rows.clone() {
            let [cx, cy] = middle([column, row], cell_m);
            let (dx, dy) = (cx - x, cy - y);
            let squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
            shares.push(([column, row], (-0.5 * squared).exp()));
        }
    }
    let all: f64 = shares.iter().map(|(_, share)| share).sum();
    (all > 0.0).then(|| {
        let share = |(cell, share)| (cell, share / all);
        shares.into_iter().map(share).collect()
    })
}
