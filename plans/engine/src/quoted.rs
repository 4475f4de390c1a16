//! Names and texts as they stand in a query.

/// A name in quotes.
pub fn name(name: &str) -> String {
    format!("\"{}\"", name.replace('"', "\"\""))
}

/// A text in quotes.
pub fn text(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_within_are_doubled() {
        assert_eq!(name(r#"the "old" one's"#), r#""the ""old"" one's""#);
        assert_eq!(text(r#"the "old" one's"#), r#"'the "old" one''s'"#);
    }
}
