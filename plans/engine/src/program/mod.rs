//! From a checked plan to stages: what is stored, at which scope, and what runs inside what.
//!
//! A step is one stage, a Fold two: its lift, which runs where the rows are, and its merge. A stage's [`Scope`] says
//! how much of the map one unit of it covers; a stage that is not stored runs inside the units of its reader.

pub mod compile;
mod locality;

use std::collections::{BTreeMap, BTreeSet};

use arrow::datatypes::SchemaRef;
use evermap_contract::{Layer, LayerRow, Registry, StateRow};
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::digest::digest;
use crate::nodes::operator::Phase;

/// How much of a map one unit of a stage covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// One session.
    Session,
    /// All sessions of one site.
    Site,
    /// Everything.
    Map,
}

/// What a stage reads.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Table {
    /// Another stage.
    Stage(String),
    /// A table of the logs: a role or a topic.
    Log(String),
    /// A layer of the version before.
    Previous(String),
}

/// What a stage does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Task {
    /// An operator.
    Op {
        /// Its name.
        op: String,
        /// Its version.
        version: u32,
        /// Which part of its work.
        phase: Phase,
        /// Its parameters, complete.
        params: Value,
        /// Port to table.
        inputs: BTreeMap<String, Table>,
    },
    /// A query.
    Sql {
        /// Its text.
        query: String,
        /// The tables it names.
        inputs: Vec<Table>,
        /// Whether it orders its rows itself.
        ordered: bool,
    },
}

impl Task {
    /// The tables it reads.
    pub fn inputs(&self) -> Vec<&Table> {
        match self {
            Task::Op { inputs, .. } => inputs.values().collect(),
            Task::Sql { inputs, .. } => inputs.iter().collect(),
        }
    }
}

/// One stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// The step's name; a lift has [`LIFT`] behind it.
    pub name: String,
    /// What it does.
    pub task: Task,
    /// How much one unit of it covers.
    pub scope: Scope,
    /// Whether its rows are kept as artifacts.
    pub stored: bool,
}

impl Stage {
    /// The operator; `None` for a query.
    pub fn op(&self) -> Option<&str> {
        match &self.task {
            Task::Op { op, .. } => Some(op),
            Task::Sql { .. } => None,
        }
    }

    /// The layer whose rows it makes; `None` for a query.
    pub fn layer(&self, registry: &Registry) -> Option<Layer> {
        match &self.task {
            Task::Op {
                phase: Phase::Lift, ..
            } => Some(StateRow::layer()),
            Task::Op { op, .. } => registry.get(op).ok().map(|entry| entry.output.clone()),
            Task::Sql { .. } => None,
        }
    }
}

/// What follows a step's name in the name of its lift.
pub const LIFT: &str = "#lift";

/// A plan, ready to run.
#[derive(Debug, Clone)]
pub struct Program {
    /// The plan's name.
    pub plan: String,
    /// Stages, each after all it reads.
    pub stages: Vec<Stage>,
    /// The schema of every stage.
    pub schemas: BTreeMap<String, SchemaRef>,
    /// The stages that are published as layers, in the plan's order.
    pub write: Vec<String>,
    /// What is allowed but probably not meant.
    pub warnings: Vec<String>,
}

impl Program {
    /// Digest of all that the program does: operators with versions and parameters, queries, what is written.
    ///
    /// # Errors
    /// A bug fault when it does not serialise.
    pub fn digest(&self) -> Result<String, Fault> {
        let text = serde_json::to_vec(&(&self.stages, &self.write))
            .map_err(|error| Fault::bug(error.to_string()))?;
        Ok(digest(&text))
    }

    /// A stage by name.
    ///
    /// # Errors
    /// A bug fault: names were checked.
    pub fn stage(&self, name: &str) -> Result<&Stage, Fault> {
        self.stages
            .iter()
            .find(|stage| stage.name == name)
            .ok_or_else(|| Fault::bug(format!("no stage {name}")))
    }

    /// A stage and those that run inside it, in order.
    ///
    /// # Errors
    /// As [`Program::stage`].
    pub fn fragment(&self, name: &str) -> Result<Vec<Stage>, Fault> {
        let mut wanted = BTreeSet::from([name.to_owned()]);
        let mut fragment = Vec::new();
        for stage in self
            .stages
            .iter()
            .rev()
            .filter(|stage| stage.name == name || !stage.stored)
        {
            if wanted.contains(&stage.name) {
                let inside = stage
                    .task
                    .inputs()
                    .into_iter()
                    .filter_map(|table| match table {
                        Table::Stage(input) => Some(input.clone()),
                        _ => None,
                    });
                wanted.extend(inside);
                fragment.push(stage.clone());
            }
        }
        fragment.reverse();
        Ok(fragment)
    }
}
