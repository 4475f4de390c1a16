//! The naive engine: one thread, everything in memory, no optimisation. It is what unit tests and the laws run
//! operators on, and what the real engine is compared with.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::{RecordBatch, UInt32Array};
use arrow::compute::{SortColumn, concat_batches, lexsort_to_indices, take_record_batch};
use evermap_schemas::{Fault, LayerRow};
use serde_json::Value;

use crate::row_store::{InMemory, catalogue};
use crate::sides::runs_of_equal;
use crate::table::with_pixels;
use crate::{Emit, Entry, Job, Losses, Phase, Port, Shape, Sides};

/// How the naive engine cuts its input up; no operator's result may depend on it.
#[derive(Debug, Clone, Copy)]
pub struct Split {
    /// Rows per batch.
    pub batch_rows: usize,
    /// Partitions; rows are dealt out batch by batch, or group by group.
    pub partitions: usize,
    /// Whether partitions run last to first.
    pub reverse: bool,
}

impl Default for Split {
    fn default() -> Self {
        Self {
            batch_rows: usize::MAX,
            partitions: 1,
            reverse: false,
        }
    }
}

/// An operator's output, in the order of its layer's key, and what it skipped.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The rows.
    pub rows: RecordBatch,
    /// What was left out.
    pub losses: Losses,
}

/// Runs an operator. Tables are by port; a port that is missing is empty. Where a port asks for pixels, its image column
/// may hold encoded images in place of references.
///
/// # Errors
/// Whatever the kernel says.
pub fn run(
    entry: &Entry,
    params: &Value,
    inputs: &BTreeMap<String, RecordBatch>,
    split: Split,
) -> Result<Outcome, Fault> {
    let mut losses = Losses::default();
    let mut rows = |phase, inputs| work(entry, params, phase, inputs, split, &mut losses);
    let rows = match entry.shape {
        Shape::Map | Shape::Group(_) => rows(Phase::Run, inputs)?,
        Shape::Fold => {
            let states = BTreeMap::from([("states".to_owned(), rows(Phase::Lift, inputs)?)]);
            rows(Phase::Merge, &states)?
        }
    };
    Ok(Outcome {
        rows: sort(&rows, entry.output.key)?,
        losses,
    })
}

fn work(
    entry: &Entry,
    params: &Value,
    phase: Phase,
    inputs: &BTreeMap<String, RecordBatch>,
    split: Split,
    losses: &mut Losses,
) -> Result<RecordBatch, Fault> {
    let driving = entry.driving(phase);
    let table = |port: &Port, order: &[&str]| {
        let rows = match inputs.get(port.name) {
            Some(rows) => rows.clone(),
            None => RecordBatch::new_empty(port.layer.schema()),
        };
        sort(&with_pixels(&rows, port.pixels)?, order)
    };
    let mut sides = Sides::default();
    for port in entry.sides(phase) {
        let rows = table(port, &port.sorting())?;
        if port.fetched {
            let held = vec![catalogue(&rows, 0)?];
            sides.store(port.name, held, Arc::new(InMemory::new(vec![rows])));
        } else {
            sides.add(port.name, vec![rows]);
        }
    }
    let input = table(&driving.port, &driving.sorting)?;
    let mut emitted = Vec::new();
    let mut collect = |batch: RecordBatch| {
        emitted.push(batch);
        Ok(())
    };
    let mut emit = Emit::new(&mut collect, losses);
    let job = Job::new(entry, params, phase, sides)?;
    for part in partitions(&input, driving.group, split)? {
        let mut worker = job.worker();
        part.iter()
            .try_for_each(|batch| worker.push(batch, &mut emit))?;
        worker.close(&mut emit)?;
    }
    let yields = entry.yields(phase);
    concat_batches(&yields.schema(), &emitted).map_err(|error| {
        Fault::bug(format!(
            "operator {} emitted rows outside its layer {}: {error}",
            entry.name, yields.name
        ))
    })
}

/// The rows dealt out to partitions: batch by batch where any split will do, else group by group.
fn partitions(
    rows: &RecordBatch,
    group: &[&str],
    split: Split,
) -> Result<Vec<Vec<RecordBatch>>, Fault> {
    let mut parts = vec![Vec::new(); split.partitions.max(1)];
    let count = parts.len();
    if group.is_empty() {
        for (index, batch) in batches(rows, split).into_iter().enumerate() {
            parts[index % count].push(batch);
        }
    } else {
        for (index, group) in runs_of_equal(rows, group)?.iter().enumerate() {
            parts[index % count].extend(batches(group, split));
        }
    }
    if split.reverse {
        parts.reverse();
    }
    Ok(parts)
}

fn batches(rows: &RecordBatch, split: Split) -> Vec<RecordBatch> {
    let step = split.batch_rows.max(1);
    (0..rows.num_rows())
        .step_by(step)
        .map(|at| rows.slice(at, step.min(rows.num_rows() - at)))
        .collect()
}

/// The rows ordered by the named columns; rows that tie keep their order.
///
/// # Errors
/// When a column cannot be ordered.
pub fn sort(rows: &RecordBatch, columns: &[&str]) -> Result<RecordBatch, Fault> {
    let mut keys: Vec<SortColumn> = columns
        .iter()
        .filter_map(|name| rows.column_by_name(name))
        .map(|values| SortColumn {
            values: values.clone(),
            options: None,
        })
        .collect();
    if keys.is_empty() {
        return Ok(rows.clone());
    }
    let position = UInt32Array::from_iter_values(0..rows.num_rows() as u32);
    keys.push(SortColumn {
        values: Arc::new(position),
        options: None,
    });
    Ok(take_record_batch(rows, &lexsort_to_indices(&keys, None)?)?)
}

/// A typed row's table, for tests that build their input in Rust.
///
/// # Errors
/// As [`evermap_schemas::batch`].
pub fn inputs_of<T: LayerRow>(port: &str, rows: Vec<T>) -> Result<(String, RecordBatch), Fault> {
    Ok((port.to_owned(), evermap_schemas::batch(rows)?))
}
