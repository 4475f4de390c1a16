//! Logs of what people say about a map: every act is on the disk before the next one begins.
//!
//! A log is only ever added to. Its messages stand outside chunks, so that what a killed program leaves is read up to its
//! last whole message; a log that has ended, or that is torn, is never opened for writing again: the next sitting makes the
//! next *part*, `labels_2.mcap` beside `labels.mcap`.

use std::collections::BTreeMap;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use evermap_messages::annotation::{NAME, SCHEMA};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use crate::failed;
use crate::unfinished::parent;

pub use crate::RecordingError;
pub use evermap_messages::annotation::{Anchor, Annotation, DrawnPixels, Geometry, OnImage};

/// The topic of annotations.
pub const TOPIC: &str = "/annotations";

/// A log of annotations being written.
pub struct AnnotationLog {
    writer: Writer<BufWriter<File>>,
    file: File,
    path: PathBuf,
    channel: u16,
    sent: u32,
}

impl AnnotationLog {
    /// Begins the next part of a log: the file `target` where there is none, else the first free one of `target_2`,
    /// `target_3` …; never one whose name, without its extension, is `taken` by a session of the map. `library` is named
    /// as its writer.
    ///
    /// # Errors
    /// [`RecordingError`], as of all that is written.
    pub fn begin(
        target: &Path,
        taken: impl Fn(&str) -> bool,
        library: &str,
    ) -> Result<Self, RecordingError> {
        let (file, path) = create(target, taken)?;
        let fail = |error| failed(&path, error);
        let writing = file.try_clone().map_err(|error| fail(error.into()))?;
        let options = WriteOptions::new().library(library).use_chunks(false);
        let mut writer = options.create(BufWriter::new(writing)).map_err(fail)?;
        let schema = writer.add_schema(NAME, "jsonschema", SCHEMA.as_bytes());
        let channel = schema
            .and_then(|schema| writer.add_channel(schema, TOPIC, "json", &BTreeMap::new()))
            .map_err(fail)?;
        sync_folder(&path)?;
        Ok(Self {
            writer,
            file,
            path,
            channel,
            sent: 0,
        })
    }

    /// Writes acts that are said together. When this returns, all are on the disk.
    ///
    /// # Errors
    /// [`RecordingError`]; these acts may then be lost, those before them are not.
    pub fn say_all(&mut self, acts: &[Annotation]) -> Result<(), RecordingError> {
        for act in acts {
            self.add(act)?;
        }
        let flushed = self.writer.flush();
        flushed.map_err(|error| failed(&self.path, error))?;
        sync(&self.file, &self.path)
    }

    fn add(&mut self, act: &Annotation) -> Result<(), RecordingError> {
        let header = MessageHeader {
            channel_id: self.channel,
            sequence: self.sent,
            log_time: act.stamp_ns,
            publish_time: act.stamp_ns,
        };
        let written = self.writer.write_to_known_channel(&header, &act.encode());
        written.map_err(|error| failed(&self.path, error))?;
        self.sent += 1;
        Ok(())
    }

    /// Where it is written.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether it is still what stands at its path. A log that was removed meanwhile, or whose place another file took, is
    /// written to, and nobody finds it.
    pub fn is_there(&self) -> bool {
        match (std::fs::metadata(&self.path), self.file.metadata()) {
            (Ok(found), Ok(own)) => is_same(&found, &own),
            _ => false,
        }
    }

    /// Ends the part.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn finish(mut self) -> Result<PathBuf, RecordingError> {
        let fail = |error| failed(&self.path, error);
        self.writer.finish().map_err(fail)?;
        let flushed = self.writer.into_inner().flush();
        flushed.map_err(|error| fail(error.into()))?;
        sync(&self.file, &self.path)?;
        Ok(self.path)
    }
}

#[cfg(unix)]
fn is_same(one: &Metadata, other: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (one.dev(), one.ino()) == (other.dev(), other.ino())
}

/// The system does not say which file it is: one that is open cannot be removed there.
#[cfg(not(unix))]
fn is_same(_: &Metadata, _: &Metadata) -> bool {
    true
}

fn sync(file: &File, path: &Path) -> Result<(), RecordingError> {
    let synced = file.sync_data();
    synced.map_err(|error| failed(path, error.into()))
}

/// A file's name without its extension.
fn stem(path: &Path) -> String {
    path.file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// The name of a log's part with this number, counted from 1: `labels`, `labels_2`, …
fn part(target: &Path, number: u32) -> String {
    match number {
        1 => stem(target),
        _ => format!("{}_{number}", stem(target)),
    }
}

/// The parts of a log that there are, in the order they were written; none where there is no such log.
pub fn parts(target: &Path) -> Vec<PathBuf> {
    let number = |path: &Path| {
        let (own, name) = (stem(target), stem(path));
        let number = match name.strip_prefix(&own)? {
            "" => 1,
            rest => rest.strip_prefix('_')?.parse().ok()?,
        };
        (path.extension() == target.extension() && part(target, number) == name).then_some(number)
    };
    let entries = std::fs::read_dir(parent(target)).into_iter().flatten();
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut found: Vec<(u32, PathBuf)> = paths
        .filter_map(|path| Some((number(&path)?, path)))
        .collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

/// A new file for the next part. Of two programs that ask at once, each gets one of its own.
fn create(target: &Path, taken: impl Fn(&str) -> bool) -> Result<(File, PathBuf), RecordingError> {
    let mut number = 0;
    loop {
        number += 1;
        let mut name = part(target, number);
        if taken(&name) {
            continue;
        }
        if let Some(extension) = target.extension() {
            name = format!("{name}.{}", extension.to_string_lossy());
        }
        let path = target.with_file_name(name);
        let made = OpenOptions::new().write(true).create_new(true).open(&path);
        match made {
            Ok(file) => return Ok((file, path)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(failed(&path, error.into())),
        }
    }
}

/// The file's name is on the disk too, where the system can say so.
fn sync_folder(path: &Path) -> Result<(), RecordingError> {
    let folder = parent(path);
    if cfg!(unix) {
        let synced = File::open(folder).and_then(|folder| folder.sync_all());
        synced.map_err(|error| failed(folder, error.into()))?;
    }
    Ok(())
}
