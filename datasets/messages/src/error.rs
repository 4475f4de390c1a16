//! What can go wrong: once per channel ([`SchemaError`]) or once per message ([`DecodeError`]).

/// Why a channel's schema gave no columns. One line: what was expected, what was found, what next.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SchemaError {
    /// No decoder exists for this pair of encodings.
    #[error(
        "cannot decode message encoding '{message_encoding}' with schema encoding '{schema_encoding}': expected cdr with ros2msg or ros2idl, ros1 with ros1msg, protobuf with protobuf, or json with jsonschema or none; record the topic in one of these, or leave it out"
    )]
    Unsupported {
        /// The channel's message encoding.
        message_encoding: String,
        /// The schema's encoding.
        schema_encoding: String,
    },
    /// The schema text breaks the grammar of its language.
    #[error(
        "{language} schema of '{schema}', line {line}: expected {expected}, found '{found}'; re-record with a valid definition, or leave this topic out"
    )]
    Syntax {
        /// The schema language, e.g. `ros2msg`.
        language: &'static str,
        /// The name of the schema.
        schema: String,
        /// Line in the schema text, from 1.
        line: usize,
        /// What the grammar allows there.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// A type is used whose definition the schema does not carry.
    #[error(
        "schema of '{schema}' uses type '{missing}' but does not define it; the recorder must store definitions with all their dependencies, so re-record, or leave this topic out"
    )]
    UnknownType {
        /// The name of the schema.
        schema: String,
        /// The type without a definition.
        missing: String,
    },
    /// A type contains itself where the format allows no such thing.
    #[error(
        "schema of '{schema}': type '{recursive}' contains itself, but a column needs a finite type; leave this topic out"
    )]
    Recursive {
        /// The name of the schema.
        schema: String,
        /// The type that contains itself.
        recursive: String,
    },
    /// The schema is valid but beyond what is decoded here.
    #[error("schema of '{schema}': {reason}; leave this topic out")]
    Refused {
        /// The name of the schema.
        schema: String,
        /// What was expected and what was found.
        reason: String,
    },
}

impl SchemaError {
    pub(crate) fn refused(schema: &str, reason: String) -> Self {
        SchemaError::Refused {
            schema: shown(schema),
            reason,
        }
    }
}

/// Why one message gave no row. The decoder is unchanged by it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The payload ends inside a value.
    #[error(
        "payload ends early: expected {needed} more bytes at offset {offset}, found {available}"
    )]
    Truncated {
        /// Byte offset in the payload (after the CDR header, where there is one).
        offset: usize,
        /// Bytes the next value needs at least.
        needed: u64,
        /// Bytes left.
        available: usize,
    },
    /// The payload is one zstd frame, as rosbag2 writes with `compression_mode: MESSAGE`.
    #[error(
        "payload is compressed on its own (zstd, rosbag2 compression_mode MESSAGE): expected a CDR header; decompress it first"
    )]
    Compressed,
    /// The CDR header names a representation that is not decoded.
    #[error(
        "CDR header names representation {identifier:#06x}: expected plain CDR (0x0000, 0x0001), plain CDR2 (0x0006, 0x0007) or delimited CDR2 (0x0008, 0x0009); parameter lists are not decoded"
    )]
    Encapsulation {
        /// The representation identifier found.
        identifier: u16,
    },
    /// The batch cannot grow: 32-bit offsets are used up.
    #[error(
        "batch is full: one column would exceed {limit} bytes or elements; finish the batch before this message"
    )]
    Full {
        /// The bound that was met.
        limit: usize,
    },
    /// The message stands for far more than it holds: absent fields, elements without bytes.
    #[error(
        "expected a payload that yields at most {limit} bytes or elements for its size, found one that yields more"
    )]
    Unfolds {
        /// The bound that was met.
        limit: usize,
    },
    /// The payload breaks the wire format.
    #[error("{format} payload, offset {offset}: expected {expected}")]
    Malformed {
        /// The wire format, e.g. `protobuf`.
        format: &'static str,
        /// Byte offset in the payload.
        offset: usize,
        /// What the format allows there.
        expected: String,
    },
    /// A JSON value is not of the type its schema promises.
    #[error("json field '{field}': expected {expected}, found {found}")]
    Mismatch {
        /// The field's name.
        field: String,
        /// The type of the schema.
        expected: String,
        /// The value found, shortened.
        found: String,
    },
}

impl DecodeError {
    /// A value of `needed` bytes at `offset` is not all in `data`.
    #[cold]
    pub(crate) fn truncated(data: &[u8], offset: usize, needed: u64) -> Self {
        DecodeError::Truncated {
            offset,
            needed,
            available: data.len().saturating_sub(offset),
        }
    }
}

/// A name as a message shows it.
pub(crate) fn shown(name: &str) -> String {
    name.chars().take(200).collect()
}
