//! A JSON Schema as column shapes.

use crate::budget::SchemaBudget;
use crate::{MAX_DEPTH, SchemaError};
use arrow::datatypes::{DataType, Field, Fields};
use serde_json::Value;
use std::collections::HashMap;
use std::sync::Arc;

/// How a JSON value becomes a column.
#[derive(Debug, Clone)]
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
    Object(Object),
}

/// The properties of an object that are columns.
#[derive(Debug, Clone)]
pub(super) struct Object {
    pub(super) properties: Vec<(String, Shape)>,
    places: HashMap<String, usize>,
    /// Bytes of a row's own columns, without those of objects within.
    pub(super) own_bytes: usize,
    /// Bytes of a row that is null.
    pub(super) absent_bytes: usize,
}

/// The columns of a JSON channel.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// What a payload is: an object, or [`Shape::Json`] where all of it is one column of text.
    pub(super) root: Shape,
    fields: Fields,
}

struct Builder<'a> {
    root: &'a Value,
    budget: SchemaBudget,
    /// References being followed.
    open: Vec<String>,
    columns: usize,
    depth: usize,
}

impl Plan {
    /// One column, `json`, with each payload as it stands.
    pub(crate) fn untyped() -> Arc<Plan> {
        Arc::new(Plan {
            root: Shape::Json,
            fields: Fields::from(vec![Field::new("json", DataType::Utf8, true)]),
        })
    }

    /// The columns of a JSON Schema; untyped where it names no properties.
    pub(crate) fn parse(schema_name: &str, schema: &[u8]) -> Result<Arc<Plan>, SchemaError> {
        if schema.iter().all(u8::is_ascii_whitespace) {
            return Ok(Plan::untyped());
        }
        let budget = SchemaBudget::of_text(schema_name, schema)?;
        let root: Value = serde_json::from_slice(schema).map_err(|error| SchemaError::Syntax {
            language: "jsonschema",
            schema: schema_name.to_owned(),
            line: error.line(),
            expected: "a JSON Schema object".to_owned(),
            found: error.to_string(),
        })?;
        let mut builder = Builder {
            root: &root,
            budget,
            open: Vec::new(),
            columns: 0,
            depth: 0,
        };
        let root = builder.shape(&root)?;
        let Shape::Object(object) = &root else {
            return Ok(Plan::untyped());
        };
        let fields = fields(&object.properties);
        Ok(Arc::new(Plan { root, fields }))
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
            Shape::Base64 => DataType::BinaryView,
            Shape::List(item) => DataType::new_list(item.data_type(), true),
            Shape::Object(object) => DataType::Struct(fields(&object.properties)),
        }
    }

    /// Bytes that a value takes in its own column at least, with its validity.
    pub(super) fn own_bytes(&self) -> usize {
        match self {
            Shape::Object(_) => 1,
            other => other.fixed_bytes(),
        }
    }

    /// As [`Shape::own_bytes`]; of an object, those of its columns too.
    pub(super) fn fixed_bytes(&self) -> usize {
        1 + match self {
            Shape::Boolean => 1,
            Shape::Integer | Shape::Number => 8,
            Shape::Base64 => 16,
            Shape::Text | Shape::Json | Shape::List(_) => 4,
            Shape::Object(object) => object.absent_bytes,
        }
    }
}

impl Object {
    fn new(properties: Vec<(String, Shape)>) -> Self {
        let names = properties.iter().enumerate();
        let places = names
            .map(|(place, (name, _))| (name.clone(), place))
            .collect();
        let shapes = || properties.iter().map(|(_, shape)| shape);
        Self {
            places,
            own_bytes: shapes().map(Shape::own_bytes).sum(),
            absent_bytes: shapes().map(Shape::fixed_bytes).sum(),
            properties,
        }
    }

    /// The place of a property.
    pub(super) fn place(&self, name: &str) -> Option<usize> {
        self.places.get(name).copied()
    }
}

impl Builder<'_> {
    /// The shape of a schema; [`Shape::Json`] for all that has no single type.
    fn shape(&mut self, schema: &Value) -> Result<Shape, SchemaError> {
        self.columns += 1;
        self.budget.check_columns(self.columns)?;
        if self.depth >= MAX_DEPTH {
            return Ok(Shape::Json);
        }
        self.depth += 1;
        let shape = self.shape_within(schema);
        self.depth -= 1;
        shape
    }

    fn shape_within(&mut self, schema: &Value) -> Result<Shape, SchemaError> {
        if let Some(reference) = schema.get("$ref").and_then(Value::as_str) {
            return self.referenced(reference);
        }
        Ok(match single_type(schema) {
            Some("boolean") => Shape::Boolean,
            Some("integer") => Shape::Integer,
            Some("number") => Shape::Number,
            Some("string") if is_base64(schema) => Shape::Base64,
            Some("string") => Shape::Text,
            Some("array") => match schema.get("items") {
                Some(items) if items.is_object() => Shape::List(Box::new(self.shape(items)?)),
                _ => Shape::Json,
            },
            Some("object") => self.object(schema)?,
            Some(_) => Shape::Json,
            None if schema.get("properties").is_some() => self.object(schema)?,
            None => self.constants(schema)?,
        })
    }

    fn object(&mut self, schema: &Value) -> Result<Shape, SchemaError> {
        let properties = match schema.get("properties").and_then(Value::as_object) {
            Some(properties) if !properties.is_empty() => properties,
            _ => return Ok(Shape::Json),
        };
        let mut shapes = Vec::new();
        for (name, property) in properties {
            self.budget.spend(name.len())?;
            shapes.push((name.clone(), self.shape(property)?));
        }
        Ok(Shape::Object(Object::new(shapes)))
    }

    fn referenced(&mut self, reference: &str) -> Result<Shape, SchemaError> {
        self.budget.spend(reference.len())?;
        let target = reference
            .strip_prefix('#')
            .and_then(|pointer| self.root.pointer(pointer));
        let Some(target) = target else {
            return Ok(Shape::Json);
        };
        if reference == "#" || self.open.iter().any(|open| open == reference) {
            return Ok(Shape::Json);
        }
        self.open.push(reference.to_owned());
        let shape = self.shape(target);
        self.open.pop();
        shape
    }

    /// An untyped schema that lists constants has their type.
    fn constants(&mut self, schema: &Value) -> Result<Shape, SchemaError> {
        let options = ["oneOf", "anyOf"].iter().find_map(|key| schema.get(*key));
        let listed = match (options, schema.get("enum")) {
            (Some(Value::Array(values)), _) | (None, Some(Value::Array(values))) => values,
            _ => return Ok(Shape::Json),
        };
        self.budget.spend(listed.len())?;
        let value = |listed| match options {
            Some(_) => Value::get(listed, "const"),
            None => Some(listed),
        };
        let all = |kind: fn(&Value) -> bool| listed.iter().all(|l| value(l).is_some_and(kind));
        Ok(match listed.is_empty() {
            false if all(Value::is_i64) => Shape::Integer,
            false if all(Value::is_string) => Shape::Text,
            _ => Shape::Json,
        })
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
