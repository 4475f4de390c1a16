//! A map as a catalog: its layers at the version that was asked for, those of every other version as schemas `v1`, `v2` …,
//! and the logs of its sessions as schemas of their names.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use async_trait::async_trait;
use datafusion::catalog::{CatalogProvider, SchemaProvider, TableProvider};
use datafusion::error::Result;
use datafusion::prelude::SessionContext;
use datafusion::sql::parser::Statement as Parsed;
use datafusion::sql::sqlparser::ast::Statement;
use evermap_schemas::Fault;
use tokio::sync::OnceCell;

use crate::error::{OrFault, external};
use crate::locked::locked;
use crate::map::logs::LogTables;
use crate::map::tables::Tables;

/// The schemas of a map.
#[derive(Debug)]
pub struct Catalog {
    /// The schemas that have names of their own.
    named: Arc<dyn CatalogProvider>,
    tables: Arc<Tables>,
    /// The versions that queries named.
    versions: Mutex<BTreeMap<u64, Arc<VersionTables>>>,
}

impl Catalog {
    /// The catalog of the map of these tables, beside the schemas of another one.
    pub fn new(named: Arc<dyn CatalogProvider>, tables: Arc<Tables>) -> Self {
        Self {
            named,
            tables,
            versions: Mutex::default(),
        }
    }

    fn version(&self, number: u64) -> Arc<VersionTables> {
        let mut versions = locked(&self.versions);
        let version = versions.entry(number).or_insert_with(|| {
            Arc::new(VersionTables {
                number,
                beside: Arc::clone(&self.tables),
                opened: OnceCell::new(),
            })
        });
        Arc::clone(version)
    }
}

/// The tables of a map that a schema has; `None` where it has others, or is of a version that nobody has opened.
pub fn tables_of<'s>(schema: &'s (dyn SchemaProvider + 'static)) -> Option<&'s Tables> {
    match schema.downcast_ref::<VersionTables>() {
        Some(version) => version.opened.get(),
        None => schema.downcast_ref(),
    }
}

/// Whether a statement that was planned before would be planned the same way now. Its tables are asked for, as who plans it does:
/// so the files of layers are looked at. Logs and what functions make of a map are opened by planning alone.
///
/// # Errors
/// What asking for a table says: that its layer's files are not what was written.
pub async fn is_as_planned(context: &SessionContext, statement: &Statement) -> Result<bool, Fault> {
    let state = context.state();
    let statement = Parsed::Statement(Box::new(statement.clone()));
    for reference in state.resolve_table_references(&statement).or_fault()? {
        let name = reference.table().to_owned();
        let Ok(schema) = state.schema_for_ref(reference) else {
            return Ok(false);
        };
        let is_log = schema.is::<LogTables>();
        if is_log || schema.table(&name).await.or_fault()?.is_none() {
            return Ok(false);
        }
    }
    Ok(true)
}

impl CatalogProvider for Catalog {
    fn schema_names(&self) -> Vec<String> {
        self.named.schema_names()
    }

    fn schema(&self, name: &str) -> Option<Arc<dyn SchemaProvider>> {
        self.named
            .schema(name)
            .or_else(|| {
                let number = name.strip_prefix('v')?.parse().ok()?;
                Some(self.version(number))
            })
            .or_else(|| Some(Arc::new(self.tables.log(name)?)))
    }

    fn register_schema(
        &self,
        name: &str,
        schema: Arc<dyn SchemaProvider>,
    ) -> Result<Option<Arc<dyn SchemaProvider>>> {
        self.named.register_schema(name, schema)
    }
}

/// The tables of one version, which is read when a query names one of them.
#[derive(Debug)]
struct VersionTables {
    number: u64,
    /// Those of the version that the map is open at.
    beside: Arc<Tables>,
    opened: OnceCell<Tables>,
}

#[async_trait]
impl SchemaProvider for VersionTables {
    fn table_names(&self) -> Vec<String> {
        self.opened
            .get()
            .map_or_else(Vec::new, SchemaProvider::table_names)
    }

    async fn table(&self, name: &str) -> Result<Option<Arc<dyn TableProvider>>> {
        let open = || self.beside.at(self.number);
        let opened = self.opened.get_or_try_init(open).await.map_err(external)?;
        opened.table(name).await
    }

    fn table_exist(&self, name: &str) -> bool {
        self.opened
            .get()
            .is_some_and(|tables| tables.table_exist(name))
    }
}
