//! Files and folders that are not finished, and where they go when they are.
//!
//! They lie beside what they become, under names that nobody else has and that begin with a dot, with the rights that it will
//! have. Who drops them removes them.

use std::fs::{File, OpenOptions};
use std::io::{Error, Result};
#[cfg(unix)]
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile, TempDir};

/// How their names begin.
const PREFIX: &str = ".evermap-";

/// A new file in a folder.
///
/// # Errors
/// What the system says.
pub fn unfinished_file(folder: &Path) -> Result<NamedTempFile> {
    builder(0o666).tempfile_in(folder)
}

/// A new folder in another one.
///
/// # Errors
/// What the system says.
pub fn unfinished_folder(folder: &Path) -> Result<TempDir> {
    builder(0o777).tempdir_in(folder)
}

/// Gives a folder its name, which nothing may have.
///
/// # Errors
/// What the system says.
pub fn finish_folder(unfinished: TempDir, name: &Path) -> Result<()> {
    std::fs::rename(unfinished.path(), name)?;
    // There is nothing to be removed under its old name.
    let _ = unfinished.keep();
    Ok(())
}

/// What makes them, with rights as those of other files: the system takes away those that the user has excluded.
fn builder(rights: u32) -> Builder<'static, 'static> {
    let mut builder = Builder::new();
    builder.prefix(PREFIX);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(rights));
    builder
}

/// Where what is written to a path goes.
#[derive(Debug)]
pub enum Goes {
    /// To a file of this name, in place of what is there: links lead to it, and stay.
    Named(PathBuf),
    /// Into something that is open already, or is no file: what a shell has redirected, a pipe, a device.
    Into(File),
}

impl Goes {
    /// By what is at a path, behind all links.
    ///
    /// # Errors
    /// For something that cannot be opened to be written, and for links in a circle.
    pub fn to(path: &Path) -> Result<Self> {
        let mut place = path.to_owned();
        for _ in 0..MOST_LINKS {
            if let Some(descriptor) = descriptor(&place) {
                return opened(descriptor, path).map(Self::Into);
            }
            let Ok(next) = place.read_link() else {
                return Self::to_place(place);
            };
            place = parent(&place).join(next);
        }
        Err(Error::other("expected a file, found links in a circle"))
    }

    fn to_place(place: PathBuf) -> Result<Self> {
        match place.metadata() {
            Ok(found) if !found.is_file() && !found.is_dir() => {
                let opened = OpenOptions::new().write(true).open(place)?;
                Ok(Self::Into(opened))
            }
            _ => Ok(Self::Named(place)),
        }
    }
}

/// More links one behind another are a circle.
const MOST_LINKS: usize = 40;

/// The number of what this process has open, if a path is that: `/dev/fd/1`, where `/dev/stdout` leads to.
fn descriptor(path: &Path) -> Option<u32> {
    let number = path.file_name()?.to_str()?.parse().ok()?;
    let own = Path::new("/proc/self/fd").canonicalize().ok()?;
    (parent(path).canonicalize().ok()? == own).then_some(number)
}

/// What is open under a number. Opened again it would be written from its beginning on.
#[cfg(unix)]
fn opened(descriptor: u32, path: &Path) -> Result<File> {
    match descriptor {
        1 => std::io::stdout()
            .as_fd()
            .try_clone_to_owned()
            .map(File::from),
        2 => std::io::stderr()
            .as_fd()
            .try_clone_to_owned()
            .map(File::from),
        _ => OpenOptions::new().append(true).open(path),
    }
}

#[cfg(not(unix))]
fn opened(_: u32, path: &Path) -> Result<File> {
    OpenOptions::new().append(true).open(path)
}

/// The folder that a file is in.
pub fn parent(path: &Path) -> &Path {
    let parent = path.parent();
    let parent = parent.filter(|parent| !parent.as_os_str().is_empty());
    parent.unwrap_or(Path::new("."))
}

#[cfg(all(test, unix))]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use std::os::unix::fs::symlink;

    use super::*;

    fn named(path: &Path) -> PathBuf {
        match Goes::to(path).unwrap() {
            Goes::Named(place) => place,
            Goes::Into(file) => panic!("{file:?}"),
        }
    }

    #[test]
    fn what_is_written_to_a_link_goes_where_it_leads() {
        let folder = tempfile::tempdir().unwrap();
        let within = |name: &str| folder.path().join(name);
        std::fs::create_dir(within("else")).unwrap();
        symlink("else/there", within("first")).unwrap();
        symlink("first", within("second")).unwrap();
        // Whether it is there or not.
        assert_eq!(named(&within("second")), within("else/there"));
        std::fs::write(within("else/there"), "").unwrap();
        assert_eq!(named(&within("second")), within("else/there"));
        assert_eq!(named(&within("other")), within("other"));
        symlink("b", within("a")).unwrap();
        symlink("a", within("b")).unwrap();
        let circle = Goes::to(&within("a")).unwrap_err().to_string();
        assert!(circle.contains("links in a circle"), "{circle}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_is_open_is_written_to_and_not_replaced() {
        use std::io::{Seek, Write};
        use std::os::fd::AsRawFd;

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let mut open = File::create(&path).unwrap();
        open.write_all(b"first ").unwrap();
        let number = open.as_raw_fd();
        for way in ["/dev/fd", "/proc/self/fd"] {
            let Goes::Into(mut file) = Goes::to(&Path::new(way).join(number.to_string())).unwrap()
            else {
                panic!("{way} is replaced")
            };
            file.write_all(b"next ").unwrap();
        }
        assert_eq!(std::fs::read(&path).unwrap(), b"first next next ");
        open.rewind().unwrap();
        assert!(matches!(
            Goes::to(Path::new("/dev/stdout")),
            Ok(Goes::Into(_))
        ));
        assert!(matches!(
            Goes::to(Path::new("/dev/null")),
            Ok(Goes::Into(_))
        ));
    }
}
