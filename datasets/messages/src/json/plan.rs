//! A JSON Schema as column shapes.

use crate::{MAX_COLUMNS, MAX_DEPTH, SchemaError};
use arrow::datatypes::{DataType, Field, Fields};
use serde_json::Value;
use std::sync::Arc;

/// How a JSON value becomes a column.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    Boolean,
    Integer,
    Number,
    Text,
    /// A string of base64 that stands for bytes.
    Base64,
    /// Anything, kept as JSON text.
    Json,
    List(Box<Shape>),
    Object(Vec<(String, Shape)>),
}

/// The columns of a JSON channel.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// None where the whole payload is one column of text.
    pub(super) properties: Option<Vec<(String, Shape)>>,
    fields: Fields,
}

struct Builder<'a> {
    root: &'a Value,
    /// References being followed.
    open: Vec<String>,
    columns: usize,
    depth: usize,
}

impl Plan {
    /// One column, `json`, with each payload as it stands.
    pub(crate) fn untyped() -> Arc<Plan> {
        Arc::new(Plan {
            properties: None,
            fields: Fields::from(vec![Field::new("json", DataType::Utf8, true)]),
        })
    }

    /// The columns of a JSON Schema; untyped where it names no properties.
    pub(crate) fn parse(schema_name: &str, schema: &[u8]) -> Result<Arc<Plan>, SchemaError> {
        if schema.iter().all(u8::is_ascii_whitespace) {
            return Ok(Plan::untyped());
        }
        let root: Value = serde_json::from_slice(schema).map_err(|error| SchemaError::Syntax {
            language: "jsonschema",
            schema: schema_name.to_owned(),
            line: error.line(),
            expected: "a JSON Schema object".to_owned(),
            found: error.to_string(),
        })?;
        let mut builder = Builder {
            root: &root,
            open: Vec::new(),
            columns: 0,
            depth: 0,
        };
        let shape = builder.shape(&root);
        if builder.columns > MAX_COLUMNS {
            let reason = format!("expected at most {MAX_COLUMNS} columns, found more");
            return Err(SchemaError::refused(schema_name, reason));
        }
        let Shape::Object(properties) = shape else {
            return Ok(Plan::untyped());
        };
        let fields = fields(&properties);
        Ok(Arc::new(Plan {
            properties: Some(properties),
            fields,
        }))
    }

    /// The Arrow fields, in the schema's order.
    pub(crate) fn fields(&self) -> &Fields {
        &self.fields
    }
}

fn fields(properties: &[(String, Shape)]) -> Fields {
    properties
        .iter()
        .map(|(name, shape)| Field::new(name, shape.data_type(), true))
        .collect()
}

impl Shape {
    fn data_type(&self) -> DataType {
        match self {
            Shape::Boolean => DataType::Boolean,
            Shape::Integer => DataType::Int64,
            Shape::Number => DataType::Float64,
            Shape::Text | Shape::Json => DataType::Utf8,
            Shape::Base64 => DataType::Binary,
            Shape::List(item) => DataType::new_list(item.data_type(), true),
            Shape::Object(properties) => DataType::Struct(fields(properties)),
        }
    }
}

impl Builder<'_> {
    /// The shape of a schema; [`Shape::Json`] for all that has no single type.
    fn shape(&mut self, schema: &Value) -> Shape {
        self.columns += 1;
        if self.depth >= MAX_DEPTH || self.columns > MAX_COLUMNS {
            return Shape::Json;
        }
        self.depth += 1;
        let shape = self.shape_within(schema);
        self.depth -= 1;
        shape
    }

    fn shape_within(&mut self, schema: &Value) -> Shape {
        if let Some(reference) = schema.get("$ref").and_then(Value::as_str) {
            return self.referenced(reference);
        }
        match single_type(schema) {
            Some("boolean") => Shape::Boolean,
            Some("integer") => Shape::Integer,
            Some("number") => Shape::Number,
            Some("string") if is_base64(schema) => Shape::Base64,
            Some("string") => Shape::Text,
            Some("array") => match schema.get("items") {
                Some(items) if items.is_object() => Shape::List(Box::new(self.shape(items))),
                _ => Shape::Json,
            },
            Some("object") => self.object(schema),
            Some(_) => Shape::Json,
            None if schema.get("properties").is_some() => self.object(schema),
            None => constants(schema),
        }
    }

    fn object(&mut self, schema: &Value) -> Shape {
        let properties = match schema.get("properties").and_then(Value::as_object) {
            Some(properties) if !properties.is_empty() => properties,
            _ => return Shape::Json,
        };
        let shapes = properties
            .iter()
            .map(|(name, property)| (name.clone(), self.shape(property)));
        Shape::Object(shapes.collect())
    }

    fn referenced(&mut self, reference: &str) -> Shape {
        let target = reference
            .strip_prefix('#')
            .and_then(|pointer| self.root.pointer(pointer));
        let Some(target) = target else {
            return Shape::Json;
        };
        if reference == "#" || self.open.iter().any(|open| open == reference) {
            return Shape::Json;
        }
        self.open.push(reference.to_owned());
        let shape = self.shape(target);
        self.open.pop();
        shape
    }
}

/// The one type a schema allows beside null.
fn single_type(schema: &Value) -> Option<&str> {
    match schema.get("type")? {
        Value::String(name) => Some(name),
        Value::Array(names) => {
            let mut names = names
                .iter()
                .filter_map(Value::as_str)
                .filter(|n| *n != "null");
            let first = names.next()?;
            Some(if names.next().is_none() { first } else { "" })
        }
        _ => None,
    }
}

fn is_base64(schema: &Value) -> bool {
    let encoding = schema.get("contentEncoding").and_then(Value::as_str);
    encoding.is_some_and(|encoding| encoding.eq_ignore_ascii_case("base64"))
}

/// An untyped schema that lists constants has their type.
fn constants(schema: &Value) -> Shape {
    let options = ["oneOf", "anyOf"].iter().find_map(|key| schema.get(*key));
    let values: Option<Vec<&Value>> = match (options, schema.get("enum")) {
        (Some(Value::Array(options)), _) => options.iter().map(|o| o.get("const")).collect(),
        (None, Some(Value::Array(values))) => Some(values.iter().collect()),
        _ => None,
    };
    match values {
        Some(values) if values.is_empty() => Shape::Json,
        Some(values) if values.iter().all(|v| v.is_i64()) => Shape::Integer,
        Some(values) if values.iter().all(|v| v.is_string()) => Shape::Text,
        _ => Shape::Json,
    }
}
