//! What a plan may name, and whom the language asks about the rest.

use serde_json::{Map, Value};

use crate::fault::Source;

/// Everything plans can be written with. Its order is the order of suggestions and listings.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Vocabulary {
    /// The operators, each once.
    pub operators: Vec<OperatorSpec>,
    /// Tables that exist before any step: `frames`, `odometry`, `sessions`.
    pub sources: Vec<String>,
    /// Whether every name that starts with `/` is a source: the table of a topic.
    pub open_sources: bool,
    /// Tables that every map has beside its layers, which no step makes: `columns`, `runs`.
    pub map_tables: Vec<String>,
}

/// One operator, as far as a plan is concerned.
#[derive(Debug, Clone, PartialEq)]
pub struct OperatorSpec {
    /// Its name after `op:`.
    pub name: String,
    /// Its inputs, in the operator's order.
    pub ports: Vec<PortSpec>,
    /// JSON Schema of its parameters, an object with `properties`, as schemars derives it. The
    /// object's `description` is shown by editors as the operator's. A parameter whose schema says
    /// `"x-files": true` is a mapping; an entry of it that is text is the path of a file.
    pub params: Value,
}

/// One named input of an operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PortSpec {
    /// Its name under `in:`.
    pub name: String,
    /// Whether it may be left open.
    pub optional: bool,
}

/// What is wrong with a parameter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParameterFault {
    /// Its name; empty where parameters do not make sense together.
    pub parameter: String,
    /// The entry of its value that is at fault; empty where that is all of it.
    pub entry: String,
    /// What was expected and what was found: one line, no full stop.
    pub message: String,
}

/// What is wrong with a query.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QueryFault {
    /// One sentence.
    pub message: String,
    /// Line and column in the query, from 1, where they are known.
    pub at: Option<(usize, usize)>,
}

/// Answers what the language does not know itself.
pub trait Host {
    /// The tables a query reads (not those it defines itself with `WITH`), under the names
    /// that steps and sources have: `poses`, `/odom`, `previous.lanes`.
    ///
    /// # Errors
    /// What is wrong with the query.
    fn tables(&self, query: &str) -> Result<Vec<String>, QueryFault>;

    /// All that is wrong with what a plan gives as parameters of an operator, a JSON object;
    /// the others have their defaults.
    fn parameter_faults(&self, operator: &str, params: &Value) -> Vec<ParameterFault>;

    /// The plan that another one extends: by its name or by its path, relative to the origin
    /// of the other one. One plan has one origin.
    ///
    /// # Errors
    /// One sentence.
    fn plan(&self, name: &str, extended_by: &str) -> Result<Source, String>;

    /// The text of a file of Python, whose path is relative to the origin of the plan that names it.
    ///
    /// # Errors
    /// One sentence.
    fn code(&self, path: &str, named_by: &str) -> Result<String, String> {
        let _ = named_by;
        Err(format!("{path} is not read here"))
    }

    /// What a parameter is given in the place of the path of a file, which is relative to the origin of the text that
    /// names it; of an option, `named_by` is empty.
    ///
    /// # Errors
    /// What was found in the place of a file that can be read, and where.
    fn file(&self, path: &str, named_by: &str) -> Result<Value, String> {
        let _ = named_by;
        Err(format!("{path}, which is not read here"))
    }

    /// The session manifest whose `defaults` are laid over those of the plan.
    fn manifest(&self) -> Option<Source> {
        None
    }
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

    /// What has this name, so that no step can have it; `None` where nothing has.
    pub(crate) fn taken_by(&self, name: &str) -> Option<&'static str> {
        let is_map_table = || self.map_tables.iter().any(|table| table == name);
        match self.is_source(name) {
            true => Some("a source table"),
            false => is_map_table().then_some("a table that every map has"),
        }
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

    /// Whether entries of a parameter may be paths of files.
    pub(crate) fn takes_files(&self, parameter: &str) -> bool {
        let property = self.params["properties"].get(parameter);
        property.is_some_and(|property| property["x-files"] == true)
    }

    /// The names of its parameters.
    pub(crate) fn parameter_names(&self) -> impl Iterator<Item = &str> {
        let properties = self.params.get("properties").and_then(Value::as_object);
        properties
            .into_iter()
            .flat_map(Map::keys)
            .map(String::as_str)
    }
}
