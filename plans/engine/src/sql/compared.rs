//! Values that are equal and have other bits: -0.0 and 0.0, NaN with a sign, as `0.0 / 0.0` has it, and NaN without, a day and
//! 24 hours. DataFusion compares them by their bits: in operators and lists, by `CASE`, in groups and joins, where each is
//! counted once, and where rows are sorted.
//!
//! Behind type coercion a function is put around them that makes equal ones the same. What they are compared for has them as
//! they are.

mod grouped;
mod plain;
mod rows;
mod windows;

use std::sync::Arc;

use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::{Column, DFSchema, JoinConstraint, Result, ScalarValue};
use datafusion::logical_expr::expr::{
    Between, BinaryExpr, Case, InList, InSubquery, ScalarFunction, Sort,
};
use datafusion::logical_expr::expr_rewriter::NamePreserver;
use datafusion::logical_expr::utils::merge_schema;
use datafusion::logical_expr::{
    Aggregate, Distinct, Expr, ExprSchemable, Join, LogicalPlan, Projection,
};
use datafusion::optimizer::AnalyzerRule;
use datafusion::prelude::SessionContext;

use crate::sql::compared::grouped::of_groups;
use crate::sql::compared::plain::{compare_all, has_twins, innermost, number};
use crate::sql::compared::rows::of_rows;
use crate::sql::compared::windows::of_window;
use crate::sql::lengths::WHOLE;
use crate::sql::literals::is_comparison;

pub use self::plain::compare;

/// Functions that compare their arguments, or items of them, by bits, and tell whether or where they are.
const FINDING: [&str; 5] = [
    "array_has",
    "array_has_all",
    "array_has_any",
    "array_position",
    "array_positions",
];

/// Functions that do so, and give what is left of them.
const LEAVING: [&str; 4] = [
    "nullif",
    "array_remove",
    "array_remove_n",
    "array_remove_all",
];

/// Has a context compare values as they are equal.
pub fn compare_values(context: &SessionContext) {
    context.add_analyzer_rule(Arc::new(ComparedValues));
}

#[derive(Debug)]
struct ComparedValues;

impl AnalyzerRule for ComparedValues {
    fn name(&self) -> &str {
        "compared_values"
    }

    fn analyze(&self, plan: LogicalPlan, _: &ConfigOptions) -> Result<LogicalPlan> {
        let mut are_wider = false;
        let found = plan.transform_up_with_subqueries(|node| {
            let node = match are_wider {
                true => node.recompute_schema()?,
                false => node,
            };
            of_node(node, &mut are_wider)
        })?;
        Ok(found.data)
    }
}

/// A node that compares values; says if columns of it may be null that might not.
fn of_node(plan: LogicalPlan, are_wider: &mut bool) -> Result<Transformed<LogicalPlan>> {
    let schema = merge_schema(&plan.inputs());
    let names = NamePreserver::new(&plan);
    let plan = plan.map_expressions(|expr| {
        let name = names.save(&expr);
        let found = expr.transform_up(|part| within(part, &schema))?;
        Ok(found.update_data(|expr| name.restore(expr)))
    })?;
    Ok(match plan.data {
        LogicalPlan::Sort(mut sort) => {
            sorted(&mut sort.expr, &schema);
            Transformed::yes(LogicalPlan::Sort(sort))
        }
        // What rows are told apart by leads the order, as it stands.
        LogicalPlan::Distinct(Distinct::On(mut distinct)) => {
            compare_all(&mut distinct.on_expr, &schema);
            sorted(
                distinct.sort_expr.as_deref_mut().unwrap_or_default(),
                &schema,
            );
            Transformed::yes(LogicalPlan::Distinct(Distinct::On(distinct)))
        }
        LogicalPlan::Distinct(Distinct::All(input))
            if schema.fields().iter().any(|f| has_twins(f.data_type())) =>
        {
            let columns = input.schema().iter();
            let columns = columns.map(|field| Expr::Column(Column::from(field)));
            let columns = columns.collect();
            let total = Aggregate::try_new(input, columns, Vec::new())?;
            Transformed::yes(of_groups(total, are_wider)?)
        }
        LogicalPlan::Aggregate(total) => Transformed::yes(of_groups(total, are_wider)?),
        LogicalPlan::Join(join) => Transformed::yes(LogicalPlan::Join(of_join(join))),
        LogicalPlan::Window(window) => Transformed::yes(of_window(window)?),
        data => Transformed::new(data, plan.transformed, plan.tnr),
    })
}

/// Keys of a join that are no columns are none that USING names.
fn of_join(mut join: Join) -> Join {
    let mut is_changed = false;
    for (left, right) in &mut join.on {
        let left = compare(left, join.left.schema());
        is_changed |= compare(right, join.right.schema()) || left;
    }
    if is_changed {
        join.join_constraint = JoinConstraint::On;
    }
    join
}

/// A term whose own parts are compared.
fn within(mut term: Expr, schema: &DFSchema) -> Result<Transformed<Expr>> {
    let is_changed = match &mut term {
        Expr::BinaryExpr(BinaryExpr { left, op, right }) if is_comparison(*op) => {
            operands(vec![left.as_mut(), right.as_mut()], schema)
        }
        Expr::Between(Between {
            expr, low, high, ..
        }) => operands(vec![expr.as_mut(), low.as_mut(), high.as_mut()], schema),
        Expr::InList(InList { expr, list, .. }) if !list.iter().all(is_plain) => {
            let is_changed = compare_all(list, schema);
            compare(expr, schema) || is_changed
        }
        Expr::InSubquery(found) => in_rows(found, schema)?,
        Expr::Case(Case {
            expr: Some(expr),
            when_then_expr,
            ..
        }) => {
            let whens = when_then_expr.iter_mut().map(|(when, _)| when.as_mut());
            let is_changed = compare_all(whens, schema);
            compare(expr, schema) || is_changed
        }
        Expr::ScalarFunction(call) => match function(call, schema) {
            Some(other) => {
                term = other;
                true
            }
            None => false,
        },
        Expr::AggregateFunction(call) => {
            let is_distinct = call.params.distinct;
            let args = is_distinct && compare_all(&mut call.params.args, schema);
            // A percentile's order is that of its argument.
            let is_sorted = is_distinct || !call.func.supports_within_group_clause();
            is_sorted && sorted(&mut call.params.order_by, schema) || args
        }
        Expr::WindowFunction(call) => {
            let params = &mut call.params;
            params.distinct && compare_all(&mut params.args, schema)
        }
        _ => false,
    };
    Ok(match is_changed {
        true => Transformed::yes(term),
        false => Transformed::no(term),
    })
}

/// What stands on both sides of an operator. That has numbers that are written right, and files are left out by them; and an
/// aggregate's subquery knows rows of the query around it by columns as they are.
fn operands(values: Vec<&mut Expr>, schema: &DFSchema) -> bool {
    let is_written = |value: &Expr| number(value).is_some_and(|it| !it.is_some_and(f64::is_nan));
    let written = values.iter().filter(|value| is_written(value)).count();
    let is_interval = |value: &Expr| value.get_type(schema).is_ok_and(|kind| kind == WHOLE);
    let mut all = values.iter();
    if written + 1 >= values.len() || all.any(|value| value.contains_outer() && !is_interval(value))
    {
        return false;
    }
    compare_all(values, schema)
}

/// What a call is that compares its arguments, where it is another one.
fn function(call: &mut ScalarFunction, schema: &DFSchema) -> Option<Expr> {
    let name = call.func.name();
    let (is_nullif, is_leaving) = (name == "nullif", LEAVING.contains(&name));
    if !is_leaving && !FINDING.contains(&name) {
        return of_rows(call, schema);
    }
    let kind = call.args.first()?.get_type(schema).ok()?;
    // Intervals that are left are as they were: a month is added to an instant as no 30 days are.
    if is_leaving && *innermost(&kind) == WHOLE {
        let is_told = is_nullif && kind == WHOLE;
        return is_told.then(|| unless_equal(call, schema)).flatten();
    }
    let is_changed = compare_all(&mut call.args, schema);
    is_changed.then(|| Expr::ScalarFunction(call.clone()))
}

/// `nullif` of intervals, which gives the first one as it is.
fn unless_equal(call: &ScalarFunction, schema: &DFSchema) -> Option<Expr> {
    let [first, second] = call.args.as_slice() else {
        return None;
    };
    let (mut left, mut right) = (first.clone(), second.clone());
    compare_all([&mut left, &mut right], schema);
    let nothing = Expr::Literal(ScalarValue::IntervalMonthDayNano(None), None);
    let when = vec![(Box::new(left.eq(right)), Box::new(nothing))];
    let otherwise = Some(Box::new(first.clone()));
    Some(Expr::Case(Case::new(None, when, otherwise)))
}

/// A value that is looked for among rows, and these.
fn in_rows(found: &mut InSubquery, schema: &DFSchema) -> Result<bool> {
    if !compare(&mut found.expr, schema) {
        return Ok(false);
    }
    let rows = &mut found.subquery.subquery;
    let columns = rows.schema().iter().map(|(table, field)| {
        let mut column = Expr::Column(Column::from((table, field)));
        compare(&mut column, rows.schema());
        column.alias_qualified(table.cloned(), field.name())
    });
    let rows_compared = Projection::try_new(columns.collect(), Arc::clone(rows))?;
    *rows = Arc::new(LogicalPlan::Projection(rows_compared));
    Ok(true)
}

fn sorted(keys: &mut [Sort], schema: &DFSchema) -> bool {
    compare_all(keys.iter_mut().map(|key| &mut key.expr), schema)
}

/// Whether a value is written that is equal to nothing that has other bits.
fn is_plain(value: &Expr) -> bool {
    number(value).is_some_and(|it| it.is_none_or(|it| it != 0.0 && !it.is_nan()))
}

#[cfg(test)]
mod tests;
