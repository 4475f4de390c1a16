//! Where results go: standard output, or a file that is there whole or not at all.

use std::io::{BufWriter, Error, IntoInnerError, IsTerminal, Seek, SeekFrom, Stdout, Write};
use std::path::{Path, PathBuf};

use evermap_datasets::{Goes, parent, unfinished_file};
use evermap_schemas::Fault;
use tempfile::{NamedTempFile, SpooledTempFile};

use crate::ending::Failure;
use crate::output::place::may_write;

/// Where bytes go.
#[derive(Debug)]
pub enum Sink {
    /// Standard output.
    Stdout(BufWriter<Stdout>),
    /// A file beside the one that is asked for, behind all links, renamed when it is complete.
    Temporary(Box<BufWriter<NamedTempFile>>, PathBuf),
    /// Something that is no regular file, or is open already: a pipe, a device, what a shell has redirected.
    Special(BufWriter<std::fs::File>),
    /// Memory as long as it is little, then a file without a name in this folder, which is gone when nobody has it open.
    Spooled(BufWriter<SpooledTempFile>, PathBuf),
}

impl Sink {
    /// Standard output.
    pub fn stdout() -> Self {
        Self::Stdout(BufWriter::new(std::io::stdout()))
    }

    /// A file. It appears, or is replaced, when [`Sink::finish`] is called.
    ///
    /// # Errors
    /// A user fault for a folder that is not there, a log, and a map's own file, a resource fault when it cannot be written to.
    pub fn file(path: &Path) -> Result<Self, Fault> {
        let fault =
            |error: Error| Fault::resource(format!("cannot write {}: {error}", path.display()));
        let place = match Goes::to(path).map_err(fault)? {
            Goes::Into(file) => return Ok(Self::Special(BufWriter::new(file))),
            Goes::Named(place) => place,
        };
        let folder = parent(&place);
        if !folder.is_dir() {
            let fault = format!(
                "cannot write {}: there is no folder {}",
                path.display(),
                folder.display()
            );
            return Err(Fault::user(fault));
        }
        // A link may be a log's or a map's own, and so may be what it leads to.
        may_write(path)?;
        may_write(&place)?;
        let file = unfinished_file(folder).map_err(fault)?;
        Ok(Self::Temporary(Box::new(BufWriter::new(file)), place))
    }

    /// A file where one is named, else standard output.
    ///
    /// # Errors
    /// As [`Sink::file`].
    pub fn to(path: Option<&Path>) -> Result<Self, Fault> {
        path.map_or_else(|| Ok(Self::stdout()), Self::file)
    }

    /// Memory for so many bytes; of more, a file without a name.
    pub fn spooled(most: usize) -> Self {
        Self::spooled_in(tempfile::env::temp_dir(), most)
    }

    /// As [`Sink::spooled`], with its file in this folder.
    pub(super) fn spooled_in(folder: PathBuf, most: usize) -> Self {
        let file = SpooledTempFile::new_in(most, &folder);
        Self::Spooled(BufWriter::new(file), folder)
    }

    /// What was written to a sink of [`Sink::spooled`], to be read from its beginning on, and its bytes.
    ///
    /// # Errors
    /// A resource fault when the folder of its file is full or gone; a fault of ours for other sinks.
    pub fn rewound(self) -> Result<(SpooledTempFile, u64), Failure> {
        let Self::Spooled(file, folder) = self else {
            return Err(Fault::bug("what was written cannot be read again").into());
        };
        let file = file.into_inner().map_err(IntoInnerError::into_error);
        let rewound = file.and_then(|mut file| {
            let bytes = file.seek(SeekFrom::End(0))?;
            file.rewind()?;
            Ok((file, bytes))
        });
        Ok(rewound.map_err(|error| of_folder(&folder, &error))?)
    }

    /// All that was written to a sink of [`Sink::spooled`].
    #[cfg(test)]
    #[allow(clippy::unwrap_used)]
    pub fn bytes(self) -> Vec<u8> {
        let (mut file, _) = self.rewound().unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut file, &mut bytes).unwrap();
        bytes
    }

    fn out(&mut self) -> &mut dyn Write {
        match self {
            Self::Stdout(out) => out,
            Self::Temporary(out, _) => out,
            Self::Special(out) => out,
            Self::Spooled(out, _) => out,
        }
    }

    /// What an error of writing says: nobody has named the folder of a temporary file, so it is named.
    fn told(&self, error: Error) -> Error {
        match self {
            Self::Spooled(_, folder) => of_folder(folder, &error),
            _ => error,
        }
    }

    /// Whether a person is looking.
    pub fn is_terminal(&self) -> bool {
        matches!(self, Self::Stdout(out) if out.get_ref().is_terminal())
    }

    /// Writes what is still held back, and gives a file its name.
    ///
    /// # Errors
    /// That the output is closed or full.
    pub fn finish(mut self) -> Result<(), Failure> {
        self.flush()?;
        if let Self::Temporary(file, path) = self {
            let file = file
                .into_inner()
                .map_err(|error| Failure::from(error.into_error()))?;
            file.persist(&path).map_err(|error| {
                Fault::resource(format!("cannot write {}: {}", path.display(), error.error))
            })?;
        }
        Ok(())
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.out().write(bytes);
        written.map_err(|error| self.told(error))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        let flushed = self.out().flush();
        flushed.map_err(|error| self.told(error))
    }
}

/// The error of a temporary file in a folder, as a fault that is carried through whatever writes.
fn of_folder(folder: &Path, error: &Error) -> Error {
    let folder = folder.display();
    let fault = Fault::resource(format!(
        "cannot write a temporary file in {folder}: {error}"
    ));
    let next = format!("make room in {folder}, or set TMPDIR to a folder that has it");
    Error::new(error.kind(), fault.next(next))
}

/// Writes a whole file, or none.
///
/// # Errors
/// As [`Sink::file`] and [`Sink::finish`].
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let mut sink = Sink::file(path)?;
    sink.write_all(bytes)?;
    sink.finish()
}

/// Writes a file, and others beside it that it is nothing without: all, or, as far as there is room, none. They get their names
/// in this order.
///
/// # Errors
/// As [`write_file`], and a user fault where two have one name, or where there is nothing to be beside.
pub fn write_together(files: &[(PathBuf, &[u8])]) -> Result<(), Failure> {
    let mut sinks = Vec::with_capacity(files.len());
    for (number, (path, bytes)) in files.iter().enumerate() {
        let mut sink = Sink::file(path)?;
        let is_named = matches!(sink, Sink::Temporary(..));
        let is_other = files[..number].iter().all(|(other, _)| other != path);
        if !(is_named && is_other) {
            let found = format!(
                "expected names for {} files, which belong together, found {}",
                files.len(),
                path.display()
            );
            return Err(Fault::user(found)
                .next("name a file with another ending: the others are written beside it")
                .into());
        }
        sink.write_all(bytes)?;
        sink.flush()?;
        sinks.push(sink);
    }
    sinks.into_iter().try_for_each(Sink::finish)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_file_is_whole_or_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        let mut sink = Sink::file(&path).unwrap();
        sink.write_all(b"half").unwrap();
        sink.flush().unwrap();
        assert!(!path.exists());
        drop(sink);
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            0,
            "nothing is left of it"
        );
        write_file(&path, b"one").unwrap();
        write_file(&path, b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        assert!(Sink::file(Path::new("/no/such/folder/a")).is_err());
    }

    #[test]
    fn files_that_belong_together_have_names_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let within = |name: &str| folder.path().join(name);
        let both = |one: &str, other: &str| {
            write_together(&[(within(one), b"one"), (within(other), b"other")])
        };
        both("a.pgm", "a.yaml").unwrap();
        assert_eq!(std::fs::read(within("a.yaml")).unwrap(), b"other");
        let refused = format!("{:?}", both("b.pgm", "b.pgm").unwrap_err());
        assert!(refused.contains("names for 2 files"), "{refused}");
        std::fs::create_dir(within("c.yaml")).unwrap();
        both("c.pgm", "no folder/c.yaml").unwrap_err();
        assert!(!within("b.pgm").exists() && !within("c.pgm").exists());
        let device = (PathBuf::from("/dev/null"), b"one".as_slice());
        assert!(write_together(&[device]).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_one_and_what_it_leads_to_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let within = |name: &str| folder.path().join(name);
        std::fs::create_dir(within("else")).unwrap();
        std::os::unix::fs::symlink("else/there", within("link")).unwrap();
        for bytes in [b"one", b"two"] {
            write_file(&within("link"), bytes).unwrap();
            assert!(within("link").is_symlink());
            assert_eq!(std::fs::read(within("else/there")).unwrap(), bytes);
        }
    }

    #[test]
    fn what_is_spooled_is_read_whole_from_memory_and_from_a_file() {
        for (most, is_on_disk) in [(11, false), (10, true)] {
            let mut sink = Sink::spooled(most);
            sink.write_all(b"first, ").unwrap();
            sink.flush().unwrap();
            sink.write_all(b"last").unwrap();
            let (mut file, bytes) = sink.rewound().unwrap();
            assert_eq!((bytes, file.is_rolled()), (11, is_on_disk));
            let mut text = String::new();
            std::io::Read::read_to_string(&mut file, &mut text).unwrap();
            assert_eq!(text, "first, last");
        }
    }
}
