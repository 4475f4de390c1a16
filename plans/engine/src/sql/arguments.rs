//! Arguments of table functions. DataFusion computes them while it plans, and no rule has seen them by then:
//! `generate_series(1, 9223372036854775807 + 1)` would be a series to another number, and what fails would be no literal.
//! So they are computed here first, by the functions that the rest of a query gets, and what fails is said.

use std::ops::ControlFlow;
use std::sync::Arc;

use arrow::array::{RecordBatch, RecordBatchOptions};
use arrow::datatypes::Schema;
use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::TreeNode;
use datafusion::common::{DFSchema, Result, Span};
use datafusion::error::DataFusionError;
use datafusion::logical_expr::Expr;
use datafusion::logical_expr::execution_props::ExecutionProps;
use datafusion::logical_expr::expr_rewriter::FunctionRewrite;
use datafusion::logical_expr::physical_planning_context::PhysicalPlanningContext;
use datafusion::logical_expr::planner::{
    RelationPlanner, RelationPlannerContext, RelationPlanning,
};
use datafusion::logical_expr::simplify::SimplifyContext;
use datafusion::optimizer::simplify_expressions::ExprSimplifier;
use datafusion::physical_expr::create_physical_expr;
use datafusion::prelude::SessionContext;
use datafusion::sql::sqlparser::ast::{
    Expr as SqlExpr, FunctionArg, FunctionArgExpr, Query, Spanned, TableFactor, Visit, Visitor,
};

use crate::sql::overflow::CheckedOperators;
use crate::sql::statement_text::placed;
use crate::sql::widths::check_width;

/// Has a context refuse table functions whose arguments fail. Of its functions it takes those that stand in the place of
/// others by now.
///
/// # Errors
/// When the planner cannot be registered.
pub fn check_arguments(context: &SessionContext) -> Result<()> {
    let arguments = Arguments {
        functions: context.state().analyzer().function_rewrites().to_vec(),
    };
    context.register_relation_planner(Arc::new(arguments))
}

/// Looks at the arguments, and leaves the planning to others.
#[derive(Debug)]
struct Arguments {
    /// What is put in the place of functions.
    functions: Vec<Arc<dyn FunctionRewrite + Send + Sync>>,
}

impl RelationPlanner for Arguments {
    fn plan_relation(
        &self,
        relation: TableFactor,
        context: &mut dyn RelationPlannerContext,
    ) -> Result<RelationPlanning> {
        for written in given(&relation).iter().filter_map(value) {
            // A query is no constant, and would be planned twice.
            if written.visit(&mut Queries).is_break() {
                continue;
            }
            // What does not plan says so when it is planned.
            if let Ok(argument) = context.sql_to_expr(written.clone(), &DFSchema::empty()) {
                let options = context.context_provider().options();
                let checked = self.check(argument, options);
                let place = Span::try_from_sqlparser_span(written.span());
                checked.map_err(|error| placed(error, place))?;
            }
        }
        Ok(RelationPlanning::Original(Box::new(relation)))
    }
}

impl Arguments {
    /// Computes an argument, if it is a constant; says what fails.
    fn check(&self, argument: Expr, options: &ConfigOptions) -> Result<()> {
        if matches!(argument, Expr::Literal(..)) {
            return Ok(());
        }
        argument.apply(check_width)?;
        let schema = DFSchema::empty();
        let replaced = |argument: Expr, by: &dyn FunctionRewrite| {
            let replaced = argument.transform_up(|part| by.rewrite(part, &schema, options))?;
            Ok::<_, DataFusionError>(replaced.data)
        };
        let functions = self.functions.iter();
        let argument = functions
            .map(|by| &**by as &dyn FunctionRewrite)
            .try_fold(argument, replaced)?;
        let coercing = ExprSimplifier::new(SimplifyContext::default());
        let Ok(argument) = coercing.coerce(argument, &schema) else {
            return Ok(());
        };
        let argument = replaced(argument, &CheckedOperators)?;
        let mut props = ExecutionProps::new();
        props.config_options = Some(Arc::new(options.clone()));
        let planning = PhysicalPlanningContext::default();
        // It may have columns.
        let Ok(argument) = create_physical_expr(&argument, &schema, &props, &planning) else {
            return Ok(());
        };
        let one = RecordBatchOptions::new().with_row_count(Some(1));
        let one = RecordBatch::try_new_with_options(Arc::new(Schema::empty()), vec![], &one)?;
        match argument.evaluate(&one) {
            // Functions such as `now` are known to planning alone.
            Err(error) if !matches!(error.find_root(), DataFusionError::Internal(_)) => Err(error),
            _ => Ok(()),
        }
    }
}

/// What a table function is called with.
fn given(relation: &TableFactor) -> &[FunctionArg] {
    match relation {
        TableFactor::Table {
            args: Some(given), ..
        } => &given.args,
        TableFactor::Function { args, .. } => args,
        _ => &[],
    }
}

fn value(argument: &FunctionArg) -> Option<&SqlExpr> {
    match argument {
        FunctionArg::Unnamed(FunctionArgExpr::Expr(value))
        | FunctionArg::Named {
            arg: FunctionArgExpr::Expr(value),
            ..
        } => Some(value),
        _ => None,
    }
}

/// Ends where there is a query.
struct Queries;

impl Visitor for Queries {
    type Break = ();

    fn pre_visit_query(&mut self, _: &Query) -> ControlFlow<()> {
        ControlFlow::Break(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, context, read_only};

    #[tokio::test]
    async fn what_fails_in_an_argument_of_a_table_function_is_said_with_its_place() {
        let limits = Limits {
            memory_bytes: 1 << 20,
            ..Limits::one_partition()
        };
        let context = context(limits).unwrap();
        let nested = (0..6).fold("repeat('a', 60000)".to_owned(), |text, _| {
            format!("encode({text}, 'hex')")
        });
        let nested = format!("SELECT * FROM generate_series(1, length({nested}))");
        for (query, said) in [
            (
                "SELECT * FROM generate_series(1, 9223372036854775807 + 1)",
                "Arithmetic overflow: expected a sum that fits i64, found 9223372036854775807 + 1 (at line 1, column 34 of the query); compute with",
            ),
            (
                "SELECT * FROM generate_series(1, 9223372036854775807 + 1) AS g, (SELECT 1) AS h",
                "Arithmetic overflow",
            ),
            (
                "SELECT * FROM range(0, 4611686018427387904 * 2)",
                "Arithmetic overflow",
            ),
            (
                "SELECT * FROM range(-(-9223372036854775807 - 1), 0)",
                "verflow",
            ),
            (
                "SELECT * FROM (SELECT value FROM generate_series(1, 9223372036854775807 + 1)) AS t",
                "Arithmetic overflow",
            ),
            (
                "SELECT 1 WHERE 1 IN (SELECT value FROM generate_series(1, 9223372036854775807 + 1))",
                "Arithmetic overflow",
            ),
            (
                "SELECT * FROM generate_series(1, abs(-9223372036854775807) + 1)",
                "Arithmetic overflow",
            ),
            ("SELECT * FROM generate_series(1, 1 / 0)", "Divide by zero"),
            (
                "SELECT * FROM generate_series(1, length(repeat('a', 2000000000)))",
                "the limit is 131072",
            ),
            (nested.as_str(), "half of the memory"),
        ] {
            let fault = read_only(&context, query).await.err().unwrap().to_string();
            assert!(fault.contains(said), "{query}: {fault}");
        }
    }

    #[tokio::test]
    async fn arguments_that_can_be_computed_are_what_they_were() {
        let context = context(Limits::one_partition()).unwrap();
        for (query, rows) in [
            ("SELECT * FROM generate_series(1, 2 + 1)", 3),
            ("SELECT * FROM range(3)", 3),
            (
                "SELECT * FROM generate_series(9223372036854775806, 9223372036854775806 + 1)",
                2,
            ),
            (
                "SELECT * FROM generate_series(1, CAST(length('a' || 'b') AS BIGINT))",
                2,
            ),
            ("SELECT * FROM generate_series(1, 5, -1 + 2)", 5),
            ("SELECT * FROM generate_series(1, NULL)", 0),
            (
                "SELECT * FROM generate_series(TIMESTAMP '2026-01-01', TIMESTAMP '2026-01-01' + INTERVAL '1 day', INTERVAL '12 hours')",
                3,
            ),
        ] {
            let frame = read_only(&context, query).await.unwrap();
            let found = frame.collect().await.unwrap();
            let found: usize = found.iter().map(|batch| batch.num_rows()).sum();
            assert_eq!(found, rows, "{query}");
        }
    }
}
