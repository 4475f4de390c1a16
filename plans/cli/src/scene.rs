//! What there is to draw, gathered from a map's layers.

use std::collections::{BTreeMap, BTreeSet};

use evermap_contract::Registry;
use evermap_engine::conform::conform;
use evermap_engine::map::Map;
use evermap_schemas::layers::{Keyframe, VehiclePose};
use evermap_schemas::{Fault, LayerRow, Stamp, rows};

use crate::draw::{Drive, Scene};
use crate::shown::{Crossing, Lane, Tile};

/// The published layer that holds rows of this kind: the one of its name, else one that such an operator made.
pub fn layer_of<T: LayerRow>(map: &Map, registry: &Registry) -> Option<String> {
    let published = || {
        map.version
            .layers
            .iter()
            .filter(|(_, layer)| layer.published)
    };
    if map.has(T::NAME) {
        return Some(T::NAME.to_owned());
    }
    let makes = |op: &str| {
        registry
            .get(op)
            .is_ok_and(|entry| entry.output.name == T::NAME)
    };
    published()
        .find(|(_, layer)| layer.op.as_deref().is_some_and(makes))
        .map(|(name, _)| name.clone())
}

/// All rows of this kind; none where no layer holds them, or where it has other columns.
pub async fn rows_of<T: LayerRow>(map: &Map, registry: &Registry) -> Result<Vec<T>, Fault> {
    let Some(layer) = layer_of::<T>(map, registry) else {
        return Ok(Vec::new());
    };
    let mut found = Vec::new();
    for batch in map.batches(&layer).await? {
        match conform(&batch, &T::layer()) {
            Ok(batch) => {
                found.extend(rows::<T>(&batch).map_err(|fault| fault.at(format!("layer {layer}")))?)
            }
            Err(fault) => {
                tracing::warn!(%layer, %fault, "not drawn: it has other columns");
                return Ok(Vec::new());
            }
        }
    }
    Ok(found)
}

/// The trajectories of a map by session; from keyframes where it has no poses.
///
/// # Errors
/// When the vehicle was where (m).
type StampedPlace = (Stamp, [f64; 2]);

/// As [`Map::batches`].
pub async fn drives(map: &Map, registry: &Registry) -> Result<Vec<(String, Drive)>, Fault> {
    let poses = rows_of::<VehiclePose>(map, registry).await?;
    let mut places: Vec<(String, String, Stamp, [f64; 2])> = poses
        .into_iter()
        .map(|row| {
            (
                row.site,
                row.session,
                row.stamp,
                [row.map_from_vehicle.x, row.map_from_vehicle.y],
            )
        })
        .collect();
    if places.is_empty() {
        let keyframes = rows_of::<Keyframe>(map, registry).await?.into_iter();
        places.extend(keyframes.map(|row| {
            (
                row.site,
                row.session,
                row.stamp,
                [row.odom_from_vehicle.x, row.odom_from_vehicle.y],
            )
        }));
    }
    let mut sessions: BTreeMap<(String, String), Vec<StampedPlace>> = BTreeMap::new();
    for (site, session, stamp, place) in places {
        sessions
            .entry((site, session))
            .or_default()
            .push((stamp, place));
    }
    let drive = |((site, session), mut places): (_, Vec<(Stamp, [f64; 2])>)| {
        places.sort_by_key(|(stamp, _)| *stamp);
        (
            site,
            Drive {
                session,
                points: places.into_iter().map(|(_, place)| place).collect(),
            },
        )
    };
    Ok(sessions.into_iter().map(drive).collect())
}

/// One site's scene: the one asked for, else the first by name. Also says the names of all sites.
///
/// # Errors
/// A user fault for a site that is not in the map.
pub async fn scene(
    map: &Map,
    registry: &Registry,
    site: Option<&str>,
) -> Result<(Scene, Vec<String>), Fault> {
    let tiles: Vec<Tile> = rows_of(map, registry).await?;
    let lanes: Vec<Lane> = rows_of(map, registry).await?;
    let intersections: Vec<Crossing> = rows_of(map, registry).await?;
    let drives = drives(map, registry).await?;
    let mut sites: BTreeSet<String> = drives.iter().map(|(site, _)| site.clone()).collect();
    sites.extend(
        map.version
            .sessions
            .iter()
            .map(|session| session.log.site.clone()),
    );
    sites.extend(tiles.iter().map(|row| row.site.clone()));
    sites.extend(lanes.iter().map(|row| row.site.clone()));
    sites.extend(intersections.iter().map(|row| row.site.clone()));
    let sites: Vec<String> = sites.into_iter().collect();
    let chosen = match site {
        Some(site) if !sites.iter().any(|known| known == site) => {
            return Err(Fault::user(format!(
                "no site {site} in this map; there are {}",
                sites.join(", ")
            )));
        }
        Some(site) => site.to_owned(),
        None => sites.first().cloned().unwrap_or_default(),
    };
    let scene = Scene {
        tiles: tiles.into_iter().filter(|row| row.site == chosen).collect(),
        lanes: lanes.into_iter().filter(|row| row.site == chosen).collect(),
        intersections: intersections
            .into_iter()
            .filter(|row| row.site == chosen)
            .collect(),
        drives: drives
            .into_iter()
            .filter(|(site, _)| *site == chosen)
            .map(|(_, drive)| drive)
            .collect(),
        ..Scene::default()
    };
    Ok((scene, sites))
}
