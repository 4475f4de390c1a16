//! Digests of logs, remembered beside the map, so that logs that have not changed are not read again.
//!
//! A log is taken for unchanged when each of its files has the place, size, time of modification, entity tag and, on
//! a local disk, time of status change that it had when it was read. Times within the last two seconds say nothing,
//! as clocks of file systems are coarse: such a log is read again, and its digest is not remembered.

use std::collections::BTreeSet;
use std::path::Path;

use chrono::{DateTime, TimeDelta, Utc};
use evermap_datasets::{Dataset, Session};
use evermap_schemas::Fault;
use object_store::ObjectStoreExt;
use serde::{Deserialize, Serialize};

use crate::digest::digest_of;
use crate::map::store::Store;

/// How long a file must have rested for its times to be trusted.
const REST: TimeDelta = TimeDelta::seconds(2);

/// What tells one state of a file from another without reading it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct FileState {
    store: String,
    location: String,
    size: u64,
    modified: DateTime<Utc>,
    e_tag: Option<String>,
    /// Seconds and nanoseconds; null where the store has none.
    status_changed: Option<(i64, i64)>,
}

/// A log's digest, and what its files were like when it was computed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// BLAKE3 of the files.
    pub content: String,
    files: Vec<FileState>,
}

impl Fingerprint {
    /// Where it is remembered.
    fn name(files: &[FileState]) -> Result<String, Fault> {
        Ok(format!("{FOLDER}/{}.json", digest_of(&files)?))
    }

    /// Remembers it.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn remember(&self, store: &Store) -> Result<(), Fault> {
        store.write_json(&Self::name(&self.files)?, self).await
    }
}

/// The folder of a map that remembers digests of logs.
pub const FOLDER: &str = "logs";

/// The names under which the digests of logs with these contents are remembered.
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

/// The digest of a session's log, and what is worth remembering of it.
///
/// # Errors
/// A resource fault when a file cannot be read.
pub async fn fingerprint(
    store: &Store,
    dataset: &Dataset,
    session: &Session,
) -> Result<(String, Option<Fingerprint>), Fault> {
    let begun = Utc::now();
    let files = states(session);
    let rested = files.iter().all(|file| rests(file, begun));
    if rested && let Some(content) = remembered(store, &files).await? {
        return Ok((content, None));
    }
    let content = dataset
        .fingerprint(&session.name)
        .await?
        .to_hex()
        .to_string();
    let fresh = (rested && unchanged(session, &files).await).then(|| Fingerprint {
        content: content.clone(),
        files,
    });
    Ok((content, fresh))
}

/// What is remembered of these files; nothing where somebody else wrote there.
async fn remembered(store: &Store, files: &[FileState]) -> Result<Option<String>, Fault> {
    let found = store
        .read_json::<Fingerprint>(&Fingerprint::name(files)?)
        .await;
    Ok(match found {
        Ok(Some(found)) if found.files == files => Some(found.content),
        Ok(_) => None,
        Err(fault) if fault.kind == evermap_schemas::Kind::Data => None,
        Err(fault) => return Err(fault),
    })
}

/// The files as they were when their indexes were read.
fn states(session: &Session) -> Vec<FileState> {
    session
        .parts
        .iter()
        .map(|part| state(part.store_url.as_str(), &part.meta))
        .collect()
}

fn state(store: &str, meta: &object_store::ObjectMeta) -> FileState {
    FileState {
        store: store.to_owned(),
        location: meta.location.to_string(),
        size: meta.size,
        modified: meta.last_modified,
        e_tag: meta.e_tag.clone(),
        status_changed: status_changed(store, meta.location.as_ref()),
    }
}

/// When a local file's status last changed: unlike the time of modification, nobody sets it back.
#[cfg(unix)]
fn status_changed(store: &str, location: &str) -> Option<(i64, i64)> {
    use std::os::unix::fs::MetadataExt;
    let local = store.starts_with("file:");
    let path = Path::new("/").join(location);
    let found = local.then(|| std::fs::metadata(path).ok())??;
    Some((found.ctime(), found.ctime_nsec()))
}

#[cfg(not(unix))]
fn status_changed(_: &str, _: &str) -> Option<(i64, i64)> {
    None
}

fn rests(file: &FileState, now: DateTime<Utc>) -> bool {
    let changed = file
        .status_changed
        .and_then(|(seconds, nanoseconds)| {
            DateTime::from_timestamp(seconds, u32::try_from(nanoseconds).ok()?)
        })
        .unwrap_or(file.modified);
    now - file.modified.max(changed) > REST
}

/// Whether the files are now what they were before they were read.
async fn unchanged(session: &Session, files: &[FileState]) -> bool {
    for (part, before) in session.parts.iter().zip(files) {
        let now = part.store.head(&part.meta.location).await;
        let same = now.is_ok_and(|now| state(part.store_url.as_str(), &now) == *before);
        if !same {
            return false;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert!(rests(&file(2001), now));
        assert!(!rests(&file(1999), now));
        assert!(!rests(&file(-60_000), now));
        let touched = FileState {
            status_changed: Some((now.timestamp(), 0)),
            ..file(1_000_000)
        };
        assert!(!rests(&touched, now), "its status changed just now");
    }
}
