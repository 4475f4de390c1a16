//! JSON payloads, by their JSON Schema where there is one.
//!
//! All columns are nullable: null stands for a property that is null or absent. A value
//! of another type than promised loses the row, except where nothing is lost: flags are
//! numbers 0 and 1, whole numbers written as `1.0` are integers, and numbers may be the
//! strings `NaN`, `Infinity` and `-Infinity`.
//!
//! Payloads are read from front to back, straight into columns: what is in no column is
//! stepped over, so that a payload costs no more memory than its columns.

mod compact;
mod locate;
mod plan;
mod read;

use crate::DecodeError;
use crate::buffers::{Node, Pool};
use crate::decoder::Format;
pub(crate) use locate::locate;
pub(crate) use plan::Plan;
use plan::Shape;
pub use read::bytes_of_base64;
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, Visitor};
use std::fmt;
use std::sync::Arc;

/// Reads payloads of one JSON channel.
pub(crate) struct Reader(pub(crate) Arc<Plan>);

impl Format for Reader {
    fn append(
        &mut self,
        payload: &[u8],
        message: &Node,
        row: usize,
        pool: &mut Pool,
    ) -> Result<(), DecodeError> {
        if !matches!(self.0.root, Shape::Json) {
            return read::message(&self.0.root, payload, message, row, pool);
        }
        serde_json::from_slice::<IgnoredAny>(payload).map_err(|error| malformed(&error))?;
        let node = message.member(0);
        node.append_present(pool);
        let text = String::from_utf8_lossy(payload);
        node.append_bytes(pool, text.trim().as_bytes())
    }
}

fn malformed(error: &serde_json::Error) -> DecodeError {
    DecodeError::Malformed {
        format: "json",
        offset: error.column(),
        expected: format!("valid JSON, found: {error}"),
    }
}

/// The name of a member, as what a function makes of it.
struct Name<F>(F);

impl<'de, T, F: FnOnce(&str) -> T> DeserializeSeed<'de> for Name<F> {
    type Value = T;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<T, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl<T, F: FnOnce(&str) -> T> Visitor<'_> for Name<F> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a name")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<T, E> {
        Ok((self.0)(name))
    }
}
