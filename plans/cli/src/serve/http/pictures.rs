//! Pictures of maps: overhead tiles, and the camera images behind keyframes.

use std::collections::BTreeMap;

use axum::extract::{Path, Query, State};
use axum::http::HeaderMap;
use axum::response::Response;
use datafusion::prelude::{Expr, col, lit};
use evermap_datasets::ImageReader;
use evermap_engine::error::OrFault;
use evermap_schemas::layers::{Keyframe, OverheadTile};
use evermap_schemas::{Fault, Stamp};
use serde::Deserialize;

use crate::reader::typed;
use crate::serve::http::{App, MapOf, Refusal, tagged};
use crate::serve::maps::Opened;
use crate::shown::Tile;

/// `GET /tiles/{site}/{version}/{zoom}/{x}/{y}`: a tile as the layer has it.
///
/// # Errors
/// For a version or tile that is not there.
pub async fn tile(
    State(app): State<App>,
    MapOf(map): MapOf,
    Path(path): Path<BTreeMap<String, String>>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let site = path.get("site").map_or("", String::as_str);
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

/// Bytes of log that stay decompressed while images are asked for.
const CACHE_BYTES: u64 = 64 << 20;

/// `GET /images?session=…&camera=…&stamp=…`: the image of a camera that a keyframe names, out of its log.
///
/// # Errors
/// For an image that no keyframe names, or a log that is gone.
pub async fn image(
    State(app): State<App>,
    MapOf(map): MapOf,
    Query(asked): Query<AskedImage>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let opened = map.version(asked.version).await?;
    let found = app.within(async {
        let layer = opened.reader.layer_of::<Keyframe>();
        let layer = layer.ok_or_else(|| Fault::user("the map has no keyframes"))?;
        let wanted = col("session").eq(lit(asked.session.as_str()));
        let keyframes = typed::<Keyframe>(&rows(&opened, &layer, wanted).await?)?;
        let mut images = keyframes.into_iter().flat_map(|keyframe| keyframe.images);
        let image =
            images.find(|image| image.camera == asked.camera && image.stamp == Stamp(asked.stamp));
        let image = image.ok_or_else(|| {
            Fault::user("no keyframe has such an image")
                .next("SELECT session, unnest(images) FROM keyframes")
        })?;
        let log = opened.reader.map.log(&asked.session, map.runtime()).await?;
        let log =
            log.ok_or_else(|| Fault::user(format!("the map has no session {}", asked.session)))?;
        let reader = ImageReader::new(&log, CACHE_BYTES);
        let mut bytes = reader.resolve(&[image.image]).await?;
        bytes
            .pop()
            .unwrap_or_else(|| Err(Fault::bug("an image was not answered")))
    });
    let bytes = found.await?;
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
