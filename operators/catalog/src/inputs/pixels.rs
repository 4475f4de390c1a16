//! What several operators see of an image: its colours, its labels, or a classifier's scores.

use evermap_algorithms::learning::dense_crf::ColourView;
use evermap_algorithms::semantic_map::class_scores::ScoresView;
use evermap_algorithms::semantic_map::semantic_graph::MOST_CLASSES;
use evermap_contract::Reason;
use evermap_schemas::Bytes;
use evermap_schemas::layers::{ClassScores, LabelImage};
use evermap_vision::{Grey, ImageError, Rgb, decode_colour, decode_labels, encode_png};

use crate::inputs::rig::frame;

/// Why an image is left out that is damaged, or no picture: `encoding` is that of its reference, empty where that is not
/// known.
pub(crate) fn undecoded(camera: &str, encoding: &str) -> Reason {
    let camera = frame(camera);
    match encoding {
        "" => format!("image of camera `{camera}` does not decode").into(),
        _ => format!("image of camera `{camera}` ({encoding}) does not decode").into(),
    }
}

/// Why an image is left out that gives this error; `undecoded` names it.
pub(crate) fn left_out(error: &ImageError, undecoded: Reason) -> Reason {
    format!("{undecoded}: {}", error.kind()).into()
}

/// An encoded image in colour; `room` holds it, and `undecoded` says why it is left out.
pub(crate) fn colours<'a>(
    bytes: &[u8],
    room: &'a mut Rgb,
    undecoded: impl Fn() -> Reason,
) -> Result<ColourView<'a>, Reason> {
    decode_colour(bytes, room).map_err(|error| left_out(&error, undecoded()))?;
    ColourView::new(room.width, room.height, &room.data).ok_or_else(undecoded)
}

/// The values of a row's label image.
pub(crate) fn labels(row: &LabelImage) -> Result<Vec<u8>, Reason> {
    values(&row.png.0, [row.width, row.height])
}

/// The values of an image of labels, whose row says this size.
pub(crate) fn values(png: &[u8], size: [u32; 2]) -> Result<Vec<u8>, Reason> {
    values_of(png, size, "label image has another size than its row says")
}

/// The values of the labels of an image of this size.
pub(crate) fn values_on_image(png: &[u8], size: [u32; 2]) -> Result<Vec<u8>, Reason> {
    values_of(png, size, "label image has another size than its image")
}

fn values_of(png: &[u8], size: [u32; 2], other: &'static str) -> Result<Vec<u8>, Reason> {
    let labels = decode_labels(png).map_err(|_| NO_LABELS)?;
    match [labels.width, labels.height] == size {
        true => Ok(labels.data),
        false => Err(other.into()),
    }
}

/// Why labels are left out that are no image.
pub(crate) const NO_LABELS: &str = "label image does not decode";

/// Values as the image that layers have.
pub(crate) fn label_image([width, height]: [u32; 2], data: Vec<u8>) -> Result<Bytes, Reason> {
    let image = Grey {
        width,
        height,
        data,
    };
    let png = encode_png(&image).map_err(|_| "label image does not encode")?;
    Ok(Bytes(png))
}

/// Why a label image with more than [`MOST_CLASSES`] is left out.
pub(crate) fn too_many_classes() -> Reason {
    format!("label image has more than {MOST_CLASSES} classes").into()
}

/// The scores of a row.
pub(crate) fn scores(row: &ClassScores) -> Result<ScoresView<'_>, Reason> {
    let (size, bytes) = ([row.width, row.height], &row.probabilities.0);
    ScoresView::new(size, row.stride_px, row.classes.len(), bytes)
        .ok_or("scores do not have the size that they claim".into())
}
