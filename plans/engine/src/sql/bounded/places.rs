//! What looks for every place of an expression in a long text, one place after the other. DataFusion finds them all in one go:
//! an expression that looks to the end of the text from each of them takes minutes for a megabyte, and nothing interrupts it.
//! Here it is asked between two places whether somebody still waits.

use arrow::datatypes::DataType;
use datafusion::common::{Result, ScalarValue};
use datafusion::logical_expr::ScalarFunctionArgs;
use regex::{Match, Regex};

use crate::sql::bounded::growth::Argument;
use crate::sql::term::go_on;

/// Bytes of a text in which all places are found within a moment, whatever the expression is.
const SHORT: usize = 10_000;

/// A group of the expression as a replacement names it: `\1`.
const GROUP: &str = r"\\{1,2}(\d+)";

/// The answer to a call of one row: `regexp_replace` with the flag `g`, `regexp_count` or `regexp_instr`, as DataFusion has
/// them. `None` where its own function takes no longer than the text is long, or says what is wrong: for short texts, other
/// calls, null, and what is no expression.
///
/// # Errors
/// When an argument cannot be read, or the query ends meanwhile.
pub fn answer(name: &str, args: &ScalarFunctionArgs) -> Result<Option<ScalarValue>> {
    let given = args.args.iter().map(Argument::new);
    let call = Call(given.collect::<Result<_>>()?);
    if call.text(0, "").is_none_or(|text| text.len() <= SHORT) {
        return Ok(None);
    }
    match name {
        "regexp_replace" => Ok(replaced(&call)?.map(|made| match args.return_type() {
            DataType::LargeUtf8 => ScalarValue::LargeUtf8(Some(made)),
            DataType::Utf8View => ScalarValue::Utf8View(Some(made)),
            _ => ScalarValue::Utf8(Some(made)),
        })),
        "regexp_count" => Ok(counted(&call)?.map(|count| ScalarValue::Int64(Some(count)))),
        "regexp_instr" => Ok(found(&call)?.map(|letter| ScalarValue::Int64(Some(letter)))),
        _ => Ok(None),
    }
}

/// The arguments of a call of one row.
struct Call(Vec<Argument>);

impl Call {
    /// A text; `None` for null, and for what is none.
    fn text<'c>(&'c self, index: usize, absent: &'c str) -> Option<&'c str> {
        match self.0.get(index) {
            Some(given) => given.text(0),
            None => Some(absent),
        }
    }

    /// A number; `None` for null.
    fn number(&self, index: usize, absent: i64) -> Option<i64> {
        match self.0.get(index) {
            Some(given) => given.number(0).map(|number| number as i64),
            None => Some(absent),
        }
    }

    /// The expression with the flags of this argument, among which is no `g`.
    fn expression(&self, flags: usize) -> Option<Regex> {
        let (pattern, flags) = (self.text(1, "")?, self.text(flags, "")?);
        match flags {
            "" => Regex::new(pattern).ok(),
            flags if flags.contains('g') => None,
            flags => Regex::new(&format!("(?{flags}){pattern}")).ok(),
        }
    }

    /// The text, and from which byte on it is looked at: the third argument counts letters from 1 on.
    fn looked_at(&self) -> Option<(&str, usize)> {
        let text = self.text(0, "")?;
        let before = usize::try_from(self.number(2, 1)?.checked_sub(1)?).ok()?;
        let letters = text.char_indices().map(|(at, _)| at);
        let from = letters.chain([text.len()]).nth(before)?;
        Some((text, from))
    }
}

/// A text of which places are replaced.
struct Rewritten<'t> {
    text: &'t str,
    /// The bytes of it that are done with.
    done: usize,
    made: String,
}

impl Rewritten<'_> {
    /// What is made so far, up to a place, which is done with then.
    fn up_to(&mut self, place: Match<'_>) -> &mut String {
        self.made.push_str(&self.text[self.done..place.start()]);
        self.done = place.end();
        &mut self.made
    }

    fn whole(mut self) -> String {
        self.made.push_str(&self.text[self.done..]);
        self.made
    }
}

/// `regexp_replace(text, pattern, with, flags)`, where the flags have a `g`.
fn replaced(call: &Call) -> Result<Option<String>> {
    let texts = [0, 1, 2, 3].map(|index| call.text(index, ""));
    let [Some(text), Some(pattern), Some(with), Some(flags)] = texts else {
        return Ok(None);
    };
    let pattern = match flags {
        "g" => pattern.to_owned(),
        flags if flags.contains('g') => format!("(?{}){pattern}", flags.replace('g', "")),
        _ => return Ok(None),
    };
    let (Ok(expression), Ok(group)) = (Regex::new(&pattern), Regex::new(GROUP)) else {
        return Ok(None);
    };
    let with = group.replace_all(with, "$${$1}");
    let mut rewritten = Rewritten {
        text,
        done: 0,
        made: String::new(),
    };
    if with.contains('$') {
        for captures in expression.captures_iter(text) {
            go_on()?;
            if let Some(place) = captures.get(0) {
                captures.expand(&with, rewritten.up_to(place));
            }
        }
    } else {
        for place in expression.find_iter(text) {
            go_on()?;
            rewritten.up_to(place).push_str(&with);
        }
    }
    Ok(Some(rewritten.whole()))
}

/// `regexp_count(text, pattern, start, flags)`.
fn counted(call: &Call) -> Result<Option<i64>> {
    let (Some((text, from)), Some(expression)) = (call.looked_at(), call.expression(3)) else {
        return Ok(None);
    };
    let mut count = 0;
    for _ in expression.find_iter(&text[from..]) {
        go_on()?;
        count += 1;
    }
    Ok(Some(count))
}

/// `regexp_instr(text, pattern, start, n, flags, group)`, unless it is for a group: the letter at which the place of this
/// number begins, 0 where there is none.
fn found(call: &Call) -> Result<Option<i64>> {
    let (Some((text, from)), Some(expression)) = (call.looked_at(), call.expression(4)) else {
        return Ok(None);
    };
    let (Some(number @ 1..), Some(..=0)) = (call.number(3, 1), call.number(5, 0)) else {
        return Ok(None);
    };
    let mut places = expression.find_iter(&text[from..]);
    let mut place = None;
    for _ in 0..number {
        go_on()?;
        place = places.next();
        if place.is_none() {
            break;
        }
    }
    let letter = |place: Match<'_>| text[..from + place.start()].chars().count() as i64 + 1;
    Ok(Some(place.map_or(0, letter)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use arrow::datatypes::Field;
    use datafusion::common::config::ConfigOptions;
    use datafusion::execution::FunctionRegistry;
    use datafusion::logical_expr::ColumnarValue;
    use datafusion::prelude::SessionContext;

    use super::*;

    fn call(name: &str, values: &[ScalarValue]) -> ScalarFunctionArgs {
        let field = |kind: DataType| Arc::new(Field::new("value", kind, true));
        let returned = match name {
            "regexp_replace" => values[0].data_type(),
            _ => DataType::Int64,
        };
        ScalarFunctionArgs {
            arg_fields: values
                .iter()
                .map(|value| field(value.data_type()))
                .collect(),
            args: values.iter().cloned().map(ColumnarValue::Scalar).collect(),
            number_rows: 1,
            return_field: field(returned),
            config_options: Arc::new(ConfigOptions::default()),
        }
    }

    /// What DataFusion's own function answers.
    fn own(name: &str, args: ScalarFunctionArgs) -> ScalarValue {
        let function = SessionContext::new().udf(name).unwrap();
        match function.invoke_with_args(args).unwrap() {
            ColumnarValue::Scalar(value) => value,
            ColumnarValue::Array(values) => ScalarValue::try_from_array(&values, 0).unwrap(),
        }
    }

    /// Ten bytes, again and again: 20 kB.
    fn long() -> String {
        "añb1 c\nB ".repeat(2000)
    }

    fn texts(values: &[&str]) -> Vec<ScalarValue> {
        values
            .iter()
            .map(|value| ScalarValue::from(*value))
            .collect()
    }

    fn number(number: i64) -> ScalarValue {
        ScalarValue::Int64(Some(number))
    }

    #[test]
    fn places_are_replaced_as_by_datafusion() {
        let text = long();
        let kinds = [DataType::Utf8, DataType::LargeUtf8, DataType::Utf8View];
        for (pattern, with, flags) in [
            ("b", "x", "g"),
            ("(b)(\\d)", r"\2-\1", "g"),
            ("(b)(\\d)", r"<\\0>", "g"),
            ("B", "$0$0", "gi"),
            ("(?P<n>b)", "${n}$$", "g"),
            ("x*", "-", "g"),
            (r"\b", "|", "g"),
            ("^a", "", "gm"),
            ("ñ.*?B", r"\0", "sg"),
            ("nothing", "x", "g"),
            ("b$", "x", "g"),
        ] {
            for kind in &kinds {
                let values = texts(&[&text, pattern, with, flags]);
                let values = values.iter().map(|value| value.cast_to(kind).unwrap());
                let args = call("regexp_replace", &values.collect::<Vec<_>>());
                let found = answer("regexp_replace", &args).unwrap();
                let expected = own("regexp_replace", args);
                assert_eq!(found, Some(expected), "{pattern} {with} {flags} {kind}");
            }
        }
    }

    #[test]
    fn places_are_counted_and_found_as_by_datafusion() {
        let text = long();
        let start = |pattern: &str, start: i64| {
            let mut values = texts(&[&text, pattern]);
            values.push(number(start));
            values
        };
        let nth = |pattern: &str, from: i64, nth: i64, flags: &str| {
            let mut values = start(pattern, from);
            values.extend([number(nth), ScalarValue::from(flags)]);
            values
        };
        let counts = [
            texts(&[&text, "b"]),
            texts(&[&text, "x*"]),
            start("b", 5),
            // There are 18,000 letters.
            start("x*", 18_001),
            [start("b", 3), texts(&["i"])].concat(),
        ];
        let found = [
            texts(&[&text, "ñ"]),
            start("ñ", 3),
            nth("b", 1, 700, ""),
            nth("b", 11, 700, "i"),
            nth("b", 1, 2001, ""),
            nth("x*", 1, 18_001, ""),
            nth("nothing", 1, 1, ""),
        ];
        let counts = counts.into_iter().map(|values| ("regexp_count", values));
        let found = found.into_iter().map(|values| ("regexp_instr", values));
        for (name, values) in counts.chain(found) {
            let args = call(name, &values);
            let found = answer(name, &args).unwrap();
            assert_eq!(found, Some(own(name, args)), "{name} {:?}", &values[1..]);
        }
    }

    #[test]
    fn what_is_quick_or_wrong_is_left_to_datafusion() {
        let text = long();
        let null = ScalarValue::Utf8(None);
        let groups = [texts(&[&text, "(b)"]), vec![number(1), number(1)]];
        for (name, values) in [
            ("regexp_replace", texts(&[&text, "b", "x"])),
            ("regexp_replace", texts(&[&text, "b", "x", "i"])),
            ("regexp_replace", texts(&["short", "o", "x", "g"])),
            ("regexp_replace", texts(&[&text, "(", "x", "g"])),
            (
                "regexp_replace",
                [texts(&[&text, "b", "x"]), vec![null.clone()]].concat(),
            ),
            ("regexp_count", [texts(&[&text]), vec![null]].concat()),
            (
                "regexp_count",
                [texts(&[&text, "b"]), vec![number(0)]].concat(),
            ),
            (
                "regexp_count",
                [texts(&[&text, "b"]), vec![number(18_002)]].concat(),
            ),
            (
                "regexp_count",
                [texts(&[&text, "b"]), vec![number(1)], texts(&["g"])].concat(),
            ),
            (
                "regexp_instr",
                [texts(&[&text, "b"]), vec![number(1), number(0)]].concat(),
            ),
            (
                "regexp_instr",
                [groups.concat(), vec![ScalarValue::from(""), number(1)]].concat(),
            ),
            ("regexp_like", texts(&[&text, "b"])),
        ] {
            let found = answer(name, &call(name, &values)).unwrap();
            assert_eq!(found, None, "{name} {:?}", &values[1..]);
        }
    }
}
