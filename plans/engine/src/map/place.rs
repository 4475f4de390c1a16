//! Which files are a map's own.

use std::path::{Path, PathBuf};

use crate::fingerprint;
use crate::map::lease;
use crate::map::newest::{LINKS, NEWEST};
use crate::map::parts::PARTS;
use crate::map::receipt::RECEIPTS;
use crate::map::rows::RUNS;
use crate::map::sound;
use crate::map::store::{ARTIFACTS, TEMPORARY};
use crate::map::version::VERSIONS;

/// What a map's folder has that is its own.
const OWN: [&str; 11] = [
    ARTIFACTS,
    RECEIPTS,
    VERSIONS,
    PARTS,
    RUNS,
    NEWEST,
    LINKS,
    TEMPORARY,
    fingerprint::FOLDER,
    lease::FOLDER,
    sound::NAME,
];

/// The map on this machine whose own a file of this path is, or would be: readers believe it, and `gc` removes what it does
/// not know. The path is whole, without links and `..`.
pub fn map_of(path: &Path) -> Option<PathBuf> {
    let is_own = |root: &&Path| {
        let within = path.strip_prefix(root).ok();
        let first = within.and_then(|within| within.components().next());
        let is_named = first.is_some_and(|first| OWN.iter().any(|own| first.as_os_str() == *own));
        is_named && is_map(root)
    };
    path.ancestors().find(is_own).map(Path::to_owned)
}

/// Whether a run has left something in a folder.
fn is_map(folder: &Path) -> bool {
    [RECEIPTS, ARTIFACTS]
        .iter()
        .all(|own| folder.join(own).is_dir())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_runs_write_is_the_maps_own_and_what_lies_beside_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let within = |name: &str| folder.path().join(name);
        let own = ["versions/1.json", "artifacts/a.parquet", "sound.json"];
        // A folder with these names is no map.
        assert!(own.iter().all(|name| map_of(&within(name)).is_none()));
        for made in [RECEIPTS, ARTIFACTS] {
            std::fs::create_dir(within(made)).unwrap();
        }
        for name in own
            .into_iter()
            .chain(["versions", "newest/poses/00000.parquet"])
        {
            assert_eq!(
                map_of(&within(name)).as_deref(),
                Some(folder.path()),
                "{name}"
            );
        }
        for name in ["lanes.geojson", "exports/versions/1.json", ""] {
            assert_eq!(map_of(&within(name)), None, "{name}");
        }
    }
}
