//! Objects: known, unknown and missing keys.

use serde_json::{Map, Value};

use super::Checker;
use crate::fault::Faults;
use crate::suggest::{listed, quoted};
use crate::yaml::{Entry, Node};

/// How an object is spoken of.
pub(super) struct Object<'o> {
    /// What its keys are called.
    pub noun: &'o str,
    /// What has the keys.
    pub owner: &'o str,
    /// Keys that need not be written although the schema requires them.
    pub has_default: &'o dyn Fn(&str) -> bool,
}

impl Object<'_> {
    /// " of step x" after a key; nothing after a parameter, which needs no owner.
    fn of(&self) -> String {
        match self.noun {
            "parameter" => String::new(),
            _ => format!(" of {}", self.owner),
        }
    }
}

/// Whether the schema says anything about keys.
pub(super) fn describes_object(schema: &Value) -> bool {
    ["properties", "additionalProperties", "required"]
        .iter()
        .any(|key| schema.get(key).is_some())
}

impl<'s> Checker<'s> {
    pub(super) fn object(
        self,
        node: &Node,
        schema: &'s Value,
        object: &Object<'_>,
        faults: &mut Faults,
    ) {
        let Some(entries) = node.mapping(object.owner, faults) else {
            return;
        };
        let mut known = Vec::new();
        self.known_keys(schema, 0, &mut known);
        let has =
            |key: &str| entries.iter().any(|entry| entry.key == key) || (object.has_default)(key);
        for key in required(schema).filter(|key| !has(key)) {
            let of = object.of();
            let message = format!("{} {}{of} is missing", object.noun, quoted(key));
            faults.error(node.place, message);
        }
        let properties = schema.get("properties").and_then(Value::as_object);
        let others = schema
            .get("additionalProperties")
            .filter(|others| *others != &Value::Bool(false));
        for entry in entries {
            let of = object.of();
            let what = format!("{} {}{of}", object.noun, quoted(&entry.key));
            let property = properties.and_then(|properties| properties.get(&entry.key));
            if let Some(schema) = property.or(others) {
                self.value(&entry.value, schema, &what, faults);
            } else if !known.contains(&entry.key.as_str()) {
                unknown_key(entry, &known, object, faults);
            }
        }
        self.alternatives(node, schema, object.owner, faults);
    }

    /// The keys that the schema or any alternative in it knows.
    pub(super) fn known_keys(self, schema: &'s Value, depth: usize, known: &mut Vec<&'s str>) {
        let schema = self.followed(schema);
        if depth > 8 {
            return;
        }
        let properties = schema.get("properties").and_then(Value::as_object);
        known.extend(
            properties
                .into_iter()
                .flat_map(Map::keys)
                .map(String::as_str),
        );
        for keyword in ["allOf", "oneOf", "anyOf"] {
            let branches = schema.get(keyword).and_then(Value::as_array);
            for branch in branches.into_iter().flatten() {
                self.known_keys(branch, depth + 1, known);
            }
        }
    }
}

/// The keys an object must have.
pub(super) fn required(schema: &Value) -> impl Iterator<Item = &str> {
    let keys = schema.get("required").and_then(Value::as_array);
    keys.into_iter().flatten().filter_map(Value::as_str)
}

fn unknown_key(entry: &Entry, known: &[&str], object: &Object<'_>, faults: &mut Faults) {
    let key = quoted(&entry.key);
    let message = match (object.noun, known) {
        ("parameter", []) => format!("unknown parameter {key}; there are none"),
        ("parameter", _) => {
            let known = listed(known.iter().copied());
            format!("unknown parameter {key}; there are {known}")
        }
        (_, _) => {
            let known = listed(known.iter().copied());
            format!(
                "unknown key {key} in {}; its keys are {known}",
                object.owner
            )
        }
    };
    faults.unknown(entry.place, message, &entry.key, known.iter().copied());
}
