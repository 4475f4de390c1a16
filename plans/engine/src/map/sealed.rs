//! JSON that carries a digest of itself: versions and receipts say what no other file says, so that what a disk gives back of
//! them is held against their own seal.
//!
//! The seal is the first member, over all bytes behind it: `{"seal":"DIGEST","version":3, …}`. Files of an older evermap have
//! none and are believed.

use evermap_schemas::Fault;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};

use crate::digest::{LETTERS, digest, is_digest};
use crate::map::store::{Store, other_json};

/// What stands before the digest of a seal.
const BEFORE: &str = "{\"seal\":\"";
/// What stands behind it.
const BEHIND: &str = "\",";
/// Bytes of a seal.
const LENGTH: usize = BEFORE.len() + LETTERS + BEHIND.len();

/// The JSON of a value with members, sealed.
///
/// # Errors
/// A bug fault for a value without members, or one that does not serialise.
pub fn bytes(value: &impl Serialize) -> Result<Vec<u8>, Fault> {
    let text = serde_json::to_vec(value).map_err(|error| Fault::bug(error.to_string()))?;
    match text.strip_prefix(b"{") {
        Some(members) if members != b"}" => Ok([seal_of(members).as_bytes(), members].concat()),
        _ => Err(Fault::bug("expected members to seal, found none")),
    }
}

/// What is sealed in the file of a name; `None` where there is no such file.
///
/// # Errors
/// A resource fault when the store does not answer, a data fault for what is no file, is not as it was sealed, or has another
/// shape.
pub async fn read<T: DeserializeOwned>(store: &Store, name: &str) -> Result<Option<T>, Fault> {
    let Some(text) = store.read(name).await? else {
        return Ok(None);
    };
    let opened = opened(&text).map(Some);
    opened.map_err(|fault| fault.at(format!("{}{name}", store.url())))
}

fn seal_of(members: &[u8]) -> String {
    format!("{BEFORE}{}{BEHIND}", digest(members))
}

fn opened<T: DeserializeOwned>(text: &[u8]) -> Result<T, Fault> {
    match sealed_members(text) {
        Some((found, members)) => {
            let expected = seal_of(members);
            if found != expected.as_bytes() {
                let found = String::from_utf8_lossy(found);
                return Err(Fault::data(format!(
                    "expected to begin with {expected}…, found {found}…"
                )));
            }
        }
        None if has_moved(text) => {
            return Err(Fault::data(
                "expected its seal to come first, found it elsewhere",
            ));
        }
        None => {}
    }
    serde_json::from_slice(text).map_err(|error| other_json(&error))
}

/// A file's seal and the members behind it; `None` for a file of an older evermap.
fn sealed_members(text: &[u8]) -> Option<(&[u8], &[u8])> {
    let (seal, members) = text.split_at_checked(LENGTH)?;
    let (before, digest) = seal.split_at(BEFORE.len());
    // Either of the two tells, so that a byte that flipped there makes it no file of an older evermap.
    let is_sealed = before == BEFORE.as_bytes() || is_digest(&digest[..LETTERS]);
    is_sealed.then_some((seal, members))
}

/// Whether a seal stands where none is written, as a program leaves it that writes the JSON anew.
fn has_moved(text: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Moved {
        seal: Option<IgnoredAny>,
    }
    serde_json::from_slice::<Moved>(text).is_ok_and(|moved| moved.seal.is_some())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use serde_json::{Value, json};

    use super::*;

    fn value() -> Value {
        json!({ "version": 3, "layers": { "lanes": ["a", "b"] }, "seconds": 0.1, "site": null })
    }

    #[test]
    fn any_flipped_byte_is_found() {
        let text = bytes(&value()).unwrap();
        let mut read: Value = opened(&text).unwrap();
        assert!(read.as_object_mut().unwrap().remove("seal").is_some());
        assert_eq!(read, value());
        for at in 0..text.len() {
            for bits in [0x01, 0x10, 0x20, 0x80, 0xff] {
                let mut flipped = text.clone();
                flipped[at] ^= bits;
                let fault = opened::<Value>(&flipped).unwrap_err();
                assert_eq!(fault.kind, evermap_schemas::Kind::Data, "{at}: {fault}");
            }
            opened::<Value>(&text[..at]).unwrap_err();
        }
    }

    #[test]
    fn what_an_older_evermap_wrote_is_read_and_what_was_written_anew_is_not() {
        let older = serde_json::to_vec(&value()).unwrap();
        assert_eq!(opened::<Value>(&older).unwrap(), value());
        let named = json!({ "digest": digest(b"recipe") });
        let older = serde_json::to_vec(&named).unwrap();
        assert_eq!(opened::<Value>(&older).unwrap(), named);
        // Another program may change what is in it, and nothing would tell.
        let read: Value = serde_json::from_slice(&bytes(&value()).unwrap()).unwrap();
        let anew = serde_json::to_vec_pretty(&read).unwrap();
        let fault = opened::<Value>(&anew).unwrap_err();
        assert!(fault.to_string().contains("elsewhere"), "{fault}");
    }

    #[test]
    fn only_members_are_sealed() {
        for value in [json!({}), json!([1]), json!(7)] {
            bytes(&value).unwrap_err();
        }
    }
}
