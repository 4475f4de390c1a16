//! What a version of a map is made of, and how one comes to be.

use std::collections::BTreeMap;

use evermap_datasets::Manifest;
use evermap_schemas::{Fault, Kind};
use futures::Stream;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::digest::digest;
use crate::map::receipt::{Artifact, LogContent};
use crate::map::store::{Store, answers, other_json};
use crate::map::{parts, sealed};

pub use crate::fingerprint::FileState;

/// The folder of a map that has its versions.
pub const VERSIONS: &str = "versions";

/// A stored stage in a version: a published layer, or something that later runs build on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredLayer {
    /// Whether it is a layer that readers see.
    pub published: bool,
    /// The operator that made it; null for a query.
    pub op: Option<String>,
    /// Its rows, one artifact a unit.
    pub artifacts: Vec<Artifact>,
    /// Digests of the units' recipes, in the order of the artifacts.
    pub recipes: Vec<String>,
}

impl StoredLayer {
    /// Rows in all.
    pub fn rows(&self) -> u64 {
        self.artifacts.iter().map(|artifact| artifact.rows).sum()
    }

    /// Bytes in all.
    pub fn bytes(&self) -> u64 {
        self.artifacts.iter().map(|artifact| artifact.bytes).sum()
    }

    /// One digest for all the rows.
    pub fn digest(&self) -> String {
        let contents: Vec<_> = self
            .artifacts
            .iter()
            .map(|artifact| artifact.content.as_str())
            .collect();
        digest(contents.join("\n").as_bytes())
    }
}

/// A session of a map, or of a run that is to add it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MappedSession {
    /// The log, by content.
    pub log: LogContent,
    /// Where the log was when it was mapped, as a manifest of this one session.
    pub manifest: Manifest,
    /// Earliest and latest log time, ns; null where there are no messages, and in versions that are older than this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<(i64, i64)>,
}

impl MappedSession {
    /// The session of a name among some that are sorted by name.
    pub fn named<'s>(sorted: &'s [Self], name: &str) -> Option<&'s Self> {
        Self::place(sorted, name).map(|place| &sorted[place])
    }

    /// Where it is among them.
    pub fn place(sorted: &[Self], name: &str) -> Option<usize> {
        let place = sorted.binary_search_by(|session| session.log.session.as_str().cmp(name));
        place.ok()
    }
}

/// The layers of the version before that a plan reads.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Previous {
    /// The version; 0 for none.
    pub version: u64,
    /// The layers that the plan reads as `previous.NAME`.
    pub layers: BTreeMap<String, Vec<Artifact>>,
    /// Sessions whose logs have been replaced since: their rows are no longer read. Sorted.
    pub replaced: Vec<String>,
    /// Sessions that the version had, of the logs that they still have. Sorted.
    #[serde(default)]
    pub sessions: Vec<String>,
}

/// A version with the names of the files that hold parts of its lists, or none, or why it does not read.
pub type StoredVersion = Result<Option<(Version, Vec<String>)>, Fault>;

/// One version of a map.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Version {
    /// Counted from 1.
    pub version: u64,
    /// The version that the run began with; 0 for none.
    pub parent: u64,
    /// Digest of the program that made it: equal where a run would do the same.
    #[serde(default)]
    pub program: String,
    /// What `previous` meant in the run that made it.
    #[serde(default)]
    pub previous: Previous,
    /// The plan's name.
    pub plan: String,
    /// The program that made it.
    pub evermap: String,
    /// When it was published, RFC 3339.
    pub published: String,
    /// The sessions that it is made from, sorted by name.
    pub sessions: Vec<MappedSession>,
    /// Layers by name.
    pub layers: BTreeMap<String, StoredLayer>,
    /// Everything that was skipped or lost on the way, by reason. What several steps skipped in the same words is counted once,
    /// with their names.
    pub losses: BTreeMap<String, u64>,
}

impl Version {
    /// Its name in the map store.
    pub fn name(version: u64) -> String {
        format!("{VERSIONS}/{version}.json")
    }

    /// The numbers of the versions that there are, ascending; also of those that do not read, be they no files. A file with
    /// another spelling of a number, as `03.json`, is no version's.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn numbers(store: &Store) -> Result<Vec<u64>, Fault> {
        let names = store.names(VERSIONS).await?;
        let number = |name: &String| {
            let file = name.strip_prefix(VERSIONS)?.strip_prefix('/')?;
            let number = file.strip_suffix(".json")?.parse().ok()?;
            // `03` is a number too, and its file is not where version 3 is read from.
            (Self::name(number) == *name).then_some(number)
        };
        let mut numbers: Vec<_> = names.iter().filter_map(number).collect();
        numbers.sort_unstable();
        Ok(numbers)
    }

    /// A version by number; `None` where there is none.
    ///
    /// # Errors
    /// A data fault for one that is torn, is not as it was published or does not read.
    pub async fn find(store: &Store, version: u64) -> Result<Option<Self>, Fault> {
        let found = Self::with_parts(store, version).await?;
        Ok(found.map(|(found, _)| found))
    }

    /// Versions by number, read side by side and told in order: what [`Version::find`] finds of each, or its data fault.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub fn all(
        store: &Store,
        numbers: &[u64],
    ) -> impl Stream<Item = Result<(u64, StoredVersion), Fault>> {
        answers(numbers.iter().map(move |&number| async move {
            match Self::with_parts(store, number).await {
                Err(fault) if fault.kind != Kind::Data => Err(fault),
                found => Ok((number, found)),
            }
        }))
    }

    async fn with_parts(store: &Store, version: u64) -> StoredVersion {
        let name = Self::name(version);
        let Some(mut found) = sealed::read::<Value>(store, &name).await? else {
            return Ok(None);
        };
        let at = |fault: Fault| fault.at(&name);
        let parts = parts::names(&found);
        let mut lists = parts::taken(store, &mut found).await.map_err(at)?;
        let read = serde_json::from_value(found);
        let mut found: Self = read.map_err(|error| at(other_json(&error)))?;
        found.fill(&mut lists).map_err(at)?;
        match found.version {
            other if other != version => Err(Fault::data(format!(
                "{name}: expected version {version}, found version {other}"
            ))),
            _ => Ok(Some((found, parts))),
        }
    }

    /// What the file of a version is like, which tells it from another one of its number; `None` where there is none.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn state(store: &Store, version: u64) -> Result<Option<FileState>, Fault> {
        let meta = store.meta(&Self::name(version)).await?;
        Ok(meta.map(|meta| FileState::of(store.url().as_str(), &meta)))
    }

    /// A version by number.
    ///
    /// # Errors
    /// A user fault that names the versions there are, a data fault for one that is torn or does not read.
    pub async fn read(store: &Store, version: u64) -> Result<Self, Fault> {
        match Self::find(store, version).await? {
            Some(found) => Ok(found),
            None => {
                let numbers = Self::numbers(store).await?;
                let known: Vec<_> = numbers.iter().map(ToString::to_string).collect();
                Err(Fault::user(format!(
                    "no version {version} in this map; there are: {}",
                    known.join(", ")
                )))
            }
        }
    }

    /// The newest version that reads; `None` for a map without any. Those that a crash has torn are told and ignored.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn latest(store: &Store) -> Result<Option<Self>, Fault> {
        let mut numbers = Self::numbers(store).await?;
        'listed: loop {
            for &number in numbers.iter().rev() {
                match Self::find(store, number).await {
                    Ok(None) => {
                        let listed = Self::numbers(store).await?;
                        if listed != numbers {
                            numbers = listed; // It was forgotten since, as there is a newer one.
                            continue 'listed;
                        }
                        tracing::warn!("version {number} is ignored: it is listed and not there");
                    }
                    Err(fault) if fault.kind == Kind::Data => {
                        tracing::warn!("version {number} is ignored: {fault}");
                    }
                    found => return found,
                }
            }
            return Ok(None);
        }
    }

    /// The number that follows a version: the next one, but for those that are torn and so nobody's.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn number_after(store: &Store, version: u64) -> Result<u64, Fault> {
        Self::after(store, version, |_, _| {})
            .await
            .map(|(number, _)| number)
    }

    /// What follows a version: the number of the next one, and that one where it is there. Those that are torn are nobody's:
    /// `torn` hears of each, and it is passed over.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn after(
        store: &Store,
        version: u64,
        mut torn: impl FnMut(u64, Fault),
    ) -> Result<(u64, Option<Self>), Fault> {
        let mut number = version + 1;
        loop {
            match Self::find(store, number).await {
                Err(fault) if fault.kind == Kind::Data => {
                    torn(number, fault);
                    number += 1;
                }
                found => return found.map(|found| (number, found)),
            }
        }
    }

    /// The layers that readers see, by name.
    pub fn published(&self) -> impl Iterator<Item = (&String, &StoredLayer)> {
        self.layers.iter().filter(|(_, layer)| layer.published)
    }

    /// Their names.
    pub fn published_names(&self) -> Vec<&str> {
        let published = self.published();
        published.map(|(name, _)| name.as_str()).collect()
    }

    /// Whether another version has the same sessions, plan and rows.
    pub fn same_content(&self, other: &Self) -> bool {
        self.plan == other.plan && self.sessions == other.sessions && self.layers == other.layers
    }

    /// Publishes this version: all its layers change together, or, when another run was faster, not at all, which is
    /// `false`.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn publish(&self, store: &Store) -> Result<bool, Fault> {
        let written = serde_json::to_value(self.without_lists());
        let mut written = written.map_err(|error| Fault::bug(error.to_string()))?;
        for (name, layer) in &self.layers {
            let kept = &mut written["layers"][name];
            kept["artifacts"] = parts::kept(store, &layer.artifacts).await?;
            kept["recipes"] = parts::kept(store, &layer.recipes).await?;
        }
        let previous = &mut written["previous"];
        for (name, artifacts) in &self.previous.layers {
            previous["layers"][name] = parts::kept(store, artifacts).await?;
        }
        previous["sessions"] = parts::kept(store, &self.previous.sessions).await?;
        written["sessions"] = parts::kept(store, &self.sessions).await?;
        let written = sealed::bytes(&written)?;
        store.create(&Self::name(self.version), written).await
    }

    /// Puts lists that are kept in parts where they belong.
    fn fill(&mut self, lists: &mut parts::Lists) -> Result<(), Fault> {
        for (name, layer) in &mut self.layers {
            let place = format!("/layers/{name}");
            lists.fill(&format!("{place}/artifacts"), &mut layer.artifacts)?;
            lists.fill(&format!("{place}/recipes"), &mut layer.recipes)?;
        }
        for (name, artifacts) in &mut self.previous.layers {
            lists.fill(&format!("/previous/layers/{name}"), artifacts)?;
        }
        lists.fill("/previous/sessions", &mut self.previous.sessions)?;
        lists.fill("/sessions", &mut self.sessions)?;
        lists.are_back()
    }

    /// What is left of it without the lists that may be long.
    fn without_lists(&self) -> Self {
        let layers = self.layers.iter().map(|(name, layer)| {
            let rest = StoredLayer {
                published: layer.published,
                op: layer.op.clone(),
                ..StoredLayer::default()
            };
            (name.clone(), rest)
        });
        let names = self.previous.layers.keys();
        Self {
            version: self.version,
            parent: self.parent,
            program: self.program.clone(),
            previous: Previous {
                version: self.previous.version,
                layers: names.map(|name| (name.clone(), Vec::new())).collect(),
                replaced: self.previous.replaced.clone(),
                sessions: Vec::new(),
            },
            plan: self.plan.clone(),
            evermap: self.evermap.clone(),
            published: self.published.clone(),
            sessions: Vec::new(),
            layers: layers.collect(),
            losses: self.losses.clone(),
        }
    }
}

#[cfg(test)]
impl Version {
    /// Publishes so many versions without layers.
    pub(super) async fn publish_empty(store: &Store, many: u64) {
        for version in 1..=many {
            let version = Self {
                version,
                ..Self::default()
            };
            assert!(matches!(version.publish(store).await, Ok(true)));
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn another_spelling_of_a_number_is_no_version() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        Version::publish_empty(&store, 3).await;
        let third = store.read("versions/3.json").await.unwrap().unwrap();
        for other in ["03", "+3", "4.old", "-1"] {
            let name = format!("versions/{other}.json");
            store.write(&name, third.to_vec()).await.unwrap();
        }
        assert_eq!(Version::numbers(&store).await.unwrap(), [1, 2, 3]);
        store.remove("versions/3.json").await.unwrap();
        let latest = tokio::time::timeout(Duration::from_secs(60), Version::latest(&store));
        let latest = latest.await.unwrap().unwrap().unwrap();
        assert_eq!(latest.version, 2);
    }
}
