//! The exact solve of a danger map of a million cells: `cargo run --release -p evermap-bench --example danger [COLUMNS ROWS]`.
//!
//! Every cell has a prior and a tie to its neighbours; two thirds were looked at. Prints the seconds for finding out which
//! cells are neighbours and in what order to eliminate them (once for a site), and for one solve.

#![allow(clippy::print_stdout)]

use std::time::Instant;

use evermap_algorithms::ground::danger::DangerField;
use evermap_algorithms::ground::danger::field::{LookCounts, Weights};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sizes = std::env::args().skip(1).map(|size| size.parse::<i32>());
    let columns = sizes.next().transpose()?.unwrap_or(1000);
    let rows = sizes.next().transpose()?.unwrap_or(1000);
    let cells = (0..columns).flat_map(|i| (0..rows).map(move |j| [i, j]));
    let began = Instant::now();
    let mut field = DangerField::new(cells.collect())?;
    let structured = began.elapsed();
    let count = field.cells().len();
    let priors = vec![0.001; count];
    let looked = |cell: usize| LookCounts {
        looks: if cell.is_multiple_of(3) { 0.0 } else { 40.0 },
        people: if cell % 97 == 1 { 2.0 } else { 0.0 },
    };
    let seen: Vec<LookCounts> = (0..count).map(looked).collect();
    let weights = Weights {
        prior_looks: 15.0,
        tie_looks: 15.0,
    };
    let began = Instant::now();
    let danger = field
        .solve(&priors, &seen, weights)
        .ok_or("the system has no solution")?;
    let solved = began.elapsed();
    let most = danger.iter().copied().fold(0.0, f64::max);
    println!(
        "{count} cells: structure {structured:.2?}, solve {solved:.2?}; largest probability {most:.4}"
    );
    Ok(())
}
