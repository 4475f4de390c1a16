//! Words of IDL text, with their lines.

/// One word, name, literal or sign.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Token<'a> {
    /// A name, scoped with `::` or not, or a keyword.
    Name(&'a str),
    /// A number as written.
    Number(&'a str),
    /// A string or character literal, without quotes.
    Literal,
    Sign(char),
}

impl Token<'_> {
    /// As a message shows it.
    pub(super) fn shown(&self) -> String {
        match self {
            Token::Name(text) | Token::Number(text) => text.chars().take(80).collect(),
            Token::Literal => "a literal".to_owned(),
            Token::Sign(sign) => sign.to_string(),
        }
    }
}

/// Splits `text`; comments, preprocessor lines, and the lines between files are dropped.
pub(super) fn tokens(text: &str) -> Vec<(Token<'_>, u32)> {
    let mut rest = text;
    let mut line = 1_u32;
    let mut found = Vec::new();
    let mut line_start = true;
    while let Some(first) = rest.chars().next() {
        let (token, length) = if line_start && is_directive(rest) {
            (None, line_length(rest))
        } else {
            next(rest, first)
        };
        let (taken, tail) = rest.split_at(length.clamp(first.len_utf8(), rest.len()));
        found.extend(token.map(|token| (token, line)));
        line += taken.matches('\n').count() as u32;
        line_start = taken.ends_with('\n') || (line_start && taken.trim().is_empty());
        rest = tail;
    }
    found
}

fn line_length(text: &str) -> usize {
    text.find('\n').unwrap_or(text.len())
}

/// `#include`, the `====` rule between files, and the `IDL:` line below it.
fn is_directive(text: &str) -> bool {
    ["#", "====", "IDL:", "MSG:"]
        .iter()
        .any(|prefix| text.starts_with(prefix))
}

fn next(text: &str, first: char) -> (Option<Token<'_>>, usize) {
    if text.starts_with("//") {
        return (None, line_length(text));
    }
    if text.starts_with("/*") {
        return (None, text.find("*/").map_or(text.len(), |end| end + 2));
    }
    match first {
        '"' | '\'' => (Some(Token::Literal), literal_length(text, first)),
        c if c.is_ascii_digit() => {
            let length = span(text, |c| c.is_ascii_alphanumeric() || c == '.');
            (Some(Token::Number(&text[..length])), length)
        }
        c if c.is_ascii_alphabetic() || c == '_' => {
            let length = name_length(text);
            (Some(Token::Name(&text[..length])), length)
        }
        ':' if text.starts_with("::") => {
            let length = 2 + name_length(&text[2..]);
            (Some(Token::Name(&text[..length])), length)
        }
        c if c.is_whitespace() => (None, c.len_utf8()),
        c => (Some(Token::Sign(c)), c.len_utf8()),
    }
}

fn span(text: &str, keep: impl Fn(char) -> bool) -> usize {
    text.find(|c| !keep(c)).unwrap_or(text.len())
}

/// A name with its scopes: `a::b::c`.
fn name_length(text: &str) -> usize {
    let word = |text: &str| span(text, |c| c.is_ascii_alphanumeric() || c == '_');
    let mut length = word(text);
    while text[length..].starts_with("::") && word(&text[length + 2..]) > 0 {
        length += 2 + word(&text[length + 2..]);
    }
    length
}

fn literal_length(text: &str, quote: char) -> usize {
    let mut escaped = false;
    for (index, c) in text.char_indices().skip(1) {
        if c == quote && !escaped {
            return index + 1;
        }
        escaped = c == '\\' && !escaped;
    }
    text.len()
}
