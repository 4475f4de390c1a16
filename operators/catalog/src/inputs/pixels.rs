//! What several operators see of an image: its colours, or a classifier's scores.

use evermap_algorithms::learning::dense_crf::ColourView;
use evermap_algorithms::semantic_map::class_scores::ScoresView;
use evermap_contract::Reason;
use evermap_schemas::layers::ClassScores;
use evermap_vision::{Rgb, decode_colour};

/// An encoded image in colour; `room` holds it.
pub(crate) fn colours<'a>(bytes: &[u8], room: &'a mut Rgb) -> Result<ColourView<'a>, Reason> {
    decode_colour(bytes, room).map_err(|_| "image does not decode")?;
    ColourView::new(room.width, room.height, &room.data).ok_or("image does not decode".into())
}

/// The scores of a row.
pub(crate) fn scores(row: &ClassScores) -> Result<ScoresView<'_>, Reason> {
    let (size, bytes) = ([row.width, row.height], &row.probabilities.0);
    ScoresView::new(size, row.stride_px, row.classes.len(), bytes)
        .ok_or("scores do not have the size that they claim".into())
}
