//! A folder of several files, which appear when all of them are written.

use std::fs::{create_dir_all, rename, write};
use std::io::Error;
use std::path::{Path, PathBuf};

use evermap_datasets::{finish_folder, parent, unfinished_folder};
use evermap_schemas::Fault;
use tempfile::TempDir;

use crate::output::place::{may_write, outside_of_maps};

/// A folder being filled. What is in it is gone with it, unless it was finished by then.
#[derive(Debug)]
pub struct Folder {
    part: TempDir,
    done: PathBuf,
    /// Names of its files, in the order in which they appear.
    files: Vec<String>,
}

impl Folder {
    /// One whose files appear in `out`, which is made where it is missing, when [`Folder::finish`] is called.
    ///
    /// # Errors
    /// A user fault where something else than a folder is there, and among the files of a map, a resource fault when it cannot
    /// be written to.
    pub fn create(out: &Path) -> Result<Self, Fault> {
        outside_of_maps(out)?;
        if out.exists() && !out.is_dir() {
            let found = format!("expected a folder at {}, found a file", out.display());
            return Err(Fault::user(found).next("name another one"));
        }
        // Files are moved, which goes no further than a disk.
        let within = if out.is_dir() { out } else { parent(out) };
        create_dir_all(within).map_err(|error| cannot(out, &error))?;
        Ok(Self {
            part: unfinished_folder(within).map_err(|error| cannot(out, &error))?,
            done: out.to_owned(),
            files: Vec::new(),
        })
    }

    /// Adds a file.
    ///
    /// # Errors
    /// A user fault for a name that a log or a map's own file has in the folder, a resource fault when it cannot be written.
    pub fn add(&mut self, name: &str, bytes: &[u8]) -> Result<(), Fault> {
        let place = self.done.join(name);
        may_write(&place)?;
        let written = write(self.part.path().join(name), bytes);
        written.map_err(|error| cannot(&place, &error))?;
        self.files.push(name.to_owned());
        Ok(())
    }

    /// Lets all files appear, in place of those of the same names, in the order in which they were added.
    ///
    /// # Errors
    /// A resource fault when they cannot be moved.
    pub fn finish(self) -> Result<(), Fault> {
        if !self.done.exists() {
            let finished = finish_folder(self.part, &self.done);
            return finished.map_err(|error| cannot(&self.done, &error));
        }
        for name in &self.files {
            let place = self.done.join(name);
            let moved = rename(self.part.path().join(name), &place);
            moved.map_err(|error| cannot(&place, &error))?;
        }
        Ok(())
    }
}

fn cannot(place: &Path, error: &Error) -> Fault {
    Fault::resource(format!("cannot write {}: {error}", place.display()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::collections::BTreeSet;
    use std::fs::read_dir;

    use super::*;

    fn names(folder: &Path) -> BTreeSet<String> {
        let entries = read_dir(folder).unwrap();
        let name = |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().file_name();
        let names = entries.map(name).map(|name| name.into_string().unwrap());
        names.collect()
    }

    #[test]
    fn files_appear_together_or_not_at_all() {
        let here = tempfile::tempdir().unwrap();
        let out = here.path().join("deep/out");
        for (text, there) in [("first", vec!["a", "b"]), ("next", vec!["a", "b", "kept"])] {
            let mut stopped = Folder::create(&out).unwrap();
            stopped.add("a", b"of nobody").unwrap();
            drop(stopped);
            let mut folder = Folder::create(&out).unwrap();
            folder.add("a", text.as_bytes()).unwrap();
            folder.add("b", text.as_bytes()).unwrap();
            assert_ne!(std::fs::read(out.join("b")).ok(), Some(text.into()));
            folder.finish().unwrap();
            assert_eq!(names(&out), there.iter().map(ToString::to_string).collect());
            assert_eq!(std::fs::read_to_string(out.join("a")).unwrap(), text);
            assert_eq!(names(&here.path().join("deep")), ["out".into()].into());
            std::fs::write(out.join("kept"), "").unwrap();
        }
    }

    #[test]
    fn a_file_in_place_of_the_folder_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let fault = Folder::create(file.path()).unwrap_err().to_string();
        assert!(fault.contains("expected a folder at"), "{fault}");
    }
}
