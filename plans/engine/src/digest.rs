//! Names by content.

use evermap_schemas::Fault;
use serde::Serialize;

/// The BLAKE3 digest of some bytes, in hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// The digest of a value, as JSON.
///
/// # Errors
/// A bug fault when it does not serialise.
pub fn digest_of(value: &impl Serialize) -> Result<String, Fault> {
    let text = serde_json::to_vec(value).map_err(|error| Fault::bug(error.to_string()))?;
    Ok(digest(&text))
}

/// Letters of a digest.
pub const LETTERS: usize = 64;

/// Whether a text may be a digest.
pub fn is_digest(text: &[u8]) -> bool {
    text.len() == LETTERS && text.iter().all(u8::is_ascii_hexdigit)
}
