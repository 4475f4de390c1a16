//! A checked plan.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::fault::{Location, PlanFaults, Position};

/// How far numbers in a plan's test may be apart when the test does not say.
pub const DEFAULT_TOLERANCE: f64 = 1e-9;

/// A plan without errors: every name in it exists, and its steps form no cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Its name.
    pub name: String,
    /// What it is for.
    pub doc: Option<String>,
    /// Roles that a session must play for the plan to be of use. One that plays some of them must play all.
    pub needs: Vec<String>,
    /// The session manifest.
    pub sessions: Option<ManifestPath>,
    /// The steps, each after all it reads; otherwise in written order.
    pub steps: Vec<Step>,
    /// The steps whose layers are published, in written order.
    pub write: Vec<String>,
    /// Tests of the plan.
    pub tests: Vec<PlanTest>,
    /// What is allowed but probably not meant.
    pub warnings: PlanFaults,
}

/// Path of a session manifest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ManifestPath {
    /// The path, as written.
    pub path: String,
    /// Origin of the plan that it is written in.
    pub origin: String,
    /// The path for who reads it as relative to the plan itself, where it is relative to its origin.
    pub from_plan: String,
}

/// One step: it makes the layer of its name.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Name of the step and of its layer.
    pub name: String,
    /// Where the name is written.
    pub position: Position,
    /// What it reads: by port; of a query, by the name that a table has there. Optional ports may be absent.
    pub inputs: BTreeMap<String, Input>,
    /// What makes the layer.
    pub body: Body,
    /// Where that is written: a query, from its first character on.
    pub body_location: Location,
    /// Whether its rows of the version before are kept until something else that it reads than that version has changed.
    pub once: bool,
}

/// What a step does.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// An operator.
    Op {
        /// Its name.
        op: String,
        /// The parameters that the plan gives, an object; the others have the operator's defaults.
        params: Value,
    },
    /// A query.
    Sql {
        /// Its text.
        query: String,
    },
    /// A function in Python.
    Python(Box<PythonStep>),
}

/// A function in Python, as a plan names it.
#[derive(Debug, Clone, PartialEq)]
pub struct PythonStep {
    /// The file, relative to the plan, also where one that it extends names it.
    pub file: String,
    /// The function in it.
    pub function: String,
    /// The text of the file.
    pub code: String,
    /// What it is given beside tables.
    pub params: Map<String, Value>,
    /// How much it is given at once.
    pub grain: Grain,
    /// Its columns: the name of a layer that has them, or an object from name to type.
    pub output: Value,
    /// By input, the column of references whose images it is given too.
    pub pixels: BTreeMap<String, String>,
}

/// How much a function is given at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grain {
    /// Any rows of its only table.
    Rows,
    /// All rows of one session.
    Session,
    /// All rows of one site.
    Site,
    /// All rows.
    Map,
}

impl Grain {
    /// All, as plans name them.
    pub const NAMED: [(&'static str, Self); 4] = [
        ("rows", Self::Rows),
        ("session", Self::Session),
        ("site", Self::Site),
        ("map", Self::Map),
    ];

    /// Its name in plans.
    #[must_use]
    pub fn name(self) -> &'static str {
        let named = Self::NAMED.iter().find(|(_, grain)| *grain == self);
        named.map_or("rows", |(name, _)| name)
    }
}

/// A layer that a step reads.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Input {
    /// The layer another step makes.
    Step(String),
    /// A table that exists before any step.
    Source(String),
    /// The layer of this name in the version of the map before, written `previous.NAME`.
    Previous(String),
    /// The rows of the layer another step makes that are of sessions which the version before did not have, written
    /// `new.NAME`.
    New(String),
}

/// A test that a plan carries: rows in, rows out.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanTest {
    /// Its name.
    pub name: String,
    /// Where it is written.
    pub position: Position,
    /// Rows of sources, and of steps that are then not run. Tables not given are empty.
    pub given: Vec<(Input, Vec<Row>)>,
    /// Rows that steps must make, and no others; only the columns listed are compared.
    pub expect: Vec<(String, Vec<Row>)>,
    /// Rows that must be among those that steps make, in any order; only the columns listed are compared.
    pub contains: Vec<(String, Vec<Row>)>,
    /// How far numbers may be apart, absolute, in the unit of the column.
    pub tolerance: f64,
}

/// One row of a test: column to value.
pub type Row = Map<String, Value>;

impl Input {
    /// The prefix that names a layer of the version before.
    pub const PREVIOUS: &'static str = "previous.";
    /// The prefix that names the rows of new sessions.
    pub const NEW: &'static str = "new.";

    /// The name as written in a plan.
    #[must_use]
    pub fn written(&self) -> String {
        match self {
            Self::Step(name) | Self::Source(name) => name.clone(),
            Self::Previous(name) => format!("{}{name}", Self::PREVIOUS),
            Self::New(name) => format!("{}{name}", Self::NEW),
        }
    }
}

impl Plan {
    /// No faults yet, for a check that goes on with this plan.
    #[must_use]
    pub fn faults(&self) -> PlanFaults {
        self.warnings.none_yet()
    }

    /// The step of this name.
    #[must_use]
    pub fn step(&self, name: &str) -> Option<&Step> {
        self.steps.iter().find(|step| step.name == name)
    }
}
