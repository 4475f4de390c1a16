//! Paint on images: from acts of annotation to what lies on an image. `taught_labels` does this when a plan runs; programs
//! that people paint with do the same.

use std::collections::BTreeMap;

use evermap_algorithms::labels::folding::{Act, Annotation, folded};
use evermap_algorithms::labels::painting::{Paint, PaintError};
use evermap_schemas::Stamp;
use evermap_schemas::roles::ImageAnnotation;

use crate::inputs::labels::Tell;

/// An image: session, exposure instant and camera.
pub type ImageKey = (String, Stamp, String);

/// The image that an act is about.
fn image_of(act: &ImageAnnotation) -> ImageKey {
    let (session, camera) = (&act.image_session, &act.image_camera);
    (session.clone(), act.image_stamp, camera.clone())
}

/// Acts by the image that they are about.
pub fn by_image(acts: Vec<ImageAnnotation>) -> BTreeMap<ImageKey, Vec<ImageAnnotation>> {
    let mut images = BTreeMap::<_, Vec<_>>::new();
    for act in acts {
        images.entry(image_of(&act)).or_default().push(act);
    }
    images
}

/// What lies on an image, of all acts about it: later paint over earlier.
pub fn lying<'a>(acts: &'a [ImageAnnotation], tell: Tell<'_>) -> Vec<&'a ImageAnnotation> {
    let said: Vec<Annotation<'_>> = acts.iter().filter_map(said).collect();
    let folded = folded(&said);
    tell(
        "paint that contradicts another person's; the later holds".into(),
        folded.conflicts,
    );
    tell("removal of paint that does not exist".into(), folded.strays);
    let labels = folded.labels.into_values();
    let mut found: Vec<_> = labels.filter_map(|label| acts.get(label.place)).collect();
    let order = |act: &&ImageAnnotation| {
        let author = act.author.clone();
        (
            act.stamp,
            author,
            act.sequence,
            act.session.clone(),
            act.id.clone(),
        )
    };
    found.sort_by_cached_key(order);
    found
}

fn said(row: &ImageAnnotation) -> Option<Annotation<'_>> {
    Some(Annotation {
        label: &row.id,
        stamp: row.stamp.0,
        author: &row.author,
        sequence: row.sequence,
        log: &row.session,
        act: Act::named(&row.act)?,
        places: row.shape.is_some(),
    })
}

/// What an act paints on an image of this width and height.
///
/// # Errors
/// Where it cannot be painted there.
pub fn paint(act: &ImageAnnotation, size: [usize; 2]) -> Result<Paint<'_>, PaintError> {
    let paint = match act.brush_px {
        Some(brush_px) => Paint::Stroke {
            line: &act.points,
            brush_px,
        },
        None => Paint::Polygon(&act.points),
    };
    paint.check(size)?;
    Ok(paint)
}
