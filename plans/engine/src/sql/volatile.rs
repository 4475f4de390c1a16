//! What keeps rows from following from what a plan reads alone: what changes something, functions that answer differently
//! from call to call, and values that nobody gives.

use std::collections::BTreeSet;
use std::fmt;

use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::error::{DataFusionError, Result as DataFusionResult};
use datafusion::execution::context::SQLOptions;
use datafusion::logical_expr::{Expr, LogicalPlan, Volatility};
use evermap_schemas::Fault;

/// Refuses what would change a table, a file or a setting.
///
/// # Errors
/// What DataFusion says of it.
pub fn only_reads(plan: &LogicalPlan) -> DataFusionResult<()> {
    let allowed = SQLOptions::new()
        .with_allow_ddl(false)
        .with_allow_dml(false)
        .with_allow_statements(false);
    allowed.verify_plan(plan)
}

/// Names of the functions in a query that give other rows when it is asked again: `random`, `uuid`, `now` …
pub fn volatile_functions(plan: &LogicalPlan) -> Vec<String> {
    found_in(plan, volatile)
}

/// The values that a query leaves open, as it writes them: `$1`, `:x`. There is one at least.
pub struct OpenValues(Vec<String>);

impl OpenValues {
    /// What to do about them.
    pub const NEXT: &str = "write the value itself";

    /// Those of a query; `None` where it has none.
    pub fn of(plan: &LogicalPlan) -> Option<Self> {
        let found = found_in(plan, |expr| match expr {
            Expr::Placeholder(open) => Some(open.id.clone()),
            _ => None,
        });
        (!found.is_empty()).then_some(Self(found))
    }

    /// Refuses a query that has some, where nobody gives them.
    ///
    /// # Errors
    /// A user fault that names them.
    pub fn refuse(plan: &LogicalPlan) -> Result<(), Fault> {
        Self::of(plan).map_or(Ok(()), |open| {
            Err(Fault::user(format!("expected values, found {open}")).next(Self::NEXT))
        })
    }

    /// The first of them.
    pub fn first(&self) -> &str {
        self.0.first().map_or("", String::as_str)
    }
}

impl fmt::Display for OpenValues {
    /// `$1, $2, which nobody gives a value`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, which nobody gives a value", self.0.join(", "))
    }
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
    use crate::sql::{Limits, context, read_only};

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
            let found = OpenValues::of(&plan).map_or_else(Vec::new, |open| open.0);
            assert_eq!(found, expected, "{query}");
        }
    }

    #[tokio::test]
    async fn a_query_with_values_that_nobody_gives_is_refused() {
        let context = context(Limits::default()).unwrap();
        let query = "SELECT a FROM (VALUES (1)) t(a) WHERE a > $1 AND a < $2";
        let fault = read_only(&context, query).await.err().unwrap();
        let said = "user: expected values, found $1, $2, which nobody gives a value; write the value itself";
        assert_eq!(fault.to_string(), said);
        assert!(read_only(&context, "SELECT '$1' AS a").await.is_ok());
    }
}
