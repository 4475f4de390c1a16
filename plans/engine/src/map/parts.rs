//! Long lists of a version in parts that versions share, so that a commit writes what it changes.
//!
//! A version lists its sessions, and an artifact and a recipe of each unit: of ten thousand sessions 18 MB, of which one
//! more session changes a few kilobytes. A list is cut where the digest of an element says so; an element that comes, goes
//! or changes then changes its own part, wherever it stands. A part is a file named by its content, and checked against its
//! name when it is read. Short lists stay where they are.

use std::collections::BTreeMap;

use bytes::Bytes;
use evermap_schemas::{Fault, Kind};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use crate::digest::digest;
use crate::map::store::{Store, each, other_json};

/// The folder of a map that has parts.
pub const PARTS: &str = "parts";
/// The member of a list that is kept in parts: their digests, in order.
const MEMBER: &str = "parts";
/// Lists of more elements are cut.
const LONGEST: usize = 1024;
/// Elements of a part, in the mean.
const MEAN: u64 = 256;
/// No part has more elements.
const LARGEST: usize = 2048;

/// The name of the part with this content.
fn name(digest: &str) -> String {
    format!("{PARTS}/{digest}.json")
}

/// Where a version has lists that may be long, as JSON pointers.
fn places(version: &Value) -> Vec<String> {
    let members = |of: &str| -> Vec<String> {
        let found = version.pointer(of).and_then(Value::as_object);
        found.map_or_else(Vec::new, |found| found.keys().cloned().collect())
    };
    let layers = members("/layers")
        .into_iter()
        .flat_map(|layer| ["artifacts", "recipes"].map(|list| format!("/layers/{layer}/{list}")));
    let previous = members("/previous/layers").into_iter();
    let previous = previous.map(|layer| format!("/previous/layers/{layer}"));
    let sessions = ["/sessions", "/previous/sessions"].map(str::to_owned);
    layers.chain(previous).chain(sessions).collect()
}

/// A list of a version as it is written: a long one is cut, and the parts that are not there yet are written. No long list is
/// ever JSON as a whole, which takes ten times the memory of its text.
///
/// # Errors
/// A resource fault when the store does not take them.
pub async fn kept<T: Serialize>(store: &Store, list: &[T]) -> Result<Value, Fault> {
    if list.len() <= LONGEST {
        return serde_json::to_value(list).map_err(unwritten);
    }
    let parts = cut(list)?;
    let written = parts.iter().map(|(digest, text)| keep(store, digest, text));
    each(written).await?;
    let digests: Vec<String> = parts.into_iter().map(|(digest, _)| digest).collect();
    Ok(json!({ MEMBER: digests }))
}

fn unwritten(error: serde_json::Error) -> Fault {
    Fault::bug(error.to_string())
}

/// The texts of lists that are kept in parts, by where the lists are.
pub struct Lists(BTreeMap<String, Vec<Bytes>>);

/// Takes the lists that are kept in parts out of a version, and reads the parts.
///
/// # Errors
/// A data fault for a part that is missing or damaged.
pub async fn taken(store: &Store, version: &mut Value) -> Result<Lists, Fault> {
    let lists = places(version).into_iter().filter_map(|place| {
        let digests = digests(version.pointer(&place)?)?.into_iter();
        Some((place, digests.map(str::to_owned).collect()))
    });
    let lists: Vec<(String, Vec<String>)> = lists.collect();
    // Those of all lists side by side: there are many lists, most of few parts.
    let wanted: Vec<&String> = lists.iter().flat_map(|(_, digests)| digests).collect();
    let parts = each(wanted.iter().map(|digest| part(store, digest))).await?;
    let mut parts = parts.into_iter();
    let mut taken = BTreeMap::new();
    for (place, digests) in lists {
        if let Some(list) = version.pointer_mut(&place) {
            *list = Value::Array(Vec::new());
        }
        taken.insert(place, parts.by_ref().take(digests.len()).collect());
    }
    Ok(Lists(taken))
}

impl Lists {
    /// Puts the elements of the list at a place where they belong, if it was taken.
    ///
    /// # Errors
    /// A data fault for elements of another shape.
    pub fn fill<T: DeserializeOwned>(
        &mut self,
        place: &str,
        list: &mut Vec<T>,
    ) -> Result<(), Fault> {
        for text in self.0.remove(place).into_iter().flatten() {
            let elements = serde_json::from_slice::<Vec<T>>(&text);
            list.extend(elements.map_err(|error| other_json(&error).at(place))?);
        }
        Ok(())
    }

    /// That all that was taken is back: a list that is not would be an empty layer.
    ///
    /// # Errors
    /// A fault of ours, for a list that nobody knows.
    pub fn are_back(&self) -> Result<(), Fault> {
        match self.0.keys().next() {
            None => Ok(()),
            Some(place) => Err(Fault::bug("a list was not put back").at(place)),
        }
    }
}

/// The names of the parts of a version as it is written.
pub fn names(version: &Value) -> Vec<String> {
    let lists = places(version).into_iter();
    let lists = lists.filter_map(|place| digests(version.pointer(&place)?));
    lists.flatten().map(name).collect()
}

/// The digests of a list that is kept in parts.
fn digests(list: &Value) -> Option<Vec<&str>> {
    let digests = list.get(MEMBER)?.as_array()?.iter();
    Some(digests.filter_map(Value::as_str).collect())
}

/// The parts of a list: digest and text of each.
fn cut<T: Serialize>(list: &[T]) -> Result<Vec<(String, Vec<u8>)>, Fault> {
    let (mut parts, mut start) = (Vec::new(), 0);
    for (index, element) in list.iter().enumerate() {
        let text = serde_json::to_vec(element).map_err(unwritten)?;
        let hash = blake3::hash(&text);
        let [a, b, c, d, ..] = *hash.as_bytes();
        let ends = u64::from(u32::from_le_bytes([a, b, c, d])) % MEAN == 0;
        if ends || index + 1 - start == LARGEST || index + 1 == list.len() {
            let text = serde_json::to_vec(&list[start..=index]).map_err(unwritten)?;
            parts.push((digest(&text), text));
            start = index + 1;
        }
    }
    Ok(parts)
}

/// Writes a part, unless it is there and whole.
async fn keep(store: &Store, digest: &str, text: &[u8]) -> Result<(), Fault> {
    let name = name(digest);
    match store.read(&name).await {
        Ok(Some(found)) if found == text => Ok(()),
        Err(fault) if fault.kind != Kind::Data => Err(fault),
        _ => store.write(&name, text.to_vec()).await,
    }
}

async fn part(store: &Store, wanted: &str) -> Result<Bytes, Fault> {
    let name = name(wanted);
    let text = store.read(&name).await?;
    let text = text.ok_or_else(|| Fault::data(format!("expected {name}, found no such file")))?;
    let found = digest(&text);
    if found != wanted {
        return Err(Fault::data(format!("expected the digest {wanted}, found {found}")).at(name));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::collections::BTreeSet;

    use super::*;

    fn version(sessions: impl IntoIterator<Item = u32>) -> Value {
        let names: Vec<Value> = sessions
            .into_iter()
            .map(|number| json!(format!("drive_{number:05}")))
            .collect();
        json!({
            "version": 1,
            "sessions": names.clone(),
            "layers": { "keyframes#lift": { "artifacts": names, "recipes": ["r"] } },
            "previous": { "sessions": [], "layers": {} },
        })
    }

    /// As a version is published.
    async fn split(store: &Store, version: &mut Value) -> Result<(), Fault> {
        for place in places(version) {
            let list = version.pointer_mut(&place).unwrap();
            *list = kept(store, list.as_array().unwrap()).await?;
        }
        Ok(())
    }

    /// As a version is read.
    async fn join(store: &Store, version: &mut Value) -> Result<(), Fault> {
        let mut lists = taken(store, version).await?;
        for place in places(version) {
            let list = version.pointer_mut(&place).unwrap();
            lists.fill(&place, list.as_array_mut().unwrap())?;
        }
        Ok(())
    }

    #[tokio::test]
    async fn lists_come_back_and_one_more_element_changes_one_part() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let before = version((0..20_000).step_by(2));
        let mut written = before.clone();
        split(&store, &mut written).await.unwrap();
        let listed = store.list(PARTS).await.unwrap().len();
        assert!(serde_json::to_vec(&written).unwrap().len() < 10_000);
        assert!((20..80).contains(&listed), "{listed} parts");

        let after = version((0..20_000).step_by(2).chain([7777]));
        let mut sorted = after.clone();
        for list in ["/sessions", "/layers/keyframes#lift/artifacts"] {
            let list = sorted.pointer_mut(list).unwrap().as_array_mut().unwrap();
            list.sort_by_key(|name| name.as_str().unwrap().to_owned());
        }
        let mut rewritten = sorted.clone();
        split(&store, &mut rewritten).await.unwrap();
        let [old, new] =
            [&written, &rewritten].map(|v| names(v).into_iter().collect::<BTreeSet<_>>());
        assert!(
            new.difference(&old).count() <= 2,
            "{:?}",
            new.difference(&old)
        );

        join(&store, &mut rewritten).await.unwrap();
        assert_eq!(rewritten, sorted);
        join(&store, &mut written).await.unwrap();
        assert_eq!(written, before);
    }

    #[tokio::test]
    async fn parts_of_several_lists_come_back_to_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let mut written = version(0..3000);
        let recipes = (0..2000).map(|number| json!(format!("recipe_{number}")));
        written["layers"]["keyframes#lift"]["recipes"] = recipes.collect();
        let before = written.clone();
        split(&store, &mut written).await.unwrap();
        for list in ["/sessions", "/layers/keyframes#lift/recipes"] {
            let parts = digests(written.pointer(list).unwrap()).unwrap();
            assert!(parts.len() > 1, "{list}: {parts:?}");
        }
        join(&store, &mut written).await.unwrap();
        assert_eq!(written, before);
    }

    #[tokio::test]
    async fn short_lists_stay_and_damaged_parts_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
        let mut short = version(0..10);
        split(&store, &mut short).await.unwrap();
        assert_eq!(short, version(0..10));

        let mut long = version(0..5000);
        split(&store, &mut long).await.unwrap();
        let damaged = names(&long).remove(3);
        std::fs::write(folder.path().join(&damaged), "[]").unwrap();
        let fault = join(&store, &mut long.clone()).await.unwrap_err();
        assert!(fault.to_string().contains(&damaged), "{fault}");
        // Publishing the same list again mends it.
        split(&store, &mut version(0..5000)).await.unwrap();
        join(&store, &mut long).await.unwrap();
        assert_eq!(long, version(0..5000));
    }
}
