//! A map as a catalog: its layers at the version that was asked for, and those of every other version as schemas `v1`,
//! `v2` …

use std::sync::Arc;

use async_trait::async_trait;
use datafusion::catalog::{CatalogProvider, SchemaProvider, TableProvider};
use datafusion::error::Result;
use datafusion::prelude::SessionContext;
use tokio::sync::OnceCell;

use crate::error::external;
use crate::map::Map;
use crate::map::store::Store;
use crate::map::tables::Tables;

/// The schemas of a map.
#[derive(Debug)]
pub struct Catalog {
    /// The schemas that have names of their own.
    named: Arc<dyn CatalogProvider>,
    store: Store,
    reading: Reading,
}

/// Opens tables; it has none itself.
#[derive(Clone)]
struct Reading(SessionContext);

impl std::fmt::Debug for Reading {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Reading")
    }
}

impl Catalog {
    /// The catalog of a map, beside the schemas of another one.
    pub fn new(named: Arc<dyn CatalogProvider>, store: &Store, context: &SessionContext) -> Self {
        Self {
            named,
            store: store.clone(),
            reading: Reading(SessionContext::new_with_config_rt(
                context.copied_config(),
                context.runtime_env(),
            )),
        }
    }
}

impl CatalogProvider for Catalog {
    fn schema_names(&self) -> Vec<String> {
        self.named.schema_names()
    }

    fn schema(&self, name: &str) -> Option<Arc<dyn SchemaProvider>> {
        let version = || -> Option<Arc<dyn SchemaProvider>> {
            Some(Arc::new(VersionTables {
                version: name.strip_prefix('v')?.parse().ok()?,
                store: self.store.clone(),
                reading: self.reading.clone(),
                opened: OnceCell::new(),
            }))
        };
        self.named.schema(name).or_else(version)
    }
}

/// The tables of one version, which is read when a query names one of them.
#[derive(Debug)]
struct VersionTables {
    version: u64,
    store: Store,
    reading: Reading,
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
        let open = || async {
            let map = Map::at(self.store.clone(), Some(self.version)).await?;
            Ok(Tables::new(map, &self.reading.0))
        };
        let opened = self.opened.get_or_try_init(open).await.map_err(external)?;
        opened.table(name).await
    }

    fn table_exist(&self, name: &str) -> bool {
        self.opened
            .get()
            .is_some_and(|tables| tables.table_exist(name))
    }
}
