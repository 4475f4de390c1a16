//! What there is to show of a stable map: views as they were labelled, with what others saw behind what moves, with what is
//! only inferred, and, in simulated worlds, as they truly are without what moves.

mod truth;

use evermap_engine::quoted;
use evermap_schemas::layers::{InferredLabels, LabelImage, WarpedLabels};
use evermap_schemas::{Fault, LayerRow};

use crate::reader::{MapReader, typed};
use crate::shots::{image, row, spread};
use crate::shown::Shot;

/// One view.
#[derive(Debug, Clone, PartialEq)]
pub struct StableView {
    /// Which one it is.
    pub shot: Shot,
    /// The encoded image; `None` where its log is gone, or has none.
    pub image: Option<Vec<u8>>,
    /// Its labels as they were given.
    pub before: LabelImage,
    /// With what other views saw behind what moves.
    pub warped: WarpedLabels,
    /// With what was inferred behind the rest.
    pub stable: InferredLabels,
    /// What is there without what moves, an index into the classes of `stable` for each pixel; `None` where nobody knows.
    pub truth: Option<Vec<u8>>,
}

/// The stable map of one site.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StableMap {
    /// Some views, spread over those that show something that moves, or over all where none does.
    pub views: Vec<StableView>,
    /// All classes of those views, and what colours count by.
    pub classes: Vec<String>,
}

/// That a view shows something that moves.
const MOVES: &str =
    "(unseen_px > 0 OR unclear_px > 0 OR coalesce(array_length(occlusions), 0) > 0)";

/// The first layer that a stable map is drawn of and that the map does not have; `None` where it has all.
pub fn lacking(reader: &MapReader) -> Option<&'static str> {
    let layers = [
        (LabelImage::NAME, reader.layer_of::<LabelImage>()),
        (WarpedLabels::NAME, reader.layer_of::<WarpedLabels>()),
        (InferredLabels::NAME, reader.layer_of::<InferredLabels>()),
    ];
    let mut lacking = layers.into_iter().filter(|(_, layer)| layer.is_none());
    lacking.next().map(|(name, _)| name)
}

/// Some views of a site without what moves; `None` where the map has none of it.
///
/// # Errors
/// As [`MapReader::ask`].
pub async fn stable_map(reader: &MapReader, site: &str) -> Result<Option<StableMap>, Fault> {
    let mut shots = shots(reader, site, MOVES).await?;
    if shots.is_empty() {
        shots = self::shots(reader, site, "true").await?;
    }
    let mut found = StableMap::default();
    for shot in spread(shots) {
        let rows = (
            row::<LabelImage>(reader, &shot).await?,
            row::<WarpedLabels>(reader, &shot).await?,
            row::<InferredLabels>(reader, &shot).await?,
        );
        let (Some(before), Some(warped), Some(stable)) = rows else {
            continue;
        };
        for class in &stable.classes {
            if !found.classes.contains(class) {
                found.classes.push(class.clone());
            }
        }
        found.views.push(StableView {
            image: image(&reader.map, &shot).await,
            truth: truth::of(&reader.map, &shot, &stable.classes).await,
            shot,
            before,
            warped,
            stable,
        });
    }
    Ok(Some(found).filter(|found| !found.views.is_empty()))
}

/// The views of a site for which this holds, in the order of their sessions, stamps and cameras.
async fn shots(reader: &MapReader, site: &str, condition: &str) -> Result<Vec<Shot>, Fault> {
    let Some(layer) = reader.layer_of::<WarpedLabels>() else {
        return Ok(Vec::new());
    };
    let (layer, site) = (quoted::name(&layer), quoted::text(site));
    let query = format!(
        "SELECT site, session, stamp, camera FROM {layer} WHERE site = {site} AND {condition} \
         ORDER BY session, stamp, camera"
    );
    typed(&reader.ask(&query).await?)
}
