//! Checking a positioned value against a JSON Schema.
//!
//! This is the subset that schemars derives for parameters and manifests: types, ranges,
//! lengths, enumerations, tagged unions, nested objects, lists, tuples, maps, `$ref`. Unlike
//! JSON Schema, an object that lists its properties has no others unless it says so, and an
//! integer must be written as one. `pattern`, `format` of texts and `not` are not checked here.

mod alternatives;
mod object;

use serde_json::Value;

use crate::fault::Faults;
use crate::suggest::{listed, quoted};
use crate::yaml::{Kind, Node};

/// References may follow each other this often without going into the value.
const LONGEST_REFERENCE_CHAIN: usize = 32;

/// Records every way in which `node` is not what `schema` asks for. `what` names the value
/// in messages: "parameter `cell_m`". References are looked up in `schema` itself.
pub fn check(node: &Node, schema: &Value, what: &str, faults: &mut Faults) {
    let checker = Checker { root: schema };
    checker.value(node, schema, what, faults);
}

/// Checks the keys of a mapping of parameters, where `given` says which need not be written.
pub(crate) fn check_parameters(
    node: &Node,
    schema: &Value,
    has_default: &dyn Fn(&str) -> bool,
    faults: &mut Faults,
) {
    let checker = Checker { root: schema };
    let object = object::Object {
        noun: "parameter",
        owner: "the parameters",
        has_default,
    };
    let schema = checker.followed(schema);
    checker.object(node, schema, &object, faults);
}

#[derive(Clone, Copy)]
struct Checker<'s> {
    root: &'s Value,
}

impl<'s> Checker<'s> {
    /// The schema a chain of references leads to, ignoring keywords beside `$ref`.
    fn followed(self, mut schema: &'s Value) -> &'s Value {
        for _ in 0..LONGEST_REFERENCE_CHAIN {
            match self.target(schema) {
                Some(target) => schema = target,
                None => return schema,
            }
        }
        &Value::Bool(true)
    }

    fn target(self, schema: &Value) -> Option<&'s Value> {
        let reference = schema.get("$ref")?.as_str()?;
        self.root.pointer(reference.strip_prefix('#')?)
    }

    fn value(self, node: &Node, schema: &'s Value, what: &str, faults: &mut Faults) {
        let schema = self.followed(schema);
        if schema == &Value::Bool(false) {
            faults.error(node.place, format!("{what} must not be given"));
            return;
        }
        if let Some(choices) = self.choices(schema) {
            choice(node, &choices, what, faults);
            return;
        }
        if !of_type(node, schema, what, faults) {
            return;
        }
        match &node.kind {
            Kind::Integer(value) => number(node, *value as f64, schema, what, faults),
            Kind::Float(value) => number(node, *value, schema, what, faults),
            Kind::Text(text) => {
                let length = text.chars().count();
                size(
                    node,
                    length,
                    schema,
                    ["minLength", "maxLength"],
                    what,
                    "characters",
                    faults,
                );
            }
            Kind::Sequence(items) => self.items(node, items, schema, what, faults),
            Kind::Mapping(_) if object::describes_object(schema) => {
                let object = object::Object {
                    noun: "key",
                    owner: what,
                    has_default: &|_| false,
                };
                self.object(node, schema, &object, faults);
                return; // Alternatives within an object are part of the object.
            }
            Kind::Mapping(_) | Kind::Null | Kind::Bool(_) => {}
        }
        self.alternatives(node, schema, what, faults);
    }

    fn items(
        self,
        node: &Node,
        items: &[Node],
        schema: &'s Value,
        what: &str,
        faults: &mut Faults,
    ) {
        size(
            node,
            items.len(),
            schema,
            ["minItems", "maxItems"],
            what,
            "items",
            faults,
        );
        let prefix = schema.get("prefixItems").and_then(Value::as_array);
        let prefix = prefix.map_or(&[][..], Vec::as_slice);
        let rest = schema.get("items");
        for (index, item) in items.iter().enumerate() {
            if let Some(schema) = prefix.get(index).or(rest) {
                self.value(
                    item,
                    schema,
                    &format!("item {} of {what}", index + 1),
                    faults,
                );
            }
        }
        if schema.get("uniqueItems") == Some(&Value::Bool(true)) {
            for (index, item) in items.iter().enumerate().take(1000) {
                if items
                    .iter()
                    .take(index)
                    .any(|earlier| earlier.kind == item.kind)
                {
                    faults.error(item.place, format!("{what} has this item twice"));
                }
            }
        }
    }
}

/// The value is one of a fixed list.
fn choice(node: &Node, choices: &[&Value], what: &str, faults: &mut Faults) {
    if choices.iter().any(|choice| equals(node, choice)) {
        return;
    }
    let names: Vec<String> = choices.iter().map(|choice| shown(choice)).collect();
    let known = names.iter().map(String::as_str);
    let message = format!(
        "{what} must be one of {}, found {}",
        listed(known.clone()),
        node.described()
    );
    match &node.kind {
        Kind::Text(text) => faults.unknown(node.place, message, text, known),
        _ => faults.error(node.place, message),
    }
}

fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn equals(node: &Node, value: &Value) -> bool {
    match (&node.kind, value) {
        (Kind::Null, Value::Null) => true,
        (Kind::Bool(found), Value::Bool(value)) => found == value,
        (Kind::Text(found), Value::String(value)) => found == value,
        (Kind::Integer(found), Value::Number(value)) => value.as_i128() == Some(*found),
        (Kind::Float(found), Value::Number(value)) => value.as_f64() == Some(*found),
        _ => false,
    }
}

/// Whether the value is of the schema's `type`; if not, says so.
fn of_type(node: &Node, schema: &Value, what: &str, faults: &mut Faults) -> bool {
    let types: Vec<&str> = match schema.get("type") {
        Some(Value::String(one)) => vec![one],
        Some(Value::Array(several)) => several.iter().filter_map(Value::as_str).collect(),
        _ => return true,
    };
    if types.iter().any(|name| is_of_type(&node.kind, name)) {
        return true;
    }
    let expected: Vec<&str> = types.iter().map(|name| type_noun(name)).collect();
    let message = format!(
        "{what} must be {}, found {}",
        expected.join(" or "),
        node.described()
    );
    match &node.kind {
        Kind::Float(value) if value.fract() == 0.0 && value.abs() < 1e15 => {
            faults.error_with(
                node.place,
                message,
                format!("write {}", quoted(&format!("{value:.0}"))),
            );
        }
        Kind::Bool(_) | Kind::Integer(_) | Kind::Float(_) if types.contains(&"string") => {
            faults.error_with(node.place, message, "quote it");
        }
        Kind::Text(text) if types.contains(&"boolean") => {
            match text.to_ascii_lowercase().as_str() {
                "yes" | "on" => faults.error_with(node.place, message, "write `true`"),
                "no" | "off" => faults.error_with(node.place, message, "write `false`"),
                _ => faults.error(node.place, message),
            }
        }
        _ => faults.error(node.place, message),
    }
    false
}

fn is_of_type(kind: &Kind, name: &str) -> bool {
    match kind {
        Kind::Null => name == "null",
        Kind::Bool(_) => name == "boolean",
        Kind::Integer(_) => name == "integer" || name == "number",
        Kind::Float(_) => name == "number",
        Kind::Text(_) => name == "string",
        Kind::Sequence(_) => name == "array",
        Kind::Mapping(_) => name == "object",
    }
}

fn type_noun(name: &str) -> &str {
    match name {
        "null" => "null",
        "boolean" => "true or false",
        "integer" => "an integer",
        "number" => "a number",
        "string" => "text",
        "array" => "a list",
        "object" => "a mapping",
        other => other,
    }
}

/// Ranges, written and implied by the width of an integer.
fn number(node: &Node, value: f64, schema: &Value, what: &str, faults: &mut Faults) {
    let bound = |key: &str| schema.get(key).and_then(Value::as_f64);
    let mut wrong = |holds: bool, relation: &str, bound: &str| {
        if !holds {
            let found = node.described();
            faults.error(
                node.place,
                format!("{what} must be {relation} {bound}, found {found}"),
            );
        }
    };
    if !value.is_finite() {
        wrong(false, "a finite", "number");
        return;
    }
    let plain = |bound: f64| {
        Value::from(bound)
            .to_string()
            .trim_end_matches(".0")
            .to_owned()
    };
    let (width_least, width_most) = width(schema);
    if let Some(least) = bound("minimum").or(width_least) {
        wrong(value >= least, "at least", &plain(least));
    }
    if let Some(most) = bound("maximum").or(width_most) {
        wrong(value <= most, "at most", &plain(most));
    }
    if let Some(least) = bound("exclusiveMinimum") {
        wrong(value > least, "above", &plain(least));
    }
    if let Some(most) = bound("exclusiveMaximum") {
        wrong(value < most, "below", &plain(most));
    }
    if let Some(step) = bound("multipleOf").filter(|step| *step > 0.0) {
        let ratio = value / step;
        wrong(
            (ratio - ratio.round()).abs() < 1e-9,
            "a multiple of",
            &plain(step),
        );
    }
}

/// What an integer `format` implies; schemars writes no bounds for most of them.
fn width(schema: &Value) -> (Option<f64>, Option<f64>) {
    match schema.get("format").and_then(Value::as_str) {
        Some("int32") => (Some(i32::MIN.into()), Some(i32::MAX.into())),
        Some("uint32") => (Some(0.0), Some(u32::MAX.into())),
        Some("int64" | "int") => (None, Some(9_223_372_036_854_774_784.0)),
        _ => (None, None),
    }
}

/// Lengths of texts and lists.
fn size(
    node: &Node,
    found: usize,
    schema: &Value,
    [least, most]: [&str; 2],
    what: &str,
    unit: &str,
    faults: &mut Faults,
) {
    let bound = |key: &str| schema.get(key).and_then(Value::as_u64);
    let found = found as u64;
    let (least, most) = (bound(least), bound(most));
    let expected = match (least, most) {
        (Some(least), Some(most)) if least == most && found != least => format!("exactly {least}"),
        (Some(least), _) if found < least => format!("at least {least}"),
        (_, Some(most)) if found > most => format!("at most {most}"),
        _ => return,
    };
    faults.error(
        node.place,
        format!("{what} must have {expected} {unit}, found {found}"),
    );
}
