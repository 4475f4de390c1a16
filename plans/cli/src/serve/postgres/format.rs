//! `format(pattern, values …)` as Postgres has it: `%s` is a text, `%I` a name, `%L` a literal, `%%` a percent sign.

use std::fmt::Write;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, StringArray};
use arrow::compute::cast;
use arrow::datatypes::DataType;
use datafusion::common::exec_err;
use datafusion::error::Result;
use datafusion::logical_expr::{ColumnarValue, ScalarUDF, Signature, Volatility};

use crate::serve::postgres::functions::function;

/// The function.
pub fn format() -> ScalarUDF {
    let takes = Signature::variadic_any(Volatility::Immutable);
    function("format", takes, DataType::Utf8, |args| {
        let columns = ColumnarValue::values_to_arrays(args)?;
        let texts = columns.iter().map(|column| cast(column, &DataType::Utf8));
        let texts = texts.collect::<std::result::Result<Vec<ArrayRef>, _>>()?;
        let Some((patterns, values)) = texts.split_first() else {
            return exec_err!("format expects a pattern");
        };
        let values: Vec<&StringArray> = values.iter().map(|values| values.as_string()).collect();
        let row = |(row, pattern): (usize, Option<&str>)| {
            let values = values.iter();
            let values = values.map(|values| values.is_valid(row).then(|| values.value(row)));
            pattern.map(|pattern| filled(pattern, values)).transpose()
        };
        let patterns = patterns.as_string::<i32>().iter().enumerate();
        let made = patterns.map(row).collect::<Result<StringArray>>()?;
        Ok(ColumnarValue::Array(Arc::new(made)))
    })
}

/// A pattern with values in it; null is no text.
fn filled<'v>(pattern: &str, mut values: impl Iterator<Item = Option<&'v str>>) -> Result<String> {
    let mut made = String::new();
    let mut letters = pattern.chars();
    while let Some(letter) = letters.next() {
        if letter != '%' {
            made.push(letter);
            continue;
        }
        let kind = letters.next();
        if kind == Some('%') {
            made.push('%');
            continue;
        }
        let Some(value) = values.next() else {
            return exec_err!("format expects a value for each % of its pattern, found too few");
        };
        match (kind, value) {
            (Some('s'), value) => made.push_str(value.unwrap_or_default()),
            (Some('I'), Some(value)) => made.push_str(&name(value)),
            (Some('L'), value) => {
                let literal = value.map(|value| format!("'{}'", value.replace('\'', "''")));
                made.push_str(literal.as_deref().unwrap_or("NULL"));
            }
            (Some('I'), None) => return exec_err!("format expects a name for %I, found null"),
            (kind, _) => {
                let mut found = String::from("%");
                let _ = kind.map(|kind| found.write_char(kind));
                return exec_err!("format expects %s, %I, %L or %%, found {found}");
            }
        }
    }
    Ok(made)
}

/// A name, between quotes where it must be.
fn name(text: &str) -> String {
    let plain = |letter: char| matches!(letter, 'a'..='z' | '0'..='9' | '_');
    match text.chars().all(plain) && !text.starts_with(|letter: char| letter.is_ascii_digit()) {
        true => text.to_owned(),
        false => format!("\"{}\"", text.replace('"', "\"\"")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stand_where_the_pattern_says() {
        let made =
            |pattern, values: &[Option<&'static str>]| filled(pattern, values.iter().copied()).ok();
        let values = [Some("public"), Some("/Odom")];
        assert_eq!(made("%I.%I", &values).as_deref(), Some("public.\"/Odom\""));
        assert_eq!(made("100 %% %s", &values).as_deref(), Some("100 % public"));
        assert_eq!(
            made("%L, %L", &[Some("it's"), None]).as_deref(),
            Some("'it''s', NULL")
        );
        for (pattern, values) in [
            ("%s", &[][..]),
            ("%I", &[None]),
            ("%d", &[Some("1")]),
            ("%", &[Some("1")]),
        ] {
            assert_eq!(made(pattern, values), None, "{pattern}");
        }
    }
}
