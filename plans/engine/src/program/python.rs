//! A step that is a function in Python: what it takes, and the columns that it makes.

use std::sync::Arc;

use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use evermap_contract::Registry;
use evermap_interpreter::{Environment, Function};
use evermap_language::{Grain, PythonStep, Step, listed, nearest};
use evermap_schemas::{Fault, Layer, type_named};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// A function with where it runs and what it makes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PythonTask {
    /// The function.
    pub function: Function,
    /// Where it runs.
    pub environment: Environment,
    /// How much it is given at once.
    pub grain: Grain,
    /// The columns that it makes: the name of a layer that has them, or an object from name to type.
    pub output: Value,
}

impl PythonTask {
    /// The function of a step, loaded once by an interpreter.
    ///
    /// # Errors
    /// A user fault for columns that there are not, and what [`Function::check`] says.
    pub async fn of(step: &Step, python: &PythonStep, registry: &Registry) -> Result<Self, Fault> {
        output_schema(&python.output, registry)?;
        let function = Function {
            file: python.file.clone(),
            function: python.function.clone(),
            code: python.code.clone(),
            ports: step.inputs.keys().cloned().collect(),
            params: python.params.clone(),
        };
        let checked = function.clone();
        let environment = tokio::task::spawn_blocking(move || checked.check()).await;
        Ok(Self {
            function,
            environment: environment.map_err(|error| Fault::bug(error.to_string()))??,
            grain: python.grain,
            output: python.output.clone(),
        })
    }

    /// The layer whose columns it makes; `None` where the plan lists columns.
    pub fn layer(&self, registry: &Registry) -> Option<Layer> {
        layer(self.output.as_str()?, registry)
    }

    /// The columns that it makes.
    ///
    /// # Errors
    /// A user fault for a layer or a type that there is not.
    pub fn schema(&self, registry: &Registry) -> Result<SchemaRef, Fault> {
        output_schema(&self.output, registry)
    }
}

fn layer(name: &str, registry: &Registry) -> Option<Layer> {
    let mut layers = registry.entries().map(|entry| &entry.output);
    layers.find(|layer| layer.name == name).cloned()
}

fn output_schema(output: &Value, registry: &Registry) -> Result<SchemaRef, Fault> {
    match output {
        Value::String(name) => {
            let unknown = || {
                let known = registry.entries().map(|entry| entry.output.name);
                let fault = Fault::user(format!("`output` names {name}, no layer of an operator"));
                match nearest(name, known) {
                    Some(near) => fault.next(format!("did you mean {near}?")),
                    None => fault.next("list its columns: `output: { x: f64 }`"),
                }
            };
            Ok(layer(name, registry).ok_or_else(unknown)?.schema())
        }
        Value::Object(columns) if !columns.is_empty() => {
            Ok(Arc::new(Schema::new(fields(columns)?)))
        }
        other => Err(Fault::user(format!(
            "expected `output` to be the name of a layer, or columns with their types, found {other}"
        ))),
    }
}

/// Columns, or members of a struct; any may hold nulls.
fn fields(columns: &Map<String, Value>) -> Result<Vec<Field>, Fault> {
    let field = |(name, value): (&String, &Value)| {
        let data_type = match value {
            Value::Object(members) => DataType::Struct(fields(members)?.into()),
            Value::String(named) => type_named(named).ok_or_else(|| {
                let examples = listed([
                    "text",
                    "bool",
                    "i64",
                    "f64",
                    "time",
                    "bytes",
                    "list of f64",
                    "3 f64",
                ]);
                Fault::user(format!(
                    "{name}: expected a type, such as {examples}, found `{named}`"
                ))
            })?,
            other => {
                return Err(Fault::user(format!(
                    "{name}: expected a type, found {other}"
                )));
            }
        };
        Ok(Field::new(name, data_type, true))
    };
    columns.iter().map(field).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use serde_json::json;

    use super::*;

    #[test]
    fn columns_are_named_with_their_types() {
        let registry = Registry::default();
        let output = json!({"site": "text", "pose": {"x": "f64"}, "ranges_m": "list of f32"});
        let schema = output_schema(&output, &registry).unwrap();
        let pose = DataType::Struct(vec![Field::new("x", DataType::Float64, true)].into());
        assert_eq!(*schema.field(1).data_type(), pose);
        let fault = |output: Value| output_schema(&output, &registry).unwrap_err().to_string();
        assert!(fault(json!({"x": "double"})).contains("expected a type, such as `text`"));
        assert!(fault(json!("lanez")).contains("no layer of an operator"));
        assert!(fault(json!({})).contains("expected `output` to be"));
    }
}
