//! The picture of a map: one SVG, from which the PNG is made.
//!
//! ```text
//!   tiles ─► mosaic ─┐
//!   speeds, people ──┤
//!   lanes, arrows ───┤
//!   spaces, labels ──┤
//!   landmarks, loops ┤
//!   trajectories ────┼──► SVG ──► PNG (resvg)
//!   intersections ───┤
//!   scale, names ────┘
//! ```
//! What a picture looks like is in `templates`; here is where things are in it.

mod changes;
mod colours;
mod legend;
mod line;
mod map;
mod matrix;
mod outline;
mod pixels;
mod placings;
mod semantic;
mod slowness;
mod stable;
mod strokes;
mod trajectory;
mod viewport;

use std::collections::BTreeMap;

use evermap_schemas::Fault;

pub use changes::Changes;
pub use map::{NOTHING, draw};
pub use matrix::matrix;
pub use outline::{Mark, Outline};
pub use pixels::{decoded, encoded, is_in_colour, png};
pub use placings::Placings;
pub use semantic::views;
pub use slowness::SlowCell;
pub use stable::stable;
pub use trajectory::Trajectory;
use viewport::{Bounds, Viewport, bounds_of, union};

use crate::mosaic::{Mosaic, at, level, zoom_for};
use crate::shown::{Crossing, Lane, Tile};

/// What there is to draw of one site.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// Tiles of any zoom levels; may be empty.
    pub tiles: Vec<Tile>,
    /// Lanes; may be empty.
    pub lanes: Vec<Lane>,
    /// How fast to drive on them, by number (m/s): the lowest speed, and the mean; may be empty.
    pub lane_speeds: BTreeMap<u32, [f64; 2]>,
    /// Where to drive more slowly than elsewhere; may be empty.
    pub slow: Vec<SlowCell>,
    /// Where people were seen, m; may be empty.
    pub people: Vec<[f64; 2]>,
    /// Intersections; may be empty.
    pub intersections: Vec<Crossing>,
    /// Parking spaces and labels; may be empty.
    pub outlines: Vec<Outline>,
    /// Where sessions drove; may be empty.
    pub trajectories: Vec<Trajectory>,
    /// The trajectories as odometry had them, in the same order; may be empty.
    pub odometry: Vec<Trajectory>,
    /// Landmarks from above, m; may be empty.
    pub landmarks: Vec<[f64; 2]>,
    /// Loop closures; may be empty.
    pub loops: Vec<LoopLine>,
    /// What changed since an earlier version, where that is drawn.
    pub changes: Option<Changes>,
    /// Direction of the map's x axis, counter-clockwise from east; `None` where nobody knows.
    pub heading_rad: Option<f64>,
    /// What the legend ends with; may be empty.
    pub notes: Vec<String>,
}

/// A loop closure, from one keyframe's position to the other's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopLine {
    /// The two positions, m.
    pub ends: [[f64; 2]; 2],
    /// Whether the relaxed poses agree with it.
    pub accepted: bool,
}

/// What a scene is drawn on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Canvas {
    /// Width of the picture, pixels.
    pub width_px: u32,
    /// Zoom level of the tiles; by the picture's resolution where none is given.
    pub zoom: Option<u32>,
}

impl Default for Canvas {
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
    /// The same place with what changed in it: over the ground and the lanes, without all else.
    pub fn with_changes(self, changes: Changes) -> Self {
        Self {
            tiles: self.tiles,
            lanes: self.lanes,
            heading_rad: self.heading_rad,
            changes: Some(changes),
            ..Self::default()
        }
    }

    /// What lines and markers cover.
    fn line_bounds(&self) -> Option<Bounds> {
        let lanes = self.lanes.iter().flat_map(Lane::from_above);
        let meetings = self.intersections.iter().map(|row| [row.x, row.y]);
        // Landmarks reach as far as cameras see, and a bad one farther: the trajectories say what is shown.
        let driven = self.trajectories.iter().chain(&self.odometry);
        let driven = driven.flat_map(|driven| driven.points.iter().copied());
        let outlines = self.outlines.iter();
        let outlines = outlines.flat_map(|outline| outline.points.iter().copied());
        let changed = self.changes.iter().flat_map(Changes::points);
        bounds_of(
            lanes
                .chain(meetings)
                .chain(driven)
                .chain(outlines)
                .chain(changed),
        )
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
    fn ground(&self, canvas: Canvas) -> Result<Option<Mosaic>, Fault> {
        let Some(bounds) = union(self.tile_bounds(), self.line_bounds()) else {
            return Ok(None);
        };
        let viewport = Viewport::of(bounds, canvas.width_px);
        let chosen = canvas
            .zoom
            .or_else(|| zoom_for(&self.tiles, 1.0 / viewport.scale));
        let Some(zoom) = chosen.filter(|_| !self.tiles.is_empty()) else {
            return Ok(None);
        };
        let mut mosaic = Mosaic::of(&at(&self.tiles, zoom)?)?;
        mosaic.stretch();
        Ok(Some(mosaic))
    }
}

#[cfg(test)]
mod tests;
