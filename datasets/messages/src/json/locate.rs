//! Finds base64 text inside a JSON payload without taking the payload apart.

use super::plan::{Plan, Shape};
use super::{Name, malformed};
use crate::{DecodeError, Located};
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde_json::value::RawValue;
use std::fmt;

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
    let mut written = payload;
    for name in path {
        let mut reader = serde_json::Deserializer::from_slice(written);
        let member = Member(name).deserialize(&mut reader);
        match member.and_then(|member| reader.end().map(|()| member)) {
            Ok(Some(member)) => written = member.get().as_bytes(),
            Ok(None) => return Ok(None),
            Err(error) if error.is_data() => return Ok(None),
            Err(error) => return Err(malformed(&error)),
        }
    }
    let text = written
        .strip_prefix(b"\"")
        .and_then(|rest| rest.strip_suffix(b"\""));
    let plain = text.filter(|text| !text.contains(&b'\\'));
    Ok(plain.map(|text| {
        let start = text.as_ptr() as usize - payload.as_ptr() as usize;
        Located {
            range: start..start + text.len(),
            base64: true,
        }
    }))
}

/// The member of this name of an object, as it is written; the last of a name counts.
#[derive(Clone, Copy)]
struct Member<'n>(&'n str);

impl<'de> DeserializeSeed<'de> for Member<'_> {
    type Value = Option<&'de RawValue>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Member<'_> {
    type Value = Option<&'de RawValue>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Self::Value, A::Error> {
        let mut found = None;
        while let Some(wanted) = members.next_key_seed(Name(|name: &str| name == self.0))? {
            if wanted {
                found = Some(members.next_value()?);
            } else {
                members.next_value::<IgnoredAny>()?;
            }
        }
        Ok(found)
    }
}

impl Plan {
    fn is_base64(&self, path: &[&str]) -> bool {
        let mut shape = &self.root;
        for name in path {
            let Shape::Object(object) = shape else {
                return false;
            };
            let Some(place) = object.place(name) else {
                return false;
            };
            shape = &object.properties[place].1;
        }
        matches!(shape, Shape::Base64)
    }
}
