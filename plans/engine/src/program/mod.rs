//! What a plan comes to: stages with what they read, how much of the map one unit of them covers, and what is stored.
//!
//! A step is one stage, a Fold two: its lift, which runs where the rows are, and its merge. A stage that is not stored
//! runs inside the units of its reader. [`compile`] decides all of this, once: recipes, units, their DataFusion plans
//! and explanations follow from a stage's [`Read`]s.

pub mod compile;
mod kept;
mod locality;
pub mod python;
mod query;
mod reads;
pub(crate) mod test_rows;

use std::collections::{BTreeMap, BTreeSet};

use arrow::datatypes::SchemaRef;
use evermap_contract::{Layer, Phase, Reach, Registry};
use evermap_language::Input;
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::digest::digest_of;
use crate::program::python::PythonTask;
use crate::sql::described::Notes;

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

/// What a stage reads a table for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Its rows drive an operator.
    Driving,
    /// An operator or a function is given it whole at this port.
    Side(String),
    /// A query names it.
    Query,
}

/// What a stage reads of one table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Read {
    /// The table. The lift of a fold is a step too, named with [`LIFT`].
    pub table: Input,
    /// What for.
    pub role: Role,
    /// How much of it: what belongs to the unit at hand, or all of its site.
    pub reach: Reach,
    /// Which columns; whatever the query names, where there are none.
    pub columns: Vec<String>,
    /// The column whose images are fetched from the logs.
    pub pixels: Option<String>,
}

/// What a stage does with what it reads.
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
    },
    /// A query.
    Sql {
        /// Its text.
        query: String,
        /// Whether it orders its rows itself.
        ordered: bool,
        /// Units and frames of its columns.
        #[serde(default, skip_serializing_if = "Notes::is_empty")]
        notes: Notes,
    },
    /// A function in Python.
    Python(Box<PythonTask>),
}

/// One stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// The step's name; a lift has [`LIFT`] behind it.
    pub name: String,
    /// What it does.
    pub task: Task,
    /// What it reads.
    pub reads: Vec<Read>,
    /// How much one unit of it covers.
    pub scope: Scope,
    /// Whether its rows are kept as artifacts.
    pub stored: bool,
    /// Whether what was made stays until something else that it reads than the version before has changed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub once: bool,
}

impl Stage {
    /// The operator; `None` for a query or a function.
    pub fn op(&self) -> Option<&str> {
        match &self.task {
            Task::Op { op, .. } => Some(op),
            Task::Sql { .. } | Task::Python(_) => None,
        }
    }

    /// The parameters of the operator; `None` for a query or a function.
    pub fn params(&self) -> Option<&Value> {
        match &self.task {
            Task::Op { params, .. } => Some(params),
            Task::Sql { .. } | Task::Python(_) => None,
        }
    }

    /// The layer whose rows it makes; `None` for a query, and for a function of other columns.
    pub fn layer(&self, registry: &Registry) -> Option<Layer> {
        match &self.task {
            Task::Op { op, phase, .. } => Some(registry.get(op).ok()?.yields(*phase)),
            Task::Python(python) => python.layer(registry),
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
    /// Roles that the plan says a session must play.
    pub needs: Vec<String>,
    /// Stages, each after all it reads.
    pub stages: Vec<Stage>,
    /// The schema of every step's rows.
    pub schemas: BTreeMap<String, SchemaRef>,
    /// The stages that are published as layers, in the plan's order.
    pub write: Vec<String>,
    /// What is allowed but probably not meant.
    pub warnings: Vec<String>,
}

impl Program {
    /// Digest of all that the program does: operators with versions and parameters, queries, what is written. Not of
    /// what is known of columns, which changes nothing of what is done.
    ///
    /// # Errors
    /// A bug fault when it does not serialise.
    pub fn digest(&self) -> Result<String, Fault> {
        let mut stages = self.stages.clone();
        for stage in &mut stages {
            if let Task::Sql { notes, .. } = &mut stage.task {
                notes.clear();
            }
        }
        digest_of(&(&stages, &self.write))
    }

    /// The values of a parameter, of each stage that has it.
    pub fn given<'p>(&'p self, parameter: &str) -> impl Iterator<Item = &'p Value> {
        let stages = self.stages.iter();
        stages.filter_map(move |stage| stage.params()?.get(parameter))
    }

    /// Whether any stage reads this table of the logs.
    pub fn reads_source(&self, table: &str) -> bool {
        let mut reads = self.stages.iter().flat_map(|stage| &stage.reads);
        reads.any(|read| matches!(&read.table, Input::Source(name) if name == table))
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
    pub fn fragment(&self, name: &str) -> Vec<Stage> {
        let mut wanted = BTreeSet::from([name]);
        let mut fragment = Vec::new();
        let inside = |stage: &&Stage| stage.name == name || !stage.stored;
        for stage in self.stages.iter().rev().filter(inside) {
            if wanted.contains(stage.name.as_str()) {
                wanted.extend(stage.reads.iter().filter_map(|read| match &read.table {
                    Input::Step(name) => Some(name.as_str()),
                    _ => None,
                }));
                fragment.push(stage.clone());
            }
        }
        fragment.reverse();
        fragment
    }
}
