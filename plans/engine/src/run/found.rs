//! What was done before for a unit: a receipt that is of this unit, with rows that are what was written.

use evermap_schemas::{Fault, Layer};

use crate::map::artifact::columns_of;
use crate::map::damage::Damage;
use crate::map::receipt::{Artifact, Receipt};
use crate::map::sound::Sound;
use crate::run::Run;
use crate::run::pending::Pending;
use crate::run::previous_units::PreviousUnits;

impl Run<'_> {
    /// The receipt of a unit whose recipe has this digest, with what is wrong with its rows, or with itself: one that leads to the
    /// rows of another unit is as good as torn. What the version before says of the recipe is believed; of other files the end is
    /// read, where their columns are. Files of queries have no columns that are known before; of them it is known that they are
    /// of no operator.
    ///
    /// # Errors
    /// As [`Sound::receipt`].
    pub async fn found(
        &self,
        (sound, held): (&Sound<'_>, &PreviousUnits<'_>),
        unit: &Pending,
        digest: &str,
    ) -> Result<Option<(Receipt, Option<Damage>)>, Fault> {
        Ok(match sound.receipt(digest).await? {
            Some((receipt, None)) => {
                let damage = self.misfit(held, unit, &receipt).await;
                Some((receipt, damage))
            }
            found => found,
        })
    }

    async fn misfit(
        &self,
        held: &PreviousUnits<'_>,
        unit: &Pending,
        receipt: &Receipt,
    ) -> Option<Damage> {
        let (artifact, id) = (&receipt.artifact, &unit.id);
        let damage = |expected: String, found: String| Damage {
            file: Receipt::name(&receipt.digest),
            expected,
            found: Some(found),
        };
        if artifact.extent != id.extent {
            let [expected, found] = [&id.extent, &artifact.extent].map(|of| of.label("rows"));
            return Some(damage(expected, found));
        }
        if held.artifact(id, &receipt.digest) == Some(artifact) {
            return None;
        }
        let layer = unit
            .stages
            .last()
            .and_then(|stage| stage.layer(self.registry));
        let found = self.other_columns(artifact, layer.as_ref()).await;
        let expected = match layer {
            Some(layer) => format!("rows of layer {}", layer.name),
            None => "rows of a query".to_owned(),
        };
        found.map(|found| damage(expected, found))
    }

    /// How the columns of a file differ from those of a layer, or of what is none.
    async fn other_columns(&self, artifact: &Artifact, layer: Option<&Layer>) -> Option<String> {
        let Ok(columns) = columns_of(self.store, artifact).await else {
            return Some("a file that does not read".to_owned());
        };
        let written = columns.metadata().get(Layer::SAID_AS);
        if written.map(String::as_str) != layer.map(|layer| layer.name) {
            return Some(match written {
                Some(name) => format!("rows of layer {name}"),
                None => "rows of a query".to_owned(),
            });
        }
        let wanted = layer.into_iter().flat_map(|layer| &layer.columns);
        let mut wanted = wanted.map(|column| column.name);
        let missing = wanted.find(|name| columns.field_with_name(name).is_err());
        missing.map(|name| format!("rows without {name}"))
    }
}
