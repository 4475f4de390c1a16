//! A JSON value as compact text, written while it is read.

use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use std::fmt;

/// Writes the value that is read next.
pub(super) struct Compact<'t>(pub(super) &'t mut Vec<u8>);

impl Compact<'_> {
    fn write<E: Error>(self, value: &(impl serde::Serialize + ?Sized)) -> Result<(), E> {
        serde_json::to_writer(self.0, value).map_err(E::custom)
    }
}

impl<'de> DeserializeSeed<'de> for Compact<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Compact<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("any JSON value")
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        self.write(&())
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<(), E> {
        self.write(&value)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<(), E> {
        self.write(&value)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<(), E> {
        self.write(&value)
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<(), E> {
        self.write(&value)
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<(), E> {
        self.write(value)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<(), A::Error> {
        self.0.push(b'[');
        let start = self.0.len();
        while values.next_element_seed(Next(self.0, start))?.is_some() {}
        self.0.push(b']');
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<(), A::Error> {
        self.0.push(b'{');
        let start = self.0.len();
        while members.next_key_seed(Next(self.0, start))?.is_some() {
            self.0.push(b':');
            members.next_value_seed(Compact(self.0))?;
        }
        self.0.push(b'}');
        Ok(())
    }
}

/// An element or a member's name, behind a comma unless it is the first, which lies here.
struct Next<'t>(&'t mut Vec<u8>, usize);

impl<'de> DeserializeSeed<'de> for Next<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        if self.0.len() > self.1 {
            self.0.push(b',');
        }
        Compact(self.0).deserialize(deserializer)
    }
}

/// The value is written as [`serde_json::Value`] would write it.
#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn text_is_as_the_tree_would_write_it() {
        let text = r#" { "a" : [ 1 , -2.50 , 1e3 , null , true , [ ] ] , "\u00e9\n" : { } , "z":18446744073709551615 } "#;
        let tree: serde_json::Value = serde_json::from_str(text).unwrap();
        let mut written = Vec::new();
        let mut reader = serde_json::Deserializer::from_str(text);
        Compact(&mut written).deserialize(&mut reader).unwrap();
        assert_eq!(String::from_utf8(written).unwrap(), tree.to_string());
    }
}
