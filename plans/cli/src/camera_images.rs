//! The images of cameras that a map names, out of their logs.

use std::borrow::Cow;

use arrow::array::RecordBatch;
use bytes::Bytes;
use datafusion::prelude::{Expr, SessionContext, col, lit};
use evermap_catalog::painted::ImageKey;
use evermap_datasets::ImageReader;
use evermap_engine::error::OrFault;
use evermap_engine::nodes::raw::as_file;
use evermap_schemas::layers::Keyframe;
use evermap_schemas::{Fault, ImageRef, Stamp};

use crate::reader::{MapReader, typed};
use crate::shown::Picture;

/// An image as a file: JPEG or PNG as it was recorded, netpbm of raw images and video. `context` has the layers of the map
/// as tables.
///
/// # Errors
/// For an image that neither pictures nor keyframes name, a log that is gone, or an encoding that nobody here reads.
pub async fn file(
    reader: &MapReader,
    context: &SessionContext,
    key: &ImageKey,
) -> Result<Bytes, Fault> {
    let (session, ..) = key;
    let log = reader.map.log(session, &context.runtime_env()).await?;
    let log = log.ok_or_else(|| Fault::user(format!("the map has no session {session}")))?;
    let image = reference(reader, context, key).await?;
    let images = ImageReader::new(&log, ImageReader::CACHE_BYTES);
    let found = images.resolve(std::slice::from_ref(&image)).await?.pop();
    let bytes = found.unwrap_or_else(|| Err(Fault::bug("an image was not answered")))?;
    let file = as_file(&image, &bytes).map_err(|text| Fault::data(text).at(session))?;
    Ok(match file {
        Cow::Borrowed(file) => bytes.slice_ref(file),
        Cow::Owned(file) => file.into(),
    })
}

/// The rows of a layer that something holds of.
///
/// # Errors
/// As a query.
pub async fn rows(
    context: &SessionContext,
    layer: &str,
    wanted: Expr,
) -> Result<Vec<RecordBatch>, Fault> {
    let table = context.table(layer).await.or_fault()?;
    let found = table.filter(wanted).or_fault()?;
    found.collect().await.or_fault()
}

/// Where an image lies: as the layer of pictures has it, or a keyframe. By its own instant; of a keyframe whose images have
/// other instants, by the keyframe's, which plans name them by.
async fn reference(
    reader: &MapReader,
    context: &SessionContext,
    (session, stamp, camera): &ImageKey,
) -> Result<ImageRef, Fault> {
    let wanted = || col("session").eq(lit(session.as_str()));
    if let Some(layer) = reader.layer_of::<Picture>() {
        let wanted = wanted().and(col("camera").eq(lit(camera.as_str())));
        let pictures = typed::<Picture>(&rows(context, &layer, wanted).await?)?;
        let found = pictures.into_iter().find(|row| row.stamp == *stamp);
        if let Some(found) = found {
            return Ok(found.image);
        }
    }
    if let Some(layer) = reader.layer_of::<Keyframe>() {
        let keyframes = typed::<Keyframe>(&rows(context, &layer, wanted()).await?)?;
        if let Some(found) = of_keyframes(keyframes, *stamp, camera) {
            return Ok(found);
        }
    }
    Err(Fault::user(format!(
        "the map has no image of {camera} in {session} at {} ns",
        stamp.0
    ))
    .next("its pictures and the images of its keyframes are there: SELECT session, unnest(images) FROM keyframes"))
}

/// The image of a camera among those of a session's keyframes.
fn of_keyframes(keyframes: Vec<Keyframe>, stamp: Stamp, camera: &str) -> Option<ImageRef> {
    let mut by_keyframe = None;
    for keyframe in keyframes {
        let mut images = keyframe.images.into_iter();
        let Some(image) = images.find(|image| image.camera == camera) else {
            continue;
        };
        if image.stamp == stamp {
            return Some(image.image);
        }
        if keyframe.stamp == stamp {
            by_keyframe = Some(image.image);
        }
    }
    by_keyframe
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_schemas::Pose;
    use evermap_schemas::layers::KeyframeImage;

    use super::*;

    /// A keyframe of one camera whose image was taken later, and lies there.
    fn keyframe(stamp: i64, later: i64, offset: u64) -> Keyframe {
        let image = ImageRef {
            session: "a".into(),
            offset,
            length: 1,
            format: "jpeg".into(),
            ..ImageRef::default()
        };
        Keyframe {
            site: "lot".into(),
            session: "a".into(),
            stamp: Stamp(stamp),
            keyframe: 0,
            distance_m: 0.0,
            stretch: 0,
            odom_from_vehicle: Pose::IDENTITY,
            images: vec![KeyframeImage {
                camera: "front".into(),
                stamp: Stamp(stamp + later),
                image,
            }],
        }
    }

    #[test]
    fn an_image_is_found_by_its_own_instant_and_else_by_its_keyframes() {
        let found = |stamp, camera| {
            let keyframes = vec![keyframe(10, 3, 1), keyframe(13, 4, 2), keyframe(20, 0, 3)];
            of_keyframes(keyframes, Stamp(stamp), camera).map(|image| image.offset)
        };
        assert_eq!(found(10, "front"), Some(1));
        assert_eq!(found(17, "front"), Some(2));
        assert_eq!(found(20, "front"), Some(3));
        // The instant of one keyframe, and that of the image of another.
        assert_eq!(found(13, "front"), Some(1));
        assert_eq!(found(11, "front"), None);
        assert_eq!(found(10, "rear"), None);
    }
}
