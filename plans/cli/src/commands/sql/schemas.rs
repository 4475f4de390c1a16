//! The tables of sessions as schemas of their names.

use std::collections::BTreeMap;
use std::sync::Arc;

use datafusion::catalog::{MemorySchemaProvider, SchemaProvider, TableProvider};
use datafusion::prelude::SessionContext;
use evermap_datasets::Dataset;
use evermap_engine::error::OrFault;
use evermap_engine::sql::catalog;
use evermap_language::listed;
use evermap_schemas::Fault;

use crate::progress::line;

/// A schema of these tables.
///
/// # Errors
/// A fault of ours.
fn schema_of(
    tables: BTreeMap<String, Arc<dyn TableProvider>>,
) -> Result<Arc<MemorySchemaProvider>, Fault> {
    let schema = MemorySchemaProvider::new();
    for (name, table) in tables {
        schema.register_table(name, table).or_fault()?;
    }
    Ok(Arc::new(schema))
}

/// The tables of a session beside a map: a topic that is called as a role goes before it, and that is said.
///
/// # Errors
/// A fault of ours.
pub(super) fn schema_of_session(alone: &Dataset) -> Result<Arc<MemorySchemaProvider>, Fault> {
    let (mut tables, hidden) = (alone.tables()?, alone.hidden_topics());
    if hidden.is_empty() {
        return schema_of(tables);
    }
    for session in &alone.sessions {
        for topic in &hidden {
            line(&format!(
                "note: \"{}\".\"{topic}\" is the topic, not what every log has under that name",
                session.name
            ));
        }
    }
    tables.extend(alone.topic_tables());
    schema_of(tables)
}

/// Makes topics that are called as a role, `odometry`, tables of a schema of their session's name, and says so.
///
/// # Errors
/// A fault of ours.
pub(super) fn add_hidden_topics(context: &SessionContext, dataset: &Dataset) -> Result<(), Fault> {
    let catalog = catalog(context)?;
    for session in &dataset.sessions {
        let (name, alone) = (&*session.name, dataset.of_session(session));
        let hidden = alone.hidden_topics();
        if hidden.is_empty() {
            continue;
        }
        if catalog.schema(name).is_some() {
            let hidden = listed(hidden.iter().map(String::as_str));
            line(&format!(
                "note: topics {hidden} of session {name} are called as what every log has, and the session as a schema: give \
                 it another name in a manifest"
            ));
            continue;
        }
        let tables = schema_of(alone.topic_tables())?;
        catalog.register_schema(name, tables).or_fault()?;
        for topic in hidden {
            line(&format!(
                "note: {topic} in a query is what every log has, not the topic: that is \"{name}\".\"{topic}\""
            ));
        }
    }
    Ok(())
}
