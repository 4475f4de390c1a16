//! Links to the files of the newest version, where any program finds them: `newest/lanes/00000.parquet`, in the order of
//! rows. `newest` is itself a link, to a folder of the version's own, and changes at once for all layers.
//!
//! The links of the version before stay for whoever has begun to read them. Object stores have no links, nor have layers of very
//! many files: to make and remove ten thousand takes longer than to map one more session.

use std::io::{ErrorKind, Result};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use evermap_schemas::Fault;

use crate::map::local::{Folder, entries};
use crate::map::receipt::Artifact;
use crate::map::store::Store;
use crate::map::version::Version;

/// The link to the newest version's folder.
pub const NEWEST: &str = "newest";
/// Folders of links, one a version.
const LINKS: &str = "links";

/// Files of a layer that has links.
const MOST_FILES: usize = 1000;

/// What is linked: each published layer with the names of its files.
type Layers = Vec<(String, Vec<String>)>;

/// Makes the links of a version, unless those of a later one are there. Where the file system has no links there are none.
pub async fn link(store: &Store, version: &Version) {
    let Some(folder) = &store.folder else {
        return;
    };
    let published = version.published();
    let few = published.filter(|(_, layer)| layer.artifacts.len() <= MOST_FILES);
    let files = few.map(|(name, layer)| {
        let files = layer.artifacts.iter().map(Artifact::name).collect();
        (name.clone(), files)
    });
    let (files, number) = (files.collect(), version.version);
    let linked: std::result::Result<(), Fault> = folder
        .with(NEWEST, move |folder, _| link_all(folder, number, &files))
        .await;
    if let Err(fault) = linked {
        tracing::warn!("no links to the files of version {number}: {fault}");
    }
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

fn link_all(folder: &Folder, version: u64, layers: &Layers) -> Result<()> {
    let newest = folder.path(NEWEST);
    if linked_version(&newest)?.is_some_and(|linked| linked >= version) {
        return Ok(());
    }
    let links = folder.path(LINKS);
    let own = links.join(version.to_string());
    // What a killed run left is begun anew.
    remove(&own)?;
    std::fs::create_dir_all(&own)?;
    for (layer, files) in layers {
        let of_layer = own.join(layer);
        std::fs::create_dir_all(&of_layer)?;
        for (index, file) in files.iter().enumerate() {
            let to = PathBuf::from_iter(["..", "..", "..", file]);
            symlink(to, of_layer.join(format!("{index:05}.parquet")))?;
        }
    }
    let next = links.join(format!("{version}.{NEWEST}"));
    remove(&next)?;
    symlink(Path::new(LINKS).join(version.to_string()), &next)?;
    std::fs::rename(&next, &newest)?;
    remove_before(&links, version.saturating_sub(1))
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
    use super::*;

    #[test]
    fn a_version_whose_layers_have_no_links_leaves_none_of_another_one() {
        let root = tempfile::tempdir().unwrap();
        let folder = Folder::new(root.path().to_owned());
        let of = vec![("lanes".to_owned(), vec!["artifacts/a.parquet".to_owned()])];
        link_all(&folder, 1, &of).unwrap();
        link_all(&folder, 2, &Layers::new()).unwrap();
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
        link_all(&folder, 2, &of(&["a", "b"])).unwrap();
        assert_eq!(
            (read(0).unwrap(), read(1).unwrap()),
            ("a".into(), "b".into())
        );
        // Killed before it was done.
        std::fs::create_dir_all(root.path().join("links/3/lanes")).unwrap();
        link_all(&folder, 3, &of(&["b"])).unwrap();
        assert_eq!(read(0).unwrap(), "b");
        assert!(read(1).is_err());
        link_all(&folder, 2, &of(&["a"])).unwrap();
        assert_eq!(read(0).unwrap(), "b");
        // Those of the version before are there still, older ones are not.
        link_all(&folder, 4, &of(&["a"])).unwrap();
        let there = |version: u64| root.path().join(format!("links/{version}")).exists();
        assert_eq!([2, 3, 4].map(there), [false, true, true]);
        remove_before(&folder.path(LINKS), 4).unwrap();
        assert_eq!([3, 4].map(there), [false, true]);
    }
}
