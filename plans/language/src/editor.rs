//! The JSON Schema of plans, for editors to complete and check from.

use serde_json::{Map, Value, json};

use crate::vocabulary::{OperatorSpec, Vocabulary};
use crate::written::MOST_STEPS;

const NAME: &str = "^[a-z][a-z0-9_]{0,63}$";

/// The JSON Schema (draft 2020-12) of plans written with `vocabulary`.
///
/// Steps are told apart by `op`: for each operator its ports and parameters are completed
/// and anything else is rejected. What a schema cannot say (names that exist, no cycles) is
/// left to [`crate::parse`].
#[must_use]
pub fn json_schema(vocabulary: &Vocabulary) -> Value {
    let mut definitions = Map::new();
    for operator in &vocabulary.operators {
        add_parameters(operator, &mut definitions);
    }
    definitions.insert("step".to_owned(), step(vocabulary));
    definitions.insert("input".to_owned(), input(vocabulary));
    definitions.insert("test".to_owned(), test());
    definitions.insert("rows".to_owned(), rows());
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "evermap plan",
        "type": "object",
        "required": ["plan", "steps", "write"],
        "additionalProperties": false,
        "properties": {
            "plan": {"type": "string", "pattern": NAME, "description": "Name of the plan."},
            "doc": {"type": "string", "description": "What the plan is for."},
            "sessions": {"type": "string", "description": "Path of a session manifest."},
            "steps": {
                "type": "object",
                "description": "Steps by name; each makes the layer of its name.",
                "minProperties": 1,
                "maxProperties": MOST_STEPS,
                "propertyNames": {"pattern": NAME, "not": {"enum": vocabulary.sources}},
                "additionalProperties": {"$ref": "#/$defs/step"},
            },
            "write": {
                "type": "array",
                "description": "The steps whose layers are published.",
                "items": {"type": "string"},
                "minItems": 1,
                "uniqueItems": true,
            },
            "tests": {"type": "array", "items": {"$ref": "#/$defs/test"}},
        },
        "$defs": definitions,
    })
}

fn step(vocabulary: &Vocabulary) -> Value {
    let operators: Vec<Value> = vocabulary.operators.iter().map(operator_choice).collect();
    let op = match operators.as_slice() {
        [] => json!({"type": "string"}),
        _ => json!({"description": "The operator.", "oneOf": operators}),
    };
    let cases: Vec<Value> = vocabulary.operators.iter().map(operator_case).collect();
    let query = json!({
        "if": {"required": ["sql"]},
        "then": {"not": {"anyOf": [{"required": ["in"]}, {"required": ["with"]}]}},
    });
    let conditions: Vec<Value> = cases.into_iter().chain([query]).collect();
    json!({
        "type": "object",
        "additionalProperties": false,
        "oneOf": [{"required": ["op"]}, {"required": ["sql"]}],
        "properties": {
            "op": op,
            "in": {"type": ["object", "null"], "description": "Port to layer."},
            "with": {"type": ["object", "null"], "description": "Parameters of the operator."},
            "sql": {"type": "string", "minLength": 1, "description": "The query."},
        },
        "allOf": conditions,
    })
}

fn operator_choice(operator: &OperatorSpec) -> Value {
    let mut choice = json!({"const": operator.name});
    if let Some(description) = operator.params.get("description") {
        choice["description"] = description.clone();
    }
    choice
}

/// What holds for steps of one operator.
fn operator_case(operator: &OperatorSpec) -> Value {
    let ports: Map<String, Value> = operator
        .ports
        .iter()
        .map(|port| (port.name.clone(), json!({"$ref": "#/$defs/input"})))
        .collect();
    let ports_needed: Vec<&str> = operator
        .ports
        .iter()
        .filter(|port| !port.optional)
        .map(|port| port.name.as_str())
        .collect();
    let parameters_needed = !needed_parameters(operator).is_empty();
    let needed: Vec<&str> = [
        ("in", !ports_needed.is_empty()),
        ("with", parameters_needed),
    ]
    .into_iter()
    .filter_map(|(key, needed)| needed.then_some(key))
    .collect();
    let nullable = |needed: bool| {
        if needed {
            json!("object")
        } else {
            json!(["object", "null"])
        }
    };
    let with = json!({"$ref": format!("#/$defs/{}", operator.name.clone() + ".with")});
    let with = match parameters_needed {
        true => with,
        false => json!({"anyOf": [with, {"type": "null"}]}),
    };
    json!({
        "if": {"properties": {"op": {"const": operator.name}}, "required": ["op"]},
        "then": {
            "required": needed,
            "properties": {
                "in": {
                    "type": nullable(!ports_needed.is_empty()),
                    "properties": ports,
                    "required": ports_needed,
                    "additionalProperties": false,
                },
                "with": with,
            },
        },
    })
}

/// Required parameters without a default.
fn needed_parameters(operator: &OperatorSpec) -> Vec<Value> {
    let required = operator.params.get("required").and_then(Value::as_array);
    let has_no_default = |name: &&Value| {
        name.as_str()
            .is_some_and(|name| operator.default_of(name).is_none())
    };
    required
        .into_iter()
        .flatten()
        .filter(has_no_default)
        .cloned()
        .collect()
}

/// Adds `OPERATOR.with` and, as `OPERATOR.NAME`, what the operator's schema refers to.
fn add_parameters(operator: &OperatorSpec, definitions: &mut Map<String, Value>) {
    let mut schema = operator.params.clone();
    let needed = needed_parameters(operator);
    let mut own = Map::new();
    if let Some(object) = schema.as_object_mut() {
        object.shift_remove("$schema");
        own = match object.shift_remove("$defs") {
            Some(Value::Object(own)) => own,
            _ => Map::new(),
        };
        object.insert("required".to_owned(), Value::Array(needed));
    }
    let properties = schema.get_mut("properties").and_then(Value::as_object_mut);
    for (name, property) in properties.into_iter().flatten() {
        if let (Some(default), Some(property)) =
            (operator.default_of(name), property.as_object_mut())
        {
            property.insert("default".to_owned(), default.clone());
        }
    }
    for (name, mut definition) in own {
        adopt(&mut definition, &operator.name);
        definitions.insert(format!("{}.{name}", operator.name), definition);
    }
    adopt(&mut schema, &operator.name);
    definitions.insert(format!("{}.with", operator.name), schema);
}

/// Points references at the operator's definitions and closes objects that list their keys.
fn adopt(schema: &mut Value, operator: &str) {
    match schema {
        Value::Array(items) => items.iter_mut().for_each(|item| adopt(item, operator)),
        Value::Object(object) => {
            if let Some(Value::String(reference)) = object.get_mut("$ref")
                && let Some(name) = reference.strip_prefix("#/$defs/")
            {
                *reference = format!("#/$defs/{operator}.{name}");
            }
            let is_list_of_keys = matches!(object.get("properties"), Some(Value::Object(_)));
            let has_alternatives = ["allOf", "oneOf", "anyOf"]
                .iter()
                .any(|k| object.contains_key(*k));
            if is_list_of_keys && !object.contains_key("additionalProperties") {
                let closed = if has_alternatives {
                    "unevaluatedProperties"
                } else {
                    "additionalProperties"
                };
                object.insert(closed.to_owned(), Value::Bool(false));
            }
            for (key, value) in object.iter_mut() {
                let is_data = ["default", "const", "enum", "examples"].contains(&key.as_str());
                if !is_data {
                    adopt(value, operator);
                }
            }
        }
        _ => {}
    }
}

fn input(vocabulary: &Vocabulary) -> Value {
    json!({
        "type": "string",
        "description": "A step, a source, or `previous.LAYER` of the version of the map before.",
        "examples": vocabulary.sources,
    })
}

fn test() -> Value {
    let tables = json!({"type": "object", "additionalProperties": {"$ref": "#/$defs/rows"}});
    let mut expect = tables.clone();
    expect["minProperties"] = json!(1);
    json!({
        "type": "object",
        "additionalProperties": false,
        "required": ["name", "expect"],
        "properties": {
            "name": {"type": "string"},
            "given": tables,
            "expect": expect,
            "tolerance": {"type": "number", "minimum": 0},
        },
    })
}

fn rows() -> Value {
    json!({"type": "array", "items": {"type": "object"}})
}
