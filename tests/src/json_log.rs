//! Logs of messages in JSON.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use serde_json::{Value, json};

/// A log of messages in JSON, while it is written.
pub struct JsonLog(
    /// What else a log may have is written to this.
    pub mcap::Writer<BufWriter<File>>,
);

impl JsonLog {
    /// A log that has nothing yet.
    ///
    /// # Panics
    /// When the file cannot be written.
    pub fn new(path: &Path) -> Self {
        Self::with(path, mcap::WriteOptions::new())
    }

    /// A log of these options that has nothing yet.
    ///
    /// # Panics
    /// When the file cannot be written.
    pub fn with(path: &Path, options: mcap::WriteOptions) -> Self {
        let file = File::create(path).expect("a log can be made");
        let log = options.create(BufWriter::new(file));
        Self(log.expect("a log begins"))
    }

    /// A topic whose messages have a type of this name and schema.
    ///
    /// # Panics
    /// When the file cannot be written.
    pub fn topic(&mut self, topic: &str, name: &str, schema: &[u8]) -> u16 {
        let schema = self.0.add_schema(name, "jsonschema", schema);
        let schema = schema.expect("a schema fits");
        let channel = self
            .0
            .add_channel(schema, topic, "json", &Default::default());
        channel.expect("a channel fits")
    }

    /// A topic whose messages have a type of this name with these members.
    ///
    /// # Panics
    /// When the file cannot be written.
    pub fn topic_of(&mut self, topic: &str, name: &str, members: &Value) -> u16 {
        let schema = json!({ "type": "object", "properties": members });
        self.topic(topic, name, schema.to_string().as_bytes())
    }

    /// A message that was recorded when it was sent.
    ///
    /// # Panics
    /// When the file cannot be written.
    pub fn send(&mut self, topic: u16, sequence: u32, time: u64, message: &Value) {
        let header = mcap::records::MessageHeader {
            channel_id: topic,
            sequence,
            log_time: time,
            publish_time: time,
        };
        let payload = message.to_string();
        let written = self.0.write_to_known_channel(&header, payload.as_bytes());
        written.expect("a message fits");
    }

    /// Ends the log.
    ///
    /// # Panics
    /// When the file cannot be written.
    pub fn finish(mut self) {
        self.0.finish().expect("a log ends");
    }
}
