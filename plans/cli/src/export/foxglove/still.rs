//! What of a map does not move: ground, speeds, landmarks, lanes, intersections, parking spaces, labels.

use bytes::Bytes;
use evermap_algorithms::geometry::pose::Pose as Rigid;
use evermap_schemas::{Fault, Pose};
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{Grid, PointCloud, SceneEntity, SpherePrimitive, Vector2};

use super::Said;
use super::messages::{
    GREEN, MAP, ORANGE, PURPLE, VERMILION, color, entity, field, line, place, scene, time, vector,
};
use crate::mosaic::{Mosaic, level, zoom_for};
use crate::reader::MapReader;
use crate::shown::{Crossing, Label, LandmarkPoint, Lane, Space, SpeedCell, Tile};

/// Cells of a grid are no finer than this (m): a viewer holds all of it as a texture.
const FINEST_M: f64 = 0.05;
/// Grids of more cells than this are left out.
const MOST_CELLS: i64 = 1 << 26;

/// All of it, as said at one instant.
pub(super) async fn said(reader: &MapReader, site: &str, stamp: i64) -> Result<Vec<Said>, Fault> {
    let site = Some(site);
    let mut all = Vec::new();
    let tiles: Vec<Tile> = reader.rows(site).await?;
    if let Some(zoom) = zoom_for(&tiles, FINEST_M) {
        let ground = Mosaic::of(&level(&tiles, zoom))?;
        all.push(Said::new(stamp, "/ground", &floor(&ground, stamp))?);
    }
    if let Some(grid) = speeds(&reader.rows(site).await?, stamp) {
        all.push(Said::new(stamp, "/speed", &grid)?);
    }
    let landmarks: Vec<LandmarkPoint> = reader.rows(site).await?;
    if !landmarks.is_empty() {
        all.push(Said::new(stamp, "/landmarks", &cloud(&landmarks, stamp))?);
    }
    let lanes: Vec<Lane> = reader.rows(site).await?;
    let crossings: Vec<Crossing> = reader.rows(site).await?;
    let spaces: Vec<Space> = reader.rows(site).await?;
    let labels: Vec<Label> = reader.rows(site).await?;
    let things: [(&str, Vec<SceneEntity>); 4] = [
        ("/lanes", lanes.iter().map(|row| lane(row, stamp)).collect()),
        (
            "/intersections",
            crossings.iter().map(|row| crossing(row, stamp)).collect(),
        ),
        (
            "/spaces",
            spaces.iter().filter_map(|row| space(row, stamp)).collect(),
        ),
        (
            "/labels",
            labels.iter().map(|row| label(row, stamp)).collect(),
        ),
    ];
    for (topic, entities) in things {
        if !entities.is_empty() {
            all.push(Said::new(stamp, topic, &scene(entities))?);
        }
    }
    Ok(all)
}

/// The overhead image; nothing of it where nothing was seen.
fn floor(ground: &Mosaic, stamp: i64) -> Grid {
    let south = ground.north - ground.height as f64 * ground.cell_m;
    let rows = ground.cells.chunks(ground.width.max(1)).rev();
    let cells = rows
        .flatten()
        .flat_map(|[grey, alpha]| [*grey, *grey, *grey, *alpha]);
    let channels = ["red", "green", "blue", "alpha"];
    Grid {
        timestamp: time(stamp),
        frame_id: MAP.to_owned(),
        // Below what is drawn on it.
        pose: Some(place(ground.west, south, -0.05)),
        column_count: ground.width as u32,
        cell_size: Some(Vector2 {
            x: ground.cell_m,
            y: ground.cell_m,
        }),
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
fn speeds(cells: &[SpeedCell], stamp: i64) -> Option<Grid> {
    let cell_m = cells.first()?.cell_m;
    let range = |of: fn(&SpeedCell) -> i32| {
        let numbers = cells.iter().map(|cell| i64::from(of(cell)));
        Some((numbers.clone().min()?, numbers.max()?))
    };
    let (columns, rows) = (range(|cell| cell.column)?, range(|cell| cell.row)?);
    let (width, height) = (columns.1 - columns.0 + 1, rows.1 - rows.0 + 1);
    if width * height > MOST_CELLS {
        return None;
    }
    let mut speeds = vec![f32::NAN; (width * height) as usize];
    for cell in cells.iter().filter(|cell| cell.cell_m == cell_m) {
        let at = (i64::from(cell.row) - rows.0) * width + i64::from(cell.column) - columns.0;
        speeds[at as usize] = cell.speed_mps as f32;
    }
    let [x, y] = [columns.0, rows.0].map(|first| first as f64 * cell_m);
    Some(Grid {
        timestamp: time(stamp),
        frame_id: MAP.to_owned(),
        pose: Some(place(x, y, -0.02)),
        column_count: width as u32,
        cell_size: Some(Vector2 {
            x: cell_m,
            y: cell_m,
        }),
        row_stride: 4 * width as u32,
        cell_stride: 4,
        fields: vec![field("speed_mps", 0, NumericType::Float32)],
        data: Bytes::from_iter(speeds.iter().flat_map(|speed| speed.to_le_bytes())),
    })
}

fn cloud(landmarks: &[LandmarkPoint], stamp: i64) -> PointCloud {
    let points = landmarks.iter().flat_map(|row| [row.x, row.y, row.z]);
    let bytes = points.flat_map(|value| (value as f32).to_le_bytes());
    PointCloud {
        timestamp: time(stamp),
        frame_id: MAP.to_owned(),
        pose: Some(place(0.0, 0.0, 0.0)),
        point_stride: 12,
        fields: [("x", 0), ("y", 4), ("z", 8)]
            .map(|(name, at)| field(name, at, NumericType::Float32))
            .to_vec(),
        data: Bytes::from_iter(bytes),
    }
}

fn lane(row: &Lane, stamp: i64) -> SceneEntity {
    let known = [
        ("direction", row.direction.clone()),
        ("length_m", format!("{:.1}", row.length_m)),
    ];
    SceneEntity {
        lines: vec![line(&row.points, false, ORANGE, 0.12)],
        ..entity(stamp, format!("lane {}", row.lane), &known)
    }
}

fn crossing(row: &Crossing, stamp: i64) -> SceneEntity {
    SceneEntity {
        spheres: vec![SpherePrimitive {
            pose: Some(place(row.x, row.y, 0.0)),
            size: vector(0.6, 0.6, 0.6),
            color: color(VERMILION, 1.0),
        }],
        ..entity(stamp, format!("intersection {}", row.node), &[])
    }
}

/// A parking space; `None` where its pose is not a rigid transform.
fn space(row: &Space, stamp: i64) -> Option<SceneEntity> {
    let corners = corners(&row.map_from_space, row.length_m, row.width_m)?;
    let known = [("standing", row.standing.clone())];
    Some(SceneEntity {
        lines: vec![line(&corners, true, GREEN, 0.08)],
        ..entity(stamp, format!("space {}", row.space), &known)
    })
}

fn corners(pose: &Pose, length_m: f64, width_m: f64) -> Option<[[f64; 3]; 4]> {
    let pose = Rigid::from_array(pose.to_array()).ok()?;
    let corner = |[along, left]: [f64; 2]| {
        let point = nalgebra::Vector3::new(0.5 * along * length_m, 0.5 * left * width_m, 0.0);
        pose.transform(&point).into()
    };
    Some([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].map(corner))
}

fn label(row: &Label, stamp: i64) -> SceneEntity {
    let known = [
        ("kind", row.kind.clone()),
        ("standing", row.standing.clone()),
    ];
    SceneEntity {
        lines: vec![line(&row.points, row.shape != "polyline", PURPLE, 0.06)],
        ..entity(stamp, format!("label {}", row.label), &known)
    }
}
