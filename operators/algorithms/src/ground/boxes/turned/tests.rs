//! What is kept of rows and summed up beside what it is by definition.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::ground::boxes::headings::Headings;
use crate::ground::boxes::overhead::{DIRECTIONS, NOT_SEEN, STEP};
use crate::solving::random::SplitMix64;

const COLUMNS: usize = 70;
const ROWS: usize = 50;
const CELL_M: f64 = 0.05;
const EVERYWHERE: [[f64; 2]; 2] = [[-1e9; 2], [1e9; 2]];

/// Gradients at random, of which a corner was not seen.
fn gradients(random: &mut SplitMix64) -> Gradients {
    let mut cell = |at: usize| {
        let is_seen = at % COLUMNS > 30 || at / COLUMNS > 20;
        let cell = [0, 1].map(|_| (255.0 * random.unit()) as u8);
        if is_seen { cell } else { NOT_SEEN }
    };
    let cells = (0..COLUMNS * ROWS).map(&mut cell).collect();
    Gradients::new(CELL_M, COLUMNS, [-7.0, 3.0], cells)
}

/// What is seen in a window about a place: how many samples, and the mean of their histograms.
fn window(turned: &Turned<'_>, [column, row]: [isize; 2], sides_m: [f64; 2]) -> (u32, [f64; BINS]) {
    let radius = sides_m.map(|side| turned.radius(side) as isize);
    let (mut seen, mut bins) = (0, [0.0; BINS]);
    let share = 1.0 / ((2 * radius[0] + 1) * (2 * radius[1] + 1)) as f64;
    for row in row - radius[1]..=row + radius[1] {
        for column in column - radius[0]..=column + radius[0] {
            // Beyond the first row and column there is nothing of the image.
            let at = [column, row].map(|at| usize::try_from(at).unwrap_or(100_000));
            let number = turned.gradients.number(turned.centre()(at[0], at[1]));
            let Some([steps, direction]) = turned.gradients.seen(number) else {
                continue;
            };
            seen += 1;
            let turn = f64::from(direction) / DIRECTIONS as f64;
            let turn = (turn - turned.heading as f64 / HEADINGS as f64).rem_euclid(1.0);
            let place = turn * BINS as f64 + 1e-9;
            let strength = share * f64::from(steps) * f64::from(STEP);
            bins[place as usize % BINS] += strength * (1.0 - place.fract());
            bins[(place as usize + 1) % BINS] += strength * place.fract();
        }
    }
    (seen, bins)
}

/// The score of a box about a place, without the constant; `None` where too little was seen.
fn score(turned: &Turned<'_>, weights: &[f64], [column, row]: [usize; 2]) -> Option<f64> {
    let reach = reach_m(&turned.middle);
    let place = [column, row].map(|at| at as isize);
    let (seen, _) = window(turned, place, reach);
    let all = reach.map(|side| 2 * turned.radius(side) + 1);
    if f64::from(seen) < LEAST_SEEN * (all[0] * all[1]) as f64 {
        return None;
    }
    let (mut sum, mut total) = (0.0, 0.0);
    for (cell, weights) in weights[..LENGTH - 1].chunks(BINS).enumerate() {
        let from_middle = |at: usize, count: usize, reach: f64| {
            let parts = (at as f64 + 0.5) / count as f64 - 0.5;
            (parts * reach / turned.step_m).round() as isize
        };
        let at = [
            place[0] + from_middle(cell / ACROSS, ALONG, reach[0]),
            place[1] + from_middle(cell % ACROSS, ACROSS, reach[1]),
        ];
        let sides = [reach[0] / ALONG as f64, reach[1] / ACROSS as f64];
        let (_, bins) = window(turned, at, sides);
        total += bins.iter().sum::<f64>();
        let products = bins.iter().zip(weights);
        sum += products
            .map(|(bin, weight)| bin.sqrt() * weight)
            .sum::<f64>();
    }
    Some(sum / f64::from(norm(total as f32)))
}

#[test]
fn places_are_scored_by_what_their_cells_show() {
    let mut random = SplitMix64(3);
    let gradients = gradients(&mut random);
    let weights: Vec<f64> = (0..LENGTH).map(|_| random.unit() - 0.5).collect();
    let mut turned_round = weights.clone();
    let cells = weights[..LENGTH - 1].chunks(BINS).rev().flatten();
    turned_round.splice(..LENGTH - 1, cells.copied());
    let searched = Searched::new(&gradients, EVERYWHERE, &Headings::learn(&[], &[]));
    let (mut scored, mut left_out) = (0, 0);
    for (heading, size_m) in [
        (0, [1.2, 0.5]),
        (5, [1.3, 0.6]),
        (12, [0.9, 0.5]),
        (21, [1.0, 0.7]),
    ] {
        let turned = Turned::new(&gradients, &searched, size_m, heading).unwrap();
        let columns: Vec<usize> = (20..turned.columns - 20).step_by(STRIDE).collect();
        let rows: Vec<usize> = (14..turned.rows - 14).step_by(STRIDE).collect();
        let found = turned.scores(&weights, &columns, &rows);
        let places = rows
            .iter()
            .flat_map(|row| columns.iter().map(|column| [*column, *row]));
        for (at, place) in places.enumerate() {
            for (found, weights) in found.iter().zip([&weights, &turned_round]) {
                match score(&turned, weights, place) {
                    Some(expected) => {
                        let off = (f64::from(found[at]) - expected).abs();
                        assert!(off < 1e-5, "{heading}, {place:?}: off by {off}");
                        scored += 1;
                    }
                    None => {
                        assert_eq!(found[at], f32::NEG_INFINITY);
                        left_out += 1;
                    }
                }
            }
        }
    }
    assert!(scored > 500 && left_out > 100, "{scored} {left_out}");
}
