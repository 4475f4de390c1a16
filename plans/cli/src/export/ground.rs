//! Overhead tiles as one picture.

use arrow::array::RecordBatch;
use evermap_schemas::Fault;

use crate::mosaic::{Mosaic, at, zoom_for};
use crate::reader::{one_site, typed};
use crate::shown::Tile;

/// The tiles of a zoom level, the finest that fits where none is given, of one site, and which site that is.
///
/// # Errors
/// A user fault for a layer that is no tiles, or of several sites, or has no such level.
pub fn picture(batches: &[RecordBatch], zoom: Option<u32>) -> Result<(Mosaic, String), Fault> {
    let tiles: Vec<Tile> = typed(batches).map_err(|fault| {
        let what = fault.message;
        Fault::user(format!("a picture is made of overhead tiles: {what}"))
    })?;
    let site = one_site(tiles.iter().map(|tile| tile.site.as_str()), None)?;
    let zoom = zoom.or_else(|| zoom_for(&tiles, 0.0)).ok_or_else(|| {
        // There are tiles, as they have a site.
        Fault::user("all zoom levels make too large a picture")
            .next("set more `zooms` for overhead_tiles: each is twice as coarse")
    })?;
    Ok((Mosaic::of(&at(&tiles, zoom)?)?, site))
}
