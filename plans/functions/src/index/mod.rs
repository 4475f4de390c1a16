//! `contains` and `related` on the layer `views`, answered by the layers `class_index` and `relation_index`.

mod names;
mod relations;
#[cfg(test)]
mod tests;
mod views;

use std::sync::Arc;

use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode};
use datafusion::common::{Column, DataFusionError, Result, TableReference};
use datafusion::logical_expr::expr::InSubquery;
use datafusion::logical_expr::{Expr, LogicalPlan, Subquery};
use datafusion::optimizer::AnalyzerRule;
use datafusion::prelude::SessionContext;
use datafusion::scalar::ScalarValue;
use evermap_schemas::LayerRow;
use evermap_schemas::layers::{ClassLeaf, RelatedViews, View};
use futures::FutureExt;

use names::{Names, names};
use relations::RelationIndex;
use views::Views;

/// Lets queries on `views` use `class_index` and `relation_index`, where the context has them and they are of just these
/// views, by name.
///
/// `WHERE contains(graph, 'building', 2)` becomes `WHERE view IN (views of the leaves with two buildings)`, and
/// `related(graph, 'car', 'on', 'road')` likewise, which reads names instead of graphs. What else the query asks stays as
/// it is.
///
/// # Errors
/// When the layers cannot be read.
pub async fn use_indexes(context: &SessionContext) -> Result<()> {
    let has = |layer: &str| context.table_exist(TableReference::bare(layer));
    let (classes, relations) = (has(ClassLeaf::NAME)?, has(RelatedViews::NAME)?);
    if !has(View::NAME)? || !(classes || relations) {
        return Ok(());
    }
    let names = names(context, "SELECT site, \"view\" FROM views").await?;
    let leaves = match classes {
        true => leaves(context, &names).await?,
        false => None,
    };
    let relations = match relations {
        true => RelationIndex::of(context, names).await?,
        false => None,
    };
    if leaves.is_some() || relations.is_some() {
        context.add_analyzer_rule(Arc::new(ByIndex {
            views: Views::of(context).await?,
            leaves,
            relations: relations.map(Arc::new),
        }));
    }
    Ok(())
}

/// A context with the class index alone, where it is of just these views.
async fn leaves(context: &SessionContext, of: &Names) -> Result<Option<SessionContext>> {
    let leaves = alone(context, ClassLeaf::NAME).await?;
    let indexed = names(
        &leaves,
        "SELECT site, unnest(views) AS view FROM class_index",
    )
    .await?;
    Ok((indexed == *of).then_some(leaves))
}

/// A context that has one of another's tables.
async fn alone(context: &SessionContext, table: &str) -> Result<SessionContext> {
    let one = SessionContext::new();
    one.register_table(table, context.table_provider(table).await?)?;
    Ok(one)
}

/// The rule.
struct ByIndex {
    /// The layer that the indexes are of.
    views: Views,
    /// A context with the class index alone.
    leaves: Option<SessionContext>,
    relations: Option<Arc<RelationIndex>>,
}

impl std::fmt::Debug for ByIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("ByIndex")
    }
}

impl AnalyzerRule for ByIndex {
    fn name(&self) -> &str {
        "graphs_by_index"
    }

    fn analyze(&self, plan: LogicalPlan, _: &ConfigOptions) -> Result<LogicalPlan> {
        let plan = plan.transform_up_with_subqueries(|plan| self.filter(plan))?;
        Ok(plan.data)
    }
}

impl ByIndex {
    fn filter(&self, plan: LogicalPlan) -> Result<Transformed<LogicalPlan>> {
        let LogicalPlan::Filter(mut filter) = plan else {
            return Ok(Transformed::no(plan));
        };
        let input = filter.input.clone();
        let found = filter
            .predicate
            .transform_up(|expr| self.call(expr, &input))?;
        filter.predicate = found.data;
        Ok(Transformed::new(
            LogicalPlan::Filter(filter),
            found.transformed,
            found.tnr,
        ))
    }

    fn call(&self, expr: Expr, input: &LogicalPlan) -> Result<Transformed<Expr>> {
        let Some((graph, views)) = self.answer(&expr)? else {
            return Ok(Transformed::no(expr));
        };
        let Some(table) = graph
            .relation
            .as_ref()
            .filter(|table| self.views.are(input, table))
        else {
            return Ok(Transformed::no(expr));
        };
        let view = Expr::Column(Column::new(Some(table.clone()), "view"));
        let subquery = Subquery {
            subquery: Arc::new(views),
            outer_ref_columns: Vec::new(),
            spans: Default::default(),
        };
        Ok(Transformed::yes(Expr::InSubquery(InSubquery::new(
            Box::new(view),
            subquery,
            false,
        ))))
    }

    /// Of a call that an index answers, the column of graphs and the query of the views for which it is true.
    fn answer(&self, expr: &Expr) -> Result<Option<(Column, LogicalPlan)>> {
        if let Some(leaves) = &self.leaves
            && let Some((graph, class, least)) = asked(expr)
        {
            return Ok(Some((graph, showing(leaves, &class, least)?)));
        }
        if let Some(index) = &self.relations
            && let Some((graph, asked)) = relations::asked(expr)
        {
            return Ok(Some((graph, relations::plan(index, asked)?)));
        }
        Ok(None)
    }
}

/// The views of the leaves with at least so many areas of a class.
fn showing(leaves: &SessionContext, class: &str, least: i64) -> Result<LogicalPlan> {
    let query = "SELECT unnest(views) AS view FROM (SELECT views, unnest(counts) AS entry FROM class_index) \
                     WHERE entry['class'] = $1 AND CAST(entry['areas'] AS BIGINT) >= $2";
    let planned = leaves.sql(query).now_or_never();
    let planned =
        planned.ok_or_else(|| DataFusionError::Internal("planning had to wait".to_owned()))??;
    let bound =
        planned.with_param_values(vec![ScalarValue::from(class), ScalarValue::from(least)])?;
    Ok(bound.into_unoptimized_plan())
}

/// The column, class and count of a call `contains(graph, 'class' [, count])` whose count is at least 1.
fn asked(expr: &Expr) -> Option<(Column, String, i64)> {
    let Expr::ScalarFunction(call) = expr else {
        return None;
    };
    if call.func.name() != "contains" {
        return None;
    }
    let [Expr::Column(graph), Expr::Literal(class, _), count @ ..] = call.args.as_slice() else {
        return None;
    };
    let class = class.try_as_str()??.to_owned();
    let least = match count {
        [] => 1,
        [Expr::Literal(ScalarValue::Int64(Some(least)), _)] => *least,
        _ => return None,
    };
    (graph.name == "graph" && least >= 1).then(|| (graph.clone(), class, least))
}
