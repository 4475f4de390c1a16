//! A log that has no name yet, and where it goes when it is complete.

use std::fs::File;
use std::io::{Error, Seek};
use std::path::{Path, PathBuf};

use tempfile::TempPath;

use crate::unfinished::{Goes, parent, unfinished_file};
use crate::{RecordingError, failed};

/// A file of a name that nobody else has. It is gone with what writes it, unless it was finished by then.
pub struct Partial {
    file: TempPath,
    goes: Goes,
    /// What was asked for.
    target: PathBuf,
    /// What faults of writing name.
    place: PathBuf,
}

impl Partial {
    /// A new file for what goes to `target`, in its folder; for what goes into a pipe or a device, in that of temporary
    /// files: nothing is written there that is not complete.
    ///
    /// # Errors
    /// [`RecordingError::Io`], and [`RecordingError::Folder`] for a folder.
    pub fn of(target: &Path) -> Result<(File, Self), RecordingError> {
        let path = target.to_owned();
        if target.is_dir() {
            return Err(RecordingError::Folder { path });
        }
        let goes = Goes::to(target).map_err(|error| failed(target, error.into()))?;
        let (folder, place) = match &goes {
            Goes::Named(place) => (parent(place).to_owned(), path.clone()),
            Goes::Into(_) => (std::env::temp_dir(), std::env::temp_dir()),
        };
        let made = unfinished_file(&folder);
        let made = made.map_err(|error| failed(&place, error.into()))?;
        let (writing, file) = made.into_parts();
        let partial = Self {
            file,
            goes,
            target: path,
            place,
        };
        Ok((writing, partial))
    }

    /// What faults of writing name.
    pub fn place(&self) -> &Path {
        &self.place
    }

    /// Has the log go where it belongs, when all of it is in `file`.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn finish(self, mut file: File) -> Result<(), RecordingError> {
        let gone = match self.goes {
            Goes::Named(place) => self.file.persist(place).map_err(|error| error.error),
            Goes::Into(into) => copy(&mut file, into),
        };
        gone.map_err(|error| failed(&self.target, error.into()))
    }
}

/// Copies a file from its beginning on.
fn copy(file: &mut File, mut into: File) -> Result<(), Error> {
    file.rewind()?;
    std::io::copy(file, &mut into)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::collections::BTreeSet;

    use crate::{LogWriter, Times};

    use super::*;

    /// A log of so many messages, not yet finished.
    fn begun(target: &Path, messages: u64) -> LogWriter {
        let mut log = LogWriter::create(target, "recorder 1.2", "").unwrap();
        let channel = log
            .channel("/said", ("said", "", &b""[..]), "json")
            .unwrap();
        for stamp_ns in 0..messages {
            let log_ns = stamp_ns;
            log.send(channel, Times { log_ns, stamp_ns }, b"{}")
                .unwrap();
        }
        log
    }

    /// Names in a folder.
    fn names(folder: &Path) -> BTreeSet<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let name = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        entries.map(|entry| name(entry.unwrap())).collect()
    }

    #[test]
    fn two_logs_of_one_name_and_a_file_beside_them_stay_whole() {
        let folder = tempfile::tempdir().unwrap();
        let within = |name: &str| folder.path().join(name);
        std::fs::write(within("drive.mcap.part"), "mine").unwrap();
        let [first, second] = [3, 400].map(|messages| begun(&within("drive.mcap"), messages));
        let beside = begun(&within("drive.a"), 5);
        assert!(!within("drive.mcap").exists());
        let (_, bytes) = second.finish().unwrap();
        let read = || std::fs::read(within("drive.mcap")).unwrap();
        assert_eq!(read().len() as u64, bytes);
        assert_eq!(mcap::MessageStream::new(&read()).unwrap().count(), 400);
        assert_eq!(beside.finish().unwrap().0, 5);
        // The last one to end holds.
        first.finish().unwrap();
        assert_eq!(mcap::MessageStream::new(&read()).unwrap().count(), 3);
        let mine = std::fs::read(within("drive.mcap.part")).unwrap();
        assert_eq!(mine, b"mine");
        let there = ["drive.a", "drive.mcap", "drive.mcap.part"];
        let there = BTreeSet::from(there.map(str::to_owned));
        assert_eq!(names(folder.path()), there);
    }

    #[test]
    fn a_log_that_is_given_up_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("drive.mcap");
        begun(&target, 3).finish().unwrap();
        let before = std::fs::read(&target).unwrap();
        drop(begun(&target, 400));
        assert_eq!(std::fs::read(&target).unwrap(), before);
        assert_eq!(names(folder.path()).len(), 1);
    }

    #[test]
    fn a_folder_is_refused_before_anything_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let refused = LogWriter::create(folder.path(), "recorder 1.2", "").err();
        let told = refused.unwrap().to_string();
        let expected = "expected a file, found a folder; name a file in it";
        assert!(told.contains(expected), "{told}");
        assert!(names(folder.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn a_pipe_gets_a_whole_log_or_nothing_and_stays_a_pipe() {
        use std::os::unix::fs::FileTypeExt;

        let folder = tempfile::tempdir().unwrap();
        let [pipe, file] = ["pipe", "file"].map(|name| folder.path().join(name));
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        begun(&file, 4000).finish().unwrap();
        let expected = std::fs::read(&file).unwrap();
        for is_given_up in [false, true] {
            let reader = std::thread::spawn({
                let pipe = pipe.clone();
                move || std::fs::read(pipe).unwrap()
            });
            let log = begun(&pipe, 4000);
            if is_given_up {
                drop(log);
                assert!(reader.join().unwrap().is_empty());
            } else {
                let (messages, bytes) = log.finish().unwrap();
                assert_eq!((messages, bytes), (4000, expected.len() as u64));
                assert!(reader.join().unwrap() == expected);
            }
        }
        assert!(pipe.metadata().unwrap().file_type().is_fifo());
        // And so of a link to a log, which stays one.
        let link = folder.path().join("link to a file");
        std::os::unix::fs::symlink(&file, &link).unwrap();
        begun(&link, 3).finish().unwrap();
        assert!(link.is_symlink() && std::fs::read(&file).unwrap() != expected);
        std::fs::remove_file(link).unwrap();
        // Of a link to one, too, and of a device.
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/null", &link).unwrap();
        begun(&link, 3).finish().unwrap();
        let null = Path::new("/dev/null").metadata().unwrap();
        assert!(null.file_type().is_char_device());
        assert_eq!(names(folder.path()).len(), 3);
    }

    #[cfg(unix)]
    #[test]
    fn a_log_has_the_rights_of_other_files() {
        use std::os::unix::fs::PermissionsExt;

        let folder = tempfile::tempdir().unwrap();
        let rights = |path: &Path| path.metadata().unwrap().permissions().mode();
        let [log, other] = ["log", "other"].map(|name| folder.path().join(name));
        begun(&log, 3).finish().unwrap();
        std::fs::write(&other, "mine").unwrap();
        assert_eq!(rights(&log), rights(&other));
    }
}
