//! How little of the map each row of a query depends on.

use datafusion::common::Column;
use datafusion::common::tree_node::TreeNode;
use datafusion::logical_expr::expr::{Exists, InSubquery};
use datafusion::logical_expr::utils::split_conjunction;
use datafusion::logical_expr::{BinaryExpr, Distinct, Expr, Join, LogicalPlan, Operator};

use crate::sql::as_of::AsOfJoin;

/// Whether every row of the result depends only on rows with the same value of `column` (`session`, `site`), so that
/// the query may run on each value's rows apart and the results be put together. Errs on the side of no.
pub fn is_local(plan: &LogicalPlan, column: &str) -> bool {
    let is_not = plan.exists(|node| Ok(!node_is_local(node, column)));
    has(plan, column) && !is_not.unwrap_or(true)
}

fn node_is_local(node: &LogicalPlan, column: &str) -> bool {
    if let LogicalPlan::Filter(filter) = node {
        let mut terms = split_conjunction(&filter.predicate).into_iter();
        return has(node, column) && terms.all(|term| term_is_local(term, column));
    }
    if has_subquery(node) {
        return false;
    }
    match node {
        LogicalPlan::TableScan(_) | LogicalPlan::SubqueryAlias(_) => has(node, column),
        LogicalPlan::Projection(projection) => {
            projection.expr.iter().any(|expr| passes(expr, column))
        }
        LogicalPlan::Unnest(_) | LogicalPlan::Repartition(_) | LogicalPlan::Union(_) => {
            has(node, column)
        }
        LogicalPlan::Sort(sort) => sort.fetch.is_none(),
        LogicalPlan::Aggregate(aggregate) => {
            aggregate.group_expr.iter().any(|expr| passes(expr, column))
        }
        LogicalPlan::Window(window) => window
            .window_expr
            .iter()
            .all(|expr| partitioned_by(expr, column)),
        LogicalPlan::Distinct(Distinct::All(input)) => has(input, column),
        LogicalPlan::Distinct(Distinct::On(distinct)) => {
            distinct.on_expr.iter().any(|expr| passes(expr, column))
        }
        LogicalPlan::Join(join) => joins_on(join, column),
        LogicalPlan::Extension(extension) => {
            let join = extension.node.as_any().downcast_ref::<AsOfJoin>();
            let mut keys = join.into_iter().flat_map(|join| &join.condition.keys);
            keys.any(|(left, right)| passes(left, column) && passes(right, column))
        }
        _ => false,
    }
}

/// Whether a condition on a row asks only for rows of the same value: the semi- and anti-joins of SQL,
/// `session NOT IN (SELECT session …)` and `NOT EXISTS (… WHERE other.session = this.session)`.
fn term_is_local(term: &Expr, column: &str) -> bool {
    match term {
        Expr::Not(term) => term_is_local(term, column),
        Expr::InSubquery(InSubquery { expr, subquery, .. }) => {
            let found = &subquery.subquery;
            passes(expr, column) && found.schema().fields().len() == 1 && is_local(found, column)
        }
        Expr::Exists(Exists { subquery, .. }) => is_bound(&subquery.subquery, column),
        term => !contains_subquery(term),
    }
}

/// Whether a subquery looks only at rows with the value of the row that it is asked for.
fn is_bound(subquery: &LogicalPlan, column: &str) -> bool {
    match subquery {
        LogicalPlan::Filter(filter) => {
            let terms = split_conjunction(&filter.predicate);
            terms.iter().all(|term| !contains_subquery(term))
                && if terms.iter().any(|term| binds(term, column)) {
                    is_local(&filter.input, column)
                } else {
                    is_bound(&filter.input, column)
                }
        }
        LogicalPlan::Projection(_) | LogicalPlan::Sort(_) | LogicalPlan::Limit(_) => {
            !has_subquery(subquery)
                && subquery
                    .inputs()
                    .first()
                    .is_some_and(|input| is_bound(input, column))
        }
        _ => false,
    }
}

/// Whether the term is `column = outer.column`.
fn binds(term: &Expr, column: &str) -> bool {
    let Expr::BinaryExpr(BinaryExpr {
        left,
        op: Operator::Eq,
        right,
    }) = term
    else {
        return false;
    };
    let outer =
        |expr: &Expr| matches!(expr, Expr::OuterReferenceColumn(_, outer) if outer.name == column);
    (passes(left, column) && outer(right)) || (outer(left) && passes(right, column))
}

/// Whether only rows of the same value are joined. Before it is optimised, a plan has the condition as a filter.
fn joins_on(join: &Join, column: &str) -> bool {
    let both =
        |left: &Expr, right: &Expr| passes(left, column) && passes(right, column) && left != right;
    let in_filter = join
        .filter
        .iter()
        .flat_map(split_conjunction)
        .any(|term| match term {
            Expr::BinaryExpr(BinaryExpr {
                left,
                op: Operator::Eq,
                right,
            }) => both(left, right),
            _ => false,
        });
    in_filter || join.on.iter().any(|(left, right)| both(left, right))
}

fn has(plan: &LogicalPlan, column: &str) -> bool {
    plan.schema()
        .fields()
        .iter()
        .any(|field| field.name() == column)
}

/// Whether the expression is the column itself, under its own name.
fn passes(expr: &Expr, column: &str) -> bool {
    match expr {
        Expr::Column(Column { name, .. }) => name == column,
        Expr::Alias(alias) => alias.name == column && passes(&alias.expr, column),
        _ => false,
    }
}

fn partitioned_by(expr: &Expr, column: &str) -> bool {
    match expr {
        Expr::Alias(alias) => partitioned_by(&alias.expr, column),
        Expr::WindowFunction(window) => window
            .params
            .partition_by
            .iter()
            .any(|expr| passes(expr, column)),
        _ => false,
    }
}

fn has_subquery(node: &LogicalPlan) -> bool {
    node.expressions().iter().any(contains_subquery)
}

fn contains_subquery(expr: &Expr) -> bool {
    let is_subquery = |expr: &Expr| {
        Ok(matches!(
            expr,
            Expr::ScalarSubquery(_) | Expr::InSubquery(_) | Expr::Exists(_)
        ))
    };
    expr.exists(is_subquery).unwrap_or(true)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::sql::{Limits, context};
    use datafusion::arrow::array::RecordBatch;
    use evermap_schemas::LayerRow;
    use evermap_schemas::layers::{Keyframe, VehiclePose};

    async fn plan(query: &str) -> LogicalPlan {
        let context = context(Limits::default()).unwrap();
        for layer in [VehiclePose::layer(), Keyframe::layer()] {
            context
                .register_batch(layer.name, RecordBatch::new_empty(layer.schema()))
                .unwrap();
        }
        context.sql(query).await.unwrap().into_unoptimized_plan()
    }

    #[tokio::test]
    async fn locality_is_seen_where_it_is_and_not_where_it_is_not() {
        let cases = [
            (
                "SELECT site, session, stamp FROM poses WHERE stamp IS NOT NULL",
                true,
            ),
            (
                "SELECT p.session, k.keyframe FROM poses p JOIN keyframes k ON p.session = k.session AND p.stamp = k.stamp",
                true,
            ),
            (
                "SELECT session, keyframe FROM poses JOIN keyframes USING (session, stamp)",
                true,
            ),
            (
                "SELECT p.session, k.keyframe FROM poses p JOIN keyframes k ON p.stamp = k.stamp",
                false,
            ),
            ("SELECT session, count(*) FROM poses GROUP BY session", true),
            ("SELECT site, count(*) FROM poses GROUP BY site", false),
            ("SELECT count(*) FROM poses", false),
            (
                "SELECT session, row_number() OVER (PARTITION BY session ORDER BY stamp) FROM poses",
                true,
            ),
            (
                "SELECT session, row_number() OVER (ORDER BY stamp) FROM poses",
                false,
            ),
            ("SELECT DISTINCT session FROM poses", true),
            ("SELECT session FROM poses LIMIT 3", false),
            (
                "SELECT session FROM poses WHERE stamp = (SELECT max(stamp) FROM poses)",
                false,
            ),
            ("SELECT 'x' AS session FROM poses", false),
            ("SELECT session, unnest(images) AS i FROM keyframes", true),
            (
                "SELECT session FROM (SELECT *, unnest(images) AS i FROM keyframes) k",
                true,
            ),
            (
                "SELECT * FROM keyframes WHERE session NOT IN (SELECT session FROM poses) AND keyframe > 1",
                true,
            ),
            (
                "SELECT * FROM keyframes WHERE session IN (SELECT DISTINCT session FROM poses WHERE stamp IS NOT NULL)",
                true,
            ),
            (
                "SELECT * FROM keyframes WHERE site NOT IN (SELECT site FROM poses)",
                false,
            ),
            (
                "SELECT * FROM keyframes WHERE session NOT IN (SELECT 'a' AS session FROM poses)",
                false,
            ),
            (
                "SELECT * FROM keyframes WHERE keyframe = 0 OR session NOT IN (SELECT session FROM poses)",
                false,
            ),
            (
                "SELECT * FROM keyframes WHERE session NOT IN (SELECT session FROM poses LIMIT 1)",
                false,
            ),
            (
                "SELECT * FROM keyframes k WHERE NOT EXISTS (SELECT 1 FROM poses p WHERE p.session = k.session)",
                true,
            ),
            (
                "SELECT * FROM keyframes k WHERE NOT EXISTS (SELECT * FROM poses p WHERE k.session = p.session AND p.stamp = k.stamp LIMIT 1)",
                true,
            ),
            (
                "SELECT * FROM keyframes k WHERE EXISTS (SELECT 1 FROM poses p WHERE p.stamp = k.stamp)",
                false,
            ),
            (
                "SELECT k.session FROM keyframes k LEFT ANTI JOIN poses p ON p.session = k.session",
                true,
            ),
        ];
        for (query, expected) in cases {
            assert_eq!(is_local(&plan(query).await, "session"), expected, "{query}");
        }
    }
}
