//! Parameters as plans give them, held to what their type declares: names, types and ranges.
//!
//! A parameter has one home, its field: `#[schemars(range(min = 0.0, max = 1.0))]` says the range, `#[schemars(extend(
//! "exclusiveMinimum" = 0))]` an open end, the doc comment what it means, `Default` its default. Here, on the pages, and
//! in what editors complete from, all of that is read from the JSON Schema that schemars derives.

use evermap_schemas::Fault;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// What is wrong with one parameter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParamFault {
    /// Its name, as the plan writes it; empty where parameters do not make sense together.
    pub param: String,
    /// The entry of its value that is at fault; empty where that is all of it.
    pub entry: String,
    /// What was expected and what was found, in one sentence.
    pub message: String,
}

impl ParamFault {
    /// Of parameters that do not make sense together.
    pub(crate) fn together(message: String) -> Self {
        Self {
            param: String::new(),
            entry: String::new(),
            message,
        }
    }

    /// What an operator's own check finds: of the parameter that is its place, or of several where it has none. What stands
    /// behind a point is an entry of the parameter; no parameter has a point in its name.
    pub(crate) fn checked(fault: Fault) -> Self {
        let (param, entry) = fault
            .place
            .split_once('.')
            .unwrap_or((fault.place.as_str(), ""));
        Self {
            param: param.to_owned(),
            entry: entry.to_owned(),
            message: fault.message,
        }
    }
}

/// One parameter, as its operator declares it.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name.
    pub name: String,
    /// What values are, for people: `number`, `integer or null`, `list of string`.
    pub kind: String,
    /// The range of a number, for people: `from 0 to 1`; empty where any will do.
    pub range: String,
    /// What it is where a plan does not say.
    pub default: Value,
    /// What it means.
    pub doc: String,
}

/// The parameters that a schema with these defaults declares, in the order of the struct.
pub(crate) fn declared(schema: &Value, defaults: &Value) -> Vec<Parameter> {
    let parameter = |(name, default): (&String, &Value)| {
        let property = resolved(schema, &schema["properties"][name]);
        Parameter {
            name: name.clone(),
            kind: kind(schema, &property),
            range: range(&property),
            default: default.clone(),
            doc: described(&schema["properties"][name], &property),
        }
    };
    let defaults = defaults.as_object().into_iter().flatten();
    defaults.map(parameter).collect()
}

/// The typed parameters; what is not given has its default.
///
/// # Errors
/// Every fault of every parameter.
pub(crate) fn typed<P>(schema: &Value, given: &Value) -> Result<P, Vec<ParamFault>>
where
    P: Default + Serialize + DeserializeOwned,
{
    let defaults = serde_json::to_value(P::default()).unwrap_or_default();
    let empty = Map::new();
    let (defaults, given) = (
        defaults.as_object().unwrap_or(&empty),
        given.as_object().unwrap_or(&empty),
    );
    let fault = |(name, value): (&String, &Value)| {
        let message = match defaults.contains_key(name) {
            true => misfit::<P>(schema, defaults, name, value)?,
            false => format!("no parameter `{name}`"),
        };
        let entry = misfit_entry::<P>(defaults, name, value);
        Some(ParamFault {
            param: name.clone(),
            entry: entry.unwrap_or_default(),
            message,
        })
    };
    let faults: Vec<_> = given.iter().filter_map(fault).collect();
    if !faults.is_empty() {
        return Err(faults);
    }
    let all: Vec<_> = given.iter().collect();
    with(defaults, &all).map_err(|error| vec![ParamFault::together(error.to_string())])
}

/// All faults as one.
pub(crate) fn fault(operator: &str, faults: Vec<ParamFault>) -> Fault {
    let messages: Vec<_> = faults.into_iter().map(|fault| fault.message).collect();
    Fault::user(messages.join("; "))
        .at(format!("operator {operator}"))
        .next(format!("see `evermap operators {operator}`"))
}

/// What keeps a value from being the parameter: its range, or its type.
fn misfit<P: DeserializeOwned>(
    schema: &Value,
    defaults: &Map<String, Value>,
    name: &str,
    value: &Value,
) -> Option<String> {
    let property = resolved(schema, &schema["properties"][name]);
    let expected = if value
        .as_f64()
        .is_some_and(|value| outside(&property, value))
    {
        range(&property)
    } else if let Err(error) = with::<P>(defaults, &[(&name.to_owned(), value)]) {
        match kind(schema, &property) {
            kind if value.is_object() || value.is_array() => {
                format!("to be of type {kind} ({error})")
            }
            kind => format!("to be of type {kind}"),
        }
    } else {
        return None;
    };
    Some(format!("expected `{name}` {expected}, found {value}"))
}

/// The entry of a value that keeps it from being the parameter, where it would be one without entries.
fn misfit_entry<P: DeserializeOwned>(
    defaults: &Map<String, Value>,
    name: &str,
    value: &Value,
) -> Option<String> {
    let name = name.to_owned();
    let fits = |entries: Map<String, Value>| {
        let value = Value::Object(entries);
        with::<P>(defaults, &[(&name, &value)]).is_ok()
    };
    let mut entries = value.as_object().filter(|_| fits(Map::new()))?.iter();
    let alone = |key: &str, value: &Value| Map::from_iter([(key.to_owned(), value.clone())]);
    let misfit = entries.find(|(key, value)| !fits(alone(key, value)));
    misfit.map(|(key, _)| key.clone())
}

fn with<P: DeserializeOwned>(
    defaults: &Map<String, Value>,
    given: &[(&String, &Value)],
) -> Result<P, serde_json::Error> {
    let mut all = defaults.clone();
    for (name, value) in given {
        all.insert((*name).clone(), (*value).clone());
    }
    serde_json::from_value(Value::Object(all))
}

/// A property behind its reference, if it is one.
fn resolved(schema: &Value, property: &Value) -> Value {
    let reference = property["$ref"]
        .as_str()
        .or_else(|| property["allOf"][0]["$ref"].as_str());
    let behind = reference
        .and_then(|reference| schema.pointer(reference.trim_start_matches('#')))
        .cloned();
    behind.unwrap_or_else(|| property.clone())
}

fn described(property: &Value, resolved: &Value) -> String {
    let doc = property["description"].as_str();
    let doc = doc.or_else(|| resolved["description"].as_str());
    doc.unwrap_or_default()
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

fn kind(schema: &Value, property: &Value) -> String {
    let words = |kind: &str| match kind {
        "array" => match kind_of_items(schema, property) {
            Some(items) => format!("list of {items}"),
            None => "list".to_owned(),
        },
        kind => kind.to_owned(),
    };
    match &property["type"] {
        Value::String(kind) if property["enum"].is_array() => {
            let values = property["enum"].as_array().into_iter().flatten();
            let values: Vec<_> = values.map(ToString::to_string).collect();
            format!("{kind}: {}", values.join(", "))
        }
        Value::String(kind) => words(kind),
        Value::Array(kinds) => {
            let kinds: Vec<_> = kinds.iter().filter_map(Value::as_str).map(words).collect();
            kinds.join(" or ")
        }
        _ => alternatives(schema, property),
    }
}

fn kind_of_items(schema: &Value, property: &Value) -> Option<String> {
    let items = property.get("items")?;
    Some(kind(schema, &resolved(schema, items)))
}

/// The kinds of an enumeration's variants, or of an optional struct.
fn alternatives(schema: &Value, property: &Value) -> String {
    let of = |key: &str| property[key].as_array().cloned().unwrap_or_default();
    let mut kinds = Vec::new();
    for each in of("oneOf").iter().chain(&of("anyOf")) {
        let kind = match each.get("const") {
            Some(value) => value.to_string(),
            None => kind(schema, &resolved(schema, each)),
        };
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    match kinds.is_empty() {
        true => "object".to_owned(),
        false => kinds.join(" or "),
    }
}

fn bounds(property: &Value) -> [Option<f64>; 4] {
    ["minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"]
        .map(|bound| property[bound].as_f64())
}

fn outside(property: &Value, value: f64) -> bool {
    let [least, most, above, below] = bounds(property);
    least.is_some_and(|least| value < least)
        || most.is_some_and(|most| value > most)
        || above.is_some_and(|above| value <= above)
        || below.is_some_and(|below| value >= below)
}

fn range(property: &Value) -> String {
    let [least, most, above, below] = bounds(property);
    // What an integer's width allows is no range worth telling, unless it is broken.
    match (least, above, most, below) {
        (Some(least), _, Some(most), _) => format!("from {least} to {most}"),
        (Some(least), _, None, None) => format!("of at least {least}"),
        (Some(least), _, None, Some(below)) => format!("from {least} to below {below}"),
        (None, Some(above), Some(most), _) => format!("above {above} and at most {most}"),
        (None, Some(above), None, Some(below)) => format!("above {above} and below {below}"),
        (None, Some(above), None, None) => format!("above {above}"),
        (None, None, Some(most), _) => format!("of at most {most}"),
        (None, None, None, Some(below)) => format!("below {below}"),
        (None, None, None, None) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::collections::BTreeMap;

    use super::*;
    use schemars::JsonSchema;
    use serde::Deserialize;
    use serde_json::json;

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
    #[serde(default)]
    struct Inner {
        /// A share.
        #[schemars(range(min = 0.0, max = 1.0))]
        share: f64,
    }
    impl Default for Inner {
        fn default() -> Self {
            Self { share: 0.5 }
        }
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
    #[serde(default)]
    struct Outer {
        #[serde(flatten)]
        inner: Inner,
        /// A length
        /// (m).
        #[schemars(extend("exclusiveMinimum" = 0))]
        length_m: f64,
        /// How many.
        #[schemars(range(min = 1, max = 9))]
        count: u32,
        /// Names.
        names: Vec<String>,
        /// Places.
        places: BTreeMap<String, [f64; 2]>,
    }
    impl Default for Outer {
        fn default() -> Self {
            Self {
                inner: Inner::default(),
                length_m: 2.0,
                count: 3,
                names: vec![],
                places: BTreeMap::new(),
            }
        }
    }

    fn faults(given: &Value) -> Vec<String> {
        let schema = schemars::schema_for!(Outer).to_value();
        match typed::<Outer>(&schema, given) {
            Ok(_) => Vec::new(),
            Err(faults) => faults.into_iter().map(|fault| fault.message).collect(),
        }
    }

    #[test]
    fn every_parameter_is_held_to_its_declaration() {
        assert_eq!(
            faults(&json!({
                "share": 1.5, "length_m": 0, "count": 0, "names": 1, "nonsense": 1
            })),
            [
                "expected `share` from 0 to 1, found 1.5",
                "expected `length_m` above 0, found 0",
                "expected `count` from 1 to 9, found 0",
                "expected `names` to be of type list of string, found 1",
                "no parameter `nonsense`",
            ]
        );
        assert_eq!(
            faults(&json!({ "count": 1.5 })),
            ["expected `count` to be of type integer, found 1.5"]
        );
        assert!(faults(&json!({ "share": 1, "count": 9, "names": ["a"] })).is_empty());
    }

    #[test]
    fn an_entry_that_does_not_fit_is_named() {
        let schema = schemars::schema_for!(Outer).to_value();
        let entries = |places: Value| {
            let found = typed::<Outer>(&schema, &json!({ "places": places }));
            let found = found.unwrap_err().into_iter();
            found.map(|fault| fault.entry).collect::<Vec<_>>()
        };
        assert_eq!(entries(json!({ "a": [1, 2], "b.c": [1], "d": 3 })), ["b.c"]);
        assert_eq!(entries(json!([1])), [""]);
        let fault = Fault::user("no place").at("places.b.c");
        let fault = ParamFault::checked(fault);
        assert_eq!((&*fault.param, &*fault.entry), ("places", "b.c"));
        let fault = ParamFault::checked(Fault::user("no place").at("places"));
        assert_eq!((&*fault.param, &*fault.entry), ("places", ""));
    }

    #[test]
    fn a_declaration_tells_range_default_and_meaning() {
        let schema = schemars::schema_for!(Outer).to_value();
        let declared = declared(&schema, &serde_json::to_value(Outer::default()).unwrap());
        let told: Vec<_> = declared
            .iter()
            .map(|p| format!("{} {} {} {} {}", p.name, p.kind, p.range, p.default, p.doc))
            .collect();
        assert_eq!(
            told,
            [
                "share number from 0 to 1 0.5 A share.",
                "length_m number above 0 2.0 A length (m).",
                "count integer from 1 to 9 3 How many.",
                "names list of string  [] Names.",
                "places object  {} Places.",
            ]
        );
    }
}
