//! An expression from its text, and the expressions of a plan.

use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::{DFSchema, Result};
use datafusion::logical_expr::expr_rewriter::NamePreserver;
use datafusion::logical_expr::utils::merge_schema;
use datafusion::logical_expr::{Expr as Planned, LogicalPlan};
use datafusion::sql::sqlparser::ast::Expr;
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::parser::Parser;

/// The expression that a text is; `None` where it is none.
pub fn expression(text: &str) -> Option<Expr> {
    let parser = Parser::new(&PostgreSqlDialect {}).try_with_sql(text);
    parser.and_then(|mut parser| parser.parse_expr()).ok()
}

/// The plan with what is made of each of its expressions, those of queries within too, from the inmost out and under the
/// names that they had. What makes them is given the columns that they are of.
///
/// # Errors
/// What makes them says, and planning.
pub fn each_expression(
    plan: LogicalPlan,
    mut made: impl FnMut(Planned, &DFSchema) -> Result<Transformed<Planned>>,
) -> Result<LogicalPlan> {
    let made = plan.transform_up_with_subqueries(|node| {
        let schema = merge_schema(&node.inputs());
        let names = NamePreserver::new(&node);
        let node = node.map_expressions(|found| {
            let name = names.save(&found);
            let made = found.transform_up(|found| made(found, &schema))?;
            Ok(made.update_data(|made| name.restore(made)))
        })?;
        match node.transformed {
            true => node.map_data(LogicalPlan::recompute_schema),
            false => Ok(node),
        }
    });
    made.map(|made| made.data)
}
