//! How far units have come that executors are at work on: notes among the map's temporary files, which the run looks for.
//! Ballista tells of a job only that it runs. A note counts for nothing else, and one that a killed executor leaves behind is
//! removed by `gc`, like all that is temporary.

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

/// How often it is noted, and looked, how far a unit has come. Shorter ones leave no note.
pub const EVERY: Duration = Duration::from_secs(5);

/// What follows the digest of a unit's recipe in the name of its note.
const ENDING: &str = ".json";

/// What is noted of a unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Note {
    /// The share of its rows that is done; null where nobody knows.
    share: Option<f64>,
    /// When that was.
    at: DateTime<Utc>,
}

fn name(unit: &Unit) -> Result<String, Fault> {
    Ok(format!("{TEMPORARY}/{}{ENDING}", unit.recipe.digest()?))
}

/// Does a unit's work, and notes from time to time how far it has come. Done twice, it leaves the same.
///
/// # Errors
/// Whatever stops it, as [`Unit::compute`]; that the store does not take what it made.
pub async fn run(unit: &Unit, registry: &Registry) -> Result<Receipt, Fault> {
    let (store, name) = (Store::open(&unit.store, false)?, name(unit)?);
    let begun = Instant::now();
    let (tell, told) = watch::channel(None);
    let work = async {
        let advanced = |share| {
            tell.send_replace(share);
        };
        unit.compute(registry, advanced).await?.keep().await
    };
    let done = tokio::select! {
        done = work => done,
        never = keep_noting(&store, &name, &told, EVERY) => match never {},
    };
    if begun.elapsed() >= EVERY
        && let Err(fault) = store.remove(&name).await
    {
        tracing::debug!("{name} is not removed: {fault}");
    }
    done
}

/// Notes what is told, for as long as it is waited for.
async fn keep_noting(
    store: &Store,
    name: &str,
    told: &watch::Receiver<Option<f64>>,
    every: Duration,
) -> Infallible {
    loop {
        tokio::time::sleep(every).await;
        let share = *told.borrow();
        let note = Note {
            share,
            at: Utc::now(),
        };
        if let Err(fault) = store.cache_json(name, &note).await {
            tracing::debug!("{name} is not noted: {fault}");
        }
    }
}

/// Those of some units of a map that executors are at work on, each with the share that is done of it where that is known. Notes that
/// are old, as those of executors that have died, or do not read are passed over.
///
/// # Errors
/// A resource fault when the store does not answer.
pub async fn at_work(units: &BTreeMap<usize, Unit>) -> Result<Vec<(usize, Option<f64>)>, Fault> {
    let mut found = Vec::new();
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
            && let Ok(Some(note)) = store.read_json::<Note>(&name).await
            && note.at + TERM >= Utc::now()
        {
            let share = note.share.map(|share| share.clamp(0.0, 1.0));
            found.push((*index, share));
        }
    }
    Ok(found)
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
        assert_eq!(at_work(&units).await.unwrap(), []);

        let (tell, told) = watch::channel(None);
        tell.send_replace(Some(0.25));
        let every = Duration::from_millis(5);
        while at_work(&units).await.unwrap().is_empty() {
            let noting = keep_noting(&store, &names[1], &told, every);
            let _ = tokio::time::timeout(Duration::from_millis(100), noting).await;
        }
        let old = Note {
            share: Some(0.5),
            at: Utc::now() - 2 * TERM,
        };
        store.write_json(&names[2], &old).await.unwrap();
        store.write(&names[3], b"{".to_vec()).await.unwrap();
        assert_eq!(at_work(&units).await.unwrap(), [(1, Some(0.25))]);
        let unknown = Note {
            share: None,
            at: Utc::now(),
        };
        store.write_json(&names[0], &unknown).await.unwrap();
        let both = [(0, None), (1, Some(0.25))];
        assert_eq!(at_work(&units).await.unwrap(), both);
    }
}
