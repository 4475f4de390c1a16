//! What the steps that made a version were given.

use evermap_schemas::Fault;
use serde_json::Value;

use crate::map::Map;
use crate::map::receipt::{Extent, Receipt};

impl Map {
    /// The value that a parameter had in the steps that made what a site has, the first layer's by name whose operator has
    /// such a parameter; `None` where none has, or nothing is known of their work any more.
    ///
    /// # Errors
    /// A resource fault when the store does not answer.
    pub async fn parameter(&self, name: &str, site: &str) -> Result<Option<Value>, Fault> {
        let is_of_site = |extent: &Extent| extent.site.as_ref().is_none_or(|of| of == site);
        for layer in self.version.layers.values() {
            let mut made = layer.artifacts.iter().zip(&layer.recipes);
            let Some((_, recipe)) = made.find(|(artifact, _)| is_of_site(&artifact.extent)) else {
                continue;
            };
            let Some(receipt) = Receipt::read(&self.store, recipe).await? else {
                continue;
            };
            let mut stages = receipt.recipe.stages.iter();
            if let Some(value) = stages.find_map(|stage| stage.params()?.get(name)) {
                return Ok(Some(value.clone()));
            }
        }
        Ok(None)
    }
}
