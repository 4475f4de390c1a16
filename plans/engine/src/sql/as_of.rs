//! `ASOF JOIN`: to each row the one of another table that is nearest in time, as sensors of different rates need it.
//!
//! ```sql
//! SELECT i.log_time, o.pose
//! FROM "/imu" AS i ASOF JOIN "/odom" AS o
//!   MATCH_CONDITION (i.log_time >= o.log_time AND i.log_time - o.log_time < INTERVAL '0.1 s')
//!   ON i.session = o.session
//! ```
//!
//! Each row of the left table comes once, with the row of the right that has equal keys (`ON`) and whose time is the
//! last that is not later (`>=`; `>`: earlier; `<=` and `<`: the first that is not earlier, or later). What else is in
//! `MATCH_CONDITION` says when that row is not wanted, such as one too long ago; then, and where there is none, the
//! columns of the right table are null. A null time or key matches nothing. Of rows with one time any may come.
//!
//! Both tables are sorted by keys and time, then merged in one pass.

mod condition;
mod exec;
mod merge;
mod node;

use std::ops::ControlFlow;
use std::sync::Arc;

use datafusion::common::{Column, DFSchema, Result, plan_err};
use datafusion::logical_expr::planner::{
    PlannedRelation, RelationPlanner, RelationPlannerContext, RelationPlanning,
};
use datafusion::logical_expr::type_coercion::binary::comparison_coercion;
use datafusion::logical_expr::utils::{conjunction, split_conjunction_owned};
use datafusion::logical_expr::{BinaryExpr, Expr, ExprSchemable, Extension, LogicalPlan, Operator};
use datafusion::sql::sqlparser::ast::{
    Expr as SqlExpr, Join, JoinConstraint, JoinOperator, ObjectName, Query, SetExpr, Statement,
    TableFactor, TableWithJoins, VisitMut, VisitorMut,
};

use crate::sql::as_of::condition::{Condition, Matching};
use crate::sql::compared::compare;

pub use node::{AsOfJoin, Planner};

/// Gives each as-of join of a statement brackets of its own: where it stands in them, [`Relations`] is asked to plan it.
pub fn bracketed(statement: &mut Statement) {
    let ControlFlow::Continue(()) = statement.visit(&mut Brackets);
}

struct Brackets;

impl VisitorMut for Brackets {
    type Break = std::convert::Infallible;

    fn pre_visit_query(&mut self, query: &mut Query) -> ControlFlow<Self::Break> {
        in_body(&mut query.body);
        ControlFlow::Continue(())
    }

    fn pre_visit_table_factor(&mut self, factor: &mut TableFactor) -> ControlFlow<Self::Break> {
        if let TableFactor::NestedJoin {
            table_with_joins, ..
        } = factor
            && table_with_joins.joins.len() > 1
        {
            bracket(table_with_joins);
        }
        ControlFlow::Continue(())
    }
}

fn in_body(body: &mut SetExpr) {
    match body {
        SetExpr::Select(select) => select.from.iter_mut().for_each(bracket),
        SetExpr::SetOperation { left, right, .. } => {
            in_body(left);
            in_body(right);
        }
        _ => {}
    }
}

/// `a JOIN b ASOF JOIN c JOIN d` becomes `((a JOIN b) ASOF JOIN c) JOIN d`.
fn bracket(table: &mut TableWithJoins) {
    let is_as_of = |join: &Join| matches!(join.join_operator, JoinOperator::AsOf { .. });
    if !table.joins.iter().any(is_as_of) {
        return;
    }
    let mut joins = Vec::new();
    for join in std::mem::take(&mut table.joins) {
        if is_as_of(&join) {
            if !joins.is_empty() {
                nest(table, std::mem::take(&mut joins));
            }
            nest(table, vec![join]);
        } else {
            joins.push(join);
        }
    }
    table.joins = joins;
}

/// Puts a relation with these joins in brackets.
fn nest(table: &mut TableWithJoins, joins: Vec<Join>) {
    let inner = TableWithJoins {
        relation: table.relation.clone(),
        joins,
    };
    table.relation = TableFactor::NestedJoin {
        table_with_joins: Box::new(inner),
        alias: None,
    };
}

/// Plans the relations of queries that have as-of joins, and refuses what nobody plans.
#[derive(Debug)]
pub struct Relations;

impl RelationPlanner for Relations {
    fn plan_relation(
        &self,
        relation: TableFactor,
        context: &mut dyn RelationPlannerContext,
    ) -> Result<RelationPlanning> {
        if let TableFactor::Table {
            sample: Some(_), ..
        } = &relation
        {
            // It would be passed over, and all rows come.
            return plan_err!(
                "expected a table, found TABLESAMPLE behind it; choose rows by a condition, such as keyframe % 10 = 0"
            );
        }
        let TableFactor::NestedJoin {
            table_with_joins,
            alias,
        } = relation
        else {
            return Ok(RelationPlanning::Original(Box::new(relation)));
        };
        let [
            Join {
                relation: right,
                join_operator:
                    JoinOperator::AsOf {
                        match_condition,
                        constraint,
                    },
                ..
            },
        ] = table_with_joins.joins.as_slice()
        else {
            let same = TableFactor::NestedJoin {
                table_with_joins,
                alias,
            };
            return Ok(RelationPlanning::Original(Box::new(same)));
        };
        let left = context.plan(table_with_joins.relation.clone())?;
        let right = context.plan(right.clone())?;
        let join = join(left, right, match_condition, constraint, context)?;
        let node = Arc::new(join);
        let plan = LogicalPlan::Extension(Extension { node });
        let planned = PlannedRelation::new(plan, alias);
        Ok(RelationPlanning::Planned(Box::new(planned)))
    }
}

fn join(
    left: LogicalPlan,
    right: LogicalPlan,
    condition: &SqlExpr,
    constraint: &JoinConstraint,
    context: &mut dyn RelationPlannerContext,
) -> Result<AsOfJoin> {
    let both = left.schema().join(right.schema())?;
    let sides = Sides {
        left: left.schema(),
        right: right.schema(),
    };
    let terms = context.sql_to_expr(condition.clone(), &both)?;
    let (mut times, mut limits) = (None, Vec::new());
    for term in split_conjunction_owned(terms) {
        match sides.compared(&term)? {
            Some((left, op, right)) if times.is_none() && Matching::of(op).is_some() => {
                times = Matching::of(op).map(|matching| (matching, (left, right)));
            }
            _ => limits.push(term),
        }
    }
    let Some((matching, times)) = times else {
        return plan_err!(
            "ASOF JOIN: expected a MATCH_CONDITION that compares times of both tables (left >= right), found {condition}"
        );
    };
    let mut keys = Vec::new();
    match constraint {
        JoinConstraint::None => {}
        JoinConstraint::On(on) => {
            for term in split_conjunction_owned(context.sql_to_expr(on.clone(), &both)?) {
                match sides.compared(&term)? {
                    Some((left, Operator::Eq, right)) => keys.push((left, right)),
                    _ => {
                        return plan_err!(
                            "ASOF JOIN: expected ON with columns of both tables that are equal, found {term}; MATCH_CONDITION takes other conditions"
                        );
                    }
                }
            }
        }
        other => {
            let found = match other {
                JoinConstraint::Using(columns) => {
                    let written: Vec<String> = columns.iter().map(ToString::to_string).collect();
                    let on: Option<Vec<String>> =
                        columns.iter().map(|name| sides.on(name)).collect();
                    let on = on.map_or(String::new(), |on| {
                        format!("; write ON {}", on.join(" AND "))
                    });
                    format!("USING ({}){on}", written.join(", "))
                }
                _ => "NATURAL".to_owned(),
            };
            return plan_err!("ASOF JOIN: expected ON left = right, found {found}");
        }
    }
    let condition = Condition {
        keys,
        times,
        matching,
        limit: conjunction(limits),
    };
    AsOfJoin::new(left, right, condition)
}

/// The columns of both tables.
struct Sides<'s> {
    left: &'s DFSchema,
    right: &'s DFSchema,
}

impl Sides<'_> {
    /// That a column of this name is equal in both tables; `None` where one of them has none.
    fn on(&self, name: &ObjectName) -> Option<String> {
        let [part] = name.0.as_slice() else {
            return None;
        };
        let name = &part.as_ident()?.value;
        let of = |table: &DFSchema| {
            let found = table.qualified_field_with_unqualified_name(name).ok()?;
            Some(Column::from(found).quoted_flat_name())
        };
        Some(format!("{} = {}", of(self.left)?, of(self.right)?))
    }

    /// A comparison of a value of the left table with one of the right, in this order and of one type; `None` for other
    /// expressions.
    fn compared(&self, term: &Expr) -> Result<Option<(Expr, Operator, Expr)>> {
        let Expr::BinaryExpr(BinaryExpr { left, op, right }) = term else {
            return Ok(None);
        };
        if is_of(left, self.left) && is_of(right, self.right) {
            return self.of_one_type(left, *op, right);
        }
        match op.swap() {
            Some(op) if is_of(left, self.right) && is_of(right, self.left) => {
                self.of_one_type(right, op, left)
            }
            _ => Ok(None),
        }
    }

    fn of_one_type(
        &self,
        left: &Expr,
        op: Operator,
        right: &Expr,
    ) -> Result<Option<(Expr, Operator, Expr)>> {
        let types = (left.get_type(self.left)?, right.get_type(self.right)?);
        let Some(common) = comparison_coercion(&types.0, &types.1) else {
            return plan_err!("ASOF JOIN: {} and {} do not compare", types.0, types.1);
        };
        let mut left = left.clone().cast_to(&common, self.left)?;
        let mut right = right.clone().cast_to(&common, self.right)?;
        compare(&mut left, self.left);
        compare(&mut right, self.right);
        Ok(Some((left, op, right)))
    }
}

/// Whether all columns of an expression, and one at least, are of a table.
fn is_of(expr: &Expr, table: &DFSchema) -> bool {
    let columns = expr.column_refs();
    !columns.is_empty() && columns.iter().all(|column| table.has_column(column))
}

#[cfg(test)]
mod tests;
