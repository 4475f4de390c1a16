//! `contains` and `related` on the layer `views`, answered by the layers `class_index` and `relation_index`.

mod door;
mod names;
mod relations;
#[cfg(test)]
mod tests;
mod views;

use std::collections::BTreeSet;
use std::sync::Arc;

use datafusion::common::config::ConfigOptions;
use datafusion::common::tree_node::{Transformed, TreeNode, TreeNodeRecursion};
use datafusion::common::{Column, DataFusionError, Result, TableReference, plan_err};
use datafusion::logical_expr::expr::InSubquery;
use datafusion::logical_expr::{Expr, LogicalPlan, Subquery};
use datafusion::optimizer::AnalyzerRule;
use datafusion::prelude::SessionContext;
use datafusion::scalar::ScalarValue;
use evermap_schemas::LayerRow;
use evermap_schemas::layers::{ClassLeaf, LabelImage, RelatedViews, View};
use futures::FutureExt;

use crate::{contains, related};

use door::Door;
use names::{Names, names, texts};
use relations::{Relating, RelationIndex};
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
            classes: known_classes(context, leaves.as_ref()).await?,
            leaves,
            relations: relations.map(Arc::new),
        }));
    }
    Ok(())
}

/// Whether a plan calls what the indexes answer. [`use_indexes`] reads the names of all views: whoever asks nothing of
/// graphs need not wait for it.
///
/// # Errors
/// None that a plan of DataFusion's own gives.
pub fn asks_graphs(plan: &LogicalPlan) -> Result<bool> {
    let calls = |expr: &Expr| {
        expr.exists(|expr| {
            Ok(matches!(expr, Expr::ScalarFunction(call) if [contains::NAME, related::NAME].contains(&call.name())))
        })
    };
    let mut found = false;
    plan.apply_with_subqueries(|node| {
        node.apply_expressions(|expr| {
            found = found || calls(expr)?;
            Ok(TreeNodeRecursion::Continue)
        })
    })?;
    Ok(found)
}

/// The classes that the views of a map have, and those of the images that they were made from, which may never have shown
/// some; empty without a class index.
async fn known_classes(
    context: &SessionContext,
    leaves: Option<&SessionContext>,
) -> Result<BTreeSet<String>> {
    let Some(leaves) = leaves else {
        return Ok(BTreeSet::new());
    };
    let shown = "SELECT DISTINCT site, entry['class'] FROM (SELECT site, unnest(counts) AS entry FROM class_index)";
    let mut classes = texts(leaves, shown).await?;
    if context.table_exist(TableReference::bare(LabelImage::NAME))? {
        let known = "SELECT DISTINCT site, unnest(classes) FROM label_images";
        classes.extend(texts(context, known).await?);
    }
    Ok(classes.into_iter().map(|[_, class]| class).collect())
}

/// A context with the class index alone, where it is of just these views.
async fn leaves(context: &SessionContext, of: &Names) -> Result<Option<SessionContext>> {
    let leaves = Door::to(context, ClassLeaf::NAME).await?;
    let leaves = leaves.alone(context)?;
    let indexed = names(
        &leaves,
        "SELECT site, unnest(views) AS view FROM class_index",
    )
    .await?;
    Ok((indexed == *of).then_some(leaves))
}

/// The rule.
struct ByIndex {
    /// The layer that the indexes are of.
    views: Views,
    /// A context with the class index alone.
    leaves: Option<SessionContext>,
    /// The classes that there are; empty where that is not known.
    classes: BTreeSet<String>,
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
        let Some(asked) = IndexableCall::of(&expr) else {
            return Ok(Transformed::no(expr));
        };
        let (graph, classes) = asked.of_what();
        let Some(table) = graph
            .relation
            .as_ref()
            .filter(|table| self.views.are(input, table))
        else {
            return Ok(Transformed::no(expr));
        };
        classes.iter().try_for_each(|class| self.know(class))?;
        let view = Expr::Column(Column::new(Some(table.clone()), "view"));
        let Some(views) = self.answer(asked)? else {
            return Ok(Transformed::no(expr));
        };
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

    /// Refuses a class that there is not: it is misspelt, and no row would be the answer.
    fn know(&self, class: &str) -> Result<()> {
        if self.classes.is_empty() || self.classes.contains(class) {
            return Ok(());
        }
        let known: Vec<&str> = self.classes.iter().map(String::as_str).collect();
        plan_err!(
            "no view of this map has the class `{class}`; its classes are {}",
            known.join(", ")
        )
    }

    /// The query of the views for which a call is true, where an index answers it.
    fn answer(&self, asked: IndexableCall) -> Result<Option<LogicalPlan>> {
        match asked {
            IndexableCall::Contains(_, class, least) => {
                let leaves = self.leaves.as_ref();
                leaves
                    .map(|leaves| showing(leaves, &class, least))
                    .transpose()
            }
            IndexableCall::Related(_, relating) => {
                let index = self.relations.as_ref();
                index
                    .map(|index| relations::plan(index, relating))
                    .transpose()
            }
        }
    }
}

/// A call on a column of graphs that an index can answer.
enum IndexableCall {
    /// `contains(graph, 'class' [, count])` whose count is at least 1.
    Contains(Column, String, i64),
    /// `related(graph, 'class', 'relation', 'class')`.
    Related(Column, Relating),
}

impl IndexableCall {
    fn of(expr: &Expr) -> Option<Self> {
        let contains = contains(expr);
        let contains = contains.map(|(graph, class, least)| Self::Contains(graph, class, least));
        let related = || relations::asked(expr).map(|(graph, asked)| Self::Related(graph, asked));
        contains.or_else(related)
    }

    /// The column of graphs, and the classes that are asked for.
    fn of_what(&self) -> (Column, Vec<String>) {
        match self {
            Self::Contains(graph, class, _) => (graph.clone(), vec![class.clone()]),
            Self::Related(graph, (class, _, other)) => {
                (graph.clone(), vec![class.clone(), other.clone()])
            }
        }
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

/// A text that stands in a query.
fn text(value: &Expr) -> Option<&str> {
    value.as_literal()?.try_as_str()?
}

/// The column, class and count of a call `contains(graph, 'class' [, count])` whose count is at least 1.
fn contains(expr: &Expr) -> Option<(Column, String, i64)> {
    let Expr::ScalarFunction(call) = expr else {
        return None;
    };
    if call.func.name() != contains::NAME {
        return None;
    }
    let [Expr::Column(graph), class, count @ ..] = call.args.as_slice() else {
        return None;
    };
    let class = text(class)?.to_owned();
    let least = match count {
        [] => 1,
        [Expr::Literal(ScalarValue::Int64(Some(least)), _)] => *least,
        _ => return None,
    };
    (graph.name == "graph" && least >= 1).then(|| (graph.clone(), class, least))
}
