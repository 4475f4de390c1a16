//! Finds base64 text inside a JSON payload without taking the payload apart.

use super::malformed;
use super::plan::{Plan, Shape};
use crate::{DecodeError, Located};
use serde_json::value::RawValue;
use std::borrow::Cow;
use std::collections::HashMap;

/// The members of an object, each as it is written; the last of a name counts.
type Members<'a> = HashMap<Cow<'a, str>, &'a RawValue>;

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
        match serde_json::from_slice::<Members<'_>>(written) {
            Ok(members) => match members.get(*name) {
                Some(member) => written = member.get().as_bytes(),
                None => return Ok(None),
            },
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
