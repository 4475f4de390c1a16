//! Queries of steps, planned.

use std::sync::Arc;

use arrow::datatypes::{DataType, IntervalUnit, Schema};
use datafusion::common::tree_node::Transformed;
use datafusion::datasource::{MemTable, TableType, provider_as_source};
use datafusion::error::{DataFusionError, Result as DataFusionResult};
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::{DataFrame, SessionContext};
use evermap_language::{Location, PlanFaults, QueryPosition, Step};

use crate::error::{fault_of, place_in_query};
use crate::sql;

/// The query of a step and where it begins.
#[derive(Debug, Clone, Copy)]
pub struct Query<'q> {
    /// Name of the step.
    pub step: &'q str,
    /// Its text.
    pub text: &'q str,
    /// Its location.
    pub location: Location,
}

impl<'q> Query<'q> {
    /// The query that a step is.
    pub fn of(step: &'q Step, text: &'q str) -> Self {
        Self {
            step: &step.name,
            text,
            location: step.body_location,
        }
    }

    /// The query planned; what is wrong with it is recorded.
    pub async fn planned(
        self,
        context: &SessionContext,
        faults: &mut PlanFaults,
    ) -> Option<DataFrame> {
        let frame = match sql::planned(context, self.text).await {
            Ok(frame) => frame,
            Err(error) => {
                self.does_not_plan(context, &error, faults);
                return None;
            }
        };
        let plan = frame.logical_plan();
        let repeated = sql::repeated_columns(plan);
        let volatile = sql::volatile_functions(plan);
        let open = sql::OpenValues::of(plan);
        if let Some(first) = repeated.first() {
            let names = repeated.join(", ");
            let what = format!("gives two columns the name {names}; name one with AS");
            self.fault(QueryPosition::Word(first), &what, faults);
        } else if let Some(first) = volatile.first() {
            let names = volatile.join(", ");
            let what = format!(
                "calls {names}, whose answer changes from run to run; order by columns, and take instants from the rows"
            );
            self.fault(QueryPosition::Word(first), &what, faults);
        } else if let Some(open) = open {
            let what = format!("has {open}; {}", sql::OpenValues::NEXT);
            self.fault(QueryPosition::Word(open.first()), &what, faults);
        } else if let Err(error) = planned_whole(context, plan).await {
            self.does_not_plan(context, &error, faults);
        } else {
            return Some(frame);
        }
        None
    }

    /// Records columns that no artifact can hold.
    pub fn check_stored(self, schema: &Schema, faults: &mut PlanFaults) {
        for field in schema.fields() {
            if let Some((kind, next)) = unstorable(field.data_type()) {
                let name = field.name();
                let what = format!("gives {name} as {kind}, which Parquet cannot hold; {next}");
                self.fault(QueryPosition::Word(name), &what, faults);
            }
        }
    }

    fn does_not_plan(
        self,
        context: &SessionContext,
        error: &DataFusionError,
        faults: &mut PlanFaults,
    ) {
        let fault = sql::explained(context, fault_of(error));
        let next = match fault.next.as_str() {
            "" => String::new(),
            next => format!("; {next}"),
        };
        let (line, column) = place_in_query(error).unwrap_or((1, 1));
        let what = format!("does not plan: {}{next}", fault.message);
        self.fault(QueryPosition::At(line, column), &what, faults);
    }

    fn fault(self, part: QueryPosition<'_>, what: &str, faults: &mut PlanFaults) {
        let location = faults.inside(self.location, self.text, part);
        faults.error(location, format!("the query of `{}` {what}", self.step));
    }
}

/// That a query is planned to the end. Much is refused only there, for reasons of the query alone: so its tables are empty,
/// as what is wrong with a log is told by who reads it.
async fn planned_whole(context: &SessionContext, plan: &LogicalPlan) -> DataFusionResult<()> {
    let plan = plan.clone().transform_down_with_subqueries(|node| {
        let LogicalPlan::TableScan(mut scan) = node else {
            return Ok(Transformed::no(node));
        };
        // The rows so far of a recursive query.
        if scan.source.table_type() == TableType::Temporary {
            return Ok(Transformed::no(LogicalPlan::TableScan(scan)));
        }
        let empty = MemTable::try_new(scan.source.schema(), vec![Vec::new()])?;
        scan.source = provider_as_source(Arc::new(empty));
        Ok(Transformed::yes(LogicalPlan::TableScan(scan)))
    })?;
    let state = context.state();
    state.create_physical_plan(&plan.data).await.map(drop)
}

/// What a type has in it that Parquet cannot hold, and what to write instead.
fn unstorable(kind: &DataType) -> Option<(&'static str, &'static str)> {
    match kind {
        DataType::Interval(IntervalUnit::MonthDayNano) => Some((
            "an interval",
            "take a number of it, such as its seconds by extract(epoch FROM …)",
        )),
        DataType::Union(..) => Some(("a union", "give one type to all of its values")),
        DataType::Struct(members) if members.is_empty() => {
            Some(("a struct without members", "leave it out"))
        }
        DataType::Struct(members) => {
            let mut members = members.iter();
            members.find_map(|member| unstorable(member.data_type()))
        }
        DataType::List(item)
        | DataType::LargeList(item)
        | DataType::ListView(item)
        | DataType::LargeListView(item)
        | DataType::FixedSizeList(item, _)
        | DataType::Map(item, _)
        | DataType::RunEndEncoded(_, item) => unstorable(item.data_type()),
        DataType::Dictionary(_, values) => unstorable(values),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::sql::{Limits, context};

    /// Whether Parquet holds a column of a query, by its own word.
    fn is_written(rows: &arrow::array::RecordBatch) -> bool {
        let writer = parquet::arrow::ArrowWriter::try_new(Vec::new(), rows.schema(), None);
        let mut writer = writer.unwrap();
        writer.write(rows).and_then(|()| writer.close()).is_ok()
    }

    #[tokio::test]
    async fn what_parquet_cannot_hold_is_what_its_writer_refuses() {
        let context = context(Limits::one_partition()).unwrap();
        for (column, is_refused) in [
            ("INTERVAL '1 month'", true),
            ("make_array(INTERVAL '1 month')", true),
            ("named_struct('a', make_array(INTERVAL '1 day'))", true),
            ("TIMESTAMP '2020-01-02' - TIMESTAMP '2020-01-01'", false),
            ("NULL", false),
            ("arrow_cast(1, 'Decimal256(50, 3)')", false),
            ("arrow_cast('a', 'Dictionary(Int32, Utf8)')", false),
            ("make_array(named_struct('a', 1))", false),
            ("map(make_array('a'), make_array(1))", false),
        ] {
            let rows = sql::read_only(&context, &format!("SELECT {column} AS x")).await;
            let rows = rows.unwrap().collect().await.unwrap();
            let kind = rows[0].schema().field(0).data_type().clone();
            assert_eq!(unstorable(&kind).is_some(), is_refused, "{column}");
            assert_eq!(is_written(&rows[0]), !is_refused, "{column}");
        }
    }

    #[tokio::test]
    async fn what_is_refused_when_a_query_is_planned_to_the_end_is_found() {
        let context = context(Limits::one_partition()).unwrap();
        let counting = "WITH RECURSIVE n AS (SELECT 1 AS i UNION ALL SELECT i + 1 FROM n WHERE i < 3) SELECT i FROM n";
        let around = "SELECT b FROM (VALUES (1)) t(a), LATERAL (SELECT t.a AS b LIMIT 1) u";
        for (query, plans) in [
            (counting, true),
            ("SELECT a FROM (VALUES (1)) t(a) ORDER BY a", true),
            ("SELECT value FROM generate_series(1, 3)", true),
            (around, false),
        ] {
            let frame = sql::planned(&context, query).await.unwrap();
            let whole = planned_whole(&context, frame.logical_plan()).await;
            assert_eq!(whole.is_ok(), plans, "{query}: {whole:?}");
        }
    }
}
