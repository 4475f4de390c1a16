//! The text of a query by its tokens, and the same with some of them written otherwise.

use std::borrow::Cow;

use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::tokenizer::{Location, Span, Token, TokenWithSpan, Tokenizer};

/// The tokens of a query, without blanks; none where it has such as are none, which is told by who parses it.
pub fn tokens(query: &str) -> Vec<TokenWithSpan> {
    let tokens = Tokenizer::new(&PostgreSqlDialect {}, query).tokenize_with_location();
    let mut tokens = tokens.unwrap_or_default();
    tokens.retain(|token| !matches!(token.token, Token::Whitespace(_)));
    tokens
}

/// A query with other texts where some of its tokens are, in their order.
pub fn changed(query: &str, changes: Vec<(Span, String)>) -> Cow<'_, str> {
    if changes.is_empty() {
        return Cow::Borrowed(query);
    }
    let mut changes = changes.into_iter().peekable();
    let mut made = String::with_capacity(query.len());
    let mut here = Location::new(1, 1);
    let mut passed_over = here;
    for letter in query.chars() {
        if let Some((span, text)) = changes.next_if(|(span, _)| span.start == here) {
            made.push_str(&text);
            passed_over = span.end;
        }
        if here >= passed_over {
            made.push(letter);
        }
        here = match letter {
            '\n' => Location::new(here.line + 1, 1),
            _ => Location::new(here.line, here.column + 1),
        };
    }
    Cow::Owned(made)
}
