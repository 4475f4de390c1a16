//! Files of a map in a local folder, as they must be written to outlive a power failure: whole and synced before they
//! have their name, and their name synced before another file may mention it.

use std::fs::{DirEntry, File};
use std::io::{ErrorKind, Result, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use evermap_schemas::Fault;

/// Where files are on their way.
pub const TEMPORARY: &str = "tmp";

/// What stands in the way of a file, and is not removed.
const OCCUPIED: &str = "expected a file, found a folder with something in it";

/// A map's folder.
#[derive(Debug, Clone)]
pub struct Folder {
    root: PathBuf,
    /// Gives a file a second name, unless that is taken: `std::fs::hard_link`, but for tests.
    link: fn(&Path, &Path) -> Result<()>,
}

impl Folder {
    /// The folder at a path; it need not be there yet.
    pub fn new(root: PathBuf) -> Self {
        Self {
            root,
            link: |from, to| std::fs::hard_link(from, to),
        }
    }

    /// The path of a name within the map.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Does something with the file of a name off the async threads.
    ///
    /// # Errors
    /// A resource fault with what went wrong at which name; a data fault where something else stands in the place of a file.
    pub async fn with<T: Send + 'static>(
        &self,
        name: &str,
        work: impl FnOnce(&Self, &str) -> Result<T> + Send + 'static,
    ) -> std::result::Result<T, Fault> {
        let (folder, owned) = (self.clone(), name.to_owned());
        let done = tokio::task::spawn_blocking(move || work(&folder, &owned)).await;
        let done = done.map_err(std::io::Error::other).flatten();
        done.map_err(|error| {
            let path = self.path(name).display().to_string();
            match error.kind() {
                ErrorKind::InvalidData => Fault::data(format!("{path}: {error}")),
                ErrorKind::DirectoryNotEmpty => Fault::data(format!("{path}: {OCCUPIED}"))
                    .next("move it away, as it is nothing of the map's, and do the same again"),
                _ => Fault::resource(format!("{path}: {error}")),
            }
        })
    }

    /// Writes a file, in place of what was there.
    ///
    /// # Errors
    /// What the file system says; nothing was changed.
    pub fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let temporary = self.staged(bytes)?;
        self.renamed(&temporary, &self.path(name))
            .inspect_err(|_| drop(std::fs::remove_file(&temporary)))
    }

    /// The bytes of a file; `None` where there is none.
    ///
    /// # Errors
    /// What the file system says; `InvalidData` for what is no file.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>> {
        if let Some(found) = self.no_file(name)? {
            let said = format!("expected a file, found {found}");
            return Err(std::io::Error::new(ErrorKind::InvalidData, said));
        }
        match std::fs::read(self.path(name)) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            read => read.map(Some),
        }
    }

    /// What stands at a name in the place of a file; `None` for a file, and for nothing. Whatever is opened is asked first: a pipe
    /// would hold up who opens it for ever.
    ///
    /// # Errors
    /// What the file system says.
    pub fn no_file(&self, name: &str) -> Result<Option<&'static str>> {
        match evermap_datasets::no_file(&self.path(name)) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            found => found,
        }
    }

    /// As [`Folder::put`], for a file that a power failure may undo or tear.
    ///
    /// # Errors
    /// What the file system says; nothing was changed.
    pub fn cache(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let (temporary, to) = (self.written(bytes)?, self.path(name));
        make_parent(&to)
            .and_then(|()| replace(&temporary, &to))
            .inspect_err(|_| drop(std::fs::remove_file(&temporary)))
    }

    /// Writes a file where none was; `false` where there is one.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(&self, name: &str, bytes: &[u8]) -> Result<bool> {
        let (temporary, to) = (self.staged(bytes)?, self.path(name));
        let created = self.created(&temporary, &to);
        // Where it was renamed, it is gone.
        let _ = std::fs::remove_file(&temporary);
        created
    }

    fn created(&self, from: &Path, to: &Path) -> Result<bool> {
        make_parent(to)?;
        let created = match (self.link)(from, to) {
            Ok(()) => true,
            Err(error) if error.kind() == ErrorKind::AlreadyExists => false,
            Err(_) => create_by_lock(from, to)?,
        };
        sync_parent(to)?;
        Ok(created)
    }

    /// Gives a file that is written its lasting name, in place of what had it.
    ///
    /// # Errors
    /// What the file system says.
    pub fn settle(&self, from: &str, to: &str) -> Result<()> {
        let (from, to) = (self.path(from), self.path(to));
        sync(&from)?;
        self.renamed(&from, &to)
    }

    /// Removes a file, or an empty folder in its place; one that is not there is fine.
    ///
    /// # Errors
    /// What the file system says.
    pub fn remove(&self, name: &str) -> Result<()> {
        let path = self.path(name);
        let removed = match std::fs::remove_file(&path) {
            Err(error) if error.kind() == ErrorKind::IsADirectory => std::fs::remove_dir(&path),
            removed => removed,
        };
        match removed {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// The names in a folder, also of what is no file.
    ///
    /// # Errors
    /// What the file system says.
    pub fn names(&self, folder: &str) -> Result<Vec<String>> {
        let name = |entry: DirEntry| format!("{folder}/{}", entry.file_name().display());
        let entries = entries(&self.path(folder))?.into_iter();
        Ok(entries.map(name).collect())
    }

    /// The files on their way that have not changed since, with their sizes, sorted.
    ///
    /// # Errors
    /// What the file system says.
    pub fn temporary(&self, since: SystemTime) -> Result<Vec<(String, u64)>> {
        let mut files = Vec::new();
        for entry in entries(&self.path(TEMPORARY))? {
            // It may have its lasting name by now.
            if let Ok(meta) = entry.metadata()
                && meta.modified()? <= since
            {
                let name = entry.file_name();
                files.push((format!("{TEMPORARY}/{}", name.display()), meta.len()));
            }
        }
        files.sort();
        Ok(files)
    }

    fn renamed(&self, from: &Path, to: &Path) -> Result<()> {
        make_parent(to)?;
        replace(from, to)?;
        sync_parent(to)
    }

    /// A file under a name of its own, synced.
    fn staged(&self, bytes: &[u8]) -> Result<PathBuf> {
        let path = self.written(bytes)?;
        sync(&path).inspect_err(|_| drop(std::fs::remove_file(&path)))?;
        Ok(path)
    }

    /// A file under a name of its own.
    fn written(&self, bytes: &[u8]) -> Result<PathBuf> {
        let path = self.path(TEMPORARY).join(uuid::Uuid::new_v4().to_string());
        make_parent(&path)?;
        let mut file = File::create_new(&path)?;
        file.write_all(bytes)
            .inspect_err(|_| drop(std::fs::remove_file(&path)))?;
        Ok(path)
    }
}

/// Gives a file a name in place of what has it: another file, or what is none. Of folders, an empty one: nothing of others is removed.
fn replace(from: &Path, to: &Path) -> Result<()> {
    match std::fs::rename(from, to) {
        Err(error) if error.kind() == ErrorKind::IsADirectory => {
            std::fs::remove_dir(to)?;
            std::fs::rename(from, to)
        }
        renamed => renamed,
    }
}

/// What is in a folder; nothing where there is none.
///
/// # Errors
/// What the file system says.
pub fn entries(folder: &Path) -> Result<Vec<DirEntry>> {
    match std::fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        entries => entries?.collect(),
    }
}

/// As linking does, on file systems without hard links: whoever holds the lock on the folder looks whether the name is
/// taken. A crash gives the lock back.
fn create_by_lock(from: &Path, to: &Path) -> Result<bool> {
    let folder = File::open(parent(to))?;
    folder.lock()?;
    if to.try_exists()? {
        return Ok(false);
    }
    std::fs::rename(from, to)?;
    Ok(true)
}

fn parent(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new("/"))
}

/// Makes a folder, and those above it, each synced into the one above.
///
/// # Errors
/// What the file system says.
pub fn make(folder: &Path) -> Result<()> {
    make_parent(&folder.join(TEMPORARY))
}

/// Makes the folder that a file is to be in, and those above it, each synced into the one above.
fn make_parent(path: &Path) -> Result<()> {
    let folder = parent(path);
    if folder.is_dir() {
        return Ok(());
    }
    make_parent(folder)?;
    match std::fs::create_dir(folder) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(error),
        _ => sync_parent(folder),
    }
}

fn sync(path: &Path) -> Result<()> {
    File::open(path)?.sync_all()?;
    tracing::trace!(path = %path.display(), "synced");
    Ok(())
}

/// Syncs the names in a file's folder, where folders can be synced.
fn sync_parent(path: &Path) -> Result<()> {
    match sync(parent(path)) {
        Err(error) if error.kind() != ErrorKind::InvalidInput => Err(error),
        _ => {
            tracing::trace!(path = %path.display(), "named");
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// A folder on a file system without hard links.
    fn unlinked(root: &Path) -> Folder {
        Folder {
            root: root.to_owned(),
            link: |_, _| Err(ErrorKind::Unsupported.into()),
        }
    }

    #[test]
    fn of_many_that_create_a_name_one_does_with_hard_links_and_without() {
        for make in [|root: &Path| Folder::new(root.to_owned()), unlinked] {
            let root = tempfile::tempdir().unwrap();
            for round in 0..20 {
                let name = format!("versions/{round}.json");
                let create = |by: u8| make(root.path()).create(&name, &[by; 1000]).unwrap();
                let winners: Vec<u8> = std::thread::scope(|scope| {
                    let threads: Vec<_> = (0..8)
                        .map(|by| scope.spawn(move || create(by).then_some(by)))
                        .collect();
                    let ended = threads.into_iter().map(|thread| thread.join().unwrap());
                    ended.flatten().collect()
                });
                assert_eq!(winners.len(), 1);
                let found = std::fs::read(root.path().join(&name)).unwrap();
                assert_eq!(found, [winners[0]; 1000]);
            }
            let left = std::fs::read_dir(root.path().join("tmp")).unwrap();
            assert_eq!(left.count(), 0);
        }
    }

    #[test]
    fn a_file_is_replaced_whole() {
        let root = tempfile::tempdir().unwrap();
        for folder in [Folder::new(root.path().to_owned()), unlinked(root.path())] {
            folder.put("receipts/a.json", b"before").unwrap();
            folder.put("tmp/a.parquet", b"after").unwrap();
            folder.settle("tmp/a.parquet", "receipts/a.json").unwrap();
            assert_eq!(
                std::fs::read(folder.path("receipts/a.json")).unwrap(),
                b"after"
            );
        }
    }

    #[test]
    fn an_empty_folder_gives_way_to_a_file_and_what_is_in_another_stays() {
        let root = tempfile::tempdir().unwrap();
        let folder = Folder::new(root.path().to_owned());
        for write in [Folder::put, Folder::cache] {
            std::fs::create_dir(folder.path("a.json")).unwrap();
            write(&folder, "a.json", b"a").unwrap();
            assert_eq!(std::fs::read(folder.path("a.json")).unwrap(), b"a");
            std::fs::remove_file(folder.path("a.json")).unwrap();
        }
        let mine = folder.path("b.json/mine");
        make(mine.parent().unwrap()).unwrap();
        std::fs::write(&mine, "mine").unwrap();
        for write in [Folder::put, Folder::cache] {
            let refused = write(&folder, "b.json", b"b").unwrap_err();
            assert_eq!(refused.kind(), ErrorKind::DirectoryNotEmpty);
        }
        assert_eq!(std::fs::read(&mine).unwrap(), b"mine");
        let left = std::fs::read_dir(folder.path(TEMPORARY)).unwrap();
        assert_eq!(left.count(), 0);
    }
}
