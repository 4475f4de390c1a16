//! Contexts that queries run in, and what the engine must know of a query before running it.

mod arguments;
pub mod as_of;
mod asked;
mod associated;
mod balanced;
mod bounded;
mod compared;
pub mod described;
mod expanded;
mod floats;
mod inlined;
mod joined;
mod lengths;
mod literals;
mod measures;
mod members;
mod membership;
mod merge_joins;
mod misread;
mod missing;
mod named;
mod overflow;
mod paused;
mod peers;
mod pool;
mod size;
mod statement_text;
mod term;
mod volatile;
mod widths;
mod zone;

use std::collections::HashSet;
use std::sync::Arc;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use datafusion::catalog::{CatalogProvider, MemorySchemaProvider, TableProvider};
use datafusion::common::{DFSchema, TableReference};
use datafusion::datasource::MemTable;
use datafusion::error::Result as DataFusionResult;
use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::execution::{SessionState, SessionStateBuilder};
use datafusion::logical_expr::{DescribeTable, LogicalPlan};
use datafusion::prelude::{DataFrame, SessionConfig, SessionContext};
use datafusion::sql::parser::Statement;
use datafusion::sql::sqlparser::ast::{self, DescribeAlias};
use datafusion::sql::sqlparser::dialect::GenericDialect;
use evermap_language::Input;
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};

use crate::error::{OrFault, external};
use crate::nodes::light::LightBatches;
use crate::sql::arguments::check_arguments;
use crate::sql::asked::{Operators, asking};
use crate::sql::associated::associated;
use crate::sql::balanced::balanced;
use crate::sql::bounded::{BYTES_PER_BATCH_ROW, bound_functions};
use crate::sql::compared::compare_values;
use crate::sql::expanded::check_expanded;
use crate::sql::floats::sound_floats;
use crate::sql::inlined::check_inlined;
use crate::sql::joined::joined;
use crate::sql::lengths::measure_intervals;
use crate::sql::literals::check_literals;
use crate::sql::members::{Members, check_members, mask_members};
use crate::sql::membership::three_valued;
use crate::sql::merge_joins::{MergeKeys, OuterConditions};
use crate::sql::misread::check_misread;
use crate::sql::named::named_apart;
use crate::sql::overflow::check_overflow;
use crate::sql::paused::Pauses;
use crate::sql::peers::range_by_peers;
use crate::sql::statement_text::StatementText;
use crate::sql::term::go_on;
use crate::sql::widths::check_widths;

pub use missing::{NO_TABLE, Unlisted, explained, no_table, table_of};
pub use pool::runtime;
pub use size::{QUERY_WORDS, STACK_BYTES, check_size};
pub use term::Term;
pub use volatile::{OpenValues, only_reads, volatile_functions};
pub use zone::in_utc;

/// What an engine process may use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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
            memory_bytes: 4 << 30,
            partitions,
        }
    }
}

impl Limits {
    /// The default, with everything in one partition: rows keep their order.
    pub fn one_partition() -> Self {
        Self {
            partitions: 1,
            ..Self::default()
        }
    }
}

/// The catalog of the tables of a context that has no other name for it.
const CATALOG: &str = "evermap";

/// The schema of the tables that a query names without one.
pub const TABLES: &str = "public";

/// Rows per batch, unless rows are heavy or memory is short.
pub const BATCH_ROWS: usize = 8192;

/// Rows per batch at least.
const MIN_BATCH_ROWS: usize = 64;

/// A DataFusion context as all of evermap uses it: plain string types, a bounded memory pool, the functions on map layers,
/// integers that do not wrap, NaN that is the greatest number. Where memory is short, batches are small and joins merge;
/// units, whose results must not depend on it, take [`context_with`].
///
/// # Errors
/// A resource fault when the runtime cannot be set up.
pub fn context(limits: Limits) -> Result<SessionContext, Fault> {
    context_on(CATALOG, runtime(limits)?, limits)
}

/// As [`context`], with a name for the catalog of its tables, in memory that it shares with the other contexts of a
/// runtime.
///
/// # Errors
/// As [`context`].
pub fn context_on(
    catalog: &str,
    runtime: Arc<RuntimeEnv>,
    limits: Limits,
) -> Result<SessionContext, Fault> {
    let rows = limits.memory_bytes / BYTES_PER_BATCH_ROW;
    let rows_per_batch = rows.clamp(MIN_BATCH_ROWS, BATCH_ROWS);
    let context = context_of(catalog, runtime, limits, rows_per_batch)?;
    if rows < BATCH_ROWS {
        // Joins by hashing keep one side whole; by merging they spill.
        let state = context.state_ref();
        let mut state = state.write();
        state.config_mut().options_mut().optimizer.prefer_hash_join = false;
    }
    Ok(context)
}

/// As [`context`], with so many rows per batch.
///
/// # Errors
/// As [`context`].
pub fn context_with(limits: Limits, batch_rows: usize) -> Result<SessionContext, Fault> {
    context_of(CATALOG, runtime(limits)?, limits, batch_rows)
}

/// A context with the settings and limits of another, and without its tables.
pub(crate) fn beside(context: &SessionContext) -> SessionContext {
    SessionContext::new_with_config_rt(context.copied_config(), context.runtime_env())
}

/// The catalog of a context's tables.
///
/// # Errors
/// A fault of ours.
pub fn catalog(context: &SessionContext) -> Result<Arc<dyn CatalogProvider>, Fault> {
    let name = catalog_name(context);
    let catalog = context.catalog(&name);
    catalog.ok_or_else(|| Fault::bug(format!("there is no catalog `{name}`")))
}

/// What [`catalog`] is called.
pub fn catalog_name(context: &SessionContext) -> String {
    let config = context.copied_config();
    config.options().catalog.default_catalog.clone()
}

fn context_of(
    catalog_name: &str,
    runtime: Arc<RuntimeEnv>,
    limits: Limits,
    batch_rows: usize,
) -> Result<SessionContext, Fault> {
    let mut config = SessionConfig::new()
        .with_target_partitions(limits.partitions.max(1))
        .with_default_catalog_and_schema(catalog_name, TABLES)
        .with_information_schema(true)
        .with_batch_size(batch_rows);
    let options = config.options_mut();
    let merging = &mut options.execution.sort_spill_reservation_bytes;
    *merging = (*merging).min(limits.memory_bytes / (8 * limits.partitions.max(1)));
    options.execution.parquet.schema_force_view_types = false;
    options.execution.parquet.pushdown_filters = true;
    // The two planners differ in whether a CASE may be null, which no row depends on.
    options.execution.skip_physical_aggregate_schema_check = true;
    // A node that a query reads twice runs twice: of files that its partitions share, the second run would find none.
    options.execution.enable_file_stream_work_stealing = false;
    options.sql_parser.map_string_types_to_utf8view = false;
    options.sql_parser.collect_spans = true;
    // The rule fails where a join's key is made of a member (apache/datafusion#22895, #24241).
    options.optimizer.enable_leaf_expression_pushdown = false;
    let state = SessionStateBuilder::new()
        .with_config(config)
        .with_runtime_env(runtime)
        // Of planners the first that has a plan is heard, so those of DataFusion come behind.
        .with_expr_planners(vec![
            Arc::new(Operators),
            Arc::new(Members),
            evermap_functions::extracts(),
        ])
        .with_default_features()
        .with_query_planner(Arc::new(as_of::Planner))
        .with_optimizer_rule(Arc::new(MergeKeys))
        .with_physical_optimizer_rule(Arc::new(OuterConditions))
        .with_physical_optimizer_rule(Arc::new(LightBatches))
        .with_physical_optimizer_rule(Arc::new(Pauses));
    let context = SessionContext::new_with_state(asking(state).build());
    context
        .register_relation_planner(Arc::new(as_of::Relations))
        .or_fault()?;
    let catalog = catalog(&context)?;
    for schema in ["previous", "new"] {
        let tables = Arc::new(MemorySchemaProvider::new());
        catalog.register_schema(schema, tables).or_fault()?;
    }
    evermap_functions::register(&context);
    bound_functions(&context, limits.memory_bytes).or_fault()?;
    mask_members(&context).or_fault()?;
    sound_floats(&context).or_fault()?;
    check_overflow(&context).or_fault()?;
    measure_intervals(&context).or_fault()?;
    range_by_peers(&context).or_fault()?;
    compare_values(&context);
    check_arguments(&context).or_fault()?;
    Ok(context)
}

/// The name in a context of what a plan reads.
pub fn reference(input: &Input) -> TableReference {
    match input {
        Input::Step(name) | Input::Source(name) => TableReference::bare(name.clone()),
        Input::Previous(name) => TableReference::partial("previous", name.clone()),
        Input::New(name) => TableReference::partial("new", name.clone()),
    }
}

/// The columns of what a plan reads, where a context has it.
pub async fn schema_of(context: &SessionContext, input: &Input) -> Option<SchemaRef> {
    let table = context.table_provider(reference(input)).await;
    table.ok().map(|table| table.schema())
}

/// Makes a table what a plan reads under this name, in place of what was that before.
///
/// # Errors
/// A fault of ours.
pub fn put(
    context: &SessionContext,
    input: &Input,
    table: Arc<dyn TableProvider>,
) -> Result<(), Fault> {
    let reference = reference(input);
    context.deregister_table(reference.clone()).or_fault()?;
    context
        .register_table(reference, table)
        .map(drop)
        .or_fault()
}

/// As [`put`], with rows.
///
/// # Errors
/// As [`put`].
pub fn put_rows(context: &SessionContext, input: &Input, rows: RecordBatch) -> Result<(), Fault> {
    let table = MemTable::try_new(rows.schema(), vec![vec![rows]]).or_fault()?;
    put(context, input, Arc::new(table))
}

/// Plans a query. Only queries: nothing that would change a table, a file or a setting.
///
/// # Errors
/// A user fault for what is no query, is too large, does not plan or leaves values open.
pub async fn read_only(context: &SessionContext, query: &str) -> Result<DataFrame, Fault> {
    let planned = planned(context, query).await.or_fault();
    let frame = planned.map_err(|fault| explained(context, fault))?;
    OpenValues::refuse(frame.logical_plan())?;
    Ok(frame)
}

/// As [`read_only`], with the error of DataFusion, and values left open.
///
/// # Errors
/// As [`read_only`].
pub async fn planned(context: &SessionContext, query: &str) -> DataFusionResult<DataFrame> {
    check_size(query, &GenericDialect {}).map_err(external)?;
    let state = context.state();
    let dialect = state.config().options().sql_parser.dialect;
    let statement = state.sql_to_statement(query, &dialect)?;
    let plan = plan_of(&state, statement).await?;
    only_reads(&plan)?;
    context.execute_logical_plan(plan).await
}

/// The plan of a statement.
///
/// # Errors
/// What is wrong with it; that it is small, and would become too large.
pub async fn plan_of(state: &SessionState, statement: Statement) -> DataFusionResult<LogicalPlan> {
    match described_query(&statement) {
        Some(query) => columns_of(state, plan_of_one(state, query).await?),
        None => plan_of_one(state, statement).await,
    }
}

/// The query that a statement wants described: `DESCRIBE SELECT …`.
fn described_query(statement: &Statement) -> Option<Statement> {
    let Statement::Statement(statement) = statement else {
        return None;
    };
    match statement.as_ref() {
        ast::Statement::Explain {
            describe_alias: DescribeAlias::Describe | DescribeAlias::Desc,
            statement: query,
            ..
        } if matches!(query.as_ref(), ast::Statement::Query(_)) => {
            Some(Statement::Statement(query.clone()))
        }
        _ => None,
    }
}

/// The columns of a plan's rows with the types that they come with: both sides of operators made alike. The plan itself
/// has those from before.
///
/// # Errors
/// That they are not made alike.
pub fn coming(state: &SessionState, plan: LogicalPlan) -> DataFusionResult<SchemaRef> {
    let analyzer = state.analyzer();
    let plan = analyzer.execute_and_check(plan, state.config_options(), |_, _| {})?;
    Ok(Arc::new(plan.schema().as_arrow().clone()))
}

/// The columns of a plan's rows as rows.
fn columns_of(state: &SessionState, plan: LogicalPlan) -> DataFusionResult<LogicalPlan> {
    let output_schema = DFSchema::try_from(LogicalPlan::describe_schema())?;
    Ok(LogicalPlan::DescribeTable(DescribeTable {
        schema: coming(state, plan)?,
        output_schema: Arc::new(output_schema),
    }))
}

async fn plan_of_one(
    state: &SessionState,
    mut statement: Statement,
) -> DataFusionResult<LogicalPlan> {
    let mut written = StatementText::default();
    if let Some(sql) = sql_of(&mut statement) {
        check_expanded(sql).map_err(external)?;
        written = StatementText::of(sql).map_err(external)?;
        check_misread(sql).map_err(external)?;
        associated(sql);
        balanced(sql);
        joined(sql).map_err(external)?;
        as_of::bracketed(sql);
        named_apart(sql);
    }
    let plan = state.statement_to_plan(statement).await;
    let plan = plan.map_err(|error| written.explained(error))?;
    let checks = [check_members, check_inlined, check_widths];
    for check in checks {
        go_on()?;
        check(&plan)?;
    }
    check_literals(&plan, &written)?;
    go_on()?;
    three_valued(plan)
}

/// What a statement says in SQL, of `EXPLAIN` what it explains; `None` for what is none.
fn sql_of(statement: &mut Statement) -> Option<&mut ast::Statement> {
    match statement {
        Statement::Statement(sql) => Some(sql.as_mut()),
        Statement::Explain(explain) => sql_of(&mut explain.statement),
        _ => None,
    }
}

/// The tables that a query reads, as a plan names its inputs: `poses`, `/odom`, `previous.lanes`.
///
/// # Errors
/// The parser's.
pub fn tables(query: &str) -> DataFusionResult<Vec<String>> {
    check_size(query, &GenericDialect {}).map_err(external)?;
    let state = SessionContext::new().state();
    let dialect = state.config().options().sql_parser.dialect;
    let statement = state.sql_to_statement(query, &dialect)?;
    let references = state.resolve_table_references(&statement)?;
    let name = |reference: TableReference| match reference.schema() {
        Some(schema) => format!("{schema}.{}", reference.table()),
        None => reference.table().to_owned(),
    };
    Ok(references.into_iter().map(name).collect())
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
mod tests;
