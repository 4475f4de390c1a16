//! How large a query may be. What plans it goes as deep as it nests: without a bound a text of some kilobytes ends the
//! program by overflowing the stack, and takes hours to plan.

use datafusion::sql::sqlparser::dialect::Dialect;
use datafusion::sql::sqlparser::tokenizer::{Token, Tokenizer};
use evermap_schemas::Fault;

/// Stack of the threads that plan queries. It is reserved, not used: memory is taken by the depth that a query has.
pub const STACK_BYTES: usize = 256 << 20;

/// Words and operators of a query at most; each may nest it deeper by one. A sum of 5,000 terms is planned within 64 MiB
/// of stack where nothing is optimised, so the largest takes half of [`STACK_BYTES`].
pub const QUERY_WORDS: usize = 10_000;

/// Refuses a text with a query that is too large. Literals, commas and brackets are not counted: a list may be long.
///
/// # Errors
/// A user fault with both numbers.
pub fn check_size(text: &str, dialect: &dyn Dialect) -> Result<(), Fault> {
    // What is no token at all, the parser says better.
    let tokens = Tokenizer::new(dialect, text).tokenize().unwrap_or_default();
    let queries = tokens.split(|token| *token == Token::SemiColon);
    let words = queries.map(|query| query.iter().filter(|token| counts(token)).count());
    match words.max().unwrap_or_default() {
        words if words > QUERY_WORDS => Err(Fault::user(format!(
            "expected a query of at most {QUERY_WORDS} words and operators, found {words}"
        ))
        .next("compare with a list (x IN (1, 2, …)), or make a table of it, as a step of a plan or with VALUES")),
        _ => Ok(()),
    }
}

fn counts(token: &Token) -> bool {
    !matches!(
        token,
        Token::Whitespace(_)
            | Token::Comma
            | Token::LParen
            | Token::RParen
            | Token::LBrace
            | Token::RBrace
            | Token::Number(..)
            | Token::SingleQuotedString(_)
            | Token::HexStringLiteral(_)
            | Token::EOF
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use datafusion::sql::sqlparser::dialect::GenericDialect;

    use super::*;

    #[test]
    fn what_nests_is_counted_and_what_lies_side_by_side_is_not() {
        let check = |text: &str| check_size(text, &GenericDialect {});
        let sum = |terms: usize| format!("SELECT {}", vec!["1"; terms].join(" + "));
        check(&sum(QUERY_WORDS)).unwrap();
        let fault = check(&sum(QUERY_WORDS + 1)).unwrap_err().to_string();
        assert!(
            fault.contains("at most 10000") && fault.contains("found 10001"),
            "{fault}"
        );
        let list = vec!["(1, 'a')"; 50_000].join(", ");
        check(&format!("SELECT * FROM (VALUES {list})")).unwrap();
        check(&vec!["SELECT a FROM b"; 50_000].join(";\n")).unwrap();
        check("SELECT 'not closed").unwrap();
    }
}
