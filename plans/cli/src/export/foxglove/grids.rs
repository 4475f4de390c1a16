//! What of a map lies in cells of the ground: the overhead image, speeds, and how probably somebody is there.
//!
//! Viewers show Foxglove's `Grid` with any quantity; robots read `nav_msgs/OccupancyGrid`: 0 to 100, or -1 where the map has
//! no cell.

use bytes::Bytes;
use evermap_datasets::ros2::{Header, OccupancyGrid};
use evermap_schemas::Fault;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{Grid, Vector2};

use super::TopicMessage;
use super::messages::{MAP, field, place, time};
use crate::ending::Lost;
use crate::export::nav2;
use crate::mosaic::{Mosaic, level, zoom_for};
use crate::raster::Raster;
use crate::reader::MapReader;
use crate::shown::{DangerCell, SpeedCell, Tile};

/// Cells of a grid are no finer than this (m): a viewer holds all of it as a texture.
const FINEST_M: f64 = 0.05;
/// Grids of more cells than this are left out.
const MOST_CELLS: i64 = 1 << 26;

/// All of it, as said at one instant; grids that are too large are counted.
pub(super) async fn said(
    reader: &MapReader,
    (site, stamp): (&str, i64),
    lost: &mut Lost,
) -> Result<Vec<TopicMessage>, Fault> {
    let site = Some(site);
    let mut all = Vec::new();
    let tiles: Vec<Tile> = reader.rows(site).await?;
    if let Some(zoom) = zoom_for(&tiles, FINEST_M) {
        let ground = Mosaic::of(&level(&tiles, zoom))?;
        all.push(TopicMessage::new(stamp, "/ground", &floor(&ground, stamp))?);
    }
    let cells: Vec<SpeedCell> = reader.rows(site).await?;
    if let Some(grid) = speeds(&cells, stamp, lost) {
        all.push(TopicMessage::new(stamp, "/speed", &grid)?);
    }
    all.extend(mask(&cells, stamp, lost));
    let cells: Vec<DangerCell> = reader.rows(site).await?;
    if let Some((raster, cell_m, percent)) = danger(&cells, lost) {
        all.push(occupancy(stamp, "/danger", raster, cell_m, &percent));
    }
    Ok(all)
}

/// The mask of Nav2's speed filter; `None` where there is no speed map, or it makes none.
fn mask(cells: &[SpeedCell], stamp: i64, lost: &mut Lost) -> Option<TopicMessage> {
    let cell_m = cells.first()?.cell_m;
    let topic = "/speed_mask";
    match nav2::limits(cells) {
        Ok((raster, limits)) => {
            let raster = held(raster, topic, lost)?;
            Some(occupancy(stamp, topic, raster, cell_m, &limits))
        }
        Err(fault) => {
            left_out(format!("{topic} left out: {fault}"), lost);
            None
        }
    }
}

/// A raster that a recording holds; `None`, and counted, for a larger one.
fn held(raster: Raster, topic: &str, lost: &mut Lost) -> Option<Raster> {
    let is_held = raster.cells() <= MOST_CELLS;
    if !is_held {
        let ([width, height], next) = (raster.size, nav2::SMALLER);
        let reason = format!(
            "{topic} left out: expected at most {MOST_CELLS} cells, found {width} x {height}; {next}"
        );
        left_out(reason, lost);
    }
    is_held.then_some(raster)
}

fn left_out(reason: String, lost: &mut Lost) {
    *lost.0.entry(reason).or_default() += 1;
}

fn occupancy(stamp: i64, topic: &str, raster: Raster, cell_m: f64, cells: &[i8]) -> TopicMessage {
    let [x, y] = raster.corner(cell_m);
    let header = Header {
        stamp_ns: stamp.max(0) as u64,
        frame_id: MAP,
    };
    let message = OccupancyGrid {
        header,
        cell_m,
        size: raster.size.map(|cells| cells as u32),
        corner: [x, y, 0.0],
        cells,
    };
    TopicMessage::of_ros(stamp, topic, &message)
}

/// Probabilities that somebody is in a cell in one look, in percent; the side of a cell, m. `None` where there is no map of
/// them, or it would be too large.
fn danger(cells: &[DangerCell], lost: &mut Lost) -> Option<(Raster, f64, Vec<i8>)> {
    let cell_m = cells.first()?.cell_m;
    let alike = || cells.iter().filter(|cell| cell.cell_m == cell_m);
    let raster = Raster::around(alike().map(|cell| [cell.column, cell.row]))?;
    let raster = held(raster, "/danger", lost)?;
    let mut percent = vec![-1; raster.cells() as usize];
    for cell in alike().filter(|cell| cell.danger.is_finite()) {
        let probability = cell.danger.clamp(0.0, 1.0);
        percent[raster.place([cell.column, cell.row])] = (100.0 * probability).round() as i8;
    }
    Some((raster, cell_m, percent))
}

/// The overhead image; nothing of it where nothing was seen.
fn floor(ground: &Mosaic, stamp: i64) -> Grid {
    let south = ground.north - ground.height as f64 * ground.cell_m;
    let rows = (0..ground.height).rev();
    let places = rows.flat_map(|row| row * ground.width..(row + 1) * ground.width);
    let cells = places.flat_map(|cell| ground.colour(cell));
    let channels = ["red", "green", "blue", "alpha"];
    Grid {
        timestamp: time(stamp),
        frame_id: MAP.to_owned(),
        // Below what is drawn on it.
        pose: Some(place(ground.west, south, -0.05)),
        column_count: ground.width as u32,
        cell_size: Some(square(ground.cell_m)),
        row_stride: 4 * ground.width as u32,
        cell_stride: 4,
        fields: (0..)
            .zip(channels)
            .map(|(at, name)| field(name, at, NumericType::Uint8))
            .collect(),
        data: Bytes::from_iter(cells),
    }
}

/// Recommended speeds, m/s; not a number where the map has none. `None` where there is no map of them, or it would be too
/// large.
fn speeds(cells: &[SpeedCell], stamp: i64, lost: &mut Lost) -> Option<Grid> {
    let cell_m = cells.first()?.cell_m;
    let alike = || cells.iter().filter(|cell| cell.cell_m == cell_m);
    let raster = Raster::around(alike().map(|cell| [cell.column, cell.row]))?;
    let raster = held(raster, "/speed", lost)?;
    let mut speeds = vec![f32::NAN; raster.cells() as usize];
    for cell in alike() {
        speeds[raster.place([cell.column, cell.row])] = cell.speed_mps as f32;
    }
    let [x, y] = raster.corner(cell_m);
    let width = raster.size[0] as u32;
    Some(Grid {
        timestamp: time(stamp),
        frame_id: MAP.to_owned(),
        pose: Some(place(x, y, -0.02)),
        column_count: width,
        cell_size: Some(square(cell_m)),
        row_stride: 4 * width,
        cell_stride: 4,
        fields: vec![field("speed_mps", 0, NumericType::Float32)],
        data: Bytes::from_iter(speeds.iter().flat_map(|speed| speed.to_le_bytes())),
    })
}

fn square(side_m: f64) -> Vector2 {
    Vector2 {
        x: side_m,
        y: side_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(column: i32) -> SpeedCell {
        SpeedCell {
            site: "lot".into(),
            column,
            row: 0,
            cell_m: 0.5,
            speed_mps: 1.4,
            max_mps: 2.8,
        }
    }

    /// Cells are far apart where a label was drawn in other coordinates.
    #[test]
    fn a_grid_that_a_recording_does_not_hold_is_counted() {
        let lost_of = |cells: &[SpeedCell]| {
            let mut lost = Lost::default();
            let grid = speeds(cells, 0, &mut lost).is_some();
            let mask = mask(cells, 0, &mut lost).is_some();
            (grid, mask, lost)
        };
        assert_eq!(lost_of(&[]), (false, false, Lost::default()));
        assert_eq!(lost_of(&[cell(0), cell(7)]), (true, true, Lost::default()));
        let (grid, mask, lost) = lost_of(&[cell(0), cell(1 << 27)]);
        assert!(!grid && !mask);
        let told: Vec<&str> = lost.0.keys().map(String::as_str).collect();
        assert_eq!(told.len(), 2);
        assert!(told[0].starts_with("/speed left out: expected at most"));
        assert!(told[1].starts_with("/speed_mask left out: "));
        assert!(told.iter().all(|told| told.contains(nav2::SMALLER)));
    }
}
