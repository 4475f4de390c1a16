//! Files that parameters name.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A file, in the place of the path by which a plan or a session manifest names it.
///
/// Operators read no files. A parameter whose schema says `"x-files": true` is a mapping, and an entry of it that is text
/// is a path, relative to what names it; the operator is given this instead.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GivenFile {
    /// Its path, as seen from where the program runs.
    pub file: String,
    /// Its bytes, two hexadecimal digits each.
    #[serde(serialize_with = "to_hex", deserialize_with = "from_hex")]
    #[schemars(with = "String")]
    pub hex: Vec<u8>,
}

fn to_hex<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
    let digit = |value: u8| char::from(b"0123456789abcdef"[usize::from(value)]);
    let digits = bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]);
    serializer.serialize_str(&digits.map(digit).collect::<String>())
}

fn from_hex<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
    let text = String::deserialize(deserializer)?;
    let digit = |letter: u8| char::from(letter).to_digit(16);
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    let byte = |[high, low]: &[u8; 2]| Some((16 * digit(*high)? + digit(*low)?) as u8);
    let bytes: Option<Vec<u8>> = pairs.iter().map(byte).collect();
    let bytes = bytes.filter(|_| rest.is_empty());
    bytes.ok_or_else(|| serde::de::Error::custom("expected two hexadecimal digits a byte"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serde_json::json;

    #[test]
    fn a_file_is_the_same_after_it_was_text() {
        let given = GivenFile {
            file: "body.png".into(),
            hex: vec![0, 9, 0xa0, 0xff],
        };
        let value = serde_json::to_value(&given).unwrap();
        assert_eq!(value, json!({ "file": "body.png", "hex": "0009a0ff" }));
        assert_eq!(serde_json::from_value::<GivenFile>(value).unwrap(), given);
        for hex in ["0", "0g", "+1"] {
            let value = json!({ "file": "body.png", "hex": hex });
            assert!(serde_json::from_value::<GivenFile>(value).is_err(), "{hex}");
        }
    }
}
