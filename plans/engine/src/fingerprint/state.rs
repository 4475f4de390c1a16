//! What files look like from outside.

use std::path::Path;

use chrono::{DateTime, SubsecRound, TimeDelta, Utc};
use evermap_datasets::LogPart;
use evermap_datasets::fault::store_fault;
use evermap_schemas::Fault;
use object_store::{ObjectMeta, ObjectStoreExt};
use serde::{Deserialize, Serialize};

/// How long a file must have rested for its times to be trusted.
const REST: TimeDelta = TimeDelta::seconds(2);

/// What tells one state of a file from another without reading it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileState {
    store: String,
    location: String,
    pub(super) size: u64,
    modified: DateTime<Utc>,
    e_tag: Option<String>,
    /// Seconds and nanoseconds; null where the store has none.
    status_changed: Option<(i64, i64)>,
}

impl FileState {
    /// The state of a file, as its store tells it.
    pub fn of(store: &str, meta: &ObjectMeta) -> Self {
        let (modified, e_tag) = match is_local(store) {
            true => (meta.last_modified, meta.e_tag.clone()),
            // Lists of objects tell parts of seconds, and leave quotes out, where who asks for one is told otherwise.
            false => (
                meta.last_modified.trunc_subsecs(0),
                meta.e_tag.as_deref().map(quoted),
            ),
        };
        Self {
            store: store.to_owned(),
            location: meta.location.to_string(),
            size: meta.size,
            modified,
            e_tag,
            status_changed: status_changed(store, meta.location.as_ref()),
        }
    }

    /// The state of a part of a log as it was opened.
    pub fn opened(part: &LogPart) -> Self {
        Self::of(part.store_url.as_str(), &part.meta)
    }

    /// The state of a part of a log as it is now.
    ///
    /// # Errors
    /// A fault with its place where it is gone, or the store does not answer.
    pub async fn now(part: &LogPart) -> Result<Self, Fault> {
        let meta = part.store.head(&part.meta.location).await;
        let meta = meta.map_err(|error| store_fault(&error).at(&part.url))?;
        Ok(Self::of(part.store_url.as_str(), &meta))
    }

    /// Whether it can have come from another state without that what there was is another: a file on a disk was touched, or
    /// has grown, as a log does that is being recorded. Whether it has, its content tells.
    pub fn goes_on(&self, before: &Self) -> bool {
        let place = |state: &Self| (state.store.clone(), state.location.clone());
        let grown = self.status_changed.is_some() && self.size > before.size;
        let touched = Self {
            status_changed: before.status_changed,
            ..self.clone()
        };
        touched == *before || (grown && place(self) == place(before))
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

fn is_local(store: &str) -> bool {
    store.starts_with("file:")
}

/// A strong entity tag as HTTP spells it.
fn quoted(tag: &str) -> String {
    match tag.contains('"') {
        true => tag.to_owned(),
        false => format!("\"{tag}\""),
    }
}

/// When a local file's status last changed: unlike the time of modification, nobody sets it back.
fn status_changed(store: &str, location: &str) -> Option<(i64, i64)> {
    use std::os::unix::fs::MetadataExt;
    let path = Path::new("/").join(location);
    let found = is_local(store).then(|| std::fs::metadata(path).ok())??;
    Some((found.ctime(), found.ctime_nsec()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
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
        assert!(file(2001).rests(now));
        assert!(!file(1999).rests(now));
        assert!(!file(-60_000).rests(now));
        let touched = FileState {
            status_changed: Some((now.timestamp(), 0)),
            ..file(1_000_000)
        };
        assert!(!touched.rests(now), "its status changed just now");
    }

    #[test]
    fn an_object_is_the_same_whether_it_was_listed_or_asked_for() {
        let asked = ObjectMeta {
            location: "a.mcap".into(),
            last_modified: DateTime::from_timestamp(1_000, 0).unwrap(),
            size: 3,
            e_tag: Some("\"77\"".into()),
            version: None,
        };
        let listed = ObjectMeta {
            last_modified: DateTime::from_timestamp(1_000, 250_000_000).unwrap(),
            e_tag: Some("77".into()),
            ..asked.clone()
        };
        let of = |meta: &ObjectMeta| FileState::of("s3://logs/", meta);
        assert_eq!(of(&asked), of(&listed));
        let other = ObjectMeta {
            e_tag: Some("\"78\"".into()),
            size: 4,
            ..asked.clone()
        };
        assert!(of(&listed).goes_on(&of(&asked)));
        // An object does not grow: it is replaced.
        assert!(!of(&other).goes_on(&of(&asked)));
    }

    #[test]
    fn a_file_goes_on_that_was_touched_or_has_grown_and_no_other() {
        let before = FileState {
            store: "file:///".into(),
            location: "a.mcap".into(),
            size: 10,
            modified: DateTime::from_timestamp(1_000, 0).unwrap(),
            e_tag: Some("7-1000-10".into()),
            status_changed: Some((1_000, 0)),
        };
        let touched = FileState {
            status_changed: Some((2_000, 0)),
            ..before.clone()
        };
        let written = |size: u64| FileState {
            size,
            modified: DateTime::from_timestamp(2_000, 0).unwrap(),
            e_tag: Some(format!("7-2000-{size}")),
            ..touched.clone()
        };
        assert!(before.goes_on(&before) && touched.goes_on(&before));
        assert!(written(11).goes_on(&before));
        assert!(!written(10).goes_on(&before) && !written(9).goes_on(&before));
        let elsewhere = FileState {
            location: "b.mcap".into(),
            ..written(11)
        };
        assert!(!elsewhere.goes_on(&before));
    }
}
