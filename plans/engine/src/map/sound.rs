//! Which artifacts are known to be what was written, so that none is read over again in every run.
//!
//! An artifact whose content was found right is remembered by what its file was like (`FileState`); while that stays,
//! it is not read again. Files of just now are not remembered beyond who has read them: they may change without looking
//! different. What a run itself writes was hashed on its way out; the next run reads it back once.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use chrono::{DateTime, Utc};
use evermap_schemas::{Fault, Kind};
use object_store::ObjectMeta;
use object_store::path::Path as ObjectPath;
use tokio::sync::OnceCell;

use crate::fingerprint::FileState;
use crate::locked::locked;
use crate::map::damage::{Damage, is_whole};
use crate::map::receipt::{Artifact, Receipt};
use crate::map::store::{ARTIFACTS, Store, each, gone};

/// Where it is remembered.
pub const NAME: &str = "sound.json";

type States = BTreeMap<String, FileState>;

/// The artifacts of a map that are known to be sound.
#[derive(Debug)]
pub struct Sound<'s> {
    store: &'s Store,
    /// What the file of a content was like when it was found right.
    states: Mutex<States>,
    /// The artifacts that were there when it was loaded: listed at once, not asked for one by one.
    /// What was found damaged since is asked for again.
    listed: Mutex<BTreeMap<ObjectPath, ObjectMeta>>,
    /// The files that were read since, by content.
    read: Mutex<BTreeMap<String, Arc<Reading>>>,
}

/// A file that is read once, however many ask for it, and at the same time.
#[derive(Debug)]
struct Reading {
    state: FileState,
    /// Whether it had rested: if not, it may have changed since without looking different.
    rested: bool,
    damage: OnceCell<Option<Damage>>,
}

/// What was found right since a map was opened, for whoever reads it and writes nothing into it.
#[derive(Debug, Default)]
pub struct SoundArtifacts(Mutex<States>);

impl SoundArtifacts {
    fn has(&self, artifact: &Artifact, state: &FileState) -> bool {
        locked(&self.0).get(&artifact.content) == Some(state)
    }

    /// Takes over what is known of these artifacts.
    fn add<'a>(&self, sound: &Sound<'_>, artifacts: impl Iterator<Item = &'a Artifact>) {
        let (mut known, states) = (locked(&self.0), locked(&sound.states));
        for artifact in artifacts {
            if let Some(state) = states.get(&artifact.content) {
                known.insert(artifact.content.clone(), state.clone());
            }
        }
    }
}

impl<'s> Sound<'s> {
    /// What is remembered of a map, and which artifacts there are. Where the former does not read, nothing is remembered.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn load(store: &'s Store) -> Result<Self, Fault> {
        let artifacts = store.objects_in(ARTIFACTS).await?.into_iter();
        let listed = artifacts.map(|meta| (meta.location.clone(), meta));
        Ok(Self {
            listed: Mutex::new(listed.collect()),
            ..Self::remembered(store).await?
        })
    }

    /// As [`Sound::load`], without asking which artifacts there are.
    async fn remembered(store: &'s Store) -> Result<Self, Fault> {
        let states = match store.read_json::<States>(NAME).await {
            Ok(states) => states.unwrap_or_default(),
            Err(fault) if fault.kind == Kind::Data => States::new(),
            Err(fault) => return Err(fault),
        };
        Ok(Self {
            store,
            states: Mutex::new(states),
            listed: Mutex::default(),
            read: Mutex::default(),
        })
    }

    /// That artifacts of a version are what was written, as far as their sizes tell. Those whose files have changed since it was
    /// `published` (RFC 3339), as a map's copy looks like too, are read whole unless they are known.
    ///
    /// # Errors
    /// A data fault for the first that is damaged or missing; a resource fault when the store does not answer.
    pub async fn check(
        store: &'s Store,
        published: &str,
        artifacts: &[Artifact],
        known: &SoundArtifacts,
    ) -> Result<(), Fault> {
        let published = DateTime::parse_from_rfc3339(published).ok();
        let is_before = |time: DateTime<Utc>| published.is_some_and(|then| time <= then);
        let names: Vec<String> = artifacts.iter().map(Artifact::name).collect();
        let metas = each(names.iter().map(|name| store.meta(name))).await?;
        let (mut written, mut touched) = (Vec::new(), Vec::new());
        for (artifact, meta) in artifacts.iter().zip(metas) {
            let Some(meta) = meta else {
                return Err(gone(&store.path(&artifact.name())));
            };
            if let Some(damage) = artifact.size_differs(Some(meta.size)) {
                return Err(damage.into());
            }
            let state = FileState::of(store.url().as_str(), &meta);
            if is_before(state.changed()) || known.has(artifact, &state) {
                continue;
            }
            match is_before(meta.last_modified) {
                false => written.push((artifact, meta)),
                true => touched.push((artifact, meta)),
            }
        }
        Self::check_contents(store, written, known).await?;
        Self::check_ends(store, artifacts).await?;
        // Moved here, or written and set back: there is no telling one from the other.
        Self::check_contents(store, touched, known).await
    }

    /// That artifacts, of whose files the store says this, have the contents that were written.
    async fn check_contents(
        store: &'s Store,
        artifacts: Vec<(&Artifact, ObjectMeta)>,
        known: &SoundArtifacts,
    ) -> Result<(), Fault> {
        if artifacts.is_empty() {
            return Ok(());
        }
        let sound = Self::remembered(store).await?;
        let read = artifacts
            .iter()
            .map(|(artifact, meta)| sound.damage_of(artifact, Some(meta.clone())));
        let damage = each(read).await?.into_iter().flatten().next();
        known.add(&sound, artifacts.iter().map(|(artifact, _)| *artifact));
        damage.map_or(Ok(()), |damage| Err(damage.into()))
    }

    /// That artifacts in a folder end as Parquet files do: whoever reads them believes the length there, in which a disk may
    /// have flipped a bit.
    async fn check_ends(store: &'s Store, artifacts: &[Artifact]) -> Result<(), Fault> {
        if store.folder.is_none() {
            return Ok(());
        }
        let ends = artifacts
            .iter()
            .map(async |artifact| is_whole(store, &artifact.name(), artifact.bytes).await);
        let ends = each(ends).await?;
        let torn = artifacts.iter().zip(ends).find(|(_, whole)| !whole);
        torn.map_or(Ok(()), |(torn, _)| Err(torn.without_end().into()))
    }

    /// What is wrong with an artifact: it is read unless its file is as it was when it was last found right.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn damage(&self, artifact: &Artifact) -> Result<Option<Damage>, Fault> {
        let place = self.store.path(&artifact.name());
        let listed = locked(&self.listed).get(&place).cloned();
        let meta = match listed {
            None => self.store.meta(&artifact.name()).await?,
            listed => listed,
        };
        let damage = self.damage_of(artifact, meta).await?;
        if damage.is_some() {
            locked(&self.listed).remove(&place);
        }
        Ok(damage)
    }

    /// What is wrong with an artifact of whose file the store says this.
    async fn damage_of(
        &self,
        artifact: &Artifact,
        meta: Option<ObjectMeta>,
    ) -> Result<Option<Damage>, Fault> {
        let damage = artifact.size_differs(meta.as_ref().map(|meta| meta.size));
        let (None, Some(meta)) = (&damage, &meta) else {
            return Ok(damage);
        };
        let state = FileState::of(self.store.url().as_str(), meta);
        let known = |states: &States| states.get(&artifact.content) == Some(&state);
        if known(&locked(&self.states)) {
            return Ok(None);
        }
        let reading = self.reading(&artifact.content, &state);
        let read = || artifact.content_damage(self.store);
        let damage = reading.damage.get_or_try_init(read).await?.clone();
        let mut states = locked(&self.states);
        if damage.is_none() && reading.rested {
            states.insert(artifact.content.clone(), state);
        } else {
            states.remove(&artifact.content);
        }
        Ok(damage)
    }

    /// The reading of a file that is like this; a new one unless it was like this when it was last asked for.
    fn reading(&self, content: &str, state: &FileState) -> Arc<Reading> {
        let mut read = locked(&self.read);
        match read.get(content) {
            Some(reading) if reading.state == *state => Arc::clone(reading),
            _ => {
                let reading = Arc::new(Reading {
                    state: state.clone(),
                    rested: state.rests(Utc::now()),
                    damage: OnceCell::new(),
                });
                read.insert(content.to_owned(), Arc::clone(&reading));
                reading
            }
        }
    }

    /// What is wrong with any of these artifacts.
    ///
    /// # Errors
    /// As [`Sound::damage`].
    pub async fn damages<'a>(
        &self,
        artifacts: impl IntoIterator<Item = &'a Artifact>,
    ) -> Result<Vec<Damage>, Fault> {
        let once: BTreeMap<&str, &Artifact> = artifacts
            .into_iter()
            .map(|artifact| (artifact.content.as_str(), artifact))
            .collect();
        let found = each(once.into_values().map(|artifact| self.damage(artifact))).await?;
        Ok(found.into_iter().flatten().collect())
    }

    /// The receipt of a recipe that was done before, with what is wrong with its rows.
    ///
    /// # Errors
    /// As [`Receipt::read`].
    pub async fn receipt(&self, digest: &str) -> Result<Option<(Receipt, Option<Damage>)>, Fault> {
        let Some(receipt) = Receipt::read(self.store, digest).await? else {
            return Ok(None);
        };
        let damage = self.damage(&receipt.artifact).await?;
        Ok(Some((receipt, damage)))
    }

    /// Remembers what was found.
    ///
    /// # Errors
    /// A resource fault when the store does not take it.
    pub async fn remember(&self) -> Result<(), Fault> {
        let states = locked(&self.states).clone();
        self.store.cache_json(NAME, &states).await
    }

    /// Forgets artifacts that are no more.
    ///
    /// # Errors
    /// As [`Sound::load`] and [`Sound::remember`].
    pub async fn forget_all_but(store: &'s Store, needed: &BTreeSet<String>) -> Result<(), Fault> {
        let sound = Self::load(store).await?;
        let forgotten = {
            let mut states = locked(&sound.states);
            let before = states.len();
            states.retain(|content, _| needed.contains(&Artifact::name_of(content)));
            states.len() < before
        };
        match forgotten {
            true => sound.remember().await,
            false => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::digest::digest;
    use crate::map::receipt::Extent;

    #[tokio::test]
    async fn what_was_found_right_is_not_read_again_until_its_file_changes() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let artifact = |content: String| Artifact {
            content,
            rows: 1,
            bytes: 4,
            extent: Extent::default(),
        };
        let (right, wrong) = (artifact(digest(b"rows")), artifact(digest(b"ROWS")));
        for artifact in [&right, &wrong] {
            store
                .write(&artifact.name(), b"rows".to_vec())
                .await
                .unwrap();
            let path = folder.path().join(artifact.name());
            let old = std::fs::File::options().append(true).open(path).unwrap();
            old.set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
        }
        let sound = Sound::load(&store).await.unwrap();
        assert_eq!(sound.damage(&right).await.unwrap(), None);
        let damage = sound.damage(&wrong).await.unwrap().unwrap();
        assert_eq!(damage.found, Some(right.content.clone()));

        // Were it read, it would be found wrong.
        let meta = store.meta(&wrong.name()).await.unwrap().unwrap();
        let state = FileState::of(store.url().as_str(), &meta);
        let states = States::from([(wrong.content.clone(), state)]);
        store.write_json(NAME, &states).await.unwrap();
        let sound = Sound::load(&store).await.unwrap();
        assert_eq!(sound.damage(&wrong).await.unwrap(), None);
        store.write(&wrong.name(), b"ROWs".to_vec()).await.unwrap();
        let sound = Sound::load(&store).await.unwrap();
        assert!(sound.damage(&wrong).await.unwrap().is_some());
        store.write(&wrong.name(), b"ROW".to_vec()).await.unwrap();
        let sound = Sound::load(&store).await.unwrap();
        let damage = sound.damage(&wrong).await.unwrap().unwrap();
        assert_eq!(damage.expected, "4 bytes");
        assert_eq!(damage.found.as_deref(), Some("3 bytes"));
    }

    /// A file of the size that was written, and with times of then.
    #[tokio::test]
    async fn what_was_changed_and_set_back_is_read_once_by_who_reads() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let rows = b"rows\0\0\0\0PAR1".to_vec();
        let artifact = |content: String| Artifact {
            content,
            rows: 1,
            bytes: rows.len() as u64,
            extent: Extent::default(),
        };
        let (right, wrong) = (artifact(digest(&rows)), artifact(digest(b"ROWS")));
        for artifact in [&right, &wrong] {
            let name = artifact.name();
            store.write(&name, rows.clone()).await.unwrap();
            let path = folder.path().join(name);
            let old = std::fs::File::options().append(true).open(path).unwrap();
            old.set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
        }
        let known = SoundArtifacts::default();
        let check = async |artifact: &Artifact, published: &str| {
            let artifacts = std::slice::from_ref(artifact);
            Sound::check(&store, published, artifacts, &known).await
        };
        let (before, later) = ("2001-01-01T00:00:00Z", "9999-01-01T00:00:00Z");
        check(&right, before).await.unwrap();
        // By sizes and ends alone.
        check(&wrong, later).await.unwrap();
        let fault = check(&wrong, before).await.unwrap_err();
        assert!(fault.message.contains("expected the digest"), "{fault}");

        let meta = store.meta(&wrong.name()).await.unwrap().unwrap();
        let state = FileState::of(store.url().as_str(), &meta);
        locked(&known.0).insert(wrong.content.clone(), state);
        check(&wrong, before).await.unwrap();
        store.write(&wrong.name(), rows.clone()).await.unwrap();
        assert!(check(&wrong, before).await.is_err());
    }
}
