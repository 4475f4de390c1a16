//! What of a map does not move: landmarks, lanes, intersections, parking spaces, labels, and what lies in cells.

use bytes::Bytes;
use evermap_schemas::Fault;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{PointCloud, SceneEntity, SceneUpdate, SpherePrimitive};

use super::messages::{
    GREEN, MAP, ORANGE, PURPLE, VERMILION, color, entity, field, line, place, time, vector,
};
use super::{TopicMessage, grids};
use crate::ending::Lost;
use crate::reader::MapReader;
use crate::scene::corners;
use crate::shown::{Crossing, Label, LandmarkPoint, Lane, Space};

/// All of it, as said at one instant.
pub(super) async fn said(
    reader: &MapReader,
    (site, stamp): (&str, i64),
    lost: &mut Lost,
) -> Result<Vec<TopicMessage>, Fault> {
    let mut all = grids::said(reader, (site, stamp), lost).await?;
    let site = Some(site);
    let landmarks: Vec<LandmarkPoint> = reader.rows(site).await?;
    if !landmarks.is_empty() {
        all.push(TopicMessage::new(
            stamp,
            "/landmarks",
            &cloud(&landmarks, stamp),
        )?);
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
            let there = SceneUpdate {
                entities,
                ..SceneUpdate::default()
            };
            all.push(TopicMessage::new(stamp, topic, &there)?);
        }
    }
    Ok(all)
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
    let corners = corners(&row.map_from_space, [row.length_m, row.width_m])?;
    let known = [("standing", row.standing.clone())];
    Some(SceneEntity {
        lines: vec![line(&corners, true, GREEN, 0.08)],
        ..entity(stamp, format!("space {}", row.space), &known)
    })
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
