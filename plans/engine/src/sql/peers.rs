//! Windows that go by structs, lists or bytes. Their frame is one of `RANGE` where a query says none, and DataFusion knows no
//! ranges of such values: it refuses structs and bytes, and ends in the middle of lists.
//!
//! A range up to the current row ends with the rows that are equal to it, and so does one of `GROUPS`, which goes by equality
//! alone.

use std::sync::Arc;

use arrow::datatypes::DataType;
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::Transformed;
use datafusion::common::{DFSchema, Result};
use datafusion::execution::FunctionRegistry;
use datafusion::logical_expr::expr::WindowFunction;
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::{Expr, ExprSchemable, WindowFrameBound, WindowFrameUnits};
use datafusion::prelude::SessionContext;
use evermap_schemas::{Fault, type_name};

use crate::error::external;

/// Has a context range over values of all types, as far as they are equal.
///
/// # Errors
/// When the context takes no rules.
pub fn range_by_peers(context: &SessionContext) -> Result<()> {
    let state = context.state_ref();
    let mut state = state.write();
    state.register_function_rewrite(Arc::new(Peers))
}

#[derive(Debug)]
struct Peers;

impl FunctionRewrite for Peers {
    fn name(&self) -> &str {
        "ranges_by_peers"
    }

    fn rewrite(
        &self,
        mut expr: Expr,
        schema: &DFSchema,
        _: &ConfigOptions,
    ) -> Result<Transformed<Expr>> {
        let is_other = match &mut expr {
            Expr::WindowFunction(call) => by_groups(call, schema)?,
            _ => false,
        };
        Ok(Transformed::new_transformed(expr, is_other))
    }
}

/// Whether a window's frame is one of groups now.
fn by_groups(call: &mut WindowFunction, schema: &DFSchema) -> Result<bool> {
    let frame = &mut call.params.window_frame;
    if frame.units != WindowFrameUnits::Range {
        return Ok(false);
    }
    let keys = call.params.order_by.iter();
    let kinds = keys.filter_map(|key| key.expr.get_type(schema).ok());
    let Some(kind) = kinds.into_iter().find(has_no_ranges) else {
        return Ok(false);
    };
    if [&frame.start_bound, &frame.end_bound]
        .into_iter()
        .any(is_distance)
    {
        let fault = format!(
            "expected numbers, times or intervals behind ORDER BY, as RANGE has a bound, found {}",
            type_name(&kind)
        );
        let next = "count rows, ROWS BETWEEN 1 PRECEDING AND CURRENT ROW, or go by a member, ORDER BY map_from_vehicle['x']";
        return Err(external(Fault::user(fault).next(next)));
    }
    frame.units = WindowFrameUnits::Groups;
    Ok(true)
}

fn has_no_ranges(kind: &DataType) -> bool {
    match kind {
        DataType::Dictionary(_, value) => has_no_ranges(value),
        kind => kind.is_nested() || kind.is_binary(),
    }
}

/// Whether a bound is so far from the current row's value.
fn is_distance(bound: &WindowFrameBound) -> bool {
    match bound {
        WindowFrameBound::Preceding(value) | WindowFrameBound::Following(value) => !value.is_null(),
        WindowFrameBound::CurrentRow => false,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use arrow::util::display::array_value_to_string;
    use evermap_schemas::Kind;

    use super::*;
    use crate::error::OrFault;
    use crate::sql::{Limits, context, read_only};

    async fn answer(partitions: usize, query: &str) -> Result<String, Fault> {
        let limits = Limits {
            partitions,
            ..Limits::default()
        };
        let frame = read_only(&context(limits)?, query).await?;
        let mut rows = Vec::new();
        for batch in frame.collect().await.or_fault()? {
            for row in 0..batch.num_rows() {
                let values = batch.columns().iter();
                let values = values.map(|column| array_value_to_string(column, row).unwrap());
                rows.push(values.collect::<Vec<_>>().join(" "));
            }
        }
        Ok(rows.join(", "))
    }

    #[tokio::test]
    async fn windows_go_by_structs_lists_and_bytes() {
        for key in [
            "named_struct('a', value / 2, 'b', 'x')",
            "named_struct('a', 0.0 * (value % 2 - 0.5), 'b', value / 2)",
            "make_array(value / 2)",
            "arrow_cast(CAST(value / 2 AS TEXT), 'Binary')",
            "named_struct('a', make_array(value / 2))",
        ] {
            for partitions in [1, 3] {
                for (window, expected) in [
                    (
                        "row_number() OVER w > 0, rank() OVER w, sum(1) OVER w",
                        "true 1 1, true 2 3, true 2 3, true 4 4",
                    ),
                    (
                        "sum(1) OVER (ORDER BY k RANGE BETWEEN CURRENT ROW AND UNBOUNDED FOLLOWING)",
                        "4, 3, 3, 1",
                    ),
                    (
                        "sum(1) OVER (PARTITION BY value % 2 ORDER BY k DESC, value)",
                        "2, 2, 1, 1",
                    ),
                    ("count(*) OVER (PARTITION BY k ORDER BY k)", "1, 2, 2, 1"),
                ] {
                    let query = format!(
                        "SELECT {window} FROM (SELECT value, {key} AS k FROM generate_series(1, 4)) WINDOW w AS (ORDER BY k) ORDER BY value"
                    );
                    assert_eq!(
                        answer(partitions, &query).await.unwrap(),
                        expected,
                        "{query}"
                    );
                }
            }
        }
    }

    #[tokio::test]
    async fn a_distance_from_a_struct_is_refused_with_what_may_be_written() {
        let query = "SELECT sum(1) OVER (ORDER BY named_struct('a', value) RANGE BETWEEN 1 PRECEDING AND CURRENT ROW) FROM generate_series(1, 4)";
        let fault = answer(1, query).await.unwrap_err();
        assert_eq!(fault.kind, Kind::User, "{fault}");
        assert!(fault.message.ends_with("found struct of a"), "{fault}");
        assert!(fault.next.contains("ROWS BETWEEN"), "{fault}");
    }
}
