//! Messages recorded as MCAP: those of ROS 2 that imports and simulated worlds write, and what people say about maps.

pub mod annotations;
mod partial;
mod recorder;
mod unfinished;

use evermap_messages::ros2::Message;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use partial::Partial;

pub use recorder::recorder_of;
pub use unfinished::{Goes, finish_folder, parent, unfinished_file, unfinished_folder};

/// How recorders of ROS 2 say that the topic's only message is for all who come later too.
const LATCHED: (&str, &str) = (
    "offered_qos_profiles",
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n",
);

/// Why a log was not written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file could not be written (a resource is missing).
    #[error("cannot write {}: {source}; check the folder's rights and free space", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Another program's log, or one of people's, would be lost (the user's to move).
    #[error(
        "cannot write {}: expected no log there but of {expected}, found one of {found}; name another file, or move it away",
        path.display()
    )]
    Kept {
        /// Which file.
        path: PathBuf,
        /// Whose log may be replaced.
        expected: String,
        /// Whose log is there.
        found: String,
    },
    /// A folder is where the file should be (the user's to name another).
    #[error("cannot write {}: expected a file, found a folder; name a file in it", path.display())]
    Folder {
        /// Which folder.
        path: PathBuf,
    },
    /// The MCAP writer refused a message (a bug).
    #[error("cannot write MCAP: {0}")]
    Mcap(McapError),
}

/// A log being written. It appears under its name only when it is complete; a pipe or a device gets it then.
pub struct LogWriter {
    writer: Writer<BufWriter<File>>,
    /// Messages so far, by channel.
    sent: BTreeMap<u16, u32>,
    /// Closed by then.
    partial: Partial,
}

/// When something happened, ns since the epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Times {
    /// When the recorder got it.
    pub log_ns: u64,
    /// When the sensor measured it.
    pub stamp_ns: u64,
}

impl LogWriter {
    /// Starts the file `target`, in place of an older one of the same program; `library` is named as its writer, `profile`
    /// what its channels keep to (`ros2`, or nothing).
    ///
    /// # Errors
    /// [`RecordingError`], as of all that is written, and as [`LogWriter::may_replace`].
    pub fn create(target: &Path, library: &str, profile: &str) -> Result<Self, RecordingError> {
        Self::may_replace(target, library)?;
        let (file, partial) = Partial::of(target)?;
        let options = WriteOptions::new()
            .profile(profile)
            .library(library)
            .compression(Some(Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(1 << 20));
        let writer = options.create(BufWriter::with_capacity(1 << 18, file));
        Ok(Self {
            writer: writer.map_err(|error| failed(partial.place(), error))?,
            sent: BTreeMap::new(),
            partial,
        })
    }

    /// That no log is at a path, or one that this program has written, in whatever version: a drive cannot be recorded again.
    ///
    /// # Errors
    /// [`RecordingError::Kept`].
    pub fn may_replace(path: &Path, library: &str) -> Result<(), RecordingError> {
        match recorder_of(path) {
            Some(found) if program(&found) != program(library) => Err(RecordingError::Kept {
                path: path.to_owned(),
                expected: program(library).to_owned(),
                found,
            }),
            _ => Ok(()),
        }
    }

    /// Declares a topic and gives its channel; `latched` where its only message is for all who come later too.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn topic<M: Message>(&mut self, topic: &str, latched: bool) -> Result<u16, RecordingError> {
        let metadata = latched.then(|| (LATCHED.0.to_owned(), LATCHED.1.to_owned()));
        let metadata = metadata.into_iter().collect();
        let schema = (M::NAME, "ros2msg", M::DEFINITION.as_bytes());
        self.add(topic, schema, "cdr", &metadata)
    }

    /// Declares a topic of messages that the caller encodes, with the schema's name, encoding and text.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn channel(
        &mut self,
        topic: &str,
        schema: (&str, &str, &[u8]),
        encoding: &str,
    ) -> Result<u16, RecordingError> {
        self.add(topic, schema, encoding, &BTreeMap::new())
    }

    fn add(
        &mut self,
        topic: &str,
        (name, kind, text): (&str, &str, &[u8]),
        encoding: &str,
        metadata: &BTreeMap<String, String>,
    ) -> Result<u16, RecordingError> {
        let schema = self.writer.add_schema(name, kind, text);
        let schema = schema.map_err(|error| failed(self.partial.place(), error))?;
        let channel = self.writer.add_channel(schema, topic, encoding, metadata);
        channel.map_err(|error| failed(self.partial.place(), error))
    }

    /// Says what the values of label images mean, by value; nothing where there are none.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn label_classes(
        &mut self,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), RecordingError> {
        if metadata.is_empty() {
            return Ok(());
        }
        let name = "label_classes".to_owned();
        let written = self.writer.write_metadata(&Metadata { name, metadata });
        written.map_err(|error| failed(self.partial.place(), error))
    }

    /// Writes one encoded message; the caller keeps log times in order.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn send(
        &mut self,
        channel: u16,
        times: Times,
        payload: &[u8],
    ) -> Result<(), RecordingError> {
        let sent = self.sent.entry(channel).or_default();
        let header = MessageHeader {
            channel_id: channel,
            sequence: *sent,
            log_time: times.log_ns,
            publish_time: times.stamp_ns,
        };
        *sent += 1;
        let written = self.writer.write_to_known_channel(&header, payload);
        written.map_err(|error| failed(self.partial.place(), error))
    }

    /// Completes the log, gives the file its name, or a pipe or a device all of it, and says how many messages and bytes it
    /// holds.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn finish(mut self) -> Result<(u64, u64), RecordingError> {
        let fail = |error| failed(self.partial.place(), error);
        self.writer.finish().map_err(fail)?;
        let file = self.writer.into_inner().into_inner();
        let file = file.map_err(|error| fail(error.into_error().into()))?;
        let bytes = file.metadata().map_err(|error| fail(error.into()))?.len();
        self.partial.finish(file)?;
        let messages = self.sent.values().map(|sent| u64::from(*sent)).sum();
        Ok((messages, bytes))
    }
}

/// The name of a program, without its version.
fn program(library: &str) -> &str {
    let name = library.split(char::is_numeric).next().unwrap_or(library);
    name.trim_end()
}

/// A full disk is a missing resource, and what else the writer refuses is a bug.
fn failed(path: &Path, error: McapError) -> RecordingError {
    match error {
        McapError::Io(source) => RecordingError::Io {
            path: path.to_owned(),
            source,
        },
        other => RecordingError::Mcap(other),
    }
}
