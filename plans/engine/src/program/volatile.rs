//! What keeps rows from following from what a plan reads alone: functions that answer differently from call to call, and
//! values that nobody gives.

use std::collections::BTreeSet;

use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::{Expr, LogicalPlan, Volatility};

/// Names of the functions in a query that give other rows when it is asked again: `random`, `uuid`, `now` …
pub fn volatile_functions(plan: &LogicalPlan) -> Vec<String> {
    found_in(plan, volatile)
}

/// The values that a query leaves open, as it writes them: `$1`, `:x`.
pub fn placeholders(plan: &LogicalPlan) -> Vec<String> {
    found_in(plan, |expr| match expr {
        Expr::Placeholder(open) => Some(open.id.clone()),
        _ => None,
    })
}

/// What is found in the expressions of a query, each once.
fn found_in(plan: &LogicalPlan, find: fn(&Expr) -> Option<String>) -> Vec<String> {
    let mut names = BTreeSet::new();
    // Neither closure fails.
    let _ = plan.apply_with_subqueries(|node| {
        node.apply_expressions(|expr| {
            expr.apply(|expr| {
                names.extend(find(expr));
                Ok::<_, DataFusionError>(TreeNodeRecursion::Continue)
            })
        })
    });
    names.into_iter().collect()
}

fn volatile(expr: &Expr) -> Option<String> {
    let Expr::ScalarFunction(call) = expr else {
        return None;
    };
    let fixed = call.func.signature().volatility == Volatility::Immutable;
    (!fixed).then(|| call.func.name().to_owned())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::sql::{Limits, context};

    #[tokio::test]
    async fn volatile_functions_are_found_wherever_they_stand() {
        let context = context(Limits::default()).unwrap();
        let cases = [
            ("SELECT 1 AS a ORDER BY random()", vec!["random"]),
            (
                "SELECT 1 AS a WHERE now() > TIMESTAMP '2020-01-01'",
                vec!["now"],
            ),
            (
                "SELECT (SELECT max(uuid()) FROM (VALUES (1))) AS a",
                vec!["uuid"],
            ),
            (
                "SELECT coalesce(a, random()), current_date FROM (VALUES (1.0)) t(a)",
                vec!["current_date", "random"],
            ),
            (
                "SELECT abs(a), to_timestamp(1), sum(a) OVER () FROM (VALUES (1)) t(a)",
                vec![],
            ),
        ];
        for (query, expected) in cases {
            let plan = context.sql(query).await.unwrap().into_unoptimized_plan();
            assert_eq!(volatile_functions(&plan), expected, "{query}");
        }
    }

    #[tokio::test]
    async fn values_that_are_left_open_are_found_wherever_they_stand() {
        let context = context(Limits::default()).unwrap();
        let cases = [
            ("SELECT a FROM (VALUES (1)) t(a) WHERE a > $1", vec!["$1"]),
            ("SELECT a FROM (VALUES (1)) t(a) LIMIT $2", vec!["$2"]),
            (
                "SELECT (SELECT max(a) FROM (VALUES (1)) t(a) WHERE a < $x) AS b",
                vec!["$x"],
            ),
            ("SELECT '$1' AS a", vec![]),
        ];
        for (query, expected) in cases {
            let plan = context.sql(query).await.unwrap().into_unoptimized_plan();
            assert_eq!(placeholders(&plan), expected, "{query}");
        }
    }
}
