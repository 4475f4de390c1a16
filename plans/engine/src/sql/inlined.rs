//! How large the expressions of a plan become where planning puts a column's own expression in its place, as it does to
//! filter early: thirty tables of `x + x AS x`, one upon the other, are a thousand million terms.

use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::common::{DFSchema, Result};
use datafusion::logical_expr::{Expr, LogicalPlan};
use evermap_schemas::Fault;

use crate::error::external;

/// Terms at most that a column stands for.
const MOST_TERMS: u64 = 1_000_000;

/// Refuses a plan one of whose columns stands for too large an expression.
///
/// # Errors
/// A user fault with both numbers.
pub fn check_inlined(plan: &LogicalPlan) -> Result<()> {
    terms(plan).map(drop)
}

/// For how many terms each column of a plan stands.
fn terms(plan: &LogicalPlan) -> Result<Vec<u64>> {
    let inputs = plan.inputs().into_iter().map(terms);
    let inputs: Vec<Vec<u64>> = inputs.collect::<Result<_>>()?;
    let columns = plan.schema().fields().len();
    let found = match (plan, inputs.as_slice()) {
        (LogicalPlan::Projection(projection), [input]) => {
            let schema = projection.input.schema();
            let each = projection.expr.iter();
            each.map(|expr| terms_of(expr, schema, input))
                .collect::<Result<_>>()?
        }
        // What aggregates give is computed once.
        (LogicalPlan::Aggregate(_) | LogicalPlan::Unnest(_), _) => vec![1; columns],
        (LogicalPlan::Union(_), [first, others @ ..]) => {
            let most = |at: usize| {
                let others = others.iter().filter_map(|other| other.get(at));
                others.chain(first.get(at)).copied().max().unwrap_or(1)
            };
            (0..columns).map(most).collect()
        }
        // Columns of the inputs come first, side by side, or some of them alone.
        _ => {
            let all = inputs.iter().flatten().copied();
            all.chain(std::iter::repeat(1)).take(columns).collect()
        }
    };
    let most = found.iter().copied().max().unwrap_or(0);
    if most > MOST_TERMS {
        return Err(external(
            Fault::user(format!(
                "expected columns that stand for at most {MOST_TERMS} terms, found one of {most}"
            ))
            .next("make a table of what is used often, as a step of a plan"),
        ));
    }
    Ok(found)
}

/// The terms of an expression, with those of its columns.
fn terms_of(expr: &Expr, schema: &DFSchema, input: &[u64]) -> Result<u64> {
    let mut terms = 0_u64;
    expr.apply(|part| {
        let own = match part {
            Expr::Column(column) => {
                let at = schema.maybe_index_of_column(column);
                at.and_then(|at| input.get(at)).copied().unwrap_or(1)
            }
            _ => 1,
        };
        terms = terms.saturating_add(own);
        Ok(TreeNodeRecursion::Continue)
    })?;
    Ok(terms)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, context, read_only};

    fn doubled(times: usize) -> String {
        let tables = (1..=times).map(|n| format!("c{n} AS (SELECT x + x AS x FROM c{})", n - 1));
        let tables: Vec<String> = tables.collect();
        format!(
            "WITH c0 AS (SELECT value AS x FROM generate_series(1, 3)), {} SELECT * FROM c{times} WHERE x > 5",
            tables.join(", ")
        )
    }

    #[tokio::test]
    async fn columns_that_stand_for_a_million_terms_are_refused() {
        let context = context(Limits::one_partition()).unwrap();
        let fault = read_only(&context, &doubled(30)).await.err().unwrap();
        assert!(
            fault
                .to_string()
                .contains("stand for at most 1000000 terms"),
            "{fault}"
        );
        let few = read_only(&context, &doubled(5)).await.unwrap();
        let rows = few.collect().await.unwrap();
        assert_eq!(rows.iter().map(|batch| batch.num_rows()).sum::<usize>(), 3);
    }
}
