//! The picture of a map: one SVG, from which the PNG is made.
//!
//! ```text
//!   tiles ─► mosaic ─┐
//!   lanes, arrows ───┤
//!   landmarks, loops ┤
//!   trajectories ────┼──► SVG ──► PNG (resvg)
//!   intersections ───┤
//!   scale, names ────┘
//! ```

mod colours;
mod drives;
mod furniture;
mod ground;
mod line;
mod metric;
mod raster;
mod roads;
mod semantic;
mod strokes;
mod view;

use evermap_schemas::Fault;

pub use colours::session as session_colour;
pub use drives::{Drive, escaped};
pub use metric::LoopLine;
pub use raster::png;
pub use semantic::{matrix, views};
use view::{Bounds, View, bounds_of, union};

use crate::mosaic::{Mosaic, level, zoom_for};
use crate::shown::{Crossing, Lane, Tile};

/// What there is to draw of one site.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// Tiles of any zoom levels; may be empty.
    pub tiles: Vec<Tile>,
    /// Lanes; may be empty.
    pub lanes: Vec<Lane>,
    /// Intersections; may be empty.
    pub intersections: Vec<Crossing>,
    /// Trajectories; may be empty.
    pub drives: Vec<Drive>,
    /// The trajectories as odometry had them, in the order of `drives`; may be empty.
    pub before: Vec<Drive>,
    /// Landmarks from above, m; may be empty.
    pub landmarks: Vec<[f64; 2]>,
    /// Loop closures; may be empty.
    pub loops: Vec<LoopLine>,
}

/// How it is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Look {
    /// Width of the picture, pixels.
    pub width_px: u32,
    /// Zoom level of the tiles; by the picture's resolution where none is given.
    pub zoom: Option<u32>,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            width_px: 1600,
            zoom: None,
        }
    }
}

/// A picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// SVG text, without any reference to a file or a font.
    pub svg: String,
    /// Width, pixels.
    pub width_px: u32,
    /// Height, pixels.
    pub height_px: u32,
}

impl Scene {
    /// What lines and markers cover.
    fn line_bounds(&self) -> Option<Bounds> {
        let lanes = self
            .lanes
            .iter()
            .flat_map(|lane| lane.points.iter().map(|[x, y, _]| [*x, *y]));
        let places = self.intersections.iter().map(|place| [place.x, place.y]);
        // Landmarks reach as far as cameras see, and a bad one farther: the drives say what is shown.
        let drives = self
            .drives
            .iter()
            .chain(&self.before)
            .flat_map(|drive| drive.points.iter().copied());
        bounds_of(lanes.chain(places).chain(drives))
    }

    /// What the finest tiles cover; coarser ones reach far beyond what was seen.
    fn tile_bounds(&self) -> Option<Bounds> {
        let finest = self.tiles.iter().map(|tile| tile.zoom).min()?;
        let corners = level(&self.tiles, finest).into_iter().flat_map(|tile| {
            let (x, y) = (
                f64::from(tile.tile_x) * tile.size_m,
                f64::from(tile.tile_y) * tile.size_m,
            );
            [[x, y], [x + tile.size_m, y + tile.size_m]]
        });
        bounds_of(corners)
    }

    /// The ground at the resolution of a picture this wide.
    fn ground(&self, look: Look) -> Result<Option<Mosaic>, Fault> {
        let Some(bounds) = union(self.tile_bounds(), self.line_bounds()) else {
            return Ok(None);
        };
        let view = View::of(bounds, look.width_px);
        let chosen = look
            .zoom
            .or_else(|| zoom_for(&self.tiles, 1.0 / view.scale));
        let Some(zoom) = chosen.filter(|_| !self.tiles.is_empty()) else {
            return Ok(None);
        };
        let tiles = level(&self.tiles, zoom);
        if tiles.is_empty() {
            let mut levels: Vec<_> = self.tiles.iter().map(|tile| tile.zoom).collect();
            levels.sort_unstable();
            levels.dedup();
            let levels: Vec<_> = levels.iter().map(ToString::to_string).collect();
            return Err(Fault::user(format!(
                "no tiles at zoom {zoom}; there are {}",
                levels.join(", ")
            )));
        }
        let mut mosaic = Mosaic::of(&tiles)?;
        mosaic.stretch();
        Ok(Some(mosaic))
    }
}

/// Draws a scene.
///
/// # Errors
/// A user fault where there is nothing to draw or no tile at the zoom level asked for, a data fault for a damaged tile.
pub fn draw(scene: &Scene, look: Look) -> Result<Picture, Fault> {
    let ground = scene.ground(look)?;
    let seen = ground.as_ref().and_then(Mosaic::seen);
    let bounds = union(seen, scene.line_bounds()).ok_or_else(|| {
        Fault::user("there is nothing to draw").next("publish tiles, lanes or poses in the plan")
    })?;
    let view = View::of(bounds, look.width_px);
    let mut body = String::new();
    body.push_str(&ground::grid(&view));
    if let Some(mosaic) = &ground {
        body.push_str(&ground::image(&view, mosaic)?);
    }
    body.push_str(&roads::lanes(&view, &scene.lanes));
    if !scene.landmarks.is_empty() {
        body.push_str(&metric::landmarks(&view, &scene.landmarks));
    }
    if !scene.loops.is_empty() {
        body.push_str(&metric::loops(&view, &scene.loops));
    }
    if !scene.before.is_empty() {
        body.push_str(&metric::before(&view, &scene.before));
    }
    body.push_str(&drives::drives(&view, &scene.drives));
    body.push_str(&roads::intersections(&view, &scene.intersections));
    let names: Vec<String> = scene
        .drives
        .iter()
        .map(|drive| drive.session.clone())
        .collect();
    body.push_str(&furniture::furniture(&view, &names));
    let (width, height) = (view.width_px as u32, view.height_px as u32);
    let svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"{}\"/>\n{body}</svg>\n",
        colours::BACKGROUND
    );
    Ok(Picture {
        svg,
        width_px: width,
        height_px: height,
    })
}

#[cfg(test)]
mod tests;
