//! A work unit: one stage for one session, one site, or the whole map.
//!
//! A unit is self-contained. It says what to read, by digest and by URL, and runs the same in this process, in
//! another, or on another machine; what it leaves behind is one artifact under its content's digest, and a receipt
//! under its recipe's.

pub mod build;
mod execute;
mod tables;
mod write;

use std::collections::BTreeMap;

use evermap_datasets::Manifest;
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};

use crate::map::receipt::{Artifact, Recipe};
use crate::program::Stage;
use crate::sql::Limits;

/// A layer of the version before, as a unit reads it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PreviousLayer {
    /// The operator that makes the layer in this plan: gives the columns where there is no version before.
    pub op: Option<String>,
    /// The rows; none where there is no version before.
    pub artifacts: Vec<Artifact>,
    /// Sessions whose rows are left out: their logs have been replaced.
    #[serde(default)]
    pub without: Vec<String>,
}

/// A unit of work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unit {
    /// URL of the map store.
    pub store: String,
    /// What the result depends on.
    pub recipe: Recipe,
    /// The rows of the stored stages that are read.
    pub tables: BTreeMap<String, Vec<Artifact>>,
    /// The layers of the version before that are read.
    pub previous: BTreeMap<String, PreviousLayer>,
    /// The logs that are read, as manifests of one session each.
    pub logs: Vec<Manifest>,
    /// What it may use.
    pub limits: Limits,
}

impl Unit {
    /// The stage that it makes.
    ///
    /// # Errors
    /// A bug fault for a unit without stages.
    pub fn stage(&self) -> Result<&Stage, Fault> {
        self.recipe
            .stages
            .last()
            .ok_or_else(|| Fault::bug("a unit without stages"))
    }

    /// What a person calls it: the stage and the session or site.
    pub fn label(&self) -> String {
        let stage = self
            .recipe
            .stages
            .last()
            .map_or("", |stage| stage.name.as_str());
        match self.recipe.session.as_ref().or(self.recipe.site.as_ref()) {
            Some(of) => format!("{stage} of {of}"),
            None => stage.to_owned(),
        }
    }
}
