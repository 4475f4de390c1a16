//! One session's MCAP file, written under a temporary name and renamed when complete.

use crate::WorldError;
use evermap_messages::ros2::Message;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// How recorders of ROS 2 say that the topic's only message is for all who come later too.
const LATCHED: (&str, &str) = (
    "offered_qos_profiles",
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n",
);

/// A log being written.
pub struct LogWriter {
    writer: Writer<BufWriter<File>>,
    /// Messages so far, by channel.
    sent: BTreeMap<u16, u32>,
    temporary: PathBuf,
    target: PathBuf,
}

/// When something happened, ns since the epoch.
#[derive(Debug, Clone, Copy)]
pub struct Times {
    /// When the recorder got it.
    pub log_ns: u64,
    /// When the sensor measured it.
    pub stamp_ns: u64,
}

impl LogWriter {
    /// Starts the file `target`.
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
        let writer = options.create(BufWriter::with_capacity(1 << 18, file));
        Ok(Self {
            writer: writer.map_err(|error| failed(&temporary, error))?,
            sent: BTreeMap::new(),
            temporary,
            target: target.to_owned(),
        })
    }

    /// Declares a topic and gives its channel; `latched` where its only message is for all who come later too.
    pub fn topic<M: Message>(&mut self, topic: &str, latched: bool) -> Result<u16, WorldError> {
        let metadata = latched.then(|| (LATCHED.0.to_owned(), LATCHED.1.to_owned()));
        let metadata = metadata.into_iter().collect();
        let schema = self
            .writer
            .add_schema(M::NAME, "ros2msg", M::DEFINITION.as_bytes())
            .map_err(|error| failed(&self.temporary, error))?;
        let channel = self.writer.add_channel(schema, topic, "cdr", &metadata);
        channel.map_err(|error| failed(&self.temporary, error))
    }

    /// Writes a metadata record.
    pub fn metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), WorldError> {
        let name = name.to_owned();
        let written = self.writer.write_metadata(&Metadata { name, metadata });
        written.map_err(|error| failed(&self.temporary, error))
    }

    /// Writes one message; the caller keeps log times in order.
    pub fn send(
        &mut self,
        channel: u16,
        times: Times,
        message: &impl Message,
    ) -> Result<(), WorldError> {
        let sent = self.sent.entry(channel).or_default();
        let header = MessageHeader {
            channel_id: channel,
            sequence: *sent,
            log_time: times.log_ns,
            publish_time: times.stamp_ns,
        };
        *sent += 1;
        let payload = message.encode();
        let written = self.writer.write_to_known_channel(&header, &payload);
        written.map_err(|error| failed(&self.temporary, error))
    }

    /// Completes the file, gives it its name, and says how many messages and bytes it holds.
    pub fn finish(mut self) -> Result<(u64, u64), WorldError> {
        let io = |error| WorldError::io(&self.temporary, error);
        self.writer
            .finish()
            .map_err(|error| failed(&self.temporary, error))?;
        let file = self.writer.into_inner().into_inner();
        let file = file.map_err(|error| io(error.into_error()))?;
        let bytes = file.metadata().map_err(io)?.len();
        std::fs::rename(&self.temporary, &self.target)
            .map_err(|error| WorldError::io(&self.target, error))?;
        let messages = self.sent.values().map(|sent| u64::from(*sent)).sum();
        Ok((messages, bytes))
    }
}

/// A full disk is a missing resource, and what else the writer refuses is a bug.
fn failed(path: &Path, error: McapError) -> WorldError {
    match error {
        McapError::Io(source) => WorldError::io(path, source),
        other => WorldError::Mcap(other),
    }
}
