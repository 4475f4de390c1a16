//! Operators on input made by hand, on simulated floors, on real drives, and on nonsense.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr
)]

mod bodies;
mod classes;
mod danger;
mod floor;
mod gradients;
mod indexes;
mod keyframes;
mod labels;
mod metric_map;
mod mosaic;
mod panoramas;
mod parameters;
mod people;
mod pixels;
mod recorded_labels;
mod roads;
mod views;
mod words;

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_contract::Losses;
use evermap_contract::laws::{Split, run};
use evermap_schemas::{Record, rows};
use serde_json::Value;

/// Runs an operator on the naive engine.
fn yields<T: Record>(
    operator: &str,
    params: Value,
    inputs: impl IntoIterator<Item = (String, RecordBatch)>,
) -> (Vec<T>, Losses) {
    let registry = evermap_catalog::registry();
    let inputs: BTreeMap<_, _> = inputs.into_iter().collect();
    let entry = registry.get(operator).unwrap();
    let outcome = run(entry, &params, &inputs, Split::default()).unwrap();
    (rows(&outcome.rows).unwrap(), outcome.losses)
}
