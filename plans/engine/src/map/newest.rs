//! Links to the files of the newest version, where any program finds them: `newest/lanes/00000.parquet`, in the order of
//! rows. `newest` is itself a link, to a folder of the version's own, and changes at once for all layers.
//!
//! The links of the version before stay for whoever has begun to read them. Object stores have no links, nor have layers of very
//! many files: to make and remove ten thousand takes longer than to map one more session.

use std::io::{ErrorKind, Result};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use evermap_schemas::{Fault, Kind};

use crate::map::local::{Folder, entries};
use crate::map::receipt::Artifact;
use crate::map::store::Store;
use crate::map::version::Version;

/// The link to the newest version's folder.
pub const NEWEST: &str = "newest";
/// Folders of links, one a version.
pub const LINKS: &str = "links";

/// Files of a layer that has links.
const MOST_FILES: usize = 1000;

/// What is linked: each published layer with the names of its files.
type Layers = Vec<(String, Vec<String>)>;

/// Makes the links of a version, unless they or those of a later one are there. Where the file system has no links there are
/// none.
pub async fn link(store: &Store, version: &Version) {
    let Some(folder) = &store.folder else {
        return;
    };
    let gone = linked_to_nothing(store, folder, version.version).await;
    let published = version.published();
    let few = published.filter(|(_, layer)| layer.artifacts.len() <= MOST_FILES);
    let files = few.map(|(name, layer)| {
        let files = layer.artifacts.iter().map(Artifact::name).collect();
        (name.clone(), files)
    });
    let (files, number) = (files.collect(), version.version);
    let linked: std::result::Result<(), Fault> = folder
        .with(NEWEST, move |folder, _| {
            link_all(folder, number, &files, gone)
        })
        .await;
    if let Err(fault) = linked {
        tracing::warn!("no links to the files of version {number}: {fault}");
    }
}

/// A later version than this one that is linked, and is there no longer or does not read.
async fn linked_to_nothing(store: &Store, folder: &Folder, version: u64) -> Option<u64> {
    let linked = |folder: &Folder, newest: &str| linked_version(&folder.path(newest));
    let linked = folder.with(NEWEST, linked).await.ok().flatten();
    let linked = linked.filter(|&linked| linked > version)?;
    let found = Version::find(store, linked).await;
    let is_there =
        matches!(&found, Ok(Some(_))) || found.is_err_and(|fault| fault.kind != Kind::Data);
    (!is_there).then_some(linked)
}

/// Removes the links of versions before this one.
///
/// # Errors
/// A resource fault with what the file system says.
pub async fn forget_before(store: &Store, version: u64) -> std::result::Result<(), Fault> {
    match &store.folder {
        Some(folder) => {
            let forget =
                move |folder: &Folder, links: &str| remove_before(&folder.path(links), version);
            folder.with(LINKS, forget).await
        }
        None => Ok(()),
    }
}

/// `gone`: a version that is none, whatever links it has.
fn link_all(folder: &Folder, version: u64, layers: &Layers, gone: Option<u64>) -> Result<()> {
    let newest = folder.path(NEWEST);
    let linked = linked_version(&newest)?.filter(|linked| Some(*linked) != gone);
    if linked.is_some_and(|linked| linked > version) {
        return Ok(());
    }
    let links = folder.path(LINKS);
    let own = links.join(version.to_string());
    // A number may have been that of another version, which somebody has removed.
    if linked == Some(version) && leads_to(&own, layers) {
        return Ok(());
    }
    // What a killed run left is begun anew.
    remove(&own)?;
    std::fs::create_dir_all(&own)?;
    for (layer, files) in layers {
        let of_layer = own.join(layer);
        std::fs::create_dir_all(&of_layer)?;
        for (name, to) in links_of(files) {
            symlink(to, of_layer.join(name))?;
        }
    }
    let next = links.join(format!("{version}.{NEWEST}"));
    remove(&next)?;
    symlink(Path::new(LINKS).join(version.to_string()), &next)?;
    std::fs::rename(&next, &newest)?;
    remove_before(&links, version.saturating_sub(1))
}

/// The links of a layer with these files: their names, and where they lead.
fn links_of(files: &[String]) -> impl Iterator<Item = (String, PathBuf)> {
    files.iter().enumerate().map(|(index, file)| {
        let to = PathBuf::from_iter(["..", "..", "..", file]);
        (format!("{index:05}.parquet"), to)
    })
}

/// Whether the links in a version's folder are those of these layers, and no others.
fn leads_to(own: &Path, layers: &Layers) -> bool {
    let has = |folder: &Path, many| entries(folder).is_ok_and(|found| found.len() == many);
    let is_linked = |of_layer: &Path, files: &[String]| {
        let mut links = links_of(files);
        links.all(|(name, to)| {
            std::fs::read_link(of_layer.join(name)).is_ok_and(|found| found == to)
        })
    };
    let mut of_layers = layers.iter().map(|(layer, files)| (own.join(layer), files));
    has(own, layers.len())
        && of_layers
            .all(|(of_layer, files)| has(&of_layer, files.len()) && is_linked(&of_layer, files))
}

/// The version that the link leads to; `None` where there is no link.
fn linked_version(newest: &Path) -> Result<Option<u64>> {
    match std::fs::read_link(newest) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        read => Ok(number(&read?)),
    }
}

fn number(path: &Path) -> Option<u64> {
    path.file_name()?.to_str()?.parse().ok()
}

fn remove_before(links: &Path, version: u64) -> Result<()> {
    for entry in entries(links)? {
        let path = entry.path();
        if number(&path).is_some_and(|linked| linked < version) {
            remove(&path)?;
        }
    }
    Ok(())
}

/// Removes a link, or a folder of links; one that is not there is fine.
fn remove(path: &Path) -> Result<()> {
    let removed = match path.symlink_metadata() {
        Ok(meta) if meta.is_dir() => std::fs::remove_dir_all(path),
        Ok(_) => std::fs::remove_file(path),
        Err(error) => Err(error),
    };
    match removed {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::collections::BTreeMap;
    use std::os::unix::fs::MetadataExt;

    use super::*;
    use crate::map::receipt::Extent;
    use crate::map::version::StoredLayer;

    #[test]
    fn a_version_whose_layers_have_no_links_leaves_none_of_another_one() {
        let root = tempfile::tempdir().unwrap();
        let folder = Folder::new(root.path().to_owned());
        let of = vec![("lanes".to_owned(), vec!["artifacts/a.parquet".to_owned()])];
        link_all(&folder, 1, &of, None).unwrap();
        link_all(&folder, 2, &Layers::new(), None).unwrap();
        let newest = folder.path(NEWEST);
        assert_eq!(linked_version(&newest).unwrap(), Some(2));
        assert_eq!(std::fs::read_dir(newest).unwrap().count(), 0);
    }

    #[test]
    fn a_later_version_takes_the_link_and_an_earlier_one_does_not() {
        let root = tempfile::tempdir().unwrap();
        let folder = Folder::new(root.path().to_owned());
        folder.put("artifacts/a.parquet", b"a").unwrap();
        folder.put("artifacts/b.parquet", b"b").unwrap();
        let of = |files: &[&str]| -> Layers {
            let files = files.iter().map(|name| format!("artifacts/{name}.parquet"));
            vec![("lanes".to_owned(), files.collect())]
        };
        let read = |index: usize| {
            std::fs::read_to_string(root.path().join(format!("newest/lanes/{index:05}.parquet")))
        };
        link_all(&folder, 2, &of(&["a", "b"]), None).unwrap();
        assert_eq!(
            (read(0).unwrap(), read(1).unwrap()),
            ("a".into(), "b".into())
        );
        // Killed before it was done.
        std::fs::create_dir_all(root.path().join("links/3/lanes")).unwrap();
        link_all(&folder, 3, &of(&["b"]), None).unwrap();
        assert_eq!(read(0).unwrap(), "b");
        assert!(read(1).is_err());
        link_all(&folder, 2, &of(&["a"]), None).unwrap();
        assert_eq!(read(0).unwrap(), "b");
        // Those of the version before are there still, older ones are not.
        link_all(&folder, 4, &of(&["a"]), None).unwrap();
        let there = |version: u64| root.path().join(format!("links/{version}")).exists();
        assert_eq!([2, 3, 4].map(there), [false, true, true]);
        remove_before(&folder.path(LINKS), 4).unwrap();
        assert_eq!([3, 4].map(there), [false, true]);
    }

    #[tokio::test]
    async fn links_of_a_version_that_is_gone_give_way() {
        let root = tempfile::tempdir().unwrap();
        let store = Store::open(root.path().to_str().unwrap(), true).unwrap();
        let version = |number: u64, content: &str| Version {
            version: number,
            layers: BTreeMap::from([("lanes".to_owned(), rows_of(content))]),
            ..Version::default()
        };
        let publish = async |version: &Version| {
            assert!(version.publish(&store).await.unwrap());
            link(&store, version).await;
        };
        let newest = || std::fs::read_link(root.path().join("newest/lanes/00000.parquet"));
        let leads_to = |content: &str| newest().unwrap().ends_with(Artifact::name_of(content));
        let (second, third) = (version(2, "b"), version(3, "c"));
        publish(&second).await;
        publish(&third).await;
        assert!(leads_to("c"));
        // An earlier one leaves them alone, as long as there is a later one.
        link(&store, &second).await;
        assert!(leads_to("c"));

        // Another version of the number.
        store.remove("versions/3.json").await.unwrap();
        let another = version(3, "d");
        publish(&another).await;
        assert!(leads_to("d"));
        // Links that are as they should be stay the same.
        let lanes = root.path().join("links/3/lanes");
        // Held open, so that no other folder is given its number.
        let held = std::fs::File::open(&lanes).unwrap();
        link(&store, &another).await;
        let found = std::fs::metadata(&lanes).unwrap();
        assert_eq!(found.ino(), held.metadata().unwrap().ino());

        // None of the number, and one that does not read.
        store.remove("versions/3.json").await.unwrap();
        link(&store, &second).await;
        assert!(leads_to("b"));
        publish(&another).await;
        store.write("versions/3.json", vec![b'{']).await.unwrap();
        link(&store, &second).await;
        assert!(leads_to("b"));
    }

    fn rows_of(content: &str) -> StoredLayer {
        StoredLayer {
            published: true,
            artifacts: vec![Artifact {
                content: content.to_owned(),
                rows: 1,
                bytes: 1,
                extent: Extent::default(),
            }],
            ..StoredLayer::default()
        }
    }
}
