//! The tables of a map in a context of DataFusion.

use std::collections::BTreeSet;
use std::sync::Arc;

use datafusion::catalog::{CatalogProvider, MemoryCatalogProvider};
use datafusion::prelude::SessionContext;
use evermap_contract::Registry;
use evermap_datasets::Dataset;
use evermap_schemas::Fault;

use crate::error::OrFault;
use crate::map::catalog::Catalog;
use crate::map::diff::DiffFunction;
use crate::map::lineage::LineageFunction;
use crate::map::opened::Map;
use crate::map::tables::Tables;
use crate::map::version::MappedSession;
use crate::sql::{TABLES, Unlisted, beside, catalog, catalog_name};

/// The tables that a session's log is known to have before it is opened: those of all logs, and topics that play roles.
fn tables_of(session: &MappedSession) -> BTreeSet<String> {
    let topics = session.manifest.roles.values().flatten();
    // A pattern is no name.
    let topics = topics.filter(|topic| !topic.contains(['*', '?', '[']));
    let all = Dataset::table_names().into_iter().map(str::to_owned);
    all.chain(topics.cloned()).collect()
}

impl Map {
    /// Makes every published layer a table of a new context, those with structs also with columns in their place
    /// (`poses_flat`), beside `layers`, `versions` and `runs`; those of another
    /// version are `v1.lanes`, topics and roles of the log of a session `monday."/odom"`; `diff` compares versions, `lineage` says what rows were made from. A table is opened when a query names it, and then it is that a
    /// missing or damaged artifact shows.
    ///
    /// # Errors
    /// A fault of ours.
    pub fn context(
        &self,
        context: SessionContext,
        registry: &Registry,
    ) -> Result<SessionContext, Fault> {
        context.register_object_store(self.store.url(), self.store.objects());
        let catalog = catalog(&context)?;
        let tables = Arc::new(Tables::new(self.clone(), &context, registry));
        let public = Arc::clone(&tables);
        catalog.register_schema(TABLES, public).or_fault()?;
        let catalog = Arc::new(Catalog::new(catalog, tables));
        context.register_catalog(catalog_name(&context), catalog);
        let sessions = self.version.sessions.iter();
        let logs = sessions.map(|session| (session.log.session.clone(), tables_of(session)));
        let logs = logs.collect();
        let state = context.state_ref();
        state
            .write()
            .config_mut()
            .set_extension(Arc::new(Unlisted(logs)));
        let diff = DiffFunction {
            map: self.clone(),
            registry: registry.clone(),
            reading: beside(&context),
        };
        context.register_udtf("diff", Arc::new(diff));
        context.register_udtf("lineage", Arc::new(LineageFunction(self.clone())));
        Ok(context)
    }

    /// Puts the map's tables beside those of another one in a context: `name.lanes` in its catalog, and all that this map
    /// has in a catalog of the name, `name.v1.lanes`, `name.monday."/odom"`.
    ///
    /// # Errors
    /// A user fault where the name is taken.
    pub fn join(
        &self,
        name: &str,
        context: &SessionContext,
        registry: &Registry,
    ) -> Result<(), Fault> {
        let beside = catalog(context)?;
        if context.catalog(name).is_some() || beside.schema(name).is_some() {
            return Err(
                Fault::user(format!("`{name}` is the name of several maps or sessions"))
                    .next("give the map another one: --map NAME=DIR"),
            );
        }
        context.register_object_store(self.store.url(), self.store.objects());
        let tables = Arc::new(Tables::new(self.clone(), context, registry));
        let own = MemoryCatalogProvider::new();
        for (catalog, schema) in [
            (&own as &dyn CatalogProvider, TABLES),
            (beside.as_ref(), name),
        ] {
            let public = Arc::clone(&tables);
            catalog.register_schema(schema, public).or_fault()?;
        }
        let catalog = Arc::new(Catalog::new(Arc::new(own), tables));
        context.register_catalog(name, catalog);
        Ok(())
    }
}
