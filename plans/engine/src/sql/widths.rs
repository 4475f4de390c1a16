//! Types whose values have a fixed length take it in each row, of null too: one of `CAST(NULL AS BIGINT[2000000000])` is
//! 16 GB. They are refused when a query is planned, before there is one.

use arrow::datatypes::DataType;
use datafusion::common::Result;
use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::logical_expr::expr::{Cast, ScalarFunction, TryCast};
use datafusion::logical_expr::{Expr, LogicalPlan};
use evermap_schemas::Fault;

use crate::error::external;
use crate::sql::bounded::{BYTES_PER_BATCH_ROW, SHARE};

/// Bytes of a value of a fixed length at most: of a batch of rows they take the part of the memory that an answer may take.
const MOST_BYTES: u64 = (BYTES_PER_BATCH_ROW / SHARE) as u64;

/// Functions whose second argument is the name of a type.
pub const CASTS: [&str; 2] = ["arrow_cast", "arrow_try_cast"];

/// What a value takes beside those within.
const POINTER_BYTES: u64 = 16;

/// Refuses a plan that makes values of too great a fixed length.
///
/// # Errors
/// A user fault with both numbers.
pub fn check_widths(plan: &LogicalPlan) -> Result<()> {
    plan.apply_with_subqueries(|node| node.apply_expressions(|expr| expr.apply(check_width)))?;
    Ok(())
}

/// As [`check_widths`], of one term.
///
/// # Errors
/// As [`check_widths`].
pub fn check_width(term: &Expr) -> Result<TreeNodeRecursion> {
    let found = match term {
        Expr::Cast(Cast { field, .. }) | Expr::TryCast(TryCast { field, .. }) => {
            width(field.data_type())
        }
        Expr::ScalarFunction(call) => named(call).map_or(0, |named| width(&named)),
        _ => 0,
    };
    if found <= MOST_BYTES {
        return Ok(TreeNodeRecursion::Continue);
    }
    let fault = Fault::user(format!(
        "expected a type whose values take at most {MOST_BYTES} bytes each, found one of {found}"
    ));
    Err(external(fault.next(
        "leave out the length: BIGINT[], or 'List(Int64)' in arrow_cast",
    )))
}

/// The type that a call names, if it is one that does.
fn named(call: &ScalarFunction) -> Option<DataType> {
    let [_, name] = call.args.as_slice() else {
        return None;
    };
    let is_cast = CASTS.contains(&call.func.name());
    let name = name.as_literal().filter(|_| is_cast)?;
    name.try_as_str()??.parse().ok()
}

/// Bytes that a value takes at least, with one value of each list within.
fn width(kind: &DataType) -> u64 {
    let several = |bytes: u64, count: i32| {
        // Arrow takes a length below zero for a huge one.
        u64::try_from(count).map_or(u64::MAX, |count| bytes.saturating_mul(count))
    };
    match kind {
        DataType::FixedSizeList(item, count) => several(width(item.data_type()), *count),
        DataType::FixedSizeBinary(count) => several(1, *count),
        DataType::Struct(members) => {
            let members = members.iter().map(|member| width(member.data_type()));
            members.fold(0, u64::saturating_add)
        }
        DataType::Union(members, _) => {
            let members = members.iter().map(|(_, member)| width(member.data_type()));
            members.fold(0, u64::saturating_add)
        }
        DataType::List(item)
        | DataType::LargeList(item)
        | DataType::ListView(item)
        | DataType::LargeListView(item)
        | DataType::Map(item, _)
        | DataType::RunEndEncoded(_, item) => width(item.data_type()).max(POINTER_BYTES),
        DataType::Dictionary(_, value) => width(value),
        kind => kind
            .primitive_width()
            .map_or(POINTER_BYTES, |bytes| bytes as u64),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, context, read_only};

    #[tokio::test]
    async fn types_of_a_great_fixed_length_are_refused_before_there_is_a_value() {
        let context = context(Limits::one_partition()).unwrap();
        for query in [
            "SELECT CAST(NULL AS BIGINT[2000000000])",
            "SELECT NULL::BIGINT[2000000000]",
            "SELECT TRY_CAST(NULL AS BIGINT[2000000000])",
            "SELECT CAST(NULL AS BIGINT[60000][60000])",
            "SELECT CAST([NULL] AS BIGINT[2000000000][])",
            "SELECT arrow_cast(NULL, 'FixedSizeList(2000000000 x Int64)')",
            "SELECT arrow_try_cast(NULL, 'FixedSizeList(2000000000 x Int64)')",
            "SELECT arrow_cast(NULL, 'FixedSizeBinary(2000000000)')",
            "SELECT 1 WHERE arrow_cast(NULL, 'FixedSizeBinary(2000000000)') IS NULL",
            "SELECT 1 WHERE 1 IN (SELECT 1 WHERE CAST(NULL AS BIGINT[2000000000]) IS NULL)",
            "SELECT * FROM (VALUES (CAST(NULL AS BIGINT[2000000000])))",
            "SELECT max(x) OVER (ORDER BY CAST(NULL AS BIGINT[2000000000])) FROM (VALUES (1)) t (x)",
            "SELECT * FROM generate_series(1, CAST(CAST(NULL AS BIGINT[2000000000]) IS NULL AS BIGINT))",
            "EXPLAIN SELECT CAST(NULL AS BIGINT[2000000000])",
        ] {
            let fault = read_only(&context, query).await.err().unwrap().to_string();
            let said = "expected a type whose values take at most 32768 bytes each";
            assert!(fault.contains(said), "{query}: {fault}");
        }
        for query in [
            "SELECT CAST([1, 2, 3] AS BIGINT[3]), CAST(NULL AS DOUBLE[36])",
            "SELECT arrow_cast([1, 2], 'FixedSizeList(2 x Float32)')",
            "SELECT CAST('2000000000' AS BIGINT)",
        ] {
            let frame = read_only(&context, query).await.unwrap();
            let rows = frame.collect().await.unwrap();
            assert_eq!(rows[0].num_rows(), 1, "{query}");
        }
    }
}
