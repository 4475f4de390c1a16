//! JSON from outside: what tells one program's from another's.

use serde::de::MapAccess;

use crate::annotate::reading::{JsonToken, Lenient, skipped};

/// What JSON is.
#[derive(Debug, Default)]
pub(super) enum JsonForm {
    /// Neither list nor object.
    #[default]
    Other,
    List,
    Object {
        /// Whether it has a member `images`.
        has_images: bool,
    },
}

impl Lenient for JsonForm {
    fn found(&mut self, token: JsonToken<'_>) {
        *self = match token {
            JsonToken::List => Self::List,
            JsonToken::Object => Self::Object { has_images: false },
            JsonToken::Truth(_) | JsonToken::Number(_) | JsonToken::Text(_) => Self::Other,
        };
    }

    fn member<'de, A: MapAccess<'de>>(
        &mut self,
        name: &str,
        object: &mut A,
    ) -> Result<(), A::Error> {
        if name == "images" {
            *self = Self::Object { has_images: true };
        }
        skipped(object)
    }
}
