//! Pictures of maps: overhead tiles, and the camera images behind keyframes.

use std::collections::BTreeMap;

use axum::extract::{Path, Query, State};
use axum::http::HeaderMap;
use axum::response::Response;
use bytes::Bytes;
use datafusion::prelude::{Expr, col, lit};
use evermap_catalog::painted::ImageKey;
use evermap_datasets::ImageReader;
use evermap_engine::error::OrFault;
use evermap_schemas::layers::{Keyframe, OverheadTile};
use evermap_schemas::{Fault, ImageRef, Stamp};
use serde::Deserialize;

use crate::reader::typed;
use crate::serve::http::{App, Asks, MapOf, Refusal, named, tagged};
use crate::serve::maps::{Opened, ServedMap};
use crate::shown::{Picture, Tile};

/// `GET /tiles/{site}/{version}/{zoom}/{x}/{y}`: a tile as the layer has it.
///
/// # Errors
/// For a version or tile that is not there.
pub async fn tile(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Path(path)): Asks<Path<BTreeMap<String, String>>>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let site = named(&path, "site");
    let version = match path.get("version").map(String::as_str) {
        Some("newest") => None,
        _ => Some(number(&path, "version")?),
    };
    let opened = map.version(version).await?;
    let layer = opened.reader.layer_of::<OverheadTile>();
    let layer = layer.ok_or_else(|| Fault::user("the map has no overhead tiles"))?;
    let wanted = col("site")
        .eq(lit(site))
        .and(col("zoom").eq(lit(number::<u32>(&path, "zoom")?)))
        .and(col("tile_x").eq(lit(number::<i32>(&path, "x")?)))
        .and(col("tile_y").eq(lit(number::<i32>(&path, "y")?)));
    let found = app.within(rows(&opened, &layer, wanted)).await?;
    let tile = typed::<Tile>(&found)?.into_iter().next();
    let tile = tile.ok_or_else(|| Fault::user("there is no such tile"))?;
    let digest = blake3::hash(&tile.png.0).to_hex();
    Ok(tagged(&headers, &digest, "image/png", tile.png.0))
}

/// A number of a path.
fn number<T: std::str::FromStr>(path: &BTreeMap<String, String>, name: &str) -> Result<T, Fault> {
    let text = path.get(name).map_or("", String::as_str);
    text.parse()
        .map_err(|_| Fault::user(format!("expected a number as {name}, found {text:?}")))
}

/// The rows of a layer that something holds of.
async fn rows(
    opened: &Opened,
    layer: &str,
    wanted: Expr,
) -> Result<Vec<arrow::array::RecordBatch>, Fault> {
    let table = opened.context.table(layer).await.or_fault()?;
    let found = table.filter(wanted).or_fault()?;
    found.collect().await.or_fault()
}

/// Which image is asked for.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AskedImage {
    session: String,
    camera: String,
    /// Exposure instant, ns.
    stamp: i64,
    #[serde(default)]
    version: Option<u64>,
}

/// `GET /images?session=…&camera=…&stamp=…`: the image of a camera that the map names, out of its log.
///
/// # Errors
/// As [`bytes`].
pub async fn image(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Query(asked)): Asks<Query<AskedImage>>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let opened = map.version(asked.version).await?;
    let key = (asked.session, Stamp(asked.stamp), asked.camera);
    let bytes = app.within(bytes(&opened, &map, &key)).await?;
    let kind = match bytes.get(..4) {
        Some([0xFF, 0xD8, ..]) => "image/jpeg",
        Some(b"\x89PNG") => "image/png",
        _ => {
            let fault = Fault::data("the image is neither JPEG nor PNG");
            return Err(fault.next("open the log itself").into());
        }
    };
    let digest = blake3::hash(&bytes).to_hex();
    Ok(tagged(&headers, &digest, kind, bytes.to_vec()))
}

/// An image, out of its log.
///
/// # Errors
/// For an image that neither pictures nor keyframes name, or a log that is gone.
pub async fn bytes(opened: &Opened, map: &ServedMap, key: &ImageKey) -> Result<Bytes, Fault> {
    let (session, ..) = key;
    let log = opened.reader.map.log(session, map.runtime()).await?;
    let log = log.ok_or_else(|| Fault::user(format!("the map has no session {session}")))?;
    let image = reference(opened, key).await?;
    let reader = ImageReader::new(&log, ImageReader::CACHE_BYTES);
    let mut bytes = reader.resolve(&[image]).await?;
    bytes
        .pop()
        .unwrap_or_else(|| Err(Fault::bug("an image was not answered")))
}

/// Where an image lies: as the layer of pictures has it, or a keyframe.
async fn reference(
    opened: &Opened,
    (session, stamp, camera): &ImageKey,
) -> Result<ImageRef, Fault> {
    let wanted = || col("session").eq(lit(session.as_str()));
    if let Some(layer) = opened.reader.layer_of::<Picture>() {
        let wanted = wanted().and(col("camera").eq(lit(camera.as_str())));
        let pictures = typed::<Picture>(&rows(opened, &layer, wanted).await?)?;
        let found = pictures.into_iter().find(|row| row.stamp == *stamp);
        if let Some(found) = found {
            return Ok(found.image);
        }
    }
    if let Some(layer) = opened.reader.layer_of::<Keyframe>() {
        let keyframes = typed::<Keyframe>(&rows(opened, &layer, wanted()).await?)?;
        let mut images = keyframes.into_iter().flat_map(|keyframe| keyframe.images);
        let found = images.find(|image| image.camera == *camera && image.stamp == *stamp);
        if let Some(found) = found {
            return Ok(found.image);
        }
    }
    Err(Fault::user(format!(
        "the map has no image of {camera} in {session} at {} ns",
        stamp.0
    ))
    .next("its pictures and the images of its keyframes are there: SELECT session, unnest(images) FROM keyframes"))
}
