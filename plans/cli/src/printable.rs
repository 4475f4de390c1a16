//! Text for a terminal. Names come from logs: a control character in one would move the cursor, set a title, or worse.

use std::borrow::Cow;

/// A text whose control characters, but line breaks and tabs, are escaped: `\u{1b}`.
pub fn printable(text: &str) -> Cow<'_, str> {
    let moves = |c: char| c.is_control() && !['\n', '\t'].contains(&c);
    if !text.contains(moves) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match moves(c) {
            true => shown.extend(c.escape_default()),
            false => shown.push(c),
        }
    }
    Cow::Owned(shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_a_cursor_is_escaped() {
        assert!(matches!(printable("/odom é\n\t- 漢"), Cow::Borrowed(_)));
        let cases = [
            ("/a\u{1b}[2Jb", "/a\\u{1b}[2Jb"),
            ("a\rb\u{7f}\u{9b}31m", "a\\rb\\u{7f}\\u{9b}31m"),
        ];
        for (text, expected) in cases {
            assert_eq!(printable(text), expected);
        }
    }
}
