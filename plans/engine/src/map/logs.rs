//! The logs that a map was made from, as schemas by the names of their sessions: `monday."/odom"`, `monday.frames`.

use std::sync::Arc;

use async_trait::async_trait;
use datafusion::catalog::{SchemaProvider, TableProvider};
use datafusion::error::Result;
use datafusion::execution::runtime_env::RuntimeEnv;

use crate::error::external;
use crate::map::Map;

/// The tables of one session's log, which is opened when a query names one of them.
#[derive(Debug)]
pub struct LogTables {
    /// The map that the session is in.
    pub map: Map,
    /// Its name.
    pub session: String,
    /// What opens its log.
    pub runtime: Arc<RuntimeEnv>,
}

#[async_trait]
impl SchemaProvider for LogTables {
    /// None before the log is open: to name them, it would have to be read.
    fn table_names(&self) -> Vec<String> {
        let tables = self.map.open_log(&self.session).map(|log| log.tables());
        let tables = tables.and_then(Result::ok).unwrap_or_default();
        tables.into_keys().collect()
    }

    async fn table(&self, name: &str) -> Result<Option<Arc<dyn TableProvider>>> {
        let log = self.map.log(&self.session, &self.runtime).await;
        match log.map_err(external)? {
            Some(log) => Ok(log.tables().map_err(external)?.remove(name)),
            None => Ok(None),
        }
    }

    fn table_exist(&self, _: &str) -> bool {
        false
    }
}
