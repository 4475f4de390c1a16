//! How far units have come that executors are at work on: notes among the map's temporary files, which runs look for.
//! Ballista tells of a job only that it runs, and nobody of a unit that another run has given up: it is waited for as long as its
//! note is renewed. A note that a killed executor leaves behind is removed by `gc`, like all that is temporary.

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::time::Duration;

use chrono::{DateTime, Utc};
use evermap_contract::Registry;
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::map::lease::TERM;
use crate::map::receipt::Receipt;
use crate::map::store::{Store, TEMPORARY};
use crate::unit::Unit;

/// How often it is noted, and looked, how far a unit has come.
pub const EVERY: Duration = Duration::from_secs(5);

/// How long a note is not renewed until whoever left it is taken for dead. Clocks do not count.
const DEAD: Duration = Duration::from_secs(20);

/// What follows the digest of a unit's recipe in the name of its note.
const ENDING: &str = ".json";

/// What is noted of a unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Note {
    /// The share of its rows that is done; null where nobody knows.
    pub share: Option<f64>,
    /// When that was.
    at: DateTime<Utc>,
}

/// The notes of units by their numbers.
pub type Notes = BTreeMap<usize, Note>;

fn name(unit: &Unit) -> Result<String, Fault> {
    Ok(format!("{TEMPORARY}/{}{ENDING}", unit.recipe.digest()?))
}

/// Does a unit's work, and notes that it has begun, and from time to time how far it has come. Done twice, it leaves the same.
///
/// # Errors
/// Whatever stops it, as [`Unit::compute`]; that the store does not take what it made.
pub async fn run(unit: &Unit, registry: &Registry) -> Result<Receipt, Fault> {
    let (store, name) = (Store::open(&unit.store, false)?, name(unit)?);
    let (tell, told) = watch::channel(None);
    let work = async {
        let advanced = |share| {
            tell.send_replace(share);
        };
        unit.compute(registry, advanced).await?.keep().await
    };
    noted(&store, &name, &told, work).await
}

/// What comes of work that there is a note of from its beginning to its end.
async fn noted<T>(
    store: &Store,
    name: &str,
    told: &watch::Receiver<Option<f64>>,
    work: impl Future<Output = T>,
) -> T {
    // Another run may be started at any time: what has no note is begun a second time.
    write(store, name, told).await;
    let done = tokio::select! {
        done = work => done,
        never = keep_noting(store, name, told, EVERY) => match never {},
    };
    if let Err(fault) = store.remove(name).await {
        tracing::debug!("{name} is not removed: {fault}");
    }
    done
}

/// Notes what is told, every so long, for as long as it is waited for.
async fn keep_noting(
    store: &Store,
    name: &str,
    told: &watch::Receiver<Option<f64>>,
    every: Duration,
) -> Infallible {
    loop {
        tokio::time::sleep(every).await;
        write(store, name, told).await;
    }
}

async fn write(store: &Store, name: &str, told: &watch::Receiver<Option<f64>>) {
    let share = *told.borrow();
    let note = Note {
        share,
        at: Utc::now(),
    };
    if let Err(fault) = store.cache_json(name, &note).await {
        tracing::debug!("{name} is not noted: {fault}");
    }
}

/// Those of some units of a map that executors are at work on, each with its note. Notes that are old, as those of executors that
/// have died, or do not read are passed over.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn at_work(units: &BTreeMap<usize, Unit>) -> Result<Notes, Fault> {
    let mut found = Notes::new();
    let Some(first) = units.values().next() else {
        return Ok(found);
    };
    let store = Store::open(&first.store, false)?;
    let listed = store.list(TEMPORARY).await?.into_iter();
    let noted = listed.map(|(name, _)| name);
    let noted: BTreeSet<String> = noted.filter(|name| name.ends_with(ENDING)).collect();
    if noted.is_empty() {
        return Ok(found);
    }
    for (index, unit) in units {
        let name = name(unit)?;
        if noted.contains(&name)
            && let Ok(Some(mut note)) = store.read_json::<Note>(&name).await
            && note.at + TERM >= Utc::now()
        {
            note.share = note.share.map(|share| share.clamp(0.0, 1.0));
            found.insert(*index, note);
        }
    }
    Ok(found)
}

/// The units that executors were at work on before they were to be sent: each with its last note, and since when that is known.
pub struct Others(BTreeMap<usize, (DateTime<Utc>, Instant)>);

impl Others {
    /// Those that these notes are of.
    pub fn new(notes: &Notes) -> Self {
        let now = Instant::now();
        let units = notes.iter().map(|(unit, note)| (*unit, (note.at, now)));
        Self(units.collect())
    }

    /// Whether one is waited for.
    pub fn has(&self, unit: usize) -> bool {
        self.0.contains_key(&unit)
    }

    /// Whether none is waited for.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Those that are waited for.
    pub fn units(&self) -> Vec<usize> {
        self.0.keys().copied().collect()
    }

    /// Waits for these alone.
    pub fn retain(&mut self, is_missing: impl Fn(usize) -> bool) {
        self.0.retain(|unit, _| is_missing(*unit));
    }

    /// Takes out those that nobody is at work on any more, as the notes say that there are at this time.
    pub fn left(&mut self, notes: &Notes, now: Instant) -> Vec<usize> {
        let is_at_work = |unit: &usize, (at, since): &mut (DateTime<Utc>, Instant)| {
            let Some(note) = notes.get(unit) else {
                return false;
            };
            if note.at != *at {
                (*at, *since) = (note.at, now);
            }
            now.duration_since(*since) < DEAD
        };
        let left = self.0.extract_if(.., |unit, seen| !is_at_work(unit, seen));
        left.map(|(unit, _)| unit).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use super::*;
    use crate::map::receipt::{Extent, Recipe};
    use crate::sql::Limits;

    /// A unit without stages, of a site.
    fn unit(store: &Store, site: &str) -> Unit {
        let extent = Extent {
            session: None,
            site: Some(site.to_owned()),
        };
        Unit {
            store: store.url().to_string(),
            recipe: Recipe::new(Arc::from([]), extent),
            logs: Vec::new(),
            limits: Limits::default(),
            lease: String::new(),
        }
    }

    #[tokio::test]
    async fn what_is_at_work_is_known_by_its_notes_while_they_are_fresh() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let sites = ["a", "b", "c", "d"].map(|site| unit(&store, site));
        let names = sites.clone().map(|unit| name(&unit).unwrap());
        let units: BTreeMap<usize, Unit> = sites.into_iter().enumerate().collect();
        let at_work = async || at_work(&units).await.unwrap();
        let shares = async || {
            let notes = at_work().await.into_iter();
            notes
                .map(|(index, note)| (index, note.share))
                .collect::<Vec<_>>()
        };
        assert_eq!(shares().await, []);

        let (tell, told) = watch::channel(None);
        tell.send_replace(Some(0.25));
        let every = Duration::from_millis(5);
        while at_work().await.is_empty() {
            let noting = keep_noting(&store, &names[1], &told, every);
            let _ = tokio::time::timeout(Duration::from_millis(100), noting).await;
        }
        let old = Note {
            share: Some(0.5),
            at: Utc::now() - 2 * TERM,
        };
        store.write_json(&names[2], &old).await.unwrap();
        store.write(&names[3], b"{".to_vec()).await.unwrap();
        assert_eq!(shares().await, [(1, Some(0.25))]);
        let unknown = Note {
            share: None,
            at: Utc::now(),
        };
        store.write_json(&names[0], &unknown).await.unwrap();
        let both = [(0, None), (1, Some(0.25))];
        assert_eq!(shares().await, both);
    }

    #[tokio::test]
    async fn work_has_a_note_from_its_beginning_to_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let unit = unit(&store, "a");
        let name = name(&unit).unwrap();
        let units = BTreeMap::from([(0, unit)]);
        let (_tell, told) = watch::channel(None);
        let seen = noted(&store, &name, &told, at_work(&units)).await.unwrap();
        assert_eq!(seen.keys().collect::<Vec<_>>(), [&0]);
        assert!(at_work(&units).await.unwrap().is_empty());
    }

    #[test]
    fn who_renews_a_note_is_waited_for_and_who_does_not_is_taken_for_dead() {
        let begun = Utc::now();
        let noted = |seconds: i64| Note {
            share: None,
            at: begun + chrono::Duration::seconds(seconds),
        };
        let notes = |of: &[(usize, i64)]| -> Notes {
            of.iter().map(|(unit, at)| (*unit, noted(*at))).collect()
        };
        // Of clocks that are far apart.
        let mut others = Others::new(&notes(&[(0, 0), (1, -30), (2, 30), (3, 0)]));
        let now = Instant::now();
        assert_eq!(others.units(), [0, 1, 2, 3]);
        let at_work = notes(&[(0, 0), (1, -25), (2, 30)]);
        assert_eq!(others.left(&at_work, now + DEAD / 2), [3]);
        let at_work = notes(&[(0, 0), (1, -20), (2, 30), (3, 0)]);
        assert_eq!(others.left(&at_work, now + 2 * DEAD), [0, 2]);
        let later = now + 2 * DEAD + DEAD / 2;
        assert!(others.left(&at_work, later).is_empty());
        assert!(others.has(1) && !others.has(3));
        others.retain(|unit| unit != 1);
        assert!(others.is_empty());
    }
}
