//! Lists as Postgres writes them, `{a,"b, c",NULL}`: those that are bound, and those in the text of a query, which the library
//! would cut at each comma.

use std::borrow::Cow;

use arrow::array::{StringArray, StringBuilder};
use datafusion::sql::sqlparser::ast::DataType;
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::keywords::Keyword;
use datafusion::sql::sqlparser::parser::Parser;
use datafusion::sql::sqlparser::tokenizer::{Token, TokenWithSpan};
use pgwire::error::PgWireResult;

use crate::serve::postgres::tokens::{changed, tokens};
use crate::serve::postgres::values::found_other;

/// Tokens that the name of a type has at most, as in `pg_catalog.timestamp(3) without time zone[3]`.
const OF_TYPE: usize = 16;

/// A query in which a list that is written as a text is written by its elements: `'{a,"b, c"}'::text[]` is
/// `ARRAY['a','b, c']::text[]`; so is what is cast to a list by `CAST`, and what `ANY`, `SOME` and `ALL` are given.
///
/// # Errors
/// For a text that is no list there, or one of lists.
pub fn as_lists(query: &str) -> PgWireResult<Cow<'_, str>> {
    let tokens = tokens(query);
    let lists = tokens.iter().enumerate().filter_map(|(place, found)| {
        let text = text(&found.token)?;
        let made = || list(text).map(|list| (found.span, list));
        is_list(&tokens, place).then(made)
    });
    let lists = lists.collect::<PgWireResult<Vec<_>>>()?;
    Ok(changed(query, lists))
}

fn text(token: &Token) -> Option<&str> {
    match token {
        Token::SingleQuotedString(text) | Token::EscapedStringLiteral(text) => Some(text),
        Token::DollarQuotedString(quoted) => Some(&quoted.value),
        _ => None,
    }
}

/// Whether a text is a list by what stands around it.
fn is_list(tokens: &[TokenWithSpan], place: usize) -> bool {
    let before = |steps: usize| {
        let token = tokens.get(place.checked_sub(steps)?)?;
        Some(&token.token)
    };
    let behind = tokens.get(place + 1).map(|token| &token.token);
    let type_behind = tokens.get(place + 2..).unwrap_or_default();
    match (before(1), behind) {
        // Behind an operator; `SELECT ALL ('a')` compares nothing.
        (Some(Token::LParen), Some(Token::RParen)) => {
            let is_any = matches!(
                keyword(before(2)),
                Some(Keyword::ANY | Keyword::SOME | Keyword::ALL)
            );
            is_any && before(3).is_some_and(|token| !matches!(token, Token::Word(_)))
        }
        (_, Some(Token::DoubleColon)) => is_of_lists(type_behind),
        (Some(Token::LParen), behind) => {
            keyword(before(2)) == Some(Keyword::CAST)
                && keyword(behind) == Some(Keyword::AS)
                && is_of_lists(type_behind)
        }
        _ => false,
    }
}

fn keyword(token: Option<&Token>) -> Option<Keyword> {
    match token? {
        Token::Word(word) => Some(word.keyword),
        _ => None,
    }
}

/// Whether the type that tokens begin with is one of lists.
fn is_of_lists(tokens: &[TokenWithSpan]) -> bool {
    let of_type = tokens.iter().take(OF_TYPE).cloned().collect();
    let mut parser = Parser::new(&PostgreSqlDialect {}).with_tokens_with_locations(of_type);
    matches!(parser.parse_data_type(), Ok(DataType::Array(_)))
}

/// The elements of a text as a list of literals.
fn list(text: &str) -> PgWireResult<String> {
    let elements = elements(text)?;
    let literals = elements.iter().map(|element| match element {
        Some(element) => format!("'{}'", element.replace('\'', "''")),
        None => "NULL".to_owned(),
    });
    let literals: Vec<String> = literals.collect();
    Ok(format!("ARRAY[{}]", literals.join(",")))
}

/// The elements of a list.
///
/// # Errors
/// For a text that is none, or one of lists.
pub fn elements(text: &str) -> PgWireResult<StringArray> {
    read(text).ok_or_else(|| found_other(text, "a list such as {1,2}"))
}

fn read(text: &str) -> Option<StringArray> {
    let mut letters = text.trim().strip_prefix('{')?.chars().peekable();
    let mut found = StringBuilder::new();
    let mut element = String::new();
    let mut is_first = true;
    loop {
        while letters
            .next_if(|letter| letter.is_ascii_whitespace())
            .is_some()
        {}
        if is_first && letters.next_if_eq(&'}').is_some() {
            break;
        }
        is_first = false;
        element.clear();
        let is_quoted = letters.next_if_eq(&'"').is_some();
        let mut is_plain = !is_quoted;
        // Blanks behind an element are none of it, unless they are escaped.
        let mut length = 0;
        while is_quoted || !matches!(letters.peek(), Some(',' | '}')) {
            match (letters.next()?, is_quoted) {
                ('\\', _) => {
                    element.push(letters.next()?);
                    (is_plain, length) = (false, element.len());
                }
                ('"', true) => break,
                ('"' | '{', false) => return None,
                (letter, _) => {
                    element.push(letter);
                    if is_quoted || !letter.is_ascii_whitespace() {
                        length = element.len();
                    }
                }
            }
        }
        element.truncate(length);
        match is_plain {
            true if element.is_empty() => return None,
            true if element.eq_ignore_ascii_case("null") => found.append_null(),
            _ => found.append_value(&element),
        }
        while letters
            .next_if(|letter| letter.is_ascii_whitespace())
            .is_some()
        {}
        match letters.next()? {
            ',' => {}
            '}' => break,
            _ => return None,
        }
    }
    letters.next().is_none().then(|| found.finish())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn lists_are_read_as_postgres_writes_them() {
        for (text, expected) in [
            ("{}", &[][..]),
            ("{my lot,lot}", &[Some("my lot"), Some("lot")]),
            ("{NULL,\"NULL\",null}", &[None, Some("NULL"), None]),
            (
                "{\"a, {b}\",\"\\\"\\\\\",\"\"}",
                &[Some("a, {b}"), Some("\"\\"), Some("")],
            ),
            (
                " { a b , \" c \" , d\\ } ",
                &[Some("a b"), Some(" c "), Some("d ")],
            ),
        ] {
            let found = elements(text).unwrap();
            assert_eq!(found.iter().collect::<Vec<_>>(), expected, "{text}");
        }
        for text in [
            "",
            "{",
            "a",
            "{a",
            "{a}}",
            "{a},",
            "{,}",
            "{a,}",
            "{\"a}",
            "{\"a\"b}",
            "{{1},{2}}",
            "{a\\",
            "[1:1]={a}",
        ] {
            assert!(elements(text).is_err(), "{text}");
        }
    }

    #[test]
    fn lists_in_the_text_of_a_query_are_written_by_their_elements() {
        for (query, expected) in [
            (
                r#"SELECT site = ANY('{"a, b",it''s,NULL,"NULL"}') FROM lanes"#,
                "SELECT site = ANY(ARRAY['a, b','it''s',NULL,'NULL']) FROM lanes",
            ),
            (
                r#"SELECT 1 WHERE é <>all ( E'{a\\,b,"\\"c\\""}' ) -- '{a}'::text[]"#,
                r#"SELECT 1 WHERE é <>all ( ARRAY['a,b','"c"'] ) -- '{a}'::text[]"#,
            ),
            (
                "SELECT '{1,2}'::pg_catalog.int4 [],\n'{}'::varchar(10)[3], $a${x}$a$::timestamp with time zone[]",
                "SELECT ARRAY['1','2']::pg_catalog.int4 [],\nARRAY[]::varchar(10)[3], ARRAY['x']::timestamp with time zone[]",
            ),
            (
                "SELECT cast('{a,b}' AS character varying[])",
                "SELECT cast(ARRAY['a','b'] AS character varying[])",
            ),
        ] {
            assert_eq!(as_lists(query).unwrap(), expected);
        }
        for query in [
            "SELECT '{a,b}', '{a,b}'::text, cast('{a,b}' AS text), '{a}'::text AS y, z[1]",
            "SELECT ALL ('{a,b}')",
            "SELECT \"any\"('{a,b}'), f('{a,b}'), \"x = ANY('{a,b}')\"",
            "SELECT x = ANY(ARRAY['{a,b}']), x = ANY($1), '{a}'::",
            "SELECT 'open = ANY('{a}')",
        ] {
            assert!(matches!(as_lists(query), Ok(Cow::Borrowed(_))), "{query}");
        }
        for query in [
            "SELECT x = ANY('a,b')",
            "SELECT '{{1,2},{3,4}}'::int[]",
            "SELECT CAST('[0:1]={1,2}' AS int[])",
        ] {
            let refused = as_lists(query).unwrap_err().to_string();
            assert!(
                refused.contains("expected a list such as {1,2}, found `"),
                "{refused}"
            );
        }
    }
}
