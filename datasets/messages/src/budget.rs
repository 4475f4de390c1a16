//! What a schema or a message may cost: in proportion to the bytes that are there, whatever they claim.
//!
//! A few bytes can stand for much: names that are looked up in every scope, structs that hold each other twice, two
//! bytes of protobuf that are a message of sixty absent numbers. Whatever unfolds is paid for before it is made.

use crate::{DecodeError, MAX_COLUMNS, SchemaError};

/// Bytes of a definition in text: [`MAX_COLUMNS`] members of 50 letters.
const MAX_TEXT: usize = 1 << 20;
/// Bytes of a protobuf descriptor set: it repeats what it needs of other files.
const MAX_DESCRIPTORS: usize = 4 << 20;
/// Steps that any schema may take.
const SCHEMA_STEPS: usize = 1 << 20;
/// Further steps for each of its bytes. A name is looked for in at most a few scopes of about its own length.
const SCHEMA_STEPS_PER_BYTE: usize = 32;

/// Bytes of columns that any message may yield.
const MESSAGE_BYTES: usize = 16 << 20;
/// Further bytes of columns for each of its bytes: packed numbers take eight for one. Absent fields beyond that have the
/// bytes of any message.
const MESSAGE_BYTES_PER_BYTE: usize = 8;

/// Steps that a schema may still take: letters that are compared or copied, members that are made.
#[derive(Debug)]
pub(crate) struct SchemaBudget {
    schema: String,
    left: usize,
    total: usize,
}

impl SchemaBudget {
    /// Of a definition in text.
    pub(crate) fn of_text(schema: &str, text: &[u8]) -> Result<Self, SchemaError> {
        Self::new(schema, text, MAX_TEXT)
    }

    /// Of a protobuf descriptor set.
    pub(crate) fn of_descriptors(schema: &str, set: &[u8]) -> Result<Self, SchemaError> {
        Self::new(schema, set, MAX_DESCRIPTORS)
    }

    fn new(schema: &str, bytes: &[u8], most: usize) -> Result<Self, SchemaError> {
        if bytes.len() > most {
            let reason = format!(
                "expected a definition of at most {most} B, found {} B",
                bytes.len()
            );
            return Err(SchemaError::refused(schema, reason));
        }
        let total = SCHEMA_STEPS + SCHEMA_STEPS_PER_BYTE * bytes.len();
        Ok(Self {
            schema: schema.to_owned(),
            left: total,
            total,
        })
    }

    /// Pays for `steps`.
    pub(crate) fn spend(&mut self, steps: usize) -> Result<(), SchemaError> {
        match self.left.checked_sub(steps) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err(SchemaError::refused(
                &self.schema,
                format!(
                    "expected a definition that is resolved in {} steps for its size, found one that takes more",
                    self.total
                ),
            )),
        }
    }

    /// Refuses more columns, or members to make them of, than any schema may have.
    pub(crate) fn check_columns(&self, columns: usize) -> Result<(), SchemaError> {
        if columns <= MAX_COLUMNS {
            return Ok(());
        }
        let reason = format!("expected at most {MAX_COLUMNS} columns, found {columns} or more");
        Err(SchemaError::refused(&self.schema, reason))
    }
}

/// Bytes of columns that a message may still yield. What is paid does not depend on which columns are read, so that a
/// message is a row of all projections or of none.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MessageBudget {
    left: usize,
    total: usize,
}

impl MessageBudget {
    /// Of a payload.
    pub(crate) fn of(payload: &[u8]) -> Self {
        let own = MESSAGE_BYTES_PER_BYTE.saturating_mul(payload.len());
        let total = MESSAGE_BYTES.saturating_add(own);
        Self { left: total, total }
    }

    /// Pays for `bytes` of columns.
    #[inline]
    pub(crate) fn spend(&mut self, bytes: usize) -> Result<(), DecodeError> {
        match self.left.checked_sub(bytes) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err(DecodeError::Unfolds { limit: self.total }),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_is_there_pays_for_what_is_made() {
        let mut schema = SchemaBudget::of_text("T", &[b' '; 100]).unwrap();
        schema.spend(SCHEMA_STEPS + 3_200).unwrap();
        let refused = schema.spend(1).unwrap_err().to_string();
        assert!(
            refused.contains("expected") && refused.contains("found"),
            "{refused}"
        );
        SchemaBudget::of_text("T", &vec![b' '; MAX_TEXT + 1]).unwrap_err();
        let mut message = MessageBudget::of(&[0; 10]);
        message.spend(MESSAGE_BYTES + 80).unwrap();
        message.spend(1).unwrap_err();
    }
}
