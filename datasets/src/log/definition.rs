//! The definitions of a log: its schemas and channels.

use std::collections::BTreeMap;

use bytes::Bytes;
use mcap::records::Record;
use serde::{Deserialize, Serialize};

use crate::log::record::parse;

/// A schema record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogSchema {
    /// Name of the message type.
    pub name: String,
    /// Encoding of the schema: `ros2msg`, `protobuf`, …
    pub encoding: String,
    /// The schema itself.
    #[serde(with = "base64_text")]
    pub data: Bytes,
}

/// Bytes in JSON.
mod base64_text {
    use base64::Engine;
    use base64::prelude::BASE64_STANDARD;
    use bytes::Bytes;
    use serde::de::{Deserialize, Deserializer, Error};
    use serde::ser::Serializer;

    pub fn serialize<S: Serializer>(bytes: &Bytes, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&BASE64_STANDARD.encode(bytes))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Bytes, D::Error> {
        let bytes = BASE64_STANDARD.decode(String::deserialize(deserializer)?);
        bytes.map(Bytes::from).map_err(D::Error::custom)
    }
}

/// A channel record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogChannel {
    /// The channel's number within the file.
    pub id: u16,
    /// Topic.
    pub topic: String,
    /// Encoding of the payloads: `cdr`, `json`, …
    pub message_encoding: String,
    /// Whatever the recorder noted.
    pub metadata: BTreeMap<String, String>,
    /// The number of its schema, see [`LogIndex::schema_of`](crate::log::index::LogIndex::schema_of); 0 where it has none.
    pub schema_id: u16,
}

/// A schema or channel record.
#[derive(Debug)]
pub(crate) enum Definition {
    /// A schema, behind its number within the file.
    Schema(u16, LogSchema),
    /// A channel.
    Channel(LogChannel),
}

impl Definition {
    /// From the body of a record.
    ///
    /// # Errors
    /// In words, where it is malformed, or another record.
    pub fn parse(opcode: u8, body: &[u8]) -> Result<Self, String> {
        match parse(opcode, body) {
            Ok(Record::Schema { header, data }) => Ok(Self::Schema(
                header.id,
                LogSchema {
                    name: header.name,
                    encoding: header.encoding,
                    data: Bytes::copy_from_slice(&data),
                },
            )),
            Ok(Record::Channel(channel)) => Ok(Self::Channel(LogChannel {
                id: channel.id,
                topic: channel.topic,
                message_encoding: channel.message_encoding,
                metadata: channel.metadata,
                schema_id: channel.schema_id,
            })),
            _ => Err("expected a definition, found a record that is cut or malformed".to_owned()),
        }
    }
}
