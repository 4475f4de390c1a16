//! One session's MCAP file, written under a temporary name and renamed when complete.

use crate::WorldError;
use crate::messages::MessageType;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A session being written.
pub struct Recording {
    writer: Writer<Sink>,
    sequence: BTreeMap<u16, u32>,
    temporary: PathBuf,
    target: PathBuf,
    messages: u64,
}

/// A message ready to be written.
#[derive(Debug, Clone)]
pub struct Ready {
    /// When the recorder got it, ns since the epoch.
    pub log_ns: u64,
    /// When the sensor measured it, ns since the epoch.
    pub stamp_ns: u64,
    /// On which channel.
    pub channel: u16,
    /// CDR bytes.
    pub payload: Vec<u8>,
}

impl Recording {
    /// Starts the file `target`.
    ///
    /// # Errors
    /// When the file cannot be created or written.
    pub fn create(target: &Path) -> Result<Self, WorldError> {
        let temporary = target.with_extension("mcap.part");
        let file = File::create(&temporary).map_err(|error| WorldError::io(&temporary, error))?;
        let options = WriteOptions::new()
            .profile("ros2")
            .library("evermap-worlds")
            .compression(Some(Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(1 << 20));
        let writer = options.create(Sink::new(file))?;
        Ok(Self {
            writer,
            sequence: BTreeMap::new(),
            temporary,
            target: target.to_owned(),
            messages: 0,
        })
    }

    /// Declares a topic and gives its channel.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn topic(&mut self, topic: &str, kind: MessageType) -> Result<u16, WorldError> {
        self.declare(topic, kind, &BTreeMap::new())
    }

    /// Declares a topic whose only message is for all who come later too.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn latched_topic(&mut self, topic: &str, kind: MessageType) -> Result<u16, WorldError> {
        let latched = BTreeMap::from([(
            "offered_qos_profiles".to_owned(),
            "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n".to_owned(),
        )]);
        self.declare(topic, kind, &latched)
    }

    fn declare(
        &mut self,
        topic: &str,
        kind: MessageType,
        metadata: &BTreeMap<String, String>,
    ) -> Result<u16, WorldError> {
        let definition = kind.definition.as_bytes();
        let schema = self.writer.add_schema(kind.name, "ros2msg", definition)?;
        Ok(self.writer.add_channel(schema, topic, "cdr", metadata)?)
    }

    /// Writes a metadata record.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), WorldError> {
        let name = name.to_owned();
        Ok(self.writer.write_metadata(&Metadata { name, metadata })?)
    }

    /// Writes one message; the caller keeps log times in order.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&mut self, message: &Ready) -> Result<(), WorldError> {
        let sequence = self.sequence.entry(message.channel).or_insert(0);
        let header = MessageHeader {
            channel_id: message.channel,
            sequence: *sequence,
            log_time: message.log_ns,
            publish_time: message.stamp_ns,
        };
        *sequence += 1;
        self.messages += 1;
        self.writer
            .write_to_known_channel(&header, &message.payload)?;
        Ok(())
    }

    /// Completes the file, gives it its name, and says how many messages and bytes it holds.
    ///
    /// # Errors
    /// When any write of this file failed.
    pub fn finish(mut self) -> Result<(u64, u64), WorldError> {
        self.writer.finish()?;
        let sink = self.writer.into_inner();
        let file = sink
            .close()
            .map_err(|error| WorldError::io(&self.temporary, error))?;
        let bytes = file
            .metadata()
            .map_err(|error| WorldError::io(&self.temporary, error))?
            .len();
        std::fs::rename(&self.temporary, &self.target)
            .map_err(|error| WorldError::io(&self.target, error))?;
        Ok((self.messages, bytes))
    }
}

/// A file that remembers its first error and swallows what follows, because the MCAP writer
/// would panic in its destructor on a full disk.
struct Sink {
    file: BufWriter<File>,
    failed: Option<io::Error>,
}

impl Sink {
    fn new(file: File) -> Self {
        Self {
            file: BufWriter::with_capacity(1 << 18, file),
            failed: None,
        }
    }

    fn close(mut self) -> io::Result<File> {
        self.flush()?;
        if let Some(error) = self.failed {
            return Err(error);
        }
        self.file
            .into_inner()
            .map_err(io::IntoInnerError::into_error)
    }

    fn note(&mut self, result: io::Result<()>) {
        if let (Err(error), None) = (result, &self.failed) {
            self.failed = Some(error);
        }
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.failed.is_none() {
            let result = self.file.write_all(bytes);
            self.note(result);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.failed.is_none() {
            let result = self.file.flush();
            self.note(result);
        }
        Ok(())
    }
}

impl Seek for Sink {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        if self.failed.is_some() {
            return Ok(0);
        }
        match self.file.seek(to) {
            Ok(at) => Ok(at),
            Err(error) => {
                self.note(Err(error));
                Ok(0)
            }
        }
    }
}
