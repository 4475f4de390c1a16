//! `contains` on the layer `views`, answered by the layer `class_index`.

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
use evermap_schemas::layers::{ClassLeaf, View};
use futures::FutureExt;

/// Lets queries on `views` use `class_index`, where the context has both and the index is of just these views.
///
/// `WHERE contains(graph, 'building', 2)` becomes `WHERE view IN (views of the leaves with two buildings)`, which reads
/// names instead of graphs. What else the query asks stays as it is.
///
/// # Errors
/// When the layers cannot be read.
pub async fn use_class_index(context: &SessionContext) -> Result<()> {
    let has = |layer: &str| context.table_exist(TableReference::bare(layer));
    if !(has(View::NAME)? && has(ClassLeaf::NAME)?) {
        return Ok(());
    }
    let indexed = "SELECT count(*) FROM (SELECT unnest(views) AS view FROM class_index)";
    let all = "SELECT count(*) FROM views";
    if count(context, indexed).await? != count(context, all).await? {
        return Ok(());
    }
    let leaves = SessionContext::new();
    leaves.register_table(
        ClassLeaf::NAME,
        context.table_provider(ClassLeaf::NAME).await?,
    )?;
    context.add_analyzer_rule(Arc::new(ByClassIndex { leaves }));
    Ok(())
}

async fn count(context: &SessionContext, query: &str) -> Result<Option<ScalarValue>> {
    let batches = context.sql(query).await?.collect().await?;
    let first = batches.first().filter(|batch| batch.num_rows() > 0);
    first
        .map(|batch| ScalarValue::try_from_array(batch.column(0), 0))
        .transpose()
}

/// The rule.
struct ByClassIndex {
    /// A context with the index alone.
    leaves: SessionContext,
}

impl std::fmt::Debug for ByClassIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("ByClassIndex")
    }
}

impl AnalyzerRule for ByClassIndex {
    fn name(&self) -> &str {
        "contains_by_class_index"
    }

    fn analyze(&self, plan: LogicalPlan, _: &ConfigOptions) -> Result<LogicalPlan> {
        let plan = plan.transform_up_with_subqueries(|plan| self.filter(plan))?;
        Ok(plan.data)
    }
}

impl ByClassIndex {
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
        let Some((graph, class, least)) = asked(&expr) else {
            return Ok(Transformed::no(expr));
        };
        let Some(table) = graph
            .relation
            .as_ref()
            .filter(|table| is_views(input, table))
        else {
            return Ok(Transformed::no(expr));
        };
        let view = Expr::Column(Column::new(Some(table.clone()), "view"));
        let subquery = Subquery {
            subquery: Arc::new(self.views(&class, least)?),
            outer_ref_columns: Vec::new(),
            spans: Default::default(),
        };
        Ok(Transformed::yes(Expr::InSubquery(InSubquery::new(
            Box::new(view),
            subquery,
            false,
        ))))
    }

    /// The views of the leaves with at least so many areas of a class.
    fn views(&self, class: &str, least: i64) -> Result<LogicalPlan> {
        let query = "SELECT unnest(views) AS view FROM (SELECT views, unnest(counts) AS entry FROM class_index) \
                     WHERE entry['class'] = $1 AND CAST(entry['areas'] AS BIGINT) >= $2";
        let planned = self.leaves.sql(query).now_or_never();
        let planned = planned
            .ok_or_else(|| DataFusionError::Internal("planning had to wait".to_owned()))??;
        let bound =
            planned.with_param_values(vec![ScalarValue::from(class), ScalarValue::from(least)])?;
        Ok(bound.into_unoptimized_plan())
    }
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

/// Whether a table of a plan's input is the layer `views`, perhaps under another name.
fn is_views(input: &LogicalPlan, table: &TableReference) -> bool {
    let mut found = false;
    // Never fails: nothing in the closure does.
    let _ = input.apply(|plan| {
        if let LogicalPlan::SubqueryAlias(alias) = plan
            && alias.alias == *table
        {
            found |= leads_to_views(plan);
        }
        if let LogicalPlan::TableScan(scan) = plan
            && scan.table_name == *table
        {
            found |= scan.table_name.table() == View::NAME;
        }
        Ok(datafusion::common::tree_node::TreeNodeRecursion::Continue)
    });
    found
}

fn leads_to_views(plan: &LogicalPlan) -> bool {
    match plan {
        LogicalPlan::SubqueryAlias(alias) => {
            alias.alias == TableReference::bare(View::NAME) || leads_to_views(&alias.input)
        }
        LogicalPlan::TableScan(scan) => scan.table_name.table() == View::NAME,
        _ => false,
    }
}
