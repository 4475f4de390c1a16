//! What a network sees of an image, as features of its pixels.

use evermap_algorithms::learning::pixel_features::{Backbone, FeatureMap};
use evermap_vision::{Activation, activations};

/// EfficientNet-Lite0.
pub(crate) const BACKBONE: Backbone = |image, area_px| {
    let size = [image.width(), image.height()].map(|side| side as u32);
    let found = activations(size, image.pixels().as_flattened(), area_px);
    let found = found.map_err(|error| error.to_string())?;
    Ok(found.into_iter().map(map).collect())
};

fn map(stage: Activation) -> FeatureMap {
    FeatureMap {
        channels: stage.channels,
        size: stage.size,
        cells_per_px: stage.cells_per_px,
        values: stage.values,
    }
}
