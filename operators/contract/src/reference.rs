//! The naive engine: one thread, everything in memory, no optimisation. It is what unit tests and the laws run
//! operators on, and what the real engine is compared with.

use std::collections::BTreeMap;

use arrow::array::{RecordBatch, UInt32Array};
use arrow::compute::{SortColumn, concat_batches, lexsort_to_indices, take_record_batch};
use evermap_schemas::{Bytes, Fault, LayerRow, rows};
use serde_json::Value;

use crate::fold::StateRow;
use crate::kernel::runs_of_equal;
use crate::{Emit, Entry, FoldKernel, Grain, Kernel, Losses, Port, Sides};

/// How the naive engine cuts its input up; no operator's result may depend on it.
#[derive(Debug, Clone, Copy)]
pub struct Split {
    /// Rows per batch.
    pub batch_rows: usize,
    /// Partitions of a Map or a lift; rows are dealt out batch by batch.
    pub partitions: usize,
    /// Whether states are merged, and partitions run, last to first.
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

/// Runs an operator. Tables are by port; a port that is missing is empty.
///
/// # Errors
/// Whatever the kernel says.
pub fn run(
    entry: &Entry,
    params: &Value,
    inputs: &BTreeMap<String, RecordBatch>,
    split: Split,
) -> Result<Outcome, Fault> {
    let Some((driving, others)) = entry.ports.split_first() else {
        return Err(Fault::bug(format!("operator {} has no port", entry.name)));
    };
    let sides = sides(others, inputs)?;
    let input = ordered(inputs, driving)?;
    let mut losses = Losses::default();
    let mut collected = Vec::new();
    let mut collect = |batch: RecordBatch| {
        collected.push(batch);
        Ok(())
    };
    let mut emit = Emit::new(&mut collect, &mut losses);
    match entry.kernel(params)? {
        Kernel::Map(kernel) => {
            for part in partitions(&input, split) {
                let mapper = kernel.open(&sides)?;
                part.iter()
                    .try_for_each(|batch| mapper.map(batch, &mut emit))?;
            }
        }
        Kernel::Group(kernel) => {
            for group in groups(&input, &driving.grain)? {
                let mut worker = kernel.open(&sides.belonging(others, &group)?)?;
                batches(&group, split)
                    .iter()
                    .try_for_each(|batch| worker.push(batch, &mut emit))?;
                worker.close(&mut emit)?;
            }
        }
        Kernel::Fold(kernel) => run_fold(kernel.as_ref(), &sides, &input, split, &mut emit)?,
    }
    let rows = concat_batches(&entry.output.schema(), &collected).map_err(|error| {
        Fault::bug(format!(
            "operator {} emitted rows outside its layer {}: {error}",
            entry.name, entry.output.name
        ))
    })?;
    Ok(Outcome {
        rows: sort(&rows, entry.output.key)?,
        losses,
    })
}

fn run_fold(
    kernel: &dyn FoldKernel,
    sides: &Sides,
    input: &RecordBatch,
    split: Split,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let mut states: BTreeMap<(String, Bytes), Vec<Bytes>> = BTreeMap::new();
    for part in partitions(input, split) {
        let mut lifted = Vec::new();
        let mut losses = Losses::default();
        let mut collect = |batch: RecordBatch| {
            lifted.push(batch);
            Ok(())
        };
        let mut inner = Emit::new(&mut collect, &mut losses);
        let mut lifter = kernel.lifter(sides, usize::MAX);
        part.iter()
            .try_for_each(|batch| lifter.push(batch, &mut inner))?;
        lifter.close(&mut inner)?;
        losses
            .0
            .iter()
            .for_each(|(reason, count)| emit.skip(reason, *count));
        for batch in &lifted {
            for row in rows::<StateRow>(batch)? {
                states
                    .entry((row.site, row.key))
                    .or_default()
                    .push(row.state);
            }
        }
    }
    for ((site, key), state) in states {
        kernel.finish(&site, &key, kernel.merge(state)?, emit)?;
    }
    Ok(())
}

fn sides(ports: &[Port], inputs: &BTreeMap<String, RecordBatch>) -> Result<Sides, Fault> {
    let tables = ports
        .iter()
        .map(|port| Ok((port.name.to_owned(), vec![ordered(inputs, port)?])));
    Ok(Sides::new(tables.collect::<Result<_, Fault>>()?))
}

fn ordered(inputs: &BTreeMap<String, RecordBatch>, port: &Port) -> Result<RecordBatch, Fault> {
    match inputs.get(port.name) {
        None => Ok(RecordBatch::new_empty(crate::table::port_schema(
            &port.layer,
            port.pixels,
        ))),
        Some(batch) => sort(batch, &port.order()),
    }
}

fn groups(input: &RecordBatch, grain: &Grain) -> Result<Vec<RecordBatch>, Fault> {
    runs_of_equal(input, grain.group_columns())
}

fn batches(rows: &RecordBatch, split: Split) -> Vec<RecordBatch> {
    let step = split.batch_rows.max(1);
    (0..rows.num_rows())
        .step_by(step)
        .map(|at| rows.slice(at, step.min(rows.num_rows() - at)))
        .collect()
}

fn partitions(rows: &RecordBatch, split: Split) -> Vec<Vec<RecordBatch>> {
    let mut parts = vec![Vec::new(); split.partitions.max(1)];
    let count = parts.len();
    for (index, batch) in batches(rows, split).into_iter().enumerate() {
        parts[index % count].push(batch);
    }
    if split.reverse {
        parts.reverse();
    }
    parts
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
        values: std::sync::Arc::new(position),
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
