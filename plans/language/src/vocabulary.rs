//! What a plan may name: operators and source tables, described by the caller.

use serde_json::Value;

/// Everything plans can be written with. Its order is the order of suggestions and listings.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Vocabulary {
    /// The operators, each once.
    pub operators: Vec<OperatorSpec>,
    /// Tables that exist before any step: `frames`, `odometry`, `sessions`.
    pub sources: Vec<String>,
    /// Whether every name that starts with `/` is a source: the table of a topic.
    pub open_sources: bool,
}

/// One operator, as far as a plan is concerned.
#[derive(Debug, Clone, PartialEq)]
pub struct OperatorSpec {
    /// Its name after `op:`.
    pub name: String,
    /// Its inputs, in the operator's order.
    pub ports: Vec<PortSpec>,
    /// JSON Schema of its parameters, an object, as schemars derives it. The object's
    /// `description` is shown by editors as the operator's.
    pub params: Value,
    /// An object with the values of parameters that are not written.
    pub defaults: Value,
}

/// One named input of an operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PortSpec {
    /// Its name under `in:`.
    pub name: String,
    /// Whether it may be left open.
    pub optional: bool,
}

impl Vocabulary {
    /// The operator of this name.
    #[must_use]
    pub fn operator(&self, name: &str) -> Option<&OperatorSpec> {
        self.operators.iter().find(|operator| operator.name == name)
    }

    /// Whether `name` is a table that exists before any step.
    #[must_use]
    pub fn is_source(&self, name: &str) -> bool {
        let is_topic = self.open_sources && name.len() > 1 && name.starts_with('/');
        is_topic || self.sources.iter().any(|source| source == name)
    }

    /// The names of the operators.
    pub fn operator_names(&self) -> impl Iterator<Item = &str> {
        self.operators.iter().map(|operator| operator.name.as_str())
    }

    /// The names of the listed sources.
    pub fn source_names(&self) -> impl Iterator<Item = &str> {
        self.sources.iter().map(String::as_str)
    }
}

impl OperatorSpec {
    /// The port of this name.
    #[must_use]
    pub fn port(&self, name: &str) -> Option<&PortSpec> {
        self.ports.iter().find(|port| port.name == name)
    }

    /// The default of a parameter, if it has one.
    pub(crate) fn default_of(&self, parameter: &str) -> Option<&Value> {
        self.defaults.get(parameter)
    }
}
