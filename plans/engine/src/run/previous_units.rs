//! What the version before has of a run's units.

use std::collections::BTreeMap;

use evermap_schemas::Fault;

use crate::map::receipt::{Artifact, Extent, Receipt};
use crate::map::store::Store;
use crate::run::Run;
use crate::run::pending::{Pending, UnitId};

/// The units of the version before, by what a person calls them: a session may be of another site since.
#[derive(Debug)]
pub struct PreviousUnits<'r> {
    store: &'r Store,
    /// Its rows, and the digest of its recipe.
    units: BTreeMap<String, (&'r Artifact, &'r str)>,
}

impl PreviousUnits<'_> {
    /// The receipt of a unit of the version before, whatever has become of its rows since; `None` where it had no such
    /// unit or the receipt is gone.
    ///
    /// # Errors
    /// As [`Receipt::read`].
    pub async fn receipt(&self, id: &UnitId) -> Result<Option<Receipt>, Fault> {
        match self.units.get(&id.label()) {
            Some((_, digest)) => Receipt::read(self.store, digest).await,
            None => Ok(None),
        }
    }

    /// The receipt of a unit in the version before, where [`Pending::assemble`] needs it: what was done once stays as it
    /// was then.
    ///
    /// # Errors
    /// As [`PreviousUnits::receipt`].
    pub async fn once(&self, unit: &Pending) -> Result<Option<Receipt>, Fault> {
        match unit.is_done_once() {
            true => self.receipt(&unit.id).await,
            false => Ok(None),
        }
    }

    /// The rows of a unit in the version before, if they were made by the recipe of this digest.
    pub fn artifact(&self, id: &UnitId, digest: &str) -> Option<&Artifact> {
        let (artifact, held) = self.units.get(&id.label())?;
        (*held == digest).then_some(*artifact)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.units.is_empty()
    }

    /// What the units cover.
    pub fn extents(&self) -> impl Iterator<Item = &Extent> {
        self.units.values().map(|(artifact, _)| &artifact.extent)
    }
}

impl Run<'_> {
    /// The units of the version before.
    pub fn held(&self) -> PreviousUnits<'_> {
        let layers = self.base.iter().flat_map(|base| &base.layers);
        let units = layers.flat_map(|(stage, layer)| {
            let units = layer.artifacts.iter().zip(&layer.recipes);
            units.map(move |(artifact, digest)| {
                let label = artifact.extent.label(stage);
                (label, (artifact, digest.as_str()))
            })
        });
        PreviousUnits {
            store: self.store,
            units: units.collect(),
        }
    }
}
