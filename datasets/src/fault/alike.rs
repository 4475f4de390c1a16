//! Values that do not go together, or not with a function, as people call their types.

use arrow::datatypes::DataType;
use evermap_schemas::{Cell, Pose, type_name};

/// How an instant is written where one is compared.
pub const INSTANT: &str = "write an instant as a text: stamp > '2024-05-01T10:00:00Z'";

/// How DataFusion says that a function does not take such arguments.
pub const NO_SIGNATURE: &str = " failed to match any signature";

/// How DataFusion says that arguments do not become what a function takes.
const NO_COERCION: &str = "Failed to coerce arguments";

/// The types that a function takes, and those that it was given.
pub fn types(message: &str) -> Option<String> {
    if !message.contains(NO_SIGNATURE) && !message.contains(NO_COERCION) {
        return None;
    }
    let (_, behind) = message.split_once("and argument types '")?;
    let (found, behind) = behind.split_once("'. You might need")?;
    let (_, candidates) = behind.split_once("Candidate functions:\n")?;
    let lines = candidates.lines();
    let candidates = lines.map_while(|line| line.strip_prefix('\t'));
    let mut expected = Vec::new();
    for (_, arguments) in candidates.filter_map(call) {
        if !expected.contains(&arguments) {
            expected.push(arguments);
        }
    }
    let (name, found) = call(found)?;
    let expected = expected.join(" or ");
    (!expected.is_empty()).then(|| format!("{name} expects {expected}, found {found}"))
}

/// The name of a function that is called with these types, and they as people call them: `avg` and `(f64)`.
fn call(text: &str) -> Option<(&str, String)> {
    let (name, behind) = text.split_once('(')?;
    let types = apart(behind.strip_suffix(')')?, ',');
    let types: Vec<String> = types.into_iter().map(|given| named(given.trim())).collect();
    Some((name, format!("({})", types.join(", "))))
}

/// A text cut where a character stands outside of parentheses.
fn apart(text: &str, at: char) -> Vec<&str> {
    let (mut depth, mut begin, mut parts) = (0_i32, 0, Vec::new());
    for (place, c) in text.char_indices() {
        match c {
            '(' => depth += 1,
            ')' => depth -= 1,
            c if c == at && depth == 0 => {
                parts.push(&text[begin..place]);
                begin = place + c.len_utf8();
            }
            _ => {}
        }
    }
    parts.push(&text[begin..]);
    parts
}

/// What people call a type that DataFusion names.
fn named(found: &str) -> String {
    let Ok(found) = found.parse::<DataType>() else {
        return found.to_lowercase();
    };
    let name = type_name(&found);
    match name == type_name(&<Pose as Cell>::data_type()) {
        true => "a pose".to_owned(),
        false => name,
    }
}

/// What two values are that are compared, or computed with, and do not go together, `time > i64`, and what is written instead.
pub fn not_alike(message: &str) -> Option<(String, String)> {
    let (first, operator, others) = pair(message)?;
    let kinds: Vec<String> = others.iter().map(|other| named(other)).collect();
    let shown = match kinds.as_slice() {
        [last] if operator != IN => last.clone(),
        several => format!("({})", several.join(", ")),
    };
    let said = format!(
        "expected two values that go together, found {} {operator} {shown}",
        named(first)
    );
    let mut all = std::iter::once(first).chain(others.iter().copied());
    let member = all.clone().find_map(first_member);
    let next = match member {
        Some(member) => format!("take a member of the struct: column['{member}']"),
        None if all.any(|kind| named(kind) == "time") => INSTANT.to_owned(),
        None => String::new(),
    };
    Some((said, next))
}

/// The operator of a list.
const IN: &str = "IN";

/// The type of a value, the operator, and the types of what it is put to.
fn pair(message: &str) -> Option<(&str, String, Vec<&str>)> {
    let behind = |text: &str| message.split_once(text).map(|(_, behind)| behind);
    if let Some(pair) = behind("Failed to coerce types ") {
        let pair = pair.strip_suffix(" in BETWEEN expression")?;
        let [first, "and", bound] = *apart(pair, ' ') else {
            return None;
        };
        return Some((first, "BETWEEN".to_owned(), vec![bound]));
    }
    if let Some(pair) = behind("Can not find compatible types to compare ") {
        let (first, items) = pair.strip_suffix(']')?.rsplit_once(" with [")?;
        let items = apart(items, ',').into_iter().map(str::trim);
        let mut kinds: Vec<&str> = items.collect();
        kinds.dedup();
        return Some((first, IN.to_owned(), kinds));
    }
    let pair = behind("Cannot infer common argument type for comparison operation ")
        .or_else(|| behind("Cannot coerce arithmetic expression "))?;
    let pair = pair
        .split_once(" to valid types")
        .map_or(pair, |(pair, _)| pair);
    match *apart(pair, ' ') {
        [first, ref operator @ .., last] if !operator.is_empty() => {
            Some((first, operator.join(" "), vec![last]))
        }
        _ => None,
    }
}

/// The first member of a struct.
fn first_member(kind: &str) -> Option<String> {
    match kind.parse() {
        Ok(DataType::Struct(members)) => members.first().map(|member| member.name().clone()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn values_that_do_not_go_together_are_told_with_what_may_be_written() {
        let stamp = r#"Struct("time": Int64, "nanosec": Int64)"#;
        let time = "Timestamp(ns, \"UTC\")";
        let comparison = "Cannot infer common argument type for comparison operation";
        let member = "take a member of the struct: column['time']";
        for (message, expected, next) in [
            (
                format!("{comparison} {stamp} > Utf8"),
                "struct of time, nanosec > text",
                member,
            ),
            (
                format!("{comparison} {time} IS DISTINCT FROM {stamp}"),
                "time IS DISTINCT FROM struct of time, nanosec",
                member,
            ),
            (
                format!("Failed to coerce types {stamp} and Utf8 in BETWEEN expression"),
                "struct of time, nanosec BETWEEN text",
                member,
            ),
            (
                format!("Failed to coerce types {time} and Int64 in BETWEEN expression"),
                "time BETWEEN i64",
                INSTANT,
            ),
            (
                format!(
                    "Can not find compatible types to compare {stamp} with [Int64, Int64, Utf8]"
                ),
                "struct of time, nanosec IN (i64, text)",
                member,
            ),
            (
                format!("Can not find compatible types to compare {time} with [Int64]"),
                "time IN (i64)",
                INSTANT,
            ),
            (
                "Cannot coerce arithmetic expression List(Int64) + Boolean to valid types"
                    .to_owned(),
                "list of i64 + bool",
                "",
            ),
        ] {
            let (said, meant) = not_alike(&message).unwrap();
            let (_, found) = said.split_once("found ").unwrap();
            assert_eq!((found, meant.as_str()), (expected, next), "{message}");
        }
    }
}
