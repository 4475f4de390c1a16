//! The list of operators, without their types.

use std::collections::BTreeMap;

use evermap_schemas::{Fault, Layer, LayerRow};
use serde_json::Value;

use crate::{Kernel, Operator, Page, Port};

/// One operator, as the engine and the reference see it.
#[derive(Clone)]
pub struct Entry {
    /// The operator's name.
    pub name: &'static str,
    /// The operator's version.
    pub version: u32,
    /// The page beside the operator.
    pub page: Page,
    /// Inputs; the first drives.
    pub ports: Vec<Port>,
    /// The layer that it yields.
    pub output: Layer,
    /// Default parameters, as a JSON object.
    pub defaults: Value,
    /// JSON Schema of the parameters.
    pub params_schema: Value,
    kernel: fn(&Value) -> Result<Kernel, Fault>,
    normalise: fn(&Value) -> Result<Value, Fault>,
}

fn params<O: Operator>(value: &Value) -> Result<O::Params, Fault> {
    let mut merged = serde_json::to_value(O::Params::default())
        .map_err(|error| Fault::bug(error.to_string()))?;
    if let (Some(merged), Some(given)) = (merged.as_object_mut(), value.as_object()) {
        merged.extend(
            given
                .iter()
                .map(|(name, value)| (name.clone(), value.clone())),
        );
    }
    serde_json::from_value(merged).map_err(|error| {
        Fault::user(format!("parameters of {}: {error}", O::NAME))
            .next(format!("see `evermap operators {}`", O::NAME))
    })
}

impl Entry {
    /// The entry of an operator.
    pub fn of<O: Operator>() -> Self {
        Self {
            name: O::NAME,
            version: O::VERSION,
            page: Page(O::PAGE),
            ports: O::ports(),
            output: O::Output::layer(),
            defaults: serde_json::to_value(O::Params::default()).unwrap_or_default(),
            params_schema: schemars::schema_for!(O::Params).to_value(),
            kernel: |value| {
                O::kernel(params::<O>(value)?)
                    .map_err(|fault| fault.at(format!("operator {}", O::NAME)))
            },
            normalise: |value| {
                serde_json::to_value(params::<O>(value)?)
                    .map_err(|error| Fault::bug(error.to_string()))
            },
        }
    }

    /// The kernel for parameters as a plan gives them; what it leaves out has its default.
    ///
    /// # Errors
    /// A user fault for parameters of another type, unknown ones, or ones that make no sense together.
    pub fn kernel(&self, params: &Value) -> Result<Kernel, Fault> {
        (self.kernel)(params)
    }

    /// The complete parameters, in declaration order: equal work has equal text.
    ///
    /// # Errors
    /// As [`Entry::kernel`].
    pub fn normalise(&self, params: &Value) -> Result<Value, Fault> {
        (self.normalise)(params)
    }

    /// A port by name.
    pub fn port(&self, name: &str) -> Option<&Port> {
        self.ports.iter().find(|port| port.name == name)
    }
}

/// Operators by name.
#[derive(Clone, Default)]
pub struct Registry(BTreeMap<&'static str, Entry>);

impl Registry {
    /// A registry of these entries; the later of two with one name stays.
    pub fn new(entries: impl IntoIterator<Item = Entry>) -> Self {
        Self(
            entries
                .into_iter()
                .map(|entry| (entry.name, entry))
                .collect(),
        )
    }

    /// An operator by name.
    ///
    /// # Errors
    /// A user fault that lists the names there are.
    pub fn get(&self, name: &str) -> Result<&Entry, Fault> {
        self.0.get(name).ok_or_else(|| {
            let known: Vec<_> = self.0.keys().copied().collect();
            Fault::user(format!(
                "no operator {name}; there are {}",
                known.join(", ")
            ))
        })
    }

    /// All operators, sorted by name.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.0.values()
    }
}
