//! Units and frames of what a context answers: those of a map's layers are where its files and declarations are.

use std::collections::HashMap;
use std::sync::Arc;

use arrow::datatypes::SchemaRef;
use datafusion::common::TableReference;
use datafusion::logical_expr::LogicalPlan;
use datafusion::prelude::SessionContext;
use evermap_schemas::Fault;

use crate::conform::with_metadata;
use crate::map::catalog::tables_of;
use crate::sql::described::{Origin, described, origin};
use crate::sql::table_of;

/// The columns of a table of a context, with units and frames.
///
/// # Errors
/// As [`table_of`].
pub async fn of_table(context: &SessionContext, table: TableReference) -> Result<SchemaRef, Fault> {
    let rows = table_of(context, table.clone()).await?;
    let schema = context.state().schema_for_ref(table.clone()).ok();
    let described = match schema.as_deref().and_then(tables_of) {
        Some(tables) => tables.described(table.table()).await?,
        None => None,
    };
    Ok(described.unwrap_or_else(|| rows.schema()))
}

/// The columns of an answer as they come, with units and frames as far as they are columns of tables. Names and types are
/// those of the rows that come: a plan has those from before it makes the sides of operators alike.
pub async fn of_answer(
    context: &SessionContext,
    plan: &LogicalPlan,
    coming: &SchemaRef,
) -> SchemaRef {
    let mut tables: HashMap<TableReference, SchemaRef> = HashMap::new();
    // Rows of logs say it themselves.
    let is_silent = |found: &Origin| found.column.metadata().is_empty();
    for index in 0..plan.schema().fields().len() {
        if let Some(found) = origin(plan, index).filter(is_silent)
            && !tables.contains_key(&found.table)
            && let Ok(table) = of_table(context, found.table.clone()).await
        {
            tables.insert(found.table, table);
        }
    }
    let described = described(plan, |found| {
        let table = tables.get(&found.table).filter(|_| is_silent(found))?;
        let (_, column) = table.fields().find(found.column.name())?;
        Some(Arc::clone(column))
    });
    with_metadata(coming, |index, _| {
        let described = described.fields().get(index);
        described.map_or_else(HashMap::new, |column| column.metadata().clone())
    })
}
