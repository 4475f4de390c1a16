//! What the nodes of a unit's plan did, as they tell when it has run.

use std::sync::Arc;
use std::time::Duration;

use datafusion::common::stats::Precision;
use datafusion::datasource::source::DataSourceExec;
use datafusion::physical_plan::ExecutionPlan;
use datafusion::physical_plan::metrics::{MetricValue, MetricsSet};
use datafusion::physical_plan::statistics::{StatisticsArgs, StatisticsContext};
use evermap_datasets::scan::scanned;
use evermap_schemas::record;
use serde::{Deserialize, Serialize};

use crate::nodes::light::is_filter;
use crate::nodes::operator::{DRIVING_ROWS, OperatorExec};
use crate::nodes::pixels::PixelsExec;

record! {
    /// What one node of a unit's plan did.
    #[derive(Serialize, Deserialize)]
    pub struct NodeWork {
        /// The kind of node, as `EXPLAIN` names it; `ParquetWriter` for the writing of the rows.
        node: String,
        /// The operator that it runs, the table that it scans, or the column whose images it fetches; null for others.
        of: Option<String>,
        /// Rows that came out.
        rows: u64,
        /// Bytes of logs or images that it read, or of Parquet that it wrote.
        bytes: u64 ["B"],
        /// How long it was at work, of all partitions together; without what it waited for.
        seconds: f64 ["s"],
    }
}

impl NodeWork {
    /// The writing of rows into a file of so many bytes.
    pub fn writing(rows: u64, bytes: u64, took: Duration) -> Self {
        Self {
            node: "ParquetWriter".to_owned(),
            of: None,
            rows,
            bytes,
            seconds: took.as_secs_f64(),
        }
    }

    fn of(plan: &dyn ExecutionPlan, metrics: &MetricsSet) -> Self {
        let count = |name| counted(metrics, name);
        let busy = metrics.elapsed_compute().unwrap_or(0) + count("prepare_time");
        Self {
            node: plan.name().to_owned(),
            of: subject(plan),
            rows: metrics.output_rows().unwrap_or(0) as u64,
            bytes: (count("bytes_scanned") + count("image_bytes")) as u64,
            seconds: Duration::from_nanos(busy as u64).as_secs_f64(),
        }
    }
}

/// What each node of a plan did that has run, those that read before those that are read.
pub fn of_plan(plan: &Arc<dyn ExecutionPlan>) -> Vec<NodeWork> {
    let own = plan.metrics();
    let own = own.map(|metrics| NodeWork::of(plan.as_ref(), &metrics));
    let below = plan.children().into_iter().flat_map(of_plan);
    own.into_iter().chain(below).collect()
}

/// Which share of its rows a plan is done with that runs, the least of all its operators; `None` where nobody knows how
/// many there are, or it is done with all and the work goes on.
pub fn share(plan: &Arc<dyn ExecutionPlan>) -> Option<f64> {
    let below = plan.children().into_iter().filter_map(share);
    let least = own_share(plan.as_ref()).into_iter().chain(below);
    least.min_by(f64::total_cmp).filter(|share| *share < 1.0)
}

fn own_share(plan: &dyn ExecutionPlan) -> Option<f64> {
    let operator = plan.downcast_ref::<OperatorExec>()?;
    let done = counted(&operator.metrics()?, DRIVING_ROWS);
    let rows = rows(operator.children.first()?.as_ref())?;
    (rows > 0).then(|| done as f64 / rows as f64)
}

/// How many rows come out of a plan, where that is known before.
fn rows(plan: &dyn ExecutionPlan) -> Option<usize> {
    let found = StatisticsContext::new().compute(plan, &StatisticsArgs::new());
    match (found.ok()?.num_rows, plan.children().as_slice()) {
        (Precision::Exact(rows), _) => Some(rows),
        // Fetches images, or deals rows out.
        (Precision::Absent, [only]) if !is_filter(plan) => rows(only.as_ref()),
        _ => None,
    }
}

fn counted(metrics: &MetricsSet, name: &str) -> usize {
    let sum = metrics.sum_by_name(name);
    sum.as_ref().map_or(0, MetricValue::as_usize)
}

/// What a node is about.
fn subject(plan: &dyn ExecutionPlan) -> Option<String> {
    if let Some(operator) = plan.downcast_ref::<OperatorExec>() {
        return Some(operator.duty.name().to_owned());
    }
    if let Some(pixels) = plan.downcast_ref::<PixelsExec>() {
        return Some(pixels.duty.column.to_owned());
    }
    scanned(plan.downcast_ref::<DataSourceExec>()?)
}
