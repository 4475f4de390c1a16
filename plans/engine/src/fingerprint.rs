//! Digests and indexes of logs, remembered beside the map, so that logs that have not changed are not read again: a run
//! reads a log's index once, and the units that read from the log open it with what is remembered.
//!
//! A log is taken for unchanged when each of its files has the place, size, time of modification, entity tag and, on
//! a local disk, time of status change that it had when it was read. Times within the last two seconds say nothing,
//! as clocks of file systems are coarse: the next run reads such a log again. What is remembered may be missing, of
//! another log or damaged: then a unit reads the log's own index, and so it does on a machine where files look
//! different.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use chrono::{DateTime, TimeDelta, Utc};
use datafusion::execution::object_store::ObjectStoreUrl;
use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_datasets::log::index::LogIndex;
use evermap_datasets::manifest::unwritten;
use evermap_datasets::{Dataset, LogFile, LogPart, Manifest, Recordings, Session};
use evermap_schemas::Fault;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectMeta, ObjectStoreExt};
use serde::{Deserialize, Serialize};
use tokio::time::Instant;

use crate::digest::digest_of;
use crate::map::receipt::LogContent;
use crate::map::store::{Store, each};

/// How long a file must have rested for its times to be trusted.
const REST: TimeDelta = TimeDelta::seconds(2);

/// What tells one state of a file from another without reading it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileState {
    store: String,
    location: String,
    size: u64,
    modified: DateTime<Utc>,
    e_tag: Option<String>,
    /// Seconds and nanoseconds; null where the store has none.
    status_changed: Option<(i64, i64)>,
}

impl FileState {
    /// The state of a file, as its store tells it.
    pub fn of(store: &str, meta: &ObjectMeta) -> Self {
        Self {
            store: store.to_owned(),
            location: meta.location.to_string(),
            size: meta.size,
            modified: meta.last_modified,
            e_tag: meta.e_tag.clone(),
            status_changed: status_changed(store, meta.location.as_ref()),
        }
    }

    /// When it last became like this, as far as its store tells: a time of modification can be set back.
    pub fn changed(&self) -> DateTime<Utc> {
        let changed = self.status_changed.and_then(|(seconds, nanoseconds)| {
            DateTime::from_timestamp(seconds, u32::try_from(nanoseconds).ok()?)
        });
        changed.map_or(self.modified, |changed| changed.max(self.modified))
    }

    /// Whether it has been like this for long enough: what changes it now makes it look different.
    pub fn rests(&self, now: DateTime<Utc>) -> bool {
        now - self.changed() > REST
    }
}

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
    let found = Recordings::find(runtime, &[], Some(manifest)).await;
    let found = found.map_err(unwritten)?;
    let (opened, _) = open(store, found, Believe::Content(&log.content)).await?;
    Ok(opened)
}

/// Hears, now and then while logs are read, which share of their bytes is, from 0 to 1.
pub type Told<'a> = &'a mut (dyn FnMut(f64) + Send);

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
    told: Option<Told<'_>>,
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
    let (content, fresh) = fingerprint(session, read).await?;
    if let (Some(store), Some(fresh)) = (kept_in, fresh) {
        fresh.remember(store).await?;
    }
    Ok(content)
}

/// The digest of a session's log, and what is worth remembering of it. `read` counts bytes as they come.
///
/// # Errors
/// A resource fault when a file cannot be read.
async fn fingerprint(
    session: &Session,
    read: &AtomicU64,
) -> Result<(String, Option<Fingerprint>), Fault> {
    let begun = Utc::now();
    let mut parts = session.parts.clone();
    parts.sort_by_key(|part| place(&part.store_url, &part.meta));
    let state_of = |part: &Arc<LogPart>| FileState::of(part.store_url.as_str(), &part.meta);
    let files: Vec<FileState> = parts.iter().map(state_of).collect();
    let rested = files.iter().all(|file| file.rests(begun));
    let content = session.fingerprint(read).await?.to_hex().to_string();
    if !unchanged(&parts, &files).await {
        return Ok((content, None));
    }
    let indexes = parts.iter().map(|part| part.index_since()).collect();
    let fresh = Fingerprint::new(content.clone(), rested, files, indexes)?;
    Ok((content, Some(fresh)))
}

/// What orders the files of a session.
fn place(store: &ObjectStoreUrl, meta: &ObjectMeta) -> (String, ObjectPath) {
    (store.as_str().to_owned(), meta.location.clone())
}

/// When a local file's status last changed: unlike the time of modification, nobody sets it back.
fn status_changed(store: &str, location: &str) -> Option<(i64, i64)> {
    use std::os::unix::fs::MetadataExt;
    let local = store.starts_with("file:");
    let path = Path::new("/").join(location);
    let found = local.then(|| std::fs::metadata(path).ok())??;
    Some((found.ctime(), found.ctime_nsec()))
}

/// Whether the files are now what they were before they were read.
async fn unchanged(parts: &[Arc<LogPart>], files: &[FileState]) -> bool {
    for (part, before) in parts.iter().zip(files) {
        let now = part.store.head(&part.meta.location).await;
        let same = now.is_ok_and(|now| FileState::of(part.store_url.as_str(), &now) == *before);
        if !same {
            return false;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// A log without messages: magic, header, end of data, footer, magic.
    const LOG: &[u8] = b"\x89MCAP0\r\n\
        \x01\x08\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\
        \x0f\x04\0\0\0\0\0\0\0\0\0\0\0\
        \x02\x14\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\
        \x89MCAP0\r\n";

    /// The library that the log's index names, when it is opened with what is remembered.
    async fn library(store: &Store, log: &Path, content: &str) -> String {
        let paths = [log.display().to_string()];
        let found = Recordings::find(&RuntimeEnv::default(), &paths, None).await;
        let opened = open(store, found.unwrap(), Believe::Content(content)).await;
        opened.unwrap().0.parts()[0].index.library.clone()
    }

    #[tokio::test]
    async fn a_remembered_index_is_used_for_the_same_log_only() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("a.mcap");
        std::fs::write(&log, LOG).unwrap();
        let store = Store::open(folder.path().join("map").to_str().unwrap(), true).unwrap();
        let paths = [log.display().to_string()];
        let dataset = Dataset::open(&RuntimeEnv::default(), &paths, None)
            .await
            .unwrap();
        assert!(dataset.losses.is_empty(), "{:?}", dataset.losses.lines());
        let (content, fresh) = fingerprint(&dataset.sessions[0], &AtomicU64::new(0))
            .await
            .unwrap();
        let fresh = fresh.unwrap();
        // An index that the file does not have, to see which of both is used.
        let mut indexes = fresh.indexes;
        indexes[0].library = "remembered".into();
        let kept = Fingerprint::new(content.clone(), false, fresh.files, indexes).unwrap();
        kept.remember(&store).await.unwrap();
        assert_eq!(library(&store, &log, &content).await, "remembered");
        assert_eq!(library(&store, &log, "another").await, "");

        let mut forged = kept.clone();
        forged.indexes[0].library = "forged".into();
        forged.remember(&store).await.unwrap();
        assert_eq!(library(&store, &log, &content).await, "");

        let mut earlier = kept.clone();
        earlier.seal = digest_of(&(LogIndex::VERSION - 1, &content, &earlier.indexes)).unwrap();
        earlier.remember(&store).await.unwrap();
        assert_eq!(library(&store, &log, &content).await, "");

        kept.remember(&store).await.unwrap();
        std::fs::write(&log, LOG).unwrap();
        let later = std::fs::File::options().append(true).open(&log).unwrap();
        later
            .set_modified(std::time::SystemTime::UNIX_EPOCH)
            .unwrap();
        assert_eq!(library(&store, &log, &content).await, "");
    }

    /// The first is read before the second is found gone: what comes later takes nothing of what is done.
    #[tokio::test]
    async fn each_log_is_remembered_as_soon_as_it_is_read_and_only_by_who_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["a", "b"].map(|name| folder.path().join(format!("{name}.mcap")));
        paths
            .iter()
            .for_each(|path| std::fs::write(path, LOG).unwrap());
        let store = Store::open(folder.path().join("map").to_str().unwrap(), true).unwrap();
        let texts = paths.each_ref().map(|path| path.display().to_string());
        let runtime = RuntimeEnv::default();
        let dataset = Dataset::open(&runtime, &texts, None).await.unwrap();
        let sessions = &dataset.sessions;
        let nothing = Contents::new();
        let looked = read(&store, &nothing, sessions, None).await.unwrap();
        assert!(looked.len() == 2 && looked[0] == looked[1]);
        assert!(!folder.path().join("map").exists());

        std::fs::remove_file(&paths[1]).unwrap();
        let ended = read(&store, &nothing, sessions, Some(&mut |_: f64| ())).await;
        assert!(ended.is_err());
        let kept = names_of(&store, &looked.iter().cloned().collect())
            .await
            .unwrap();
        assert_eq!(kept.len(), 1);

        // What is remembered is not read again, nor looked for.
        let remembered = sessions.iter().map(|session| session.name.to_string());
        let remembered: Contents = remembered.zip(looked.clone()).collect();
        let known = read(&store, &remembered, sessions, None).await.unwrap();
        assert_eq!(known, looked);
    }

    #[test]
    fn a_file_of_just_now_or_of_the_future_is_not_trusted() {
        let now = Utc::now();
        let file = |age_ms: i64| FileState {
            store: "s3://logs/".into(),
            location: "a.mcap".into(),
            size: 1,
            modified: now - TimeDelta::milliseconds(age_ms),
            e_tag: None,
            status_changed: None,
        };
        assert!(file(2001).rests(now));
        assert!(!file(1999).rests(now));
        assert!(!file(-60_000).rests(now));
        let touched = FileState {
            status_changed: Some((now.timestamp(), 0)),
            ..file(1_000_000)
        };
        assert!(!touched.rests(now), "its status changed just now");
    }
}
