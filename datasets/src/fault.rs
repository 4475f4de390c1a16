//! DataFusion's errors as faults with a kind, and faults on their way through DataFusion.

mod alike;
mod objects;
mod regular;
mod unplanned;

use arrow::datatypes::DataType;
use arrow::error::ArrowError;
use datafusion::error::DataFusionError;
use datafusion::sql::sqlparser::parser::ParserError;
use evermap_schemas::{Fault, Kind, type_name};

use crate::fault::alike::{INSTANT, NO_SIGNATURE, not_alike, types};
use crate::fault::regular::no_expression;
use crate::fault::unplanned::{unfound, unplanned};

pub use crate::fault::objects::{changed, store_fault, with_credentials};

/// The fault inside, or the best reading of what DataFusion says. A fault that crossed a process border as text is
/// found again by its code.
pub fn fault_of(error: &DataFusionError) -> Fault {
    let place = place_in_query(error);
    let mut cause: Option<&dyn std::error::Error> = Some(error);
    while let Some(error) = cause {
        if let Some(fault) = error.downcast_ref::<Fault>() {
            let fault = fault.clone();
            return match fault.place.is_empty() {
                true => at(fault, place),
                false => fault,
            };
        }
        cause = error.source();
    }
    let root = error.find_root();
    let whole = root.to_string();
    if let Some(fault) = Fault::parse(&whole) {
        return fault;
    }
    if let Some(said) = no_expression(&whole) {
        return at(Fault::user(said), place);
    }
    if let DataFusionError::SchemaError(error, _) = root
        && let Some((said, next)) = unfound(error, place.is_some())
    {
        return at(Fault::user(said).next(next), place);
    }
    let (kind, message) = match root {
        DataFusionError::ResourcesExhausted(message) => (Kind::Resource, message.clone()),
        DataFusionError::ObjectStore(error) => (Kind::Resource, error.to_string()),
        DataFusionError::IoError(error) => (Kind::Resource, error.to_string()),
        DataFusionError::Internal(message) if !message.contains(NO_SIGNATURE) => {
            (Kind::Bug, message.clone())
        }
        // A query says what is computed, and of what.
        DataFusionError::Plan(message)
        | DataFusionError::Internal(message)
        | DataFusionError::Execution(message) => (Kind::User, plainly(message)),
        DataFusionError::NotImplemented(message) => {
            (Kind::User, format!("not supported: {}", plainly(message)))
        }
        DataFusionError::SchemaError(error, _) => (Kind::User, error.to_string()),
        DataFusionError::SQL(error, _) => {
            let said = parser_text(error);
            let said = said.rsplit_once(PARSER_AT).map_or(said, |(said, _)| said);
            (Kind::User, format!("SQL: {said}"))
        }
        DataFusionError::ArrowError(error, _) => {
            let said = match &**error {
                ArrowError::ComputeError(said) => plainly(said),
                other => other.to_string(),
            };
            (kind_of(error), not_cast(&said).unwrap_or(said))
        }
        _ => (Kind::Data, root.strip_backtrace()),
    };
    let message = message.lines().next().unwrap_or_default();
    if let Some((said, next)) = not_alike(message) {
        return at(Fault::user(said).next(next), place);
    }
    if let Some((said, next)) = unplanned(message) {
        return at(Fault::user(said).next(next), place);
    }
    if message.contains("Dot access not supported") {
        return Fault::user("expected a column in front of `.`, found an expression")
            .next("take a member of it in brackets: sources[1]['session']");
    }
    let fault = Fault::new(kind, message);
    let fault = match () {
        () if is_other_as_of(message) => fault.next(AS_OF),
        () if message.starts_with(NO_INSTANT) => fault.next(INSTANT),
        () if message.ends_with(TOO_DEEP) => fault.next(NESTED),
        () => fault,
    };
    at(fault, place)
}

/// A fault at a line and column, where they are known.
fn at(fault: Fault, place: Option<(usize, usize)>) -> Fault {
    match place {
        Some((line, column)) => fault.at(format!("line {line}, column {column} of the query")),
        None => fault,
    }
}

/// How a join by time is written here.
const AS_OF: &str = "write a join by time as a ASOF JOIN b MATCH_CONDITION (a.time >= b.time) ON a.key = b.key: it keeps each row of a, as ASOF LEFT JOIN does elsewhere";

/// Whether the parser met a join by time as other databases write it: `ASOF LEFT JOIN`, or the times behind `ON`.
fn is_other_as_of(message: &str) -> bool {
    let found = |expected: &str| {
        let (_, found) = message.split_once(expected)?;
        Some(found.trim().to_lowercase())
    };
    let left = found("Expected: JOIN, found: ").is_some_and(|found| found == "left");
    left || found("Expected: MATCH_CONDITION, found: ").is_some()
}

/// Line and column of a query's text where an error is, from 1, if DataFusion says so.
pub fn place_in_query(error: &DataFusionError) -> Option<(usize, usize)> {
    let number = |text: &str| text.trim().parse().ok();
    if let DataFusionError::SQL(error, _) = error.find_root()
        && let Some((_, at)) = parser_text(error).rsplit_once(PARSER_AT)
        && let Some((line, column)) = at.split_once(", Column: ")
    {
        return number(line).zip(number(column));
    }
    let start = error.diagnostic()?.span?.start;
    (start.line > 0).then_some((start.line as usize, start.column as usize))
}

/// How the parser begins to say where it is.
const PARSER_AT: &str = " at Line: ";

/// What the parser of SQL says.
fn parser_text(error: &ParserError) -> &str {
    match error {
        ParserError::TokenizerError(text) | ParserError::ParserError(text) => text,
        ParserError::RecursionLimitExceeded => TOO_DEEP,
    }
}

/// That the parser goes no deeper: by 50 levels, of which two are taken by what follows an `IS DISTINCT FROM`.
const TOO_DEEP: &str = "the query is nested too deep";

/// What may be written instead.
const NESTED: &str = "put each IS DISTINCT FROM into parentheses, (a IS DISTINCT FROM b) OR …, and name queries within others: WITH a AS (SELECT …)";

/// How it is said here that a text is no instant.
const NO_INSTANT: &str = "expected a time, found '";

/// What a text is that does not become what it is compared with, or cast to.
fn not_cast(message: &str) -> Option<String> {
    if let Some((_, behind)) = message.split_once("Error parsing timestamp from '") {
        let (text, _) = behind.rsplit_once("': ")?;
        return Some(format!("{NO_INSTANT}{text}'"));
    }
    let (_, behind) = message
        .split_once("Cannot cast string '")
        .or_else(|| message.split_once("Cannot cast value '"))?;
    let (text, wanted) = behind.rsplit_once("' to value of ")?;
    let wanted: DataType = wanted.strip_suffix(" type")?.parse().ok()?;
    let wanted = match wanted.is_numeric() {
        true => "a number".to_owned(),
        false => type_name(&wanted),
    };
    Some(format!("expected {wanted}, found '{text}'"))
}

/// What DataFusion says, without what it says of its own ways.
fn plainly(message: &str) -> String {
    if let Some(types) = types(message) {
        return types;
    }
    let behind = |text: &'static str| message.split_once(text).map(|(_, behind)| behind);
    let own = behind("user-defined coercion failed with: ").unwrap_or(message);
    let prefixes = [
        "Error during planning: ",
        "Execution error: ",
        "Internal error: ",
    ];
    let own = prefixes.iter().fold(own, |text, prefix| {
        text.strip_prefix(prefix).unwrap_or(text)
    });
    let ends = [" No function matches the given name", ", errors: "];
    let ends = ends.iter().filter_map(|end| own.find(end));
    own[..ends.min().unwrap_or(own.len())].to_owned()
}

/// Whose fault it is when computing with values fails: a query says what is computed.
fn kind_of(error: &ArrowError) -> Kind {
    match error {
        ArrowError::DivideByZero
        | ArrowError::ArithmeticOverflow(_)
        | ArrowError::ComputeError(_)
        | ArrowError::CastError(_)
        | ArrowError::ParseError(_) => Kind::User,
        _ => Kind::Data,
    }
}

/// What DataFusion gives, with a fault in place of its error.
pub trait OrFault<T> {
    /// The value, or [`fault_of`] the error.
    ///
    /// # Errors
    /// As said.
    fn or_fault(self) -> Result<T, Fault>;
}

impl<T> OrFault<T> for Result<T, DataFusionError> {
    fn or_fault(self) -> Result<T, Fault> {
        self.map_err(|error| fault_of(&error))
    }
}

/// A fault inside DataFusion; [`fault_of`] takes it out again.
pub fn external(fault: Fault) -> DataFusionError {
    DataFusionError::External(Box::new(fault))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_query_does_wrong_is_said_plainly() {
        let plan = |text: &str| DataFusionError::Plan(text.to_owned());
        let cases = [
            (
                DataFusionError::Execution(
                    "Function 'yaw' user-defined coercion failed with: Error during planning: yaw expects a pose, found text. No function matches the given name and argument types 'yaw(Utf8)'.".to_owned(),
                ),
                "user: yaw expects a pose, found text.",
            ),
            (
                DataFusionError::Internal(
                    "Function 'sum' failed to match any signature, errors: Error during planning: x".to_owned(),
                ),
                "user: Function 'sum' failed to match any signature",
            ),
            (
                plan("Internal error: Function 'sum' failed to match any signature, errors: Error during planning: x.\nThis issue was likely caused by a bug. No function matches the given name and argument types 'sum(Utf8)'. You might need to add explicit type casts.\n\tCandidate functions:\n\tsum(Decimal)\n\tsum(Float64)"),
                "user: sum expects (decimal) or (f64), found (text)",
            ),
            (
                plan("Cannot infer common argument type for comparison operation Timestamp(ns, \"UTC\") > Int64"),
                "user: expected two values that go together, found time > i64; write an instant as a text: stamp > '2024-05-01T10:00:00Z'",
            ),
            (
                plan("Cannot infer common argument type for comparison operation Utf8 IS DISTINCT FROM List(Int64)"),
                "user: expected two values that go together, found text IS DISTINCT FROM list of i64",
            ),
            (
                plan("Cannot coerce arithmetic expression Struct(\"x\": non-null Float64, \"y\": Utf8) + Int64 to valid types"),
                "user: expected two values that go together, found struct of x, y + i64; take a member of the struct: column['x']",
            ),
            (
                DataFusionError::ArrowError(
                    Box::new(ArrowError::CastError(
                        "Cannot cast string 'x' to value of Float64 type".to_owned(),
                    )),
                    None,
                ),
                "user: expected a number, found 'x'",
            ),
            (
                DataFusionError::ArrowError(
                    Box::new(ArrowError::ParseError(
                        "Error parsing timestamp from 'yesterday': error parsing date".to_owned(),
                    )),
                    None,
                ),
                "user: expected a time, found 'yesterday'; write an instant as a text: stamp > '2024-05-01T10:00:00Z'",
            ),
            (
                DataFusionError::ArrowError(
                    Box::new(ArrowError::ComputeError("Timestamp out of range".to_owned())),
                    None,
                ),
                "user: Timestamp out of range",
            ),
            (
                DataFusionError::ArrowError(
                    Box::new(ArrowError::ComputeError(
                        "Execution error: cannot take square root of a negative number".to_owned(),
                    )),
                    None,
                ),
                "user: cannot take square root of a negative number",
            ),
            (DataFusionError::Internal("lost".to_owned()), "bug: lost"),
            (DataFusionError::NotImplemented("a thing".to_owned()), "user: not supported: a thing"),
            (plan("first\nsecond"), "user: first"),
        ];
        for (error, expected) in cases {
            assert_eq!(fault_of(&error).to_string(), expected);
        }
        let parsed = |said: &str| {
            let said = format!("{said} at Line: 1, Column: 20");
            fault_of(&DataFusionError::SQL(
                Box::new(ParserError::ParserError(said)),
                None,
            ))
        };
        for said in [
            "Expected: JOIN, found: LEFT",
            "Expected: JOIN, found: left",
            "Expected: MATCH_CONDITION, found: ON",
        ] {
            let fault = parsed(said);
            assert_eq!(fault.message, format!("SQL: {said}"));
            assert_eq!(fault.next, AS_OF, "{said}");
        }
        assert_eq!(parsed("Expected: JOIN, found: INNER").next, "");
        for (said, expected, next) in [
            (
                "Physical plan does not support logical expression OuterReferenceColumn(Field { name: \"l\", data_type: List(Field { data_type: Int64 }) }, Column { name: \"l\" })",
                "user: expected a subquery without columns",
                "FROM (SELECT landmark, unnest(sightings) AS s FROM landmarks)",
            ),
            (
                "Physical plan does not support logical expression WindowFunction(WindowFunction { fun: … })",
                "user: expected no window function in GROUP BY",
                "in a query within",
            ),
            (
                "Unsupported ast node Pivot { table: Derived { lateral: false } } in create_relation",
                "user: not supported: PIVOT",
                "FILTER",
            ),
        ] {
            let fault = fault_of(&DataFusionError::NotImplemented(said.to_owned())).to_string();
            assert!(
                fault.starts_with(expected) && fault.contains(next),
                "{fault}"
            );
            assert!(
                !fault.contains("Field {") && !fault.contains("fun:"),
                "{fault}"
            );
        }
        let same = fault_of(&plan(
            "Projections require unique expression names but the expression \"t.x\" at position 0 and \"CAST(t.x AS Int32)\" at position 1 have the same name.",
        ));
        assert_eq!(
            same.to_string(),
            "user: expected columns of different names, found two called t.x; name one of them with AS"
        );
        let nested = DataFusionError::NotImplemented(
            "Physical plan does not support logical expression OuterReferenceColumn(…)".to_owned(),
        );
        let fault = fault_of(&nested);
        assert!(
            fault.kind == Kind::User && fault.next.contains("ASOF JOIN"),
            "{fault}"
        );
    }
}
