//! JSON from outside: what tells one program's from another's.

use serde::de::MapAccess;

use crate::annotate::reading::{Lenient, skipped};

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
    fn list(&mut self) {
        *self = Self::List;
    }

    fn object(&mut self) {
        *self = Self::Object { has_images: false };
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
