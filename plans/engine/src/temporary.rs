//! Folders of temporary files: such a folder goes with who made it, or, where that was killed, with the next one that is
//! made beside it.
//!
//! ```text
//!   evermap-work-XXXXXX/lock   held by its maker as long as it lives
//! ```

use std::fs::{File, TryLockError};
use std::io::{Error, ErrorKind, Result};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use datafusion::error::Result as DataFusionResult;
use datafusion::execution::disk_manager::{DiskManagerBuilder, DiskManagerMode};
#[cfg(test)]
use datafusion::execution::runtime_env::{RuntimeEnv, RuntimeEnvBuilder};
use datafusion::execution::{DiskManager, SpillFile, TempFileFactory};
use evermap_schemas::Fault;
use tempfile::TempDir;

use crate::error::external;
use crate::locked::locked;

const PREFIX: &str = "evermap-work-";

/// The file that says whether a folder's maker lives, by being locked.
const LOCK: &str = "lock";

/// A folder without that file is of a process that just begins, until it is as old as this.
const BEGINS: Duration = Duration::from_secs(24 * 60 * 60);

/// A folder that nobody takes away as long as this is there.
#[derive(Debug)]
pub struct WorkFolder {
    // The folder goes first: who finds its lock free may take it away.
    folder: TempDir,
    _lock: File,
}

impl WorkFolder {
    /// A new one among the system's temporary files (`TMPDIR`).
    ///
    /// # Errors
    /// As [`WorkFolder::new_in`].
    pub fn new() -> std::result::Result<Self, Fault> {
        Self::new_in(&std::env::temp_dir())
    }

    /// A new one in this folder, from which those go that processes of the same user left when they were killed.
    ///
    /// # Errors
    /// A resource fault when it cannot be made or locked.
    pub fn new_in(parent: &Path) -> std::result::Result<Self, Fault> {
        let made = Self::make(parent).map_err(|error| {
            Fault::resource(format!(
                "cannot make a folder for temporary files in {}: {error}",
                parent.display()
            ))
            .next("set TMPDIR to a folder of a local disk")
        })?;
        if let Err(error) = made.clear_beside(parent) {
            tracing::debug!(%error, "what killed processes left is not looked for");
        }
        Ok(made)
    }

    fn make(parent: &Path) -> Result<Self> {
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent)?;
        // It gets its name when it is locked: nobody finds it free before.
        let (unnamed, named) = (folder.path().join("unlocked"), folder.path().join(LOCK));
        let lock = File::create_new(&unnamed)?;
        lock.try_lock()?;
        std::fs::rename(unnamed, named)?;
        Ok(Self {
            folder,
            _lock: lock,
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Takes away the folders of processes of the same user that are no more.
    fn clear_beside(&self, parent: &Path) -> Result<()> {
        let user = std::fs::metadata(self.path())?.uid();
        for entry in std::fs::read_dir(parent)?.flatten() {
            let path = entry.path();
            let is_named = entry.file_name().to_string_lossy().starts_with(PREFIX);
            if is_named && path != self.path() {
                match clear(&path, user) {
                    Err(error) if error.kind() != ErrorKind::NotFound => {
                        tracing::debug!(path = %path.display(), %error, "what a killed process left stays");
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }
}

/// Takes a folder away, unless it is of another user or of a process that lives.
fn clear(path: &Path, user: u32) -> Result<()> {
    let found = path.symlink_metadata()?;
    if !found.is_dir() || found.uid() != user {
        return Ok(());
    }
    let lock = match File::open(path.join(LOCK)) {
        Ok(lock) => lock,
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let age = found.modified()?.elapsed().map_err(Error::other)?;
            return match age > BEGINS {
                true => std::fs::remove_dir_all(path),
                false => Ok(()),
            };
        }
        Err(error) => return Err(error),
    };
    match lock.try_lock() {
        // Held until it is gone, so that of several that look one takes it away.
        Ok(()) => std::fs::remove_dir_all(path),
        Err(TryLockError::WouldBlock) => Ok(()),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Where a context's sorts, joins and sides put aside what memory does not hold: a folder that is made for the first file.
#[derive(Default)]
pub struct Spills {
    // The files go before their folder does.
    made: Mutex<Option<(Arc<DiskManager>, WorkFolder)>>,
}

impl TempFileFactory for Spills {
    fn create_temp_file(&self, description: &str) -> DataFusionResult<Arc<dyn SpillFile>> {
        let mut made = locked(&self.made);
        let (disk, _) = match &mut *made {
            Some(made) => made,
            none => {
                let folder = WorkFolder::new().map_err(external)?;
                let folders = DiskManagerMode::Directories(vec![folder.path().to_owned()]);
                let disk = DiskManagerBuilder::default().with_mode(folders).build()?;
                none.insert((Arc::new(disk), folder))
            }
        };
        disk.create_tmp_file(description)
    }
}

/// The same limits, with a disk manager that says how much is in its files.
#[cfg(test)]
#[allow(clippy::unwrap_used)]
pub fn counted(runtime: &RuntimeEnv) -> Arc<RuntimeEnv> {
    let files = DiskManagerBuilder::default();
    let counted = RuntimeEnvBuilder::from_runtime_env(runtime).with_disk_manager_builder(files);
    counted.build_arc().unwrap()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::path::PathBuf;
    use std::time::SystemTime;

    use super::*;

    /// A folder of a process, with something in it; locked by nobody, or without a lock.
    fn left(parent: &Path, name: &str, lock: bool) -> PathBuf {
        let folder = parent.join(format!("{PREFIX}{name}"));
        std::fs::create_dir_all(folder.join("job/1")).unwrap();
        std::fs::write(folder.join("job/1/data"), "rows").unwrap();
        if lock {
            std::fs::write(folder.join(LOCK), "").unwrap();
        }
        folder
    }

    #[test]
    fn what_the_dead_left_goes_and_what_the_living_have_stays() {
        let parent = tempfile::tempdir().unwrap();
        let parent = parent.path();
        let living = WorkFolder::new_in(parent).unwrap();
        let dead = left(parent, "dead", true);
        let begins = left(parent, "begins", false);
        let old = left(parent, "old", false);
        let long_ago = SystemTime::now().checked_sub(2 * BEGINS).unwrap();
        File::open(&old).unwrap().set_modified(long_ago).unwrap();
        let elsewhere = left(&parent.join("elsewhere"), "dead", true);
        let link = parent.join(format!("{PREFIX}link"));
        std::os::unix::fs::symlink(&elsewhere, &link).unwrap();
        let other = parent.join("evermap-other");
        std::fs::create_dir(&other).unwrap();

        let next = WorkFolder::new_in(parent).unwrap();
        assert!(!dead.exists() && !old.exists());
        for path in [
            living.path(),
            next.path(),
            &begins,
            &elsewhere,
            &link,
            &other,
        ] {
            assert!(path.exists(), "{}", path.display());
        }
        let paths = [living.path().to_owned(), next.path().to_owned()];
        drop((living, next));
        assert!(paths.iter().all(|path| !path.exists()));
    }

    #[test]
    fn a_folder_of_another_user_stays() {
        let parent = tempfile::tempdir().unwrap();
        let dead = left(parent.path(), "dead", true);
        let user = std::fs::metadata(&dead).unwrap().uid();
        clear(&dead, user + 1).unwrap();
        assert!(dead.exists());
        clear(&dead, user).unwrap();
        assert!(!dead.exists());
    }

    #[test]
    fn many_that_begin_at_once_take_nothing_of_each_other() {
        let parent = tempfile::tempdir().unwrap();
        let begin = || WorkFolder::new_in(parent.path()).unwrap();
        let begun: Vec<WorkFolder> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..16).map(|_| scope.spawn(begin)).collect();
            let ended = threads.into_iter().map(|thread| thread.join().unwrap());
            ended.collect()
        });
        assert!(begun.iter().all(|folder| folder.path().join(LOCK).exists()));
    }
}
