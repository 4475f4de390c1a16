//! Overhead tiles as one picture.

use arrow::array::RecordBatch;
use evermap_engine::conform::conform;
use evermap_schemas::{Fault, LayerRow, rows};

use crate::mosaic::{Mosaic, level, zoom_for};
use crate::shown::Tile;

/// The tiles of a zoom level, the finest that fits where none is given, of one site.
///
/// # Errors
/// A user fault for a layer that is no tiles, or of several sites.
pub fn picture(batches: &[RecordBatch], zoom: Option<u32>) -> Result<Mosaic, Fault> {
    let mut tiles: Vec<Tile> = Vec::new();
    for batch in batches {
        let tile = conform(batch, &Tile::layer()).map_err(|fault| {
            Fault::user(format!(
                "a picture is made of overhead tiles: {}",
                fault.message
            ))
        })?;
        tiles.extend(rows(&tile)?);
    }
    let mut sites: Vec<String> = tiles.iter().map(|tile| tile.site.clone()).collect();
    sites.sort();
    sites.dedup();
    if sites.len() > 1 {
        return Err(Fault::user("a picture is of one site")
            .next(format!("choose one with --site: {}", sites.join(", "))));
    }
    let zoom = zoom
        .or_else(|| zoom_for(&tiles, 0.0))
        .ok_or_else(|| Fault::user("there are no tiles"))?;
    Mosaic::of(&level(&tiles, zoom))
}
