//! The JSON Schema of plans, for editors to complete and check from.

use serde_json::{Map, Value, json};

use crate::plan::Grain;
use crate::vocabulary::{OperatorSpec, Vocabulary};
use crate::written::{BODY_KEYS, MOST_STEPS};

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
    let whole_step = json!({"anyOf": BODY_KEYS.map(|key| json!({"required": [key]}))});
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "evermap plan",
        "type": "object",
        "required": ["plan"],
        "additionalProperties": false,
        "properties": {
            "plan": {"type": "string", "pattern": NAME, "description": "Name of the plan."},
            "extends": {
                "type": "string",
                "description": "The plan that this one changes: a path relative to it, or the name of one that ships.",
            },
            "doc": {"type": "string", "description": "What the plan is for."},
            "needs": {
                "type": "array",
                "description": "Roles that a session must play for the plan to be of use. One that plays some must play all.",
                "items": {"enum": vocabulary.sources},
                "uniqueItems": true,
            },
            "sessions": {"type": "string", "description": "Path of a session manifest."},
            "defaults": {
                "type": ["object", "null"],
                "description": "Parameters of all steps that have them and give no other value.",
                "properties": defaults(vocabulary),
                "additionalProperties": false,
            },
            "presets": {
                "type": ["object", "null"],
                "description": "Parameters by step under a name, which `--set NAME` lays over the steps.",
                "additionalProperties": {"type": "object", "additionalProperties": {"type": "object"}},
            },
            "steps": {
                "type": "object",
                "description": "Steps by name; each makes the layer of its name.",
                "maxProperties": MOST_STEPS,
                "propertyNames": {"pattern": NAME, "not": {"enum": vocabulary.sources}},
                "additionalProperties": {"$ref": "#/$defs/step"},
            },
            "drop": {
                "type": "array",
                "description": "Steps of the extended plan that this one does without.",
                "items": {"type": "string"},
            },
            "write": {
                "type": "array",
                "description": "The steps whose layers are published, beside those of the extended plan.",
                "items": {"type": "string"},
                "minItems": 1,
                "uniqueItems": true,
            },
            "tests": {"type": "array", "items": {"$ref": "#/$defs/test"}},
        },
        "if": {"required": ["extends"]},
        "else": {
            "required": ["steps", "write"],
            "not": {"required": ["drop"]},
            "properties": {"steps": {"minProperties": 1, "additionalProperties": whole_step}},
        },
        "$defs": definitions,
    })
}

/// The parameters of all operators, each as one of them or another has it.
fn defaults(vocabulary: &Vocabulary) -> Map<String, Value> {
    let mut defaults = Map::new();
    for operator in &vocabulary.operators {
        for name in operator.parameter_names() {
            let known = defaults.entry(name).or_insert_with(|| json!({"anyOf": []}));
            if let Some(known) = known.get_mut("anyOf").and_then(Value::as_array_mut) {
                let owner = format!("#/$defs/{}.with/properties/{name}", operator.name);
                known.push(json!({"$ref": owner}));
            }
        }
    }
    defaults
}

fn step(vocabulary: &Vocabulary) -> Value {
    let operators: Vec<Value> = vocabulary.operators.iter().map(operator_choice).collect();
    let op = match operators.as_slice() {
        [] => json!({"type": "string"}),
        _ => json!({"description": "The operator.", "oneOf": operators}),
    };
    let cases: Vec<Value> = vocabulary.operators.iter().map(operator_case).collect();
    let alone = |key: &str, others: &[&str]| {
        let others: Vec<Value> = others
            .iter()
            .map(|key| json!({"required": [key]}))
            .collect();
        json!({"if": {"required": [key]}, "then": {"not": {"anyOf": others}}})
    };
    let kinds = [
        alone(
            "sql",
            &["op", "python", "in", "with", "grain", "output", "pixels"],
        ),
        alone("op", &["python", "grain", "output", "pixels"]),
        json!({"if": {"required": ["python"]}, "then": {"required": ["in", "grain", "output"]}}),
    ];
    let conditions: Vec<Value> = cases.into_iter().chain(kinds).collect();
    json!({
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "op": op,
            "in": {
                "type": ["object", "null"],
                "description": "Port to layer. A port that is not named takes the layer of its own name; an optional one stays open.",
            },
            "with": {"type": ["object", "null"], "description": "Parameters of the operator or function."},
            "sql": {"type": "string", "minLength": 1, "description": "The query."},
            "python": {"type": "string", "pattern": "^.+:.+$", "description": "A function: its file, relative to the plan, and its name, as `steps.py:speeds`."},
            "grain": {"enum": Grain::NAMED.map(|(name, _)| name), "description": "How much the function is given at once."},
            "output": {"type": ["string", "object"], "description": "The columns that the function makes: the name of a layer that has them, or their names and types."},
            "pixels": {"type": ["object", "null"], "additionalProperties": {"type": "string"}, "description": "By argument, the column of references whose images the function is given."},
            "once": {"type": "boolean", "description": "Done when something comes that it reads; until then, later versions keep what came out. For steps that read the version before."},
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
    let with = format!("#/$defs/{}.with", operator.name);
    json!({
        "if": {"properties": {"op": {"const": operator.name}}, "required": ["op"]},
        "then": {
            "properties": {
                "in": {"properties": ports, "additionalProperties": false},
                "with": {"anyOf": [{"$ref": with}, {"type": "null"}]},
            },
        },
    })
}

/// Adds `OPERATOR.with` and, as `OPERATOR.NAME`, what the operator's schema refers to.
fn add_parameters(operator: &OperatorSpec, definitions: &mut Map<String, Value>) {
    let mut schema = operator.params.clone();
    adopt(&mut schema, &operator.name);
    if let Some(object) = schema.as_object_mut() {
        object.shift_remove("$schema");
        if let Some(Value::Object(own)) = object.shift_remove("$defs") {
            let named = |(name, schema)| (format!("{}.{name}", operator.name), schema);
            definitions.extend(own.into_iter().map(named));
        }
    }
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
        "type": ["string", "null"],
        "description": "A step, a source, `previous.LAYER` of the version of the map before, or `new.STEP`: the rows of sessions that it did not have.",
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
        "required": ["name"],
        "anyOf": [{"required": ["expect"]}, {"required": ["contains"]}],
        "properties": {
            "name": {"type": "string"},
            "given": tables,
            "expect": expect,
            "contains": expect,
            "tolerance": {"type": "number", "minimum": 0},
        },
    })
}

fn rows() -> Value {
    json!({"type": "array", "items": {"type": "object"}})
}
