//! What steps read of the tables that a plan gives them.

use std::collections::BTreeMap;

use datafusion::common::tree_node::TreeNodeRecursion;
use datafusion::logical_expr::LogicalPlan;
use evermap_contract::{Entry, Phase, Port, Reach};
use evermap_language::Input;

use crate::program::{Read, Role, Stage, Task};
use crate::sql::reference;

/// Whether an operator needs the whole table, as a side or for the site's only group.
pub fn is_whole(stage: &Stage, read: &Read) -> bool {
    let runs = matches!(
        &stage.task,
        Task::Op {
            phase: Phase::Run,
            ..
        }
    );
    matches!(read.role, Role::Side(_)) || runs && read.reach == Reach::Site
}

/// What a phase of an operator reads of the tables that a plan gives to its ports.
pub fn operator_reads(entry: &Entry, phase: Phase, inputs: &BTreeMap<String, Input>) -> Vec<Read> {
    let read = |port: &Port, role| {
        let columns = port.layer.columns.iter();
        Some(Read {
            table: inputs.get(port.name)?.clone(),
            role,
            reach: port.reach,
            columns: columns.map(|column| column.name.to_owned()).collect(),
            pixels: port.pixels.map(str::to_owned),
        })
    };
    let driving = read(&entry.driving(phase).port, Role::Driving);
    let sides = entry.sides(phase).iter();
    let sides = sides.map(|port| read(port, Role::Side(port.name.to_owned())));
    std::iter::once(driving).chain(sides).flatten().collect()
}

/// A table that a query names: what belongs to the unit, and whatever columns are used.
pub fn query_read(table: &Input) -> Read {
    Read {
        table: table.clone(),
        role: Role::Query,
        reach: Reach::Session,
        columns: Vec::new(),
        pixels: None,
    }
}

/// Whether a query, as it is planned, reads a table more than once: in a join with itself, a subquery, a table of `WITH`
/// that is named twice.
pub fn is_read_again(plan: &LogicalPlan, table: &Input) -> bool {
    let (name, mut scans) = (reference(table), 0);
    let walked = plan.apply_with_subqueries(|node| {
        let is_scan = matches!(node, LogicalPlan::TableScan(scan) if scan.table_name == name);
        scans += usize::from(is_scan);
        Ok(match scans {
            0 | 1 => TreeNodeRecursion::Continue,
            _ => TreeNodeRecursion::Stop,
        })
    });
    walked.is_err() || scans > 1
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::array::RecordBatch;
    use evermap_schemas::LayerRow;
    use evermap_schemas::layers::{Keyframe, VehiclePose};

    use super::*;
    use crate::sql::{Limits, context, planned, put_rows};

    #[tokio::test]
    async fn a_table_is_read_as_often_as_it_is_scanned_and_not_as_it_is_named() {
        let context = context(Limits::one_partition()).unwrap();
        let poses = Input::Step("poses".into());
        for (table, schema) in [
            (poses.clone(), VehiclePose::layer().schema()),
            (
                Input::Previous("poses".into()),
                VehiclePose::layer().schema(),
            ),
            (Input::Step("keyframes".into()), Keyframe::layer().schema()),
        ] {
            put_rows(&context, &table, RecordBatch::new_empty(schema)).unwrap();
        }
        for (query, is_again) in [
            ("SELECT stamp FROM poses", false),
            ("SELECT p.stamp FROM poses p JOIN keyframes k ON p.stamp = k.stamp", false),
            ("SELECT p.stamp FROM poses p JOIN previous.poses q ON p.stamp = q.stamp", false),
            ("WITH poses AS (SELECT stamp FROM keyframes) SELECT a.stamp FROM poses a, poses b", false),
            ("SELECT a.stamp FROM poses a JOIN poses b ON a.stamp = b.stamp", true),
            ("SELECT stamp FROM poses UNION ALL SELECT stamp FROM poses", true),
            ("WITH t AS (SELECT stamp FROM poses) SELECT a.stamp FROM t a, t b", true),
            ("SELECT stamp FROM poses WHERE stamp = (SELECT max(stamp) FROM poses)", true),
            ("SELECT stamp FROM keyframes WHERE stamp IN (SELECT stamp FROM poses)", false),
            (
                "SELECT stamp FROM keyframes k WHERE EXISTS (SELECT 1 FROM poses p WHERE p.stamp = k.stamp)
                     AND stamp IN (SELECT stamp FROM poses)",
                true,
            ),
            (
                "SELECT a.stamp FROM poses AS a ASOF JOIN poses AS b MATCH_CONDITION (a.stamp >= b.stamp)
                     ON a.session = b.session",
                true,
            ),
        ] {
            let frame = planned(&context, query).await.unwrap();
            assert_eq!(is_read_again(frame.logical_plan(), &poses), is_again, "{query}");
        }
    }
}
