//! A map's layers as tables of a context. A layer is opened when a query names it: one that is damaged takes no query
//! with it that does not read it.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use arrow::datatypes::SchemaRef;
use async_trait::async_trait;
use datafusion::catalog::{SchemaProvider, TableProvider};
use datafusion::datasource::TableType;
use datafusion::error::{DataFusionError, Result};
use datafusion::prelude::{DataFrame, SessionContext};
use evermap_contract::Registry;
use evermap_language::{listed, nearest};
use evermap_schemas::dictionary::{ColumnInfo, columns};
use evermap_schemas::{Fault, Layer, LayerRow, batch, layers};
use futures::FutureExt;
use futures::future::BoxFuture;
use tokio::sync::{Mutex, OnceCell};

use crate::conform::declared;
use crate::erased::{Erased, erased};
use crate::error::{OrFault, external};
use crate::map::artifact::{self, read_files};
use crate::map::flat;
use crate::map::logs::LogTables;
use crate::map::receipt::Artifact;
use crate::map::store::each;
use crate::map::{LayerInfo, Map, RUNS, RunRow, VersionInfo, record_damage, versions};
use crate::sql::beside;
use crate::sql::described::described;

/// The tables of a map: its published layers, and what it says of itself.
pub struct Tables {
    /// The map.
    pub map: Map,
    /// The operators that may have made its layers.
    registry: Registry,
    /// Opens tables; it has none itself.
    reading: Erased<SessionContext>,
    /// The tables by name, those open that were asked for.
    tables: BTreeMap<String, Table>,
}

#[derive(Default)]
struct Table {
    rows: OnceCell<Arc<dyn TableProvider>>,
    /// Until when its layer's files are believed to be what was written.
    believed: Mutex<Option<Instant>>,
}

/// How long the files of a layer that is open are believed to be what they were, at least, so that queries one after the
/// other do not each ask a store of objects for all of them.
const BELIEVED: Duration = Duration::from_secs(1);
/// The same in times of what it takes to ask, which grows with the files: queries wait a twentieth of the time at most.
const BELIEVED_TIMES: u32 = 20;

/// What a map says of itself. No step makes layers of these names; one that an older evermap made is hidden behind them.
pub(crate) fn own() -> impl Iterator<Item = Layer> {
    [
        LayerInfo::layer(),
        VersionInfo::layer(),
        RunRow::layer(),
        ColumnInfo::layer(),
    ]
    .into_iter()
}

fn own_named(table: &str) -> Option<Layer> {
    own().find(|layer| layer.name == table)
}

/// The declaration of a table's columns, where there is one: of the operator that made it, else by name.
pub fn declaration(map: &Map, registry: &Registry, table: &str) -> Option<Layer> {
    let made = map.published(table).and_then(|layer| layer.op.as_deref());
    let made = made.and_then(|op| registry.get(op).ok());
    let made = made.map(|entry| entry.output.clone());
    made.or_else(|| layers::named(table))
        .or_else(|| own_named(table))
}

impl std::fmt::Debug for Tables {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tables").field("map", &self.map).finish()
    }
}

impl Tables {
    /// The tables of a map, opened with the settings and limits of a context.
    pub fn new(map: Map, context: &SessionContext, registry: &Registry) -> Self {
        let reading = erased(beside(context));
        let mut names = Vec::new();
        for (layer, _) in map.version.published() {
            let declared = declaration(&map, registry, layer);
            if declared.is_some_and(|layer| flat::has_structs(&layer.schema())) {
                names.push(format!("{layer}{}", flat::SUFFIX));
            }
            names.push(layer.clone());
        }
        names.extend(own().map(|layer| layer.name.to_owned()));
        let tables = names.into_iter().map(|name| (name, Table::default()));
        Self {
            tables: tables.collect(),
            registry: registry.clone(),
            reading,
            map,
        }
    }

    /// The log of a session of the map.
    pub fn log(&self, session: &str) -> Option<LogTables> {
        self.map.session(session)?;
        Some(LogTables {
            map: self.map.clone(),
            session: session.to_owned(),
            runtime: self.reading.runtime_env(),
        })
    }

    /// The declaration of a table's columns, where there is one: of the operator that made it, else by name.
    pub fn declaration(&self, table: &str) -> Option<Layer> {
        declaration(&self.map, &self.registry, table)
    }

    /// The tables of another version of the same map.
    ///
    /// # Errors
    /// As `Map::at`.
    pub fn at(&self, version: u64) -> BoxFuture<'_, Result<Self, Fault>> {
        let opened = async move {
            let map = Map::at(self.map.store.clone(), Some(version)).await?;
            Ok(Self::new(map, &self.reading, &self.registry))
        };
        opened.boxed()
    }

    /// The columns of a table with their units and frames; `None` where there is no such table.
    ///
    /// # Errors
    /// What opening it says.
    pub async fn described(&self, name: &str) -> Result<Option<SchemaRef>, Fault> {
        let Some(rows) = self.table(name).await.or_fault()? else {
            return Ok(None);
        };
        let known = match own_named(name) {
            Some(_) => None,
            None => self.described_layer(self.layer_of(name)).await?,
        };
        let Some(plan) = rows.get_logical_plan() else {
            return Ok(Some(rows.schema()));
        };
        Ok(Some(described(&plan, |origin| {
            let (_, column) = known.as_ref()?.fields().find(origin.column.name())?;
            Some(Arc::clone(column))
        })))
    }

    /// The layer whose rows a table has: flat, where it is called so.
    fn layer_of<'n>(&self, table: &'n str) -> &'n str {
        match (self.map.published(table), table.strip_suffix(flat::SUFFIX)) {
            (None, Some(layer)) => layer,
            _ => table,
        }
    }

    async fn opened(&self, name: &str) -> Result<Option<&Arc<dyn TableProvider>>, Fault> {
        let Some(table) = self.tables.get(name) else {
            return Ok(None);
        };
        if own_named(name).is_none() {
            self.check(table, self.layer_of(name)).await?;
        }
        let opened = table.rows.get_or_try_init(|| self.open(name).boxed());
        opened.await.map(Some)
    }

    /// That the files of a table's layer are what was written, also where they were replaced since it is open.
    async fn check(&self, table: &Table, layer: &str) -> Result<(), Fault> {
        let mut believed = table.believed.lock().await;
        let begun = Instant::now();
        if believed.is_none_or(|until| begun > until) {
            let found = self.map.checked(layer).await;
            found.map_err(|fault| in_layer(fault, layer))?;
            let asked = begun.elapsed();
            *believed = Some(Instant::now() + BELIEVED.max(asked * BELIEVED_TIMES));
        }
        Ok(())
    }

    async fn open(&self, name: &str) -> Result<Arc<dyn TableProvider>, Fault> {
        let (store, context) = (&self.map.store, &self.reading);
        let rows = match name {
            LayerInfo::NAME => context.read_batch(batch(self.map.layers())?).or_fault()?,
            VersionInfo::NAME => context
                .read_batch(batch(versions(store).await?)?)
                .or_fault()?,
            RunRow::NAME => self.runs().await?,
            ColumnInfo::NAME => {
                let rows = batch(self.dictionary().await)?;
                context.read_batch(rows).or_fault()?
            }
            _ => {
                let layer = self.layer_of(name);
                let rows = self.rows(layer, self.map.artifacts(layer)).await?;
                match layer == name {
                    true => rows,
                    false => flat::flat(rows).or_fault()?,
                }
            }
        };
        Ok(rows.into_view())
    }

    /// The rows of some artifacts of a layer alone; `None` where there are no artifacts.
    ///
    /// # Errors
    /// As opening the layer, as far as these are concerned.
    pub async fn rows_of(
        &self,
        layer: &str,
        artifacts: &[Artifact],
    ) -> Result<Option<Arc<dyn TableProvider>>, Fault> {
        if artifacts.is_empty() {
            return Ok(None);
        }
        let found = self.map.check(artifacts).await;
        found.map_err(|fault| in_layer(fault, layer))?;
        Ok(Some(self.rows(layer, artifacts).await?.into_view()))
    }

    async fn rows(&self, layer: &str, artifacts: &[Artifact]) -> Result<DataFrame, Fault> {
        let names = artifacts.iter().map(Artifact::name);
        let rows = read_files(&self.reading, &self.map.store, names, None).await;
        rows.map_err(|fault| in_layer(fault, layer))
    }

    /// The columns of a layer as its files describe them, and as it is declared.
    async fn described_layer(&self, layer: &str) -> Result<Option<SchemaRef>, Fault> {
        let stored = self.map.published(layer);
        let Some(first) = stored.and_then(|stored| stored.artifacts.first()) else {
            return Ok(None);
        };
        let found = artifact::described(&self.reading, &self.map.store, first).await;
        let found = found.map_err(|fault| in_layer(fault, layer))?;
        Ok(Some(match self.declaration(layer) {
            Some(layer) => declared(&found, &layer),
            None => found,
        }))
    }

    /// The columns of all layers that can be opened, and of what the map says of itself.
    async fn dictionary(&self) -> Vec<ColumnInfo> {
        let mut rows = Vec::new();
        let layers = self.map.version.published_names().into_iter();
        for name in layers.filter(|name| own_named(name).is_none()) {
            match self.columns_of(name).await {
                Ok(columns) => rows.extend(columns),
                Err(fault) => tracing::warn!("layer {name} is not among the columns: {fault}"),
            }
        }
        rows.extend(own().flat_map(|own| columns(own.name, &own.schema(), Some(&own))));
        rows
    }

    /// The columns of a published layer, or of a table in which the map says what it has.
    ///
    /// # Errors
    /// A user fault where there is no such layer; a data fault where it does not open.
    pub async fn columns_of(&self, layer: &str) -> std::result::Result<Vec<ColumnInfo>, Fault> {
        if let Some(own) = own_named(layer) {
            return Ok(columns(own.name, &own.schema(), Some(&own)));
        }
        let described = match self.map.published(layer) {
            Some(_) => self.described(layer).await?,
            None => None,
        };
        let Some(described) = described else {
            let names = self.map.version.published_names();
            let meant = nearest(layer, names.iter().copied());
            let meant = meant.map_or_else(String::new, |name| format!("; did you mean `{name}`?"));
            let fault = format!("the map has no layer `{layer}`{meant}");
            return Err(
                Fault::user(fault).next(format!("there are {}", listed(names.iter().copied())))
            );
        };
        let declared = self.declaration(layer);
        Ok(columns(layer, &described, declared.as_ref()))
    }

    async fn runs(&self) -> Result<DataFrame, Fault> {
        let (store, context) = (&self.map.store, &self.reading);
        let files = store.list(RUNS).await?;
        let damages = each(files.iter().map(|(name, _)| record_damage(store, name))).await?;
        let mut whole = Vec::new();
        for ((name, _), damage) in files.into_iter().zip(damages) {
            match damage {
                None => whole.push(name),
                Some(damage) => tracing::warn!("{name} is ignored: {damage}"),
            }
        }
        let none = batch::<RunRow>(Vec::new())?;
        if whole.is_empty() {
            return context.read_batch(none).or_fault();
        }
        // Older files have fewer columns.
        read_files(context, store, whole, Some(&none.schema())).await
    }
}

fn in_layer(fault: Fault, layer: &str) -> Fault {
    fault.at(format!("layer {layer}"))
}

#[async_trait]
impl SchemaProvider for Tables {
    fn table_names(&self) -> Vec<String> {
        self.tables.keys().cloned().collect()
    }

    async fn table(&self, name: &str) -> Result<Option<Arc<dyn TableProvider>>, DataFusionError> {
        let opened = self.opened(name).await.map_err(external)?;
        Ok(opened.map(Arc::clone))
    }

    async fn table_type(&self, name: &str) -> Result<Option<TableType>> {
        Ok(self.table_exist(name).then_some(TableType::Base))
    }

    fn table_exist(&self, name: &str) -> bool {
        self.tables.contains_key(name)
    }
}
