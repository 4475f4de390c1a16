//! Text for a terminal. Names come from logs: a control character in one would move the cursor, set a title, or worse.

use std::borrow::Cow;
use std::fmt::Display;

/// A text whose control characters, but line breaks and tabs, are escaped: `\u{1b}`.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, |c| c.is_control() && !['\n', '\t'].contains(&c))
}

/// A name as a part of a line, which it must not break: line breaks and tabs are escaped, too.
pub fn in_line(name: impl Display) -> String {
    escaped(&name.to_string(), char::is_control).into_owned()
}

fn escaped(text: &str, moves: impl Fn(char) -> bool + Copy) -> Cow<'_, str> {
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
            assert_eq!(in_line(text), expected);
        }
        assert_eq!(in_line("/odom é\n\t- 漢"), "/odom é\\n\\t- 漢");
    }
}
