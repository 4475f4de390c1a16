//! Finds base64 text inside a JSON payload without taking the payload apart.

use super::malformed;
use super::plan::{Plan, Shape};
use crate::{DecodeError, Located};
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::borrow::Cow;
use std::fmt;
use std::ops::Range;

/// Where the text of the base64 property at `path` lies, between its quotes. None where the
/// text is written with escapes, as its bytes are then not those of the base64.
pub(crate) fn locate(
    plan: &Plan,
    payload: &[u8],
    path: &[&str],
) -> Result<Option<Located>, DecodeError> {
    if !plan.is_base64(path) {
        return Ok(None);
    }
    let mut deserializer = serde_json::Deserializer::from_slice(payload);
    let text = At { payload, path }.deserialize(&mut deserializer);
    let range = text.map_err(|error| malformed(&error))?;
    Ok(range.map(|range| Located {
        range,
        base64: true,
    }))
}

impl Plan {
    fn is_base64(&self, path: &[&str]) -> bool {
        let mut properties = self.properties.as_deref().unwrap_or_default();
        let mut shape = None;
        for name in path {
            let found = properties.iter().find(|(known, _)| known == name);
            shape = found.map(|(_, shape)| shape);
            properties = match shape {
                Some(Shape::Object(inner)) => inner,
                _ => &[],
            };
        }
        shape == Some(&Shape::Base64)
    }
}

/// Looks for the text at a path, as a range of the payload.
#[derive(Clone, Copy)]
struct At<'a> {
    payload: &'a [u8],
    path: &'a [&'a str],
}

impl<'de> DeserializeSeed<'de> for At<'de> {
    type Value = Option<Range<usize>>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for At<'de> {
    type Value = Option<Range<usize>>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("any value")
    }

    /// The last member of the name counts, where there are several.
    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Self::Value, A::Error> {
        let mut found = None;
        while let Some(name) = members.next_key::<Cow<'de, str>>()? {
            match self.path {
                [wanted, path @ ..] if name == *wanted => {
                    found = members.next_value_seed(At { path, ..self })?;
                }
                _ => {
                    members.next_value::<IgnoredAny>()?;
                }
            }
        }
        Ok(found)
    }

    /// Text without escapes is handed out as it lies in the payload.
    fn visit_borrowed_str<E: Error>(self, text: &'de str) -> Result<Self::Value, E> {
        let start = (text.as_ptr() as usize).checked_sub(self.payload.as_ptr() as usize);
        Ok(start
            .filter(|_| self.path.is_empty())
            .map(|start| start..start + text.len()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Self::Value, A::Error> {
        while items.next_element::<IgnoredAny>()?.is_some() {}
        Ok(None)
    }

    fn visit_str<E: Error>(self, _: &str) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_bool<E: Error>(self, _: bool) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_i64<E: Error>(self, _: i64) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_u64<E: Error>(self, _: u64) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_f64<E: Error>(self, _: f64) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_unit<E: Error>(self) -> Result<Self::Value, E> {
        Ok(None)
    }
}
