//! Where a command may write: not among the files of a map, and over no log.

use std::path::{Path, PathBuf};

use evermap_datasets::recorder_of;
use evermap_engine::map::map_of;
use evermap_schemas::Fault;

/// That a file which is no log may be written at a path, in place of what is there.
///
/// # Errors
/// As [`outside_of_maps`], and a user fault for a log: a drive cannot be recorded again.
pub fn may_write(path: &Path) -> Result<(), Fault> {
    outside_of_maps(path)?;
    match recorder_of(path) {
        None => Ok(()),
        Some(recorder) => {
            let path = path.display();
            let found = format!("expected no log there, found one of {recorder}");
            Err(Fault::user(format!("cannot write {path}: {found}"))
                .next("name another file, or move the log away"))
        }
    }
}

/// That a path, behind all links, is not among the files of a map: readers would believe what is written there, or `gc`
/// remove it.
///
/// # Errors
/// A user fault that names the map.
pub fn outside_of_maps(path: &Path) -> Result<(), Fault> {
    // A link may be a map's own, and so may be what it leads to.
    let places = [beside(path), behind(path)];
    let Some(map) = places.iter().find_map(|place| map_of(place)) else {
        return Ok(());
    };
    let (path, map) = (path.display(), map.display());
    let found = format!("expected a place outside of maps, found one among the files of {map}");
    Err(Fault::user(format!("cannot write {path}: {found}"))
        .next("name a file elsewhere: only runs and `evermap gc` write there"))
}

/// The path from the root on, as far as its folder is there behind all links.
fn beside(path: &Path) -> PathBuf {
    match (path.parent(), path.file_name()) {
        (Some(parent), Some(name)) if parent == Path::new("") => behind(Path::new(".")).join(name),
        (Some(parent), Some(name)) => behind(parent).join(name),
        _ => path.to_owned(),
    }
}

/// The same, also behind what the path itself is.
fn behind(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| beside(path))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_datasets::LogWriter;

    use super::*;
    use crate::output::write_file;

    fn refused(path: &Path) -> String {
        let crate::ending::Failure::Fault(fault) = write_file(path, b"mine").unwrap_err() else {
            return String::new();
        };
        fault.to_string()
    }

    #[cfg(unix)]
    #[test]
    fn nothing_is_written_among_the_files_of_a_map() {
        let folder = tempfile::tempdir().unwrap();
        let within = |name: &str| folder.path().join(name);
        for made in ["lot/receipts", "lot/artifacts", "lot/versions", "else"] {
            std::fs::create_dir_all(within(made)).unwrap();
        }
        let version = within("lot/versions/1.json");
        std::fs::write(&version, "theirs").unwrap();
        std::os::unix::fs::symlink(&version, within("link.json")).unwrap();
        std::os::unix::fs::symlink(within("lot"), within("other")).unwrap();
        for name in [
            "lot/versions/1.json",
            "lot/versions/2.json",
            "else/../lot/artifacts/a.parquet",
            "other/receipts/a.json",
            "link.json",
        ] {
            let said = refused(&within(name));
            assert!(said.contains("among the files of"), "{name}: {said}");
        }
        assert_eq!(std::fs::read(&version).unwrap(), b"theirs");
        assert!(outside_of_maps(&within("lot/artifacts/not/yet")).is_err());
        write_file(&within("lot/lanes.geojson"), b"mine").unwrap();
    }

    #[test]
    fn a_log_is_replaced_by_no_file_and_by_no_log_of_another_program() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("drive.mcap");
        let write = |library: &str| LogWriter::create(&log, library, "").unwrap().finish();
        write("recorder 1.2").unwrap();
        let hard = folder.path().join("hard.json");
        std::fs::hard_link(&log, &hard).unwrap();
        for path in [&log, &hard] {
            let said = refused(path);
            let expected = "expected no log there, found one of recorder 1.2";
            assert!(said.contains(expected), "{said}");
        }
        let error = LogWriter::create(&log, "evermap export 1.2", "")
            .err()
            .unwrap();
        let said = "expected no log there but of evermap export, found one of recorder 1.2";
        assert!(error.to_string().contains(said), "{error}");
        // A newer one of the same program may.
        write("recorder 1.3").unwrap();
        assert_eq!(recorder_of(&log).as_deref(), Some("recorder 1.3"));
    }
}
