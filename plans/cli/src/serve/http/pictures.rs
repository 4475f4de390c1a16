//! Pictures of maps: overhead tiles, and the camera images behind keyframes.

use std::collections::BTreeMap;

use axum::extract::{Path, Query, State};
use axum::http::HeaderMap;
use axum::response::Response;
use datafusion::execution::memory_pool::MemoryConsumer;
use datafusion::prelude::{col, lit};
use evermap_catalog::painted::ImageKey;
use evermap_engine::error::OrFault;
use evermap_schemas::layers::OverheadTile;
use evermap_schemas::{Fault, Stamp};
use serde::Deserialize;

use crate::camera_images::{file, rows};
use crate::cutout::{self, PNG, Rectangle};
use crate::reader::typed;
use crate::serve::http::{App, Asks, MapOf, Refusal, named, tagged};
use crate::serve::maps::Opened;
use crate::shown::Tile;

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
    let found = app.within(rows(&opened.context, &layer, wanted)).await?;
    let tile = typed::<Tile>(&found)?.into_iter().next();
    let tile = tile.ok_or_else(|| Fault::user("there is no such tile"))?;
    let digest = blake3::hash(&tile.png.0).to_hex();
    Ok(tagged(&headers, &digest, PNG, tile.png.0))
}

/// A number of a path.
fn number<T: std::str::FromStr>(path: &BTreeMap<String, String>, name: &str) -> Result<T, Fault> {
    let text = path.get(name).map_or("", String::as_str);
    text.parse()
        .map_err(|_| Fault::user(format!("expected a number as {name}, found {text:?}")))
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
    /// The rectangle around which it is shown.
    #[serde(default)]
    around: Option<String>,
}

/// `GET /images?session=…&camera=…&stamp=…`: the image of a camera that the map names, out of its log: JPEG or PNG as it was
/// recorded, else PNG. With `&around=LEAST_COLUMN,LEAST_ROW,LARGEST_COLUMN,LARGEST_ROW` the part around a rectangle, with the
/// rectangle drawn, as PNG.
///
/// # Errors
/// As [`file`]; for what is no rectangle of the image, and where memory does not suffice to decode it.
pub async fn image(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Query(asked)): Asks<Query<AskedImage>>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let around = asked.around.as_deref().map(Rectangle::parse).transpose()?;
    let opened = map.version(asked.version).await?;
    let key = (asked.session, Stamp(asked.stamp), asked.camera);
    let (kind, bytes) = app.within(shown(&app, &opened, &key, around)).await?;
    let digest = blake3::hash(&bytes).to_hex();
    Ok(tagged(&headers, &digest, kind, bytes))
}

/// What a browser is shown of an image, and what it is. The memory that decoding takes is reserved, and left with its end, also
/// where nobody waits for it any more.
async fn shown(
    app: &App,
    opened: &Opened,
    key: &ImageKey,
    around: Option<Rectangle>,
) -> Result<(&'static str, Vec<u8>), Fault> {
    let bytes = file(&opened.reader, &opened.context, key).await?;
    if let (Some(kind), None) = (cutout::kind_of(&bytes), around) {
        return Ok((kind, bytes.to_vec()));
    }
    let memory = MemoryConsumer::new("an image that is decoded").register(&app.bounds.memory);
    memory.try_grow(cutout::memory(&bytes)?).or_fault()?;
    let work = tokio::task::spawn_blocking(move || {
        let shown = match around {
            Some(around) => cutout::part(&bytes, around),
            None => cutout::whole(&bytes),
        };
        drop(memory);
        shown
    });
    let shown = work.await.map_err(|error| Fault::bug(error.to_string()))?;
    Ok((PNG, shown?))
}
