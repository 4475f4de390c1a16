//! What the engine must know of a query before running it: which tables it reads, and how little of the map each
//! piece of its result depends on.

use std::collections::HashSet;
use std::sync::Arc;

use datafusion::common::Column;
use datafusion::common::tree_node::{TreeNode, TreeNodeRecursion};
use datafusion::error::DataFusionError;
use datafusion::execution::memory_pool::FairSpillPool;
use datafusion::execution::runtime_env::RuntimeEnvBuilder;
use datafusion::logical_expr::utils::split_conjunction;
use datafusion::logical_expr::{BinaryExpr, Distinct, Expr, Join, LogicalPlan, Operator};
use datafusion::prelude::{DataFrame, SQLOptions, SessionConfig, SessionContext};
use evermap_schemas::Fault;

use crate::error::fault_of;

/// What an engine process may use.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Bytes that sorts, joins and decoded chunks may hold before they spill or fail.
    pub memory_bytes: usize,
    /// Partitions that one unit's plan is cut into.
    pub partitions: usize,
}

impl Default for Limits {
    fn default() -> Self {
        let partitions = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Self {
            memory_bytes: 1 << 30,
            partitions,
        }
    }
}

/// Rows per batch, unless rows are heavy.
pub const BATCH_ROWS: usize = 8192;

/// A DataFusion context as all of evermap uses it: plain string types, a bounded memory pool.
///
/// # Errors
/// A resource fault when the runtime cannot be set up.
pub fn context(limits: Limits) -> Result<SessionContext, Fault> {
    context_with(limits, BATCH_ROWS)
}

/// As [`context`], with so many rows per batch.
///
/// # Errors
/// As [`context`].
pub fn context_with(limits: Limits, batch_rows: usize) -> Result<SessionContext, Fault> {
    let mut config = SessionConfig::new()
        .with_target_partitions(limits.partitions.max(1))
        .with_information_schema(true)
        .with_batch_size(batch_rows);
    let options = config.options_mut();
    options.execution.parquet.schema_force_view_types = false;
    options.execution.parquet.pushdown_filters = true;
    options.sql_parser.map_string_types_to_utf8view = false;
    let runtime = RuntimeEnvBuilder::new()
        .with_memory_pool(Arc::new(FairSpillPool::new(limits.memory_bytes)))
        .build_arc()
        .map_err(|error| fault_of(&error))?;
    Ok(SessionContext::new_with_config_rt(config, runtime))
}

/// Plans a query. Only queries: nothing that would change a table, a file or a setting.
///
/// # Errors
/// A user fault for what is no query or does not plan.
pub async fn read_only(context: &SessionContext, query: &str) -> Result<DataFrame, Fault> {
    let options = SQLOptions::new()
        .with_allow_ddl(false)
        .with_allow_dml(false)
        .with_allow_statements(false);
    let frame = context.sql_with_options(query, options).await;
    frame.map_err(|error| fault_of(&error))
}

/// The tables that a query reads, as a plan names its inputs: `poses`, `/odom`, `previous.lanes`.
///
/// # Errors
/// The parser's sentence.
pub fn tables(query: &str) -> Result<Vec<String>, String> {
    let state = SessionContext::new().state();
    let dialect = state.config().options().sql_parser.dialect;
    let statement = state
        .sql_to_statement(query, &dialect)
        .map_err(|error| fault_of(&error).message)?;
    let references = state
        .resolve_table_references(&statement)
        .map_err(|error| fault_of(&error).message)?;
    let mut names = Vec::new();
    for reference in references {
        let name = match reference.schema() {
            Some(schema) => format!("{schema}.{}", reference.table()),
            None => reference.table().to_owned(),
        };
        if !names.contains(&name) {
            names.push(name);
        }
    }
    Ok(names)
}

/// Whether every row of the result depends only on rows with the same value of `column` (`session`, `site`), so that
/// the query may run on each value's rows apart and the results be put together. Errs on the side of no.
pub fn is_local(plan: &LogicalPlan, column: &str) -> bool {
    let mut local = has(plan, column);
    let walked = plan.apply(|node| {
        local &= node_is_local(node, column) && !has_subquery(node);
        Ok::<_, DataFusionError>(if local {
            TreeNodeRecursion::Continue
        } else {
            TreeNodeRecursion::Stop
        })
    });
    local && walked.is_ok()
}

fn node_is_local(node: &LogicalPlan, column: &str) -> bool {
    match node {
        LogicalPlan::TableScan(_) | LogicalPlan::SubqueryAlias(_) | LogicalPlan::Filter(_) => {
            has(node, column)
        }
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
        _ => false,
    }
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
    let mut found = false;
    let _ = node.apply_expressions(|expr| {
        expr.apply(|expr| {
            found |= matches!(
                expr,
                Expr::ScalarSubquery(_) | Expr::InSubquery(_) | Expr::Exists(_)
            );
            Ok::<_, DataFusionError>(TreeNodeRecursion::Continue)
        })
    });
    found
}

/// Whether the query itself orders its rows.
pub fn is_ordered(plan: &LogicalPlan) -> bool {
    match plan {
        LogicalPlan::Sort(_) => true,
        LogicalPlan::Projection(_) | LogicalPlan::Limit(_) | LogicalPlan::SubqueryAlias(_) => {
            plan.inputs().first().is_some_and(|input| is_ordered(input))
        }
        _ => false,
    }
}

/// Names that occur twice, which a stored table cannot have.
pub fn repeated_columns(plan: &LogicalPlan) -> Vec<String> {
    let mut seen = HashSet::new();
    plan.schema()
        .fields()
        .iter()
        .filter(|field| !seen.insert(field.name()))
        .map(|field| field.name().clone())
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
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
        ];
        for (query, expected) in cases {
            assert_eq!(is_local(&plan(query).await, "session"), expected, "{query}");
        }
    }

    #[test]
    fn tables_are_named_as_a_plan_names_them() {
        let query =
            r#"WITH a AS (SELECT * FROM poses) SELECT * FROM a, "/odom", previous.lanes, poses"#;
        assert_eq!(tables(query).unwrap(), ["/odom", "poses", "previous.lanes"]);
        assert!(tables("SELEC").is_err());
    }
}
