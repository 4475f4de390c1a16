//! `related` on the layer `views`, answered by the layer `relation_index`.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use arrow::array::{ArrayRef, AsArray, RecordBatch, StringArray};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use datafusion::catalog::streaming::StreamingTable;
use datafusion::common::{Column, DataFusionError, Result, TableReference};
use datafusion::datasource::provider_as_source;
use datafusion::execution::{SendableRecordBatchStream, TaskContext};
use datafusion::logical_expr::{Expr, LogicalPlan, LogicalPlanBuilder};
use datafusion::physical_plan::stream::RecordBatchStreamAdapter;
use datafusion::physical_plan::streaming::PartitionStream;
use datafusion::prelude::SessionContext;
use evermap_algorithms::semantic_map::relation_index::ViewSet;
use evermap_algorithms::semantic_map::semantic_graph::Relation;
use evermap_schemas::LayerRow;
use evermap_schemas::layers::RelatedViews;

use super::door::Door;
use super::names::{Names, digests, texts};
use super::text;
use crate::related;

/// One class, how it lies, and another class.
pub(super) type Relating = (String, Relation, String);

/// The index of a map's views, read when it is first asked.
pub(super) struct RelationIndex {
    door: Arc<Door>,
    /// A context with the index alone.
    rows: SessionContext,
    names: Names,
    read: OnceLock<Sets>,
}

/// For what is related, the views of each site.
type Sets = BTreeMap<Relating, Vec<(String, ViewSet)>>;

impl RelationIndex {
    /// The index of a context, where it is of just these views.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(super) async fn of(context: &SessionContext, names: Names) -> Result<Option<Self>> {
        let door = Door::to(context, RelatedViews::NAME).await?;
        let rows = door.alone(context)?;
        let said = texts(&rows, "SELECT DISTINCT site, names FROM relation_index").await?;
        let number = said.len();
        let said: BTreeMap<String, String> = said.into_iter().map(|[s, n]| (s, n)).collect();
        // Two digests of one site are of views that cannot both be these.
        let same = said.len() == number && said == digests(&names);
        Ok(same.then(|| Self {
            door,
            rows,
            names,
            read: OnceLock::new(),
        }))
    }

    /// The names of the views in which this is so, site by site in their order.
    ///
    /// # Errors
    /// When the index cannot be opened or read, or has other bits than its views.
    pub(super) async fn views(&self, asked: &Relating) -> Result<StringArray> {
        // What was read stays, and is not answered from where the layer is not what it was.
        self.door.opened().await?;
        let sets = match self.read.get() {
            Some(sets) => sets,
            None => {
                let sets = self.sets().await?;
                self.read.get_or_init(|| sets)
            }
        };
        let of_sites = sets.get(asked).into_iter().flatten();
        let views: Vec<&String> = of_sites
            .flat_map(|(site, set)| {
                let names = self.names.get(site).map_or(&[][..], Vec::as_slice);
                set.iter().filter_map(|view| names.get(view as usize))
            })
            .collect();
        Ok(StringArray::from_iter_values(views))
    }

    async fn sets(&self) -> Result<Sets> {
        let query = "SELECT site, class, relation, other, views FROM relation_index";
        let mut sets = Sets::new();
        for batch in self.rows.sql(query).await?.collect().await? {
            let of = |column: usize, kind| cast(batch.column(column), &kind);
            let texts: Vec<ArrayRef> = (0..4)
                .map(|column| of(column, DataType::Utf8))
                .collect::<Result<_, _>>()?;
            let views = of(4, DataType::Binary)?;
            let views = views.as_binary::<i32>();
            for row in 0..batch.num_rows() {
                let text = |column: usize| texts[column].as_string::<i32>().value(row);
                let relation = Relation::parse(text(2))
                    .map_err(|error| DataFusionError::Execution(error.to_string()))?;
                let names = self.names.get(text(0)).map_or(0, Vec::len);
                let set = ViewSet::from_bytes(views.value(row), names).ok_or_else(|| {
                    DataFusionError::Execution(format!(
                        "relation_index: expected a bit for each of {names} views, found {} bytes",
                        views.value(row).len()
                    ))
                })?;
                let asked = (text(1).to_owned(), relation, text(3).to_owned());
                sets.entry(asked)
                    .or_default()
                    .push((text(0).to_owned(), set));
            }
        }
        Ok(sets)
    }
}

/// The views in which something is so, as a table of their names.
struct MatchingViews {
    index: Arc<RelationIndex>,
    asked: Relating,
    schema: SchemaRef,
}

impl std::fmt::Debug for MatchingViews {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "relation_index {:?}", self.asked)
    }
}

impl PartitionStream for MatchingViews {
    fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    fn execute(&self, _: Arc<TaskContext>) -> SendableRecordBatchStream {
        let (index, asked) = (Arc::clone(&self.index), self.asked.clone());
        let schema = Arc::clone(&self.schema);
        let rows = async move {
            let views = index.views(&asked).await?;
            Ok(RecordBatch::try_new(schema, vec![Arc::new(views)])?)
        };
        let schema = Arc::clone(&self.schema);
        Box::pin(RecordBatchStreamAdapter::new(
            schema,
            futures::stream::once(rows),
        ))
    }
}

/// The names of the views in which this is so, as a query that asks the index.
pub(super) fn plan(index: &Arc<RelationIndex>, asked: Relating) -> Result<LogicalPlan> {
    // Scans of one name are taken for the same, so each is named by what it asks.
    let (class, relation, other) = &asked;
    let name = format!("{} {class:?} {relation} {other:?}", RelatedViews::NAME);
    let fields = vec![Field::new("view", DataType::Utf8, false)];
    let schema = Arc::new(Schema::new(fields));
    let found = MatchingViews {
        index: Arc::clone(index),
        asked,
        schema: Arc::clone(&schema),
    };
    let table = StreamingTable::try_new(schema, vec![Arc::new(found)])?;
    let source = provider_as_source(Arc::new(table));
    LogicalPlanBuilder::scan(TableReference::bare(name), source, None)?.build()
}

/// What a call `related(graph, 'class', 'relation', 'other')` asks; `None` for one that graphs must answer.
pub(super) fn asked(expr: &Expr) -> Option<(Column, Relating)> {
    let Expr::ScalarFunction(call) = expr else {
        return None;
    };
    if call.func.name() != related::NAME {
        return None;
    }
    let [Expr::Column(graph), class, relation, other] = call.args.as_slice() else {
        return None;
    };
    // A word that is no relation is told by the function.
    let relation = Relation::parse(text(relation)?).ok()?;
    let [class, other] = [class, other].map(|word| text(word).map(str::to_owned));
    (graph.name == "graph").then_some((graph.clone(), (class?, relation, other?)))
}
