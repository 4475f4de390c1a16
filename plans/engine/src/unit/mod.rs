//! A work unit: one stage for one session, one site, or the whole map.
//!
//! A unit is self-contained. It says what to read, by digest and by URL, and runs the same in this process, in
//! another, or on another machine; what it leaves behind is one artifact under its content's digest, and a receipt
//! under its recipe's.

pub mod build;
mod execute;
mod tables;
pub mod work;
mod write;

use evermap_datasets::Manifest;
use evermap_schemas::Fault;
use serde::{Deserialize, Serialize};

use crate::map::lease;
use crate::map::receipt::{Receipt, Recipe};
use crate::map::store::Store;
use crate::program::Stage;
use crate::sql::Limits;

/// A unit of work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unit {
    /// URL of the map store.
    pub store: String,
    /// What it reads and does, which is all that the result depends on.
    pub recipe: Recipe,
    /// The logs that are read, as manifests of one session each.
    pub logs: Vec<Manifest>,
    /// What it may use.
    pub limits: Limits,
    /// The lease of the run that it is for.
    pub lease: String,
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

    /// Whether the run that it is for is at work still, as far as its lease says.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn is_wanted(&self) -> Result<bool, Fault> {
        lease::is_held(&Store::open(&self.store, false)?, &self.lease).await
    }

    /// Whether somebody has done it by now, as far as its receipt says.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn is_done(&self) -> Result<bool, Fault> {
        let store = Store::open(&self.store, false)?;
        let receipt = Receipt::find(&store, &self.recipe.digest()?).await?;
        Ok(receipt.is_some())
    }

    /// What a person calls it.
    pub fn label(&self) -> String {
        let stage = self.recipe.stages.last();
        let stage = stage.map_or("", |stage| stage.name.as_str());
        self.recipe.extent.label(stage)
    }
}
