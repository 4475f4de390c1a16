//! Digests and indexes of logs, remembered beside the map, so that logs that have not changed are not read again: a run
//! reads a log's index once, and the units that read from the log open it with what is remembered.
//!
//! A log is taken for unchanged when each of its files has the place, size, time of modification, entity tag and, on
//! a local disk, time of status change that it had when it was read. Times within the last two seconds say nothing,
//! as clocks of file systems are coarse: the next run reads such a log again. What is remembered may be missing, of
//! another log or damaged, and on another machine files look different: then a unit reads the log whole, to see that it is
//! the one that its recipe names ([`UnitLog`]).

mod state;
mod unit_log;

use std::collections::{BTreeMap, BTreeSet};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use chrono::Utc;
use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_datasets::fault::changed;
use evermap_datasets::log::index::LogIndex;
use evermap_datasets::manifest::unwritten;
use evermap_datasets::{Dataset, LogFile, LogPart, Manifest, Recordings, Session};
use evermap_schemas::Fault;
use object_store::ObjectMeta;
use object_store::path::Path as ObjectPath;
use serde::{Deserialize, Serialize};
use tokio::time::Instant;

use crate::digest::digest_of;
use crate::map::receipt::LogContent;
use crate::map::store::{Store, each};

pub use state::FileState;
pub use unit_log::UnitLog;

/// A log's digest and its index, and what its files were like when it was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// BLAKE3 of the files.
    pub content: String,
    /// Whether the files had rested: if not, they may have changed since without looking different.
    rested: bool,
    files: Vec<FileState>,
    /// The index of each file.
    indexes: Vec<LogIndex>,
    /// Binds the indexes to the content.
    seal: String,
}

/// The folder of a map that remembers logs.
pub const FOLDER: &str = "logs";

impl Fingerprint {
    fn new(
        content: String,
        rested: bool,
        files: Vec<FileState>,
        indexes: Vec<LogIndex>,
    ) -> Result<Self, Fault> {
        let seal = seal(&content, &indexes)?;
        Ok(Self {
            content,
            rested,
            files,
            indexes,
            seal,
        })
    }

    /// Where it is remembered.
    fn name(files: &[FileState]) -> Result<String, Fault> {
        Ok(format!("{FOLDER}/{}.json", digest_of(&files)?))
    }

    /// Remembers it. What is torn later does not fit its seal and is not believed.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn remember(&self, store: &Store) -> Result<(), Fault> {
        store.cache_json(&Self::name(&self.files)?, self).await
    }

    /// What is remembered of these files; nothing where somebody else wrote there.
    async fn find(store: &Store, files: &[FileState]) -> Result<Option<Self>, Fault> {
        let found = match store.read_json::<Self>(&Self::name(files)?).await {
            Ok(Some(found)) => found,
            Ok(None) => return Ok(None),
            Err(fault) if fault.kind == evermap_schemas::Kind::Data => return Ok(None),
            Err(fault) => return Err(fault),
        };
        Ok((found.files == files).then_some(found))
    }

    /// What is remembered of logs of this content, wherever they were. It is looked for in all that is remembered.
    async fn of_content(store: &Store, content: &str) -> Result<Vec<Self>, Fault> {
        let mut all = Vec::new();
        for (name, _) in store.list(FOLDER).await? {
            if let Ok(Some(found)) = store.read_json::<Self>(&name).await
                && found.content == content
                && found.seal == seal(content, &found.indexes)?
            {
                all.push(found);
            }
        }
        Ok(all)
    }
}

/// What binds indexes to a content, and to how this evermap reads them.
fn seal(content: &str, indexes: &[LogIndex]) -> Result<String, Fault> {
    digest_of(&(LogIndex::VERSION, content, indexes))
}

/// The names under which logs with these contents are remembered.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn names_of(store: &Store, contents: &BTreeSet<String>) -> Result<Vec<String>, Fault> {
    let mut names = Vec::new();
    for (name, _) in store.list(FOLDER).await? {
        if let Ok(Some(found)) = store.read_json::<Fingerprint>(&name).await
            && contents.contains(&found.content)
        {
            names.push(name);
        }
    }
    Ok(names)
}

/// Which remembered logs are believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Believe<'a> {
    /// Those whose files had rested when they were read, and have rested until now.
    Rested,
    /// Those with this content: whoever read them did so for this run.
    Content(&'a str),
}

/// The digests of logs that are remembered, by session.
pub type Contents = BTreeMap<String, String>;

/// Opens recordings. Indexes of logs that are remembered, and whose files are what they were, are not read again.
///
/// # Errors
/// As [`Recordings::open`], or a resource fault when the map's store does not answer.
pub async fn open(
    store: &Store,
    mut recordings: Recordings,
    believe: Believe<'_>,
) -> Result<(Dataset, Contents), Fault> {
    let now = Utc::now();
    let mut states = Vec::with_capacity(recordings.sessions.len());
    for recording in &mut recordings.sessions {
        let files = &mut recording.files;
        files.sort_by_key(|file| place(&file.store_url, &file.meta));
        let state_of = |file: &LogFile| FileState::of(file.store_url.as_str(), &file.meta);
        states.push(files.iter().map(state_of).collect::<Vec<_>>());
    }
    let found = each(states.iter().map(|files| Fingerprint::find(store, files))).await?;
    let mut contents = Contents::new();
    for ((recording, files), found) in recordings.sessions.iter_mut().zip(states).zip(found) {
        let Some(found) = found else {
            continue;
        };
        let believed = match believe {
            Believe::Rested => found.rested && files.iter().all(|file| file.rests(now)),
            Believe::Content(content) => found.content == content,
        };
        if believed && found.seal == seal(&found.content, &found.indexes)? {
            for (file, index) in recording.files.iter_mut().zip(found.indexes) {
                file.index = Some(index);
            }
            contents.insert(recording.name.clone(), found.content);
        }
    }
    Ok((recordings.open().await?, contents))
}

/// Opens the log of a session of a map, where it was when it was mapped and with the index that is remembered of it.
///
/// # Errors
/// As [`open`], or a user fault for a log that is gone.
pub async fn open_mapped(
    store: &Store,
    runtime: &RuntimeEnv,
    manifest: &Manifest,
    log: &LogContent,
) -> Result<Dataset, Fault> {
    let found = mapped(runtime, manifest).await?;
    let (opened, _) = open(store, found, Believe::Content(&log.content)).await?;
    Ok(opened)
}

/// Whether the files of a log are those that were opened. One on a disk may have grown meanwhile.
///
/// # Errors
/// A fault with the place of a file that is gone, or when its store does not answer.
pub async fn stands(log: &Dataset) -> Result<bool, Fault> {
    let parts = log.parts();
    let found = each(parts.iter().map(|part| FileState::now(part))).await?;
    let mut states = parts.iter().zip(found);
    Ok(states.all(|(part, found)| {
        let opened = FileState::opened(part);
        found == opened || found.goes_on(&opened)
    }))
}

/// The files of a session of a map, where they were when it was mapped.
async fn mapped(runtime: &RuntimeEnv, manifest: &Manifest) -> Result<Recordings, Fault> {
    let found = Recordings::find(runtime, &[], Some(manifest)).await;
    found.map_err(unwritten)
}

/// Hears, now and then while logs are read, which share of their bytes is, from 0 to 1.
pub type OnProgress<'a> = &'a mut (dyn FnMut(f64) + Send);

/// How often is told how far reading is.
const TOLD_EVERY: Duration = Duration::from_secs(1);

/// The digests of the logs of sessions, in their order. `remembered` are those that were when they were opened; the
/// others are read. With `told` each is remembered as soon as it is read, so that who is killed meanwhile need not read it
/// again; without, nothing is written.
///
/// # Errors
/// A resource fault when a file cannot be read, or the store does not take what is remembered.
pub async fn read(
    store: &Store,
    remembered: &Contents,
    sessions: &[Session],
    told: Option<OnProgress<'_>>,
) -> Result<Vec<String>, Fault> {
    let (bytes, kept_in) = (AtomicU64::new(0), told.is_some().then_some(store));
    let asked = sessions.iter();
    let reading = each(asked.map(|session| content(kept_in, remembered, session, &bytes)));
    let Some(told) = told else {
        return reading.await;
    };
    let is_read = |session: &&Session| !remembered.contains_key(&*session.name);
    let parts = sessions.iter().filter(is_read).flat_map(|s| &s.parts);
    let all: u64 = parts.map(|part| part.meta.size).sum();
    let mut reading = pin!(reading);
    let mut due = tokio::time::interval_at(Instant::now() + TOLD_EVERY, TOLD_EVERY);
    loop {
        tokio::select! {
            read = &mut reading => return read,
            _ = due.tick() => told(bytes.load(Ordering::Relaxed) as f64 / all.max(1) as f64),
        }
    }
}

/// The digest of a session's log, which is remembered where a store is given. `read` counts bytes as they come.
///
/// # Errors
/// As [`read`].
async fn content(
    kept_in: Option<&Store>,
    remembered: &Contents,
    session: &Session,
    read: &AtomicU64,
) -> Result<String, Fault> {
    if let Some(content) = remembered.get(&*session.name) {
        return Ok(content.clone());
    }
    let fresh = fingerprint(session, read).await?;
    if let Some(store) = kept_in {
        fresh.remember(store).await?;
    }
    Ok(fresh.content)
}

/// The digest of a session's log, with what is worth remembering of it. Of a file that grows it is that of as much as there
/// was when it was opened. `read` counts bytes as they come.
///
/// # Errors
/// A resource fault when a file cannot be read, or is another one by now than was opened.
async fn fingerprint(session: &Session, read: &AtomicU64) -> Result<Fingerprint, Fault> {
    let begun = Utc::now();
    let parts = in_place(session.parts.clone());
    let files = opened(&parts);
    let rested = files.iter().all(|file| file.rests(begun));
    let content = session.fingerprint(read).await?.to_hex().to_string();
    for (part, before) in parts.iter().zip(&files) {
        if !FileState::now(part).await?.goes_on(before) {
            return Err(changed().at(&part.url));
        }
    }
    let indexes = parts.iter().map(|part| part.index_since()).collect();
    Fingerprint::new(content, rested, files, indexes)
}

/// Parts of a log in the order in which what they are like is remembered.
fn in_place(mut parts: Vec<Arc<LogPart>>) -> Vec<Arc<LogPart>> {
    parts.sort_by_key(|part| place(&part.store_url, &part.meta));
    parts
}

/// What parts of a log were like when they were opened.
fn opened(parts: &[Arc<LogPart>]) -> Vec<FileState> {
    parts.iter().map(|part| FileState::opened(part)).collect()
}

/// What orders the files of a session.
fn place(store: &ObjectStoreUrl, meta: &ObjectMeta) -> (String, ObjectPath) {
    (store.as_str().to_owned(), meta.location.clone())
}

#[cfg(test)]
mod tests;
