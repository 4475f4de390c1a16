//! Groups of values that are compared.

use std::sync::Arc;

use datafusion::common::tree_node::{Transformed, TreeNode, TreeNodeRecursion};
use datafusion::common::{Column, DFSchema, Result};
use datafusion::logical_expr::expr::Case;
use datafusion::logical_expr::utils::grouping_set_to_exprlist;
use datafusion::logical_expr::{Aggregate, Expr, ExprSchemable, LogicalPlan, Projection};

use crate::sql::compared::plain::{Keys, compare};
use crate::sql::lengths::{WHOLE, shortest};

/// Groups go by columns that are made below them, and show above them what they would: intervals of a group the first of them
/// by their parts, as one with months is none of days to whom it is added. Says if columns may be null that might not.
pub fn of_groups(total: Aggregate, are_wider: &mut bool) -> Result<LogicalPlan> {
    let schema = Arc::clone(total.input.schema());
    let mut keys = Keys::beside(&schema);
    let mut shown: Vec<(Expr, Expr)> = Vec::new();
    let terms = total.group_expr.iter().cloned().map(|term| {
        let found =
            term.transform_down(|part| Ok(by_column(part, &schema, &mut keys, &mut shown)))?;
        Ok(found.data)
    });
    let terms = terms.collect::<Result<Vec<_>>>()?;
    if keys.is_empty() {
        return Ok(LogicalPlan::Aggregate(total));
    }
    *are_wider |= !shown.is_empty();
    let mut told = total.aggr_expr;
    let names = (0..shown.len()).map(|at| format!("__shown_{at}"));
    let names: Vec<String> = names.collect();
    let values = shown.iter().zip(&names);
    told.extend(values.map(|((_, value), name)| shortest(value.clone()).alias(name)));
    let groups = Aggregate::try_new(keys.added(total.input)?, terms, told)?;
    let terms = grouping_set_to_exprlist(&groups.group_expr)?;
    let columns = total.schema.iter().enumerate().map(|(at, (table, field))| {
        let column = Expr::Column(Column::from(groups.schema.qualified_field(at)));
        let found = terms.get(at);
        let place = found.and_then(|term| shown.iter().position(|(key, _)| key == *term));
        let column = match place.and_then(|place| names.get(place)) {
            Some(name) => if_there(column, Expr::Column(Column::new_unqualified(name))),
            None => column,
        };
        column.alias_qualified(table.cloned(), field.name())
    });
    let columns = columns.collect();
    let groups = Arc::new(LogicalPlan::Aggregate(groups));
    Ok(LogicalPlan::Projection(Projection::try_new(
        columns, groups,
    )?))
}

/// A term of groups, or of sets of them, as a column if it is compared; of intervals, noted with what is shown in its place.
fn by_column(
    term: Expr,
    schema: &DFSchema,
    keys: &mut Keys,
    shown: &mut Vec<(Expr, Expr)>,
) -> Transformed<Expr> {
    if matches!(term, Expr::GroupingSet(_)) {
        return Transformed::no(term);
    }
    let mut key = term.clone();
    if !compare(&mut key, schema) {
        return Transformed::new(term, false, TreeNodeRecursion::Jump);
    }
    let column = keys.column(key);
    let is_interval = term.get_type(schema).is_ok_and(|kind| kind == WHOLE);
    if is_interval && !shown.iter().any(|(known, _)| *known == column) {
        shown.push((column.clone(), term));
    }
    Transformed::new(column, true, TreeNodeRecursion::Jump)
}

/// What is shown for a key, which is null where a set of groups does not have it.
fn if_there(key: Expr, shown: Expr) -> Expr {
    let when = vec![(Box::new(key.is_not_null()), Box::new(shown))];
    Expr::Case(Case::new(None, when, None))
}
