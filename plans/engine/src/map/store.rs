//! The map store: a folder, or an object-store prefix.
//!
//! ```text
//!   artifacts/CONTENT.parquet   rows, named by the digest of the file
//!   receipts/RECIPE.json        a unit that was done: its recipe's digest → its artifact, rows, losses; sealed
//!   versions/N.json             what version N of the map is made of; created only if absent, sealed
//!   parts/CONTENT.json          a part of a long list of versions, named by the digest of the file
//!   sound.json                  which artifacts were read and found right, by what their files were like
//!   logs/STATE.json             the digest of a log, by what its files were like: saves reading it again
//!   runs/N-CONTENT.parquet      how each unit of a run went, with the digest of the file
//!   leases/ID.json              who is at work: a run, or gc
//!   newest, links/              links to the files of the newest version's layers, for other programs
//!   tmp/                        files on their way, and how far units of a cluster are; a killed run leaves some, gc
//!                               removes them
//! ```
//! Every name is either the digest of what it holds or never written twice, so a reader sees a version whole or not
//! at all, and nothing that was once published changes.

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use evermap_datasets::address::url_of;
use futures::stream::{Buffered, Iter};
use futures::{StreamExt, TryStreamExt};
use object_store::path::Path as ObjectPath;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt, PutMode};
use serde::Serialize;
use serde::de::DeserializeOwned;
use url::Url;

use crate::error::{no_map, store_fault};
use crate::map::local::Folder;
use crate::map::store::files::Files;
use evermap_schemas::Fault;

pub use crate::map::local::TEMPORARY;
pub use files::ARTIFACTS;
pub(super) use files::gone;

mod files;

/// Where a map is kept.
#[derive(Debug, Clone)]
pub struct Store {
    url: Url,
    root: ObjectPath,
    store: Arc<dyn ObjectStore>,
    /// The map's folder, where it is a local one: object stores neither sync files nor do without hard links.
    pub(super) folder: Option<Folder>,
}

impl Store {
    /// Opens a map by path or URL. With `create`, a local folder need not be there: the first file makes it.
    ///
    /// # Errors
    /// A user fault for an address that no object store reads, or for a folder that is not there.
    pub fn open(address: &str, create: bool) -> Result<Self, Fault> {
        let url = address_url(address, create)?;
        let (store, root) = object_store::parse_url_opts(&url, std::env::vars())
            .map_err(|error| Fault::user(format!("{address} cannot hold a map: {error}")))?;
        let local = (url.scheme() == "file").then(|| url.to_file_path().ok());
        Ok(Self {
            folder: local.flatten().map(Folder::new),
            url,
            root,
            store: Arc::new(Files(Arc::from(store))),
        })
    }

    /// The same map, on another object store that is made of its own.
    #[cfg(test)]
    pub fn over(self, made: impl FnOnce(Arc<dyn ObjectStore>) -> Arc<dyn ObjectStore>) -> Self {
        let store = made(self.store);
        Self { store, ..self }
    }

    /// The map's URL, with a slash behind it.
    pub fn url(&self) -> &Url {
        &self.url
    }

    /// What a map is called to which nobody gave a name: the last part of its address.
    ///
    /// # Errors
    /// A user fault where there is none.
    pub fn name(&self) -> Result<String, Fault> {
        let path = ObjectPath::from_url_path(self.url.path()).unwrap_or_default();
        let last = path.filename().or_else(|| self.url.host_str());
        let last = last.filter(|name| !name.is_empty());
        last.map(str::to_owned).ok_or_else(|| {
            Fault::user(format!("a map at {} has no name", self.url))
                .next("put it into a folder of its own")
        })
    }

    /// The object store beneath. Where an artifact is gone, listing what is under its name is an error.
    pub fn objects(&self) -> Arc<dyn ObjectStore> {
        Arc::clone(&self.store)
    }

    /// The object path of a name within the map.
    pub fn path(&self, name: &str) -> ObjectPath {
        ObjectPath::from_iter(self.root.parts().chain(ObjectPath::from(name).parts()))
    }

    /// The URL of a name within the map.
    ///
    /// # Errors
    /// A bug fault for a name that is no path.
    pub fn url_of(&self, name: &str) -> Result<Url, Fault> {
        self.url
            .join(name)
            .map_err(|error| Fault::bug(format!("{name} is not a valid name in a map: {error}")))
    }

    /// What the store says of a file: its size, its times; `None` where there is none.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn meta(&self, name: &str) -> Result<Option<ObjectMeta>, Fault> {
        if self.no_file(name).await?.is_some() {
            return Ok(None);
        }
        let path = self.path(name);
        there(answered(|| self.store.head(&path)).await, name)
    }

    /// What stands in a folder in the place of a file of this name; `None` for a file, and for nothing. Who opens a file by
    /// [`Store::objects`] asks first.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn no_file(&self, name: &str) -> Result<Option<&'static str>, Fault> {
        match &self.folder {
            Some(folder) => folder.with(name, Folder::no_file).await,
            None => Ok(None),
        }
    }

    /// The JSON at a name; `None` where there is none.
    ///
    /// # Errors
    /// As [`Store::read`], and a data fault for JSON of another shape.
    pub async fn read_json<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, Fault> {
        let Some(bytes) = self.read(name).await? else {
            return Ok(None);
        };
        let read = serde_json::from_slice(&bytes);
        read.map(Some)
            .map_err(|error| other_json(&error).at(format!("{}{name}", self.url)))
    }

    /// The bytes at a name; `None` where there is none.
    ///
    /// # Errors
    /// A resource fault when the store does not answer, a data fault for what is no file.
    pub async fn read(&self, name: &str) -> Result<Option<Bytes>, Fault> {
        if let Some(folder) = &self.folder {
            let read = folder.with(name, Folder::read).await?;
            return Ok(read.map(Bytes::from));
        }
        let path = self.path(name);
        let read = || async { self.store.get(&path).await?.bytes().await };
        there(answered(read).await, name)
    }

    /// Writes a file, whole or not at all; replaces what was there. When it returns, a power failure cannot undo it: so
    /// it is with all that gives a file its name here.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn write(&self, name: &str, bytes: Vec<u8>) -> Result<(), Fault> {
        if let Some(folder) = &self.folder {
            let put = move |folder: &Folder, name: &str| folder.put(name, &bytes);
            return folder.with(name, put).await;
        }
        let put = self.store.put(&self.path(name), bytes.into()).await;
        put.map(drop).map_err(|error| store_fault(&error, name))
    }

    /// As [`Store::write`], with JSON.
    ///
    /// # Errors
    /// As [`Store::write`].
    pub async fn write_json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), Fault> {
        self.write(name, json_bytes(value)?).await
    }

    /// As [`Store::write_json`], for what only saves work: a power failure may undo or tear it.
    ///
    /// # Errors
    /// As [`Store::write`].
    pub async fn cache_json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), Fault> {
        let Some(folder) = &self.folder else {
            return self.write_json(name, value).await;
        };
        let bytes = json_bytes(value)?;
        let cache = move |folder: &Folder, name: &str| folder.cache(name, &bytes);
        folder.with(name, cache).await
    }

    /// Writes a file where nothing was; `false` where something else was. Of several that write the same bytes at once, each
    /// may be told that it did.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn create(&self, name: &str, bytes: Vec<u8>) -> Result<bool, Fault> {
        if let Some(folder) = &self.folder {
            let create = move |folder: &Folder, name: &str| folder.create(name, &bytes);
            return folder.with(name, create).await;
        }
        let (path, bytes) = (self.path(name), Bytes::from(bytes));
        let mut tries = 1;
        loop {
            let put = self
                .store
                .put_opts(&path, bytes.clone().into(), PutMode::Create.into());
            let Err(error) = put.await else {
                return Ok(true);
            };
            // The answer to the first try may have been lost: then it is these bytes that are there.
            match self.read(name).await? {
                Some(found) => return Ok(found == bytes),
                None if tries == TRIES => return Err(store_fault(&error, name)),
                None => tries += 1,
            }
        }
    }

    /// Gives a finished file its lasting name.
    ///
    /// # Errors
    /// A resource fault when the store does not do it.
    pub async fn settle(&self, from: &str, to: &str) -> Result<(), Fault> {
        if let Some(folder) = &self.folder {
            let from = from.to_owned();
            let settle = move |folder: &Folder, to: &str| folder.settle(&from, to);
            return folder.with(to, settle).await;
        }
        let copied = self.store.copy(&self.path(from), &self.path(to)).await;
        copied.map_err(|error| store_fault(&error, to))?;
        // It has its name; what is left of the other one is `gc`'s.
        if let Err(fault) = self.remove(from).await {
            tracing::debug!("{from} is not removed: {fault}");
        }
        Ok(())
    }

    /// Removes a name; a name that is not there is fine.
    ///
    /// # Errors
    /// A resource fault when the store does not do it.
    pub async fn remove(&self, name: &str) -> Result<(), Fault> {
        if let Some(folder) = &self.folder {
            return folder.with(name, Folder::remove).await;
        }
        let path = self.path(name);
        there(answered(|| self.store.delete(&path)).await, name).map(drop)
    }

    /// Removes a name in a local folder at once; elsewhere nothing happens. What cannot wait for [`Store::remove`] calls it.
    pub fn remove_if_local(&self, name: &str) {
        if let Some(Err(error)) = self.folder.as_ref().map(|folder| folder.remove(name)) {
            tracing::debug!("{name} is not removed: {error}");
        }
    }

    /// The files on their way, with their sizes, that have not changed for so long: also those that an object store hides
    /// in a folder.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn temporary(&self, rested: Duration) -> Result<Vec<(String, u64)>, Fault> {
        let before = SystemTime::now() - rested;
        if let Some(folder) = &self.folder {
            let list = move |folder: &Folder, _: &str| folder.temporary(before);
            return folder.with(TEMPORARY, list).await;
        }
        let mut found = self.objects_in(TEMPORARY).await?;
        found.retain(|object| SystemTime::from(object.last_modified) <= before);
        Ok(names(TEMPORARY, found))
    }

    /// The names in a folder with their sizes, sorted.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn list(&self, folder: &str) -> Result<Vec<(String, u64)>, Fault> {
        Ok(names(folder, self.objects_in(folder).await?))
    }

    /// The names in a folder, also of what stands there in the place of a file.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn names(&self, folder: &str) -> Result<Vec<String>, Fault> {
        if let Some(local) = &self.folder {
            return local.with(folder, Folder::names).await;
        }
        let listed = self.list(folder).await?.into_iter();
        Ok(listed.map(|(name, _)| name).collect())
    }

    /// What the store says of all that is in a folder.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn objects_in(&self, folder: &str) -> Result<Vec<ObjectMeta>, Fault> {
        let path = self.path(folder);
        let found = answered(|| self.store.list_with_delimiter(Some(&path))).await;
        Ok(found.map_err(|error| store_fault(&error, folder))?.objects)
    }
}

/// The names of objects in a folder with their sizes, sorted.
fn names(folder: &str, objects: Vec<ObjectMeta>) -> Vec<(String, u64)> {
    let named = objects.into_iter().filter_map(|object| {
        let name = object.location.filename()?;
        Some((format!("{folder}/{name}"), object.size))
    });
    let mut names: Vec<_> = named.collect();
    names.sort();
    names
}

/// Files of a map, or logs, that are asked for or read side by side: a store of objects answers late.
const SIDE_BY_SIDE: usize = 16;

/// Asks a store for many things, some at a time; the answers in order.
///
/// # Errors
/// The first fault.
pub async fn each<F: Future<Output = Result<T, Fault>>, T>(
    asked: impl IntoIterator<Item = F>,
) -> Result<Vec<T>, Fault> {
    answers(asked).try_collect().await
}

/// As [`each`], one answer after the other: for those that are too large to be held together.
pub fn answers<F: Future<Output = Result<T, Fault>>, T>(
    asked: impl IntoIterator<Item = F>,
) -> Buffered<Iter<std::vec::IntoIter<F>>> {
    // They are made before any is waited for: a stream of futures that borrow cannot be sent to other threads.
    let asked: Vec<F> = asked.into_iter().collect();
    futures::stream::iter(asked).buffered(SIDE_BY_SIDE)
}

/// How often something is asked of a store that does not answer whole.
const TRIES: usize = 3;

/// How long something is asked again. Object stores try by themselves, for minutes, what they know to be safe; what is
/// left are answers that were lost on their way, and these are soon told.
const PATIENCE: Duration = Duration::from_secs(20);

/// Asks a store for something that can be asked twice, and again where the answer was lost.
async fn answered<T, F: Future<Output = object_store::Result<T>>>(
    ask: impl Fn() -> F,
) -> object_store::Result<T> {
    let begun = Instant::now();
    let mut tries = 1;
    loop {
        match ask().await {
            Err(object_store::Error::Generic { source, .. })
                if tries < TRIES && begun.elapsed() < PATIENCE =>
            {
                tracing::debug!("asked again: {source}");
                tries += 1;
            }
            answer => return answer,
        }
    }
}

/// What a store answers; `None` where it has nothing of this name.
fn there<T>(answer: object_store::Result<T>, name: &str) -> Result<Option<T>, Fault> {
    match answer {
        Ok(found) => Ok(Some(found)),
        Err(object_store::Error::NotFound { .. }) => Ok(None),
        Err(error) => Err(store_fault(&error, name)),
    }
}

/// That a file of the map has another shape than what is written there.
pub fn other_json(error: &serde_json::Error) -> Fault {
    Fault::data(format!(
        "expected what evermap wrote, found other JSON: {error}"
    ))
}

fn json_bytes<T: Serialize>(value: &T) -> Result<Vec<u8>, Fault> {
    serde_json::to_vec(value).map_err(|error| Fault::bug(error.to_string()))
}

fn address_url(address: &str, create: bool) -> Result<Url, Fault> {
    if let Some(mut url) = url_of(address)? {
        if !url.path().ends_with('/') {
            let path = format!("{}/", url.path());
            url.set_path(&path);
        }
        return Ok(url);
    }
    let folder = Path::new(address);
    if !create && !folder.is_dir() {
        return Err(no_map(address));
    }
    if folder.is_file() {
        return Err(Fault::user(format!(
            "cannot create a map at {address}: expected a folder, found a file"
        )));
    }
    let whole = whole(folder)
        .map_err(|error| Fault::user(format!("cannot create a map at {address}: {error}")))?;
    Url::from_directory_path(whole).map_err(|()| Fault::user(format!("{address} is not a folder")))
}

/// The path from the root on, without `..`. What comes behind a link is where the link leads, as far as it is there yet.
fn whole(folder: &Path) -> std::io::Result<PathBuf> {
    let path = std::path::absolute(folder)?;
    if !path.components().any(|part| part == Component::ParentDir) {
        return Ok(path);
    }
    match (path.parent(), path.file_name()) {
        (Some(parent), Some(name)) => Ok(whole(parent)?.join(name)),
        _ => path.canonicalize(),
    }
}

#[cfg(test)]
mod tests;
