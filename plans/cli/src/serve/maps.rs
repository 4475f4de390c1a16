//! The maps that are served, each at the versions that are asked for.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use datafusion::execution::runtime_env::RuntimeEnv;
use datafusion::prelude::SessionContext;
use datafusion_postgres::DfSessionService;
use datafusion_postgres::datafusion_pg_catalog::pg_catalog::context::EmptyContextProvider;
use datafusion_postgres::datafusion_pg_catalog::setup_pg_catalog;
use evermap_engine::erased::{Erased, erased};
use evermap_engine::error::OrFault;
use evermap_engine::map::store::Store;
use evermap_engine::map::version::{FileState, Version};
use evermap_engine::sql::{Limits, context_on};
use evermap_functions::use_indexes;
use evermap_language::{listed, nearest};
use evermap_schemas::Fault;
use futures::FutureExt;
use futures::future::BoxFuture;
use tokio::sync::Mutex;

use crate::reader::MapReader;
use crate::serve::http::live::Recordings;
use crate::serve::postgres::{complete_catalog, complete_types, hooks};

/// Versions of a map that are open at once; the newest is one of them.
const MOST_OPEN: usize = 4;

/// The maps that are served.
#[derive(Clone)]
pub struct Maps(Arc<BTreeMap<String, Arc<ServedMap>>>);

/// A map that is served.
pub struct ServedMap {
    /// The last part of its address.
    pub name: String,
    /// Its folder or URL, as it was given.
    pub address: String,
    store: Store,
    limits: Limits,
    runtime: Arc<RuntimeEnv>,
    /// The newest version when it was last looked for.
    newest: AtomicU64,
    /// The last of the torn versions that were told.
    torn: AtomicU64,
    /// Versions that were asked for, the last of them last.
    open: Mutex<Vec<OpenVersion>>,
    /// How many were opened.
    openings: AtomicU64,
}

/// A version that is open, and what its file was like before it was.
struct OpenVersion {
    opened: Erased<Opened>,
    state: FileState,
}

/// A version of a map with its layers as tables.
pub struct Opened {
    /// Counts what was opened of the map: a map that is made anew has versions of the same numbers.
    pub opening: u64,
    /// The map at this version.
    pub reader: MapReader,
    /// Its layers as tables.
    pub context: SessionContext,
    /// The same to clients of Postgres.
    pub postgres: DfSessionService,
    /// What is played of it to those who watch.
    pub recordings: Recordings,
}

impl Opened {
    /// The version's number.
    pub fn version(&self) -> u64 {
        self.reader.map.version.version
    }
}

impl Maps {
    /// Opens maps by their addresses. They share the runtime, which has the memory of the limits.
    ///
    /// # Errors
    /// A user fault for a place without a map, or for two maps of one name.
    pub async fn open(
        addresses: &[String],
        limits: Limits,
        runtime: &Arc<RuntimeEnv>,
    ) -> Result<Self, Fault> {
        let mut maps = BTreeMap::new();
        for address in addresses {
            let store = Store::open(address, false)?;
            let name = store.name()?;
            let map = ServedMap {
                name: name.clone(),
                address: address.clone(),
                store,
                limits,
                runtime: Arc::clone(runtime),
                newest: AtomicU64::new(0),
                torn: AtomicU64::new(0),
                open: Mutex::default(),
                openings: AtomicU64::new(0),
            };
            map.newest().await?;
            if maps.insert(name.clone(), Arc::new(map)).is_some() {
                return Err(Fault::user(format!("two maps are called {name}"))
                    .next("name their folders apart, or serve them from two processes"));
            }
        }
        Ok(Self(Arc::new(maps)))
    }

    /// The maps by name.
    pub fn all(&self) -> impl Iterator<Item = &Arc<ServedMap>> {
        self.0.values()
    }

    /// The only map; `None` where there are several.
    pub fn only(&self) -> Option<&Arc<ServedMap>> {
        self.all().next().filter(|_| self.0.len() == 1)
    }

    /// The map of a name.
    ///
    /// # Errors
    /// A user fault that names the maps.
    pub fn get(&self, name: &str) -> Result<&Arc<ServedMap>, Fault> {
        self.0.get(name).ok_or_else(|| {
            let names: Vec<&str> = self.0.keys().map(String::as_str).collect();
            let meant = nearest(name, names.iter().copied());
            let meant = meant.map_or_else(String::new, |name| format!("; did you mean `{name}`?"));
            Fault::user(format!("no map `{name}` is served{meant}"))
                .next(format!("there are {}", listed(names)))
        })
    }
}

impl ServedMap {
    /// The newest version that reads, as it is at this moment.
    ///
    /// # Errors
    /// A user fault for a map without a version, a resource fault when the store does not answer.
    pub fn newest(&self) -> BoxFuture<'_, Result<Erased<Opened>, Fault>> {
        let newest = async move {
            let mut number = self.newest.load(Ordering::Acquire);
            // `gc` forgets versions, and another map may be in the place of this one.
            let known = self.as_it_was(number).await?;
            let is_first = known.is_none();
            if is_first {
                let latest = Version::latest(&self.store).await?;
                number = latest.map_or(0, |version| version.version);
                self.torn.store(0, Ordering::Release);
            }
            let torn = |version: u64, fault: Fault| {
                // Those that there were at first were told when the newest was looked for.
                if self.is_news(version) && !is_first {
                    tracing::warn!("version {version} is ignored: {fault}");
                }
            };
            while let (next, Some(_)) = Version::after(&self.store, number, torn).await? {
                number = next;
            }
            self.newest.store(number, Ordering::Release);
            match (number, known) {
                (0, _) => self.opened(None).await,
                (_, Some(known)) if known.version() == number => Ok(known),
                _ => self.at(number).await,
            }
        };
        newest.boxed()
    }

    /// A version that is open, if it is still what the map has.
    async fn as_it_was(&self, number: u64) -> Result<Option<Erased<Opened>>, Fault> {
        if number == 0 {
            return Ok(None);
        }
        let state = Version::state(&self.store, number).await?;
        let open = self.open.lock().await;
        let known = open.iter().find(|kept| kept.opened.version() == number);
        let known = known.filter(|kept| Some(&kept.state) == state.as_ref());
        Ok(known.map(|kept| Arc::clone(&kept.opened)))
    }

    /// Whether nobody was told yet that this version is torn.
    fn is_news(&self, torn: u64) -> bool {
        self.torn.fetch_max(torn, Ordering::AcqRel) < torn
    }

    /// A version; the newest where none is named.
    ///
    /// # Errors
    /// As [`ServedMap::newest`], and a user fault for a version that is not there.
    pub fn version(&self, number: Option<u64>) -> BoxFuture<'_, Result<Erased<Opened>, Fault>> {
        match number {
            Some(number) => self.at(number).boxed(),
            None => self.newest(),
        }
    }

    /// A version as it is now: what is open of another one of its number is forgotten.
    async fn at(&self, number: u64) -> Result<Erased<Opened>, Fault> {
        let state = Version::state(&self.store, number).await?;
        let mut open = self.open.lock().await;
        let place = open.iter().position(|kept| kept.opened.version() == number);
        let known = place.map(|place| open.remove(place));
        let known = known.filter(|kept| Some(&kept.state) == state.as_ref());
        let opened = match known {
            Some(kept) => kept.opened,
            None => self.opened(Some(number)).await?,
        };
        if let Some(state) = state {
            let opened = Arc::clone(&opened);
            open.push(OpenVersion { opened, state });
        }
        let newest = self.newest.load(Ordering::Acquire);
        while open.len() > MOST_OPEN {
            let oldest = open.iter().position(|kept| kept.opened.version() != newest);
            open.remove(oldest.unwrap_or_default());
        }
        Ok(opened)
    }

    async fn opened(&self, number: Option<u64>) -> Result<Erased<Opened>, Fault> {
        let reader = MapReader::open(&self.address, number).await?;
        let runtime = Arc::clone(&self.runtime);
        let context = reader.context(context_on(&self.name, runtime, self.limits)?)?;
        if let Err(fault) = use_indexes(&context).await.or_fault() {
            tracing::warn!("queries read graphs, not their indexes: {fault}");
        }
        setup_pg_catalog(&context, &self.name, EmptyContextProvider)
            .map_err(|error| Fault::bug(format!("no catalog for Postgres: {error}")))?;
        complete_catalog(&context);
        complete_types(&context, &self.name).await.or_fault()?;
        let postgres = DfSessionService::new_with_hooks(Arc::new(context.clone()), hooks());
        Ok(erased(Opened {
            opening: self.openings.fetch_add(1, Ordering::AcqRel),
            reader,
            context,
            postgres,
            recordings: Recordings::default(),
        }))
    }

    /// What opens logs of the map.
    pub fn runtime(&self) -> &Arc<RuntimeEnv> {
        &self.runtime
    }
}

#[cfg(test)]
pub(crate) mod tests;
