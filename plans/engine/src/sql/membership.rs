//! `x IN (SELECT …)` is true, false or null as SQL says, wherever it stands.
//!
//! DataFusion joins such a condition of WHERE, rightly where it stands alone. Within another one, as beside OR, its join
//! knows true and false and no null, so that `NOT IN` gives rows that it should not; in SELECT there is none. Here such a
//! condition is counted: how many of the subquery's rows are equal, and whether any is null. Subqueries that are counted,
//! and always have one row, are compared with that: without a match, DataFusion's join has none.

use std::sync::Arc;

use datafusion::common::tree_node::{Transformed, TreeNode, TreeNodeRecursion};
use datafusion::common::{Column, DFSchema, ExprSchema, Result, ScalarValue, Spans};
use datafusion::error::DataFusionError;
use datafusion::functions_aggregate::expr_fn::{bool_or, count};
use datafusion::logical_expr::expr::{Exists, InSubquery, SetComparison, SetQuantifier};
use datafusion::logical_expr::expr_rewriter::NamePreserver;
use datafusion::logical_expr::utils::{conjunction, split_conjunction, split_conjunction_owned};
use datafusion::logical_expr::{
    Distinct, Expr, Filter, Join, JoinType, LogicalPlan, LogicalPlanBuilder, Operator, Projection,
    Subquery, lit, not, when,
};
use evermap_schemas::Fault;

use crate::error::external;

/// What the column of a subquery is called while it is compared. Under its own name it would be taken for one of the query
/// around it, where both read one table.
const FOUND: &str = "__found";

/// What a value of all its rows is called: a query around it may have a `count(*)` of its own.
const TOTAL: &str = "__total";

/// Steps of a plan at most that a subquery has where it is counted: it is planned three times, and so is one within it.
const MOST_STEPS: usize = 10_000;

/// A plan whose subqueries in conditions have three values.
///
/// # Errors
/// A user fault for a subquery that cannot be counted, and for one in the condition of a join.
pub fn three_valued(plan: LogicalPlan) -> Result<LogicalPlan> {
    let mut is_changed = false;
    let plan = plan.transform_up_with_subqueries(|node| {
        let node = in_node(node)?;
        is_changed |= node.transformed;
        // What may be null around it now may be null here.
        match is_changed {
            true => node.data.recompute_schema().map(Transformed::yes),
            false => Ok(node),
        }
    })?;
    Ok(plan.data)
}

fn in_node(node: LogicalPlan) -> Result<Transformed<LogicalPlan>> {
    match node {
        LogicalPlan::Filter(filter) if asks(&filter.predicate)? => {
            in_filter(filter).map(Transformed::yes)
        }
        LogicalPlan::Projection(projection) => in_projection(projection),
        LogicalPlan::Join(join) => {
            check_join(&join)?;
            Ok(Transformed::no(LogicalPlan::Join(join)))
        }
        LogicalPlan::Aggregate(_) | LogicalPlan::Window(_) | LogicalPlan::Sort(_) => {
            for expr in node.expressions() {
                check_elsewhere(&expr)?;
            }
            Ok(Transformed::no(node))
        }
        other => Ok(Transformed::no(other)),
    }
}

/// Where rows are counted, grouped and ordered DataFusion has no join for a condition.
fn check_elsewhere(expr: &Expr) -> Result<()> {
    match asks(expr)? {
        false => Ok(()),
        true => Err(refused(
            "expected IN, EXISTS, ANY and ALL (SELECT …) in WHERE, HAVING or SELECT, found one in an aggregate, a window, GROUP BY or ORDER BY",
            "compute it in a query within: FROM (SELECT *, x IN (SELECT …) AS found FROM …)",
        )),
    }
}

/// Whether an expression has a subquery in a condition.
fn asks(expr: &Expr) -> Result<bool> {
    expr.exists(|part| {
        Ok(matches!(
            part,
            Expr::InSubquery(_) | Expr::Exists(_) | Expr::SetComparison(_)
        ))
    })
}

fn in_filter(filter: Filter) -> Result<LogicalPlan> {
    let Filter {
        predicate, input, ..
    } = filter;
    let terms = split_conjunction_owned(plain(predicate)?).into_iter();
    let terms = terms.map(|term| match is_joined(&term)? {
        true => Ok(term),
        false => valued(term, input.schema()),
    });
    let terms = terms.collect::<Result<Vec<_>>>()?;
    let predicate = conjunction(terms).unwrap_or_else(|| lit(true));
    Filter::try_new(predicate, input).map(LogicalPlan::Filter)
}

fn in_projection(projection: Projection) -> Result<Transformed<LogicalPlan>> {
    let schema = Arc::clone(projection.input.schema());
    let names = NamePreserver::new_for_projection();
    LogicalPlan::Projection(projection).map_expressions(|expr| {
        if !asks(&expr)? {
            return Ok(Transformed::no(expr));
        }
        let name = names.save(&expr);
        let expr = valued(plain(expr)?, &schema)?.transform_up(counted)?.data;
        check_selected(&expr)?;
        Ok(Transformed::yes(name.restore(expr)))
    })
}

/// What cannot be counted is not selected.
fn check_selected(expr: &Expr) -> Result<()> {
    match expr.exists(|part| Ok(matches!(part, Expr::SetComparison(_))))? {
        false => Ok(()),
        true => Err(refused(
            "not supported: a comparison with ANY or ALL (SELECT …) in SELECT",
            "write it in WHERE, or compare with (SELECT min(…)) or (SELECT max(…))",
        )),
    }
}

/// Joins take the conditions that stand alone.
fn check_join(join: &Join) -> Result<()> {
    for term in join.filter.iter().flat_map(split_conjunction) {
        let has_member = term.exists(|part| Ok(matches!(part, Expr::InSubquery(_))))?;
        if has_member && !is_joined(term)? {
            let said = "expected IN (SELECT …) in WHERE, found it in the condition of a join";
            let next = match join.join_type {
                JoinType::Inner => "write it in WHERE",
                _ => {
                    "compute it in a query within, and join that: (SELECT *, x IN (SELECT …) AS found FROM …)"
                }
            };
            return Err(external(Fault::user(said).next(next)));
        }
    }
    Ok(())
}

/// Comparisons with ANY and ALL as what they are: `= ANY` is `IN`. Others keep a column that no other is called as.
fn plain(expr: Expr) -> Result<Expr> {
    let expr = expr.transform_up(|part| {
        let Expr::SetComparison(SetComparison {
            expr,
            subquery,
            op,
            quantifier,
        }) = part
        else {
            return Ok(Transformed::no(part));
        };
        Ok(Transformed::yes(match (op, &quantifier) {
            (Operator::Eq, SetQuantifier::Any) => {
                Expr::InSubquery(InSubquery::new(expr, subquery, false))
            }
            (Operator::NotEq, SetQuantifier::All) => {
                Expr::InSubquery(InSubquery::new(expr, subquery, true))
            }
            _ => {
                let subquery = of(found(&subquery)?.build()?);
                Expr::SetComparison(SetComparison::new(expr, subquery, op, quantifier))
            }
        }))
    })?;
    Ok(expr.data)
}

/// Whether DataFusion's join of a condition that stands alone is right: only true counts. Nulls on either side of NOT IN are
/// seen where it is one column that is compared with all rows of the subquery.
fn is_joined(term: &Expr) -> Result<bool> {
    let (InSubquery { expr, subquery, .. }, negated) = match term {
        Expr::InSubquery(found) => (found, found.negated),
        Expr::Not(inner) => match inner.as_ref() {
            Expr::InSubquery(found) => (found, !found.negated),
            _ => return Ok(false),
        },
        _ => return Ok(false),
    };
    let is_correlated = !subquery.outer_ref_columns.is_empty();
    Ok(!asks(expr)?
        && match negated {
            true => !is_correlated && matches!(expr.as_ref(), Expr::Column(_)),
            false => !(is_correlated && is_one_row(&subquery.subquery)),
        })
}

/// An expression whose conditions have three values. EXISTS has two, which its join knows.
fn valued(expr: Expr, schema: &DFSchema) -> Result<Expr> {
    let expr = expr.transform_up(|part| match part {
        Expr::InSubquery(found) => member(found, schema).map(Transformed::yes),
        Expr::Exists(found) if is_one_row(&found.subquery.subquery) => {
            Ok(Transformed::yes(lit(!found.negated)))
        }
        other => Ok(Transformed::no(other)),
    })?;
    Ok(expr.data)
}

/// EXISTS as a number of rows: what SELECT has no join for.
fn counted(part: Expr) -> Result<Transformed<Expr>> {
    let Expr::Exists(Exists { subquery, negated }) = part else {
        return Ok(Transformed::no(part));
    };
    if !is_countable(&subquery) {
        let same = Expr::Exists(Exists { subquery, negated });
        return Ok(Transformed::no(same));
    }
    let rows = LogicalPlanBuilder::new_from_arc(Arc::clone(&subquery.subquery));
    let rows = match subquery.outer_ref_columns.is_empty() {
        true => rows.limit(0, Some(1))?,
        false => rows,
    };
    let rows = total(rows, count(lit(1_i64)))?;
    Ok(Transformed::yes(match negated {
        true => rows.eq(lit(0_i64)),
        false => rows.gt(lit(0_i64)),
    }))
}

/// `x IN (SELECT …)` as an expression.
fn member(asked: InSubquery, schema: &DFSchema) -> Result<Expr> {
    let InSubquery {
        expr,
        subquery,
        negated,
    } = asked;
    let value = *expr;
    if is_one_row(&subquery.subquery) {
        let row = Expr::ScalarSubquery(subquery);
        return Ok(match negated {
            true => value.not_eq(row),
            false => value.eq(row),
        });
    }
    check(&value, &subquery)?;
    let rows = found(&subquery)?;
    let column = || Expr::Column(Column::new_unqualified(FOUND));
    let same = column().eq(outer(value.clone(), schema)?);
    let equal = total(rows.clone().filter(same)?, count(lit(1_i64)))?;
    // Null where there are no rows.
    let has_null = total(rows, bool_or(column().is_null()))?;
    let member = when(equal.gt(lit(0_i64)), lit(true))
        .when(has_null.clone().is_null(), lit(false))
        .when(
            has_null.or(value.is_null()),
            lit(ScalarValue::Boolean(None)),
        )
        .otherwise(lit(false))?;
    Ok(match negated {
        true => not(member),
        false => member,
    })
}

/// Refuses what would be counted wrongly.
fn check(value: &Expr, subquery: &Subquery) -> Result<()> {
    let is_around = value.exists(|part| {
        Ok(match part {
            Expr::ScalarSubquery(inner) => !inner.outer_ref_columns.is_empty(),
            part => matches!(part, Expr::Exists(_) | Expr::SetComparison(_)),
        })
    })?;
    if is_around {
        return Err(refused(
            "expected a value in front of IN (SELECT …), found a subquery that names columns of the query around it",
            "compute it in a query within: FROM (SELECT *, (SELECT …) AS x FROM …)",
        ));
    }
    let mut steps = 0_usize;
    subquery.subquery.apply_with_subqueries(|_| {
        steps += 1;
        Ok(match steps {
            0..=MOST_STEPS => TreeNodeRecursion::Continue,
            _ => TreeNodeRecursion::Stop,
        })
    })?;
    if steps > MOST_STEPS {
        return Err(external(
            Fault::user(format!(
                "expected a subquery of at most {MOST_STEPS} steps in IN (SELECT …) beside other conditions, found more"
            ))
            .next("make a table of it, as a step of a plan"),
        ));
    }
    match is_countable(subquery) {
        true => Ok(()),
        false => Err(refused(
            "not supported: IN (SELECT …) that names columns of the query around it, and groups, orders or limits rows",
            "write it as a join: LEFT JOIN (SELECT …) ON …",
        )),
    }
}

fn refused(said: &str, next: &str) -> DataFusionError {
    external(Fault::user(said).next(next))
}

/// Whether the rows of a subquery may be counted for each row around it, as what says which rows are meant is still known
/// where they are counted.
fn is_countable(subquery: &Subquery) -> bool {
    let is_other = subquery.subquery.exists(|node| {
        Ok(!matches!(
            node,
            LogicalPlan::Projection(_)
                | LogicalPlan::Filter(_)
                | LogicalPlan::SubqueryAlias(_)
                | LogicalPlan::TableScan(_)
                | LogicalPlan::Values(_)
                | LogicalPlan::EmptyRelation(_)
                | LogicalPlan::Distinct(Distinct::All(_))
                | LogicalPlan::Join(Join {
                    join_type: JoinType::Inner,
                    ..
                })
        ))
    });
    subquery.outer_ref_columns.is_empty() || !is_other.unwrap_or(true)
}

/// Whether a subquery has one row, whatever the rows are that it reads.
fn is_one_row(subquery: &LogicalPlan) -> bool {
    match subquery {
        LogicalPlan::Projection(projection) => is_one_row(&projection.input),
        LogicalPlan::SubqueryAlias(alias) => is_one_row(&alias.input),
        LogicalPlan::Aggregate(total) => total.group_expr.is_empty(),
        _ => false,
    }
}

/// The rows of a subquery, with its column under a name of its own.
fn found(subquery: &Subquery) -> Result<LogicalPlanBuilder> {
    let column = Column::from(subquery.subquery.schema().qualified_field(0));
    LogicalPlanBuilder::new_from_arc(Arc::clone(&subquery.subquery))
        .project([Expr::Column(column).alias(FOUND)])
}

/// A value of all rows, as an expression.
fn total(rows: LogicalPlanBuilder, value: Expr) -> Result<Expr> {
    let rows = rows.aggregate(Vec::<Expr>::new(), [value])?.build()?;
    let column = Column::from(rows.schema().qualified_field(0));
    let rows = LogicalPlanBuilder::from(rows).project([Expr::Column(column).alias(TOTAL)])?;
    Ok(Expr::ScalarSubquery(of(rows.build()?)))
}

fn of(rows: LogicalPlan) -> Subquery {
    Subquery {
        outer_ref_columns: rows.all_out_ref_exprs(),
        subquery: Arc::new(rows),
        spans: Spans::new(),
    }
}

/// An expression of the query around, as a subquery names it.
fn outer(expr: Expr, schema: &DFSchema) -> Result<Expr> {
    let expr = expr.transform_up(|part| match part {
        Expr::Column(column) => {
            let field = Arc::clone(ExprSchema::field_from_column(schema, &column)?);
            Ok(Transformed::yes(Expr::OuterReferenceColumn(field, column)))
        }
        other => Ok(Transformed::no(other)),
    })?;
    Ok(expr.data)
}

#[cfg(test)]
mod tests;
