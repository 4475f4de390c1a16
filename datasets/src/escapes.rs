//! Names that are no text, as people read them.

/// A name with escapes for bytes that are not UTF-8, control characters, quotes and backslashes.
pub(crate) fn escaped(name: &[u8]) -> String {
    let mut text = String::new();
    for chunk in name.utf8_chunks() {
        text.extend(chunk.valid().chars().flat_map(char::escape_debug));
        let others = chunk.invalid().iter().map(|byte| format!("\\x{byte:02X}"));
        text.extend(others);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_that_are_no_letters_have_escapes() {
        assert_eq!(escaped(b"caf\xe9 \xc3\xa9\n"), "caf\\xE9 é\\n");
        assert_eq!(escaped(b"\xf0\x9f\\"), "\\xF0\\x9F\\\\");
        assert_eq!(escaped(b""), "");
    }
}
