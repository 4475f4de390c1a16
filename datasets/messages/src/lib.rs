//! Payloads to typed Arrow columns, by the schema inside the log.
//!
//! A channel's schema is parsed once into a [`MessageType`]; its [`Decoder`]s append
//! payloads as rows and hand back Arrow arrays.
//!
//! ```text
//! schema text ──parse──▶ MessageType ──decoder──▶ program over flat buffers
//!                                                   ▲ push(payload)   │ finish
//!                                                                     ▼ arrays
//! ```
//!
//! # How types map
//!
//! | in the log | in Arrow |
//! |---|---|
//! | numbers, flags | the same type, not null |
//! | strings (also wide) | `Utf8`; bytes that are not text become U+FFFD |
//! | `uint8[]`, `byte[]`, `octet`, protobuf `bytes` | `BinaryView` |
//! | JSON strings with `contentEncoding: base64` | `BinaryView` |
//! | protobuf maps | `List` of `Struct` `{key, value}`, in wire order; of a key, the last entry |
//! | protobuf messages inside themselves | `BinaryView`, as on the wire |
//! | JSON without one declared type | `Utf8`, as JSON text; without any schema one column `json` |
//! | `uint8[16]` | `FixedSizeBinary(16)` |
//! | `float64[]`, `repeated` | `List` |
//! | `float64[36]` | `FixedSizeList(36)` |
//! | messages, `Time`, `Duration` | `Struct`, with the members as declared |
//! | enumerations | `Int32`, the number |
//!
//! ROS has no absent values. A protobuf field that can be absent (`optional`, members
//! of a `oneof`, messages) is null when it is; JSON columns are all nullable.
//!
//! Whether a payload is a row never depends on the projection, so counts agree
//! whichever columns are read.
//!
//! The other way, from values to payloads, go [`ros2`] and [`annotation`], for the few messages that evermap records
//! itself.

pub mod annotation;
mod budget;
mod buffers;
mod cdr;
mod decoder;
mod error;
mod idl;
mod json;
mod protobuf;
mod resolve;
pub mod ros2;
mod rosmsg;
mod views;
mod wire;

pub use decoder::Decoder;
pub use error::{DecodeError, SchemaError};
pub use json::bytes_of_base64;

use arrow::datatypes::Fields;
use cdr::Serialisation;
use decoder::Format;
use rosmsg::Generation;
use std::ops::Range;
use std::sync::Arc;
use wire::StructType;

/// Columns one schema may unfold to; beyond it a definition is refused.
const MAX_COLUMNS: usize = 20_000;
/// Members that a message may have itself: those of its table's columns that a query is planned with, which takes time by
/// their square (DataFusion 55: 6 s for 4,000).
const MAX_FIELDS: usize = 4096;
/// Bytes of the name of a message type.
const MAX_NAME: usize = 4096;
/// Levels of nesting one schema may have.
const MAX_DEPTH: usize = 64;

/// Where bytes lie inside a payload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Located {
    /// Byte range in the payload, header included.
    pub range: Range<usize>,
    /// Whether the range holds base64 text (JSON) instead of the bytes themselves.
    pub base64: bool,
}

/// The type of a channel's messages. Cheap to clone.
#[derive(Debug, Clone)]
pub struct MessageType {
    kind: Kind,
    fields: Fields,
}

#[derive(Debug, Clone)]
enum Kind {
    Ros(Serialisation, Arc<StructType>),
    Protobuf(Arc<protobuf::Plan>),
    Json(Arc<json::Plan>),
}

impl MessageType {
    /// Parses a channel's schema.
    ///
    /// `message_encoding` is the channel's, `schema_encoding`, `schema_name` and `schema`
    /// those of its schema record; a channel without one has an empty `schema_encoding`.
    ///
    /// # Errors
    /// [`SchemaError`] when no decoder exists for the encodings or the schema is unsound.
    pub fn parse(
        message_encoding: &str,
        schema_encoding: &str,
        schema_name: &str,
        schema: &[u8],
    ) -> Result<MessageType, SchemaError> {
        if schema_name.len() > MAX_NAME {
            let found = schema_name.len();
            let reason = format!("expected a name of at most {MAX_NAME} B, found {found} B");
            return Err(SchemaError::refused(schema_name, reason));
        }
        let text = || String::from_utf8_lossy(schema);
        let ros = |generation| rosmsg::parse(generation, schema_name, &text());
        let kind = match (message_encoding, schema_encoding) {
            ("cdr", "ros2msg") => Kind::Ros(Serialisation::Cdr, ros(Generation::Ros2)?),
            ("cdr", "ros2idl") => Kind::Ros(Serialisation::Cdr, idl::parse(schema_name, &text())?),
            ("ros1", "ros1msg") => Kind::Ros(Serialisation::Ros1, ros(Generation::Ros1)?),
            ("protobuf", "protobuf") => Kind::Protobuf(protobuf::Plan::parse(schema_name, schema)?),
            ("json", "jsonschema") => Kind::Json(json::Plan::parse(schema_name, schema)?),
            ("json", "") => Kind::Json(json::Plan::untyped()),
            _ => {
                return Err(SchemaError::Unsupported {
                    message_encoding: error::shown(message_encoding),
                    schema_encoding: error::shown(schema_encoding),
                });
            }
        };
        let fields = match &kind {
            Kind::Ros(_, message) => message.fields(),
            Kind::Protobuf(plan) => plan.fields().clone(),
            Kind::Json(plan) => plan.fields().clone(),
        };
        if fields.len() > MAX_FIELDS {
            let found = fields.len();
            let reason =
                format!("expected at most {MAX_FIELDS} members of a message, found {found}");
            return Err(SchemaError::refused(schema_name, reason));
        }
        Ok(MessageType { kind, fields })
    }

    /// The message's members, in declaration order, under their own names.
    pub fn fields(&self) -> &Fields {
        &self.fields
    }

    /// A decoder of the members named by `projection` (indices into [`Self::fields`], in
    /// that order; none for all). Indices out of range, and repeats, are left out.
    pub fn decoder(&self, projection: Option<&[usize]>) -> Decoder {
        let format: Box<dyn Format> = match &self.kind {
            Kind::Ros(serialisation, message) => {
                Box::new(cdr::Reader::new(*serialisation, message.clone()))
            }
            Kind::Protobuf(plan) => Box::new(protobuf::Reader::new(plan.clone())),
            Kind::Json(plan) => Box::new(json::Reader(plan.clone())),
        };
        Decoder::new(format, &self.fields, self.distinct(projection))
    }

    /// Where the bytes of the member at `path` (e.g. `["data"]`) lie in `payload`; none
    /// where the type has no such member of bytes, or they are not in one piece.
    ///
    /// # Errors
    /// [`DecodeError`] when the payload ends, or breaks its format, before that member does.
    pub fn locate(&self, payload: &[u8], path: &[&str]) -> Result<Option<Located>, DecodeError> {
        match &self.kind {
            Kind::Ros(serialisation, message) => {
                cdr::locate(*serialisation, message, payload, path)
            }
            Kind::Protobuf(plan) => protobuf::locate(plan, payload, path),
            Kind::Json(plan) => json::locate(plan, payload, path),
        }
    }

    fn distinct(&self, projection: Option<&[usize]>) -> Vec<usize> {
        let Some(projection) = projection else {
            return (0..self.fields.len()).collect();
        };
        let mut taken = vec![false; self.fields.len()];
        let mut first = |index: &usize| {
            let taken = taken.get_mut(*index);
            taken.is_some_and(|taken| !std::mem::replace(taken, true))
        };
        let projection = projection.iter().copied();
        projection.filter(|index| first(index)).collect()
    }
}
