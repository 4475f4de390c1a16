//! What there is to draw of a map from above.

use std::collections::{BTreeMap, BTreeSet};

use evermap_schemas::layers::{Keyframe, VehiclePose};
use evermap_schemas::{Fault, Stamp};

use crate::draw::{Scene, Trajectory};
use crate::reader::MapReader;

/// Where a vehicle was, and when.
type Passed = (Stamp, [f64; 2]);

/// The trajectories of a map, of one site where it is named, by site and session; from keyframes where it has no poses.
///
/// # Errors
/// As [`MapReader::rows`].
pub async fn trajectories(
    reader: &MapReader,
    site: Option<&str>,
) -> Result<Vec<Trajectory>, Fault> {
    let mut sessions: BTreeMap<(String, String), Vec<Passed>> = BTreeMap::new();
    for row in reader.rows::<VehiclePose>(site).await? {
        let points = sessions.entry((row.site, row.session)).or_default();
        points.push((row.stamp, [row.map_from_vehicle.x, row.map_from_vehicle.y]));
    }
    if sessions.is_empty() {
        for row in reader.rows::<Keyframe>(site).await? {
            let points = sessions.entry((row.site, row.session)).or_default();
            points.push((
                row.stamp,
                [row.odom_from_vehicle.x, row.odom_from_vehicle.y],
            ));
        }
    }
    let trajectory = |((_, session), mut points): (_, Vec<Passed>)| {
        points.sort_by_key(|(stamp, _)| *stamp);
        Trajectory {
            session,
            points: points.into_iter().map(|(_, point)| point).collect(),
        }
    };
    Ok(sessions.into_iter().map(trajectory).collect())
}

/// One site's scene: the one asked for, else the first by name. Also says the names of all sites.
///
/// # Errors
/// A user fault for a site that is not in the map.
pub async fn scene(reader: &MapReader, site: Option<&str>) -> Result<(Scene, Vec<String>), Fault> {
    let mapped = reader.map.version.sessions.iter();
    let sites: BTreeSet<String> = mapped.map(|session| session.log.site.clone()).collect();
    let sites: Vec<String> = sites.into_iter().collect();
    if let Some(site) = site
        && !sites.iter().any(|known| known == site)
    {
        let known = sites.join(", ");
        return Err(Fault::user(format!(
            "no site {site} in this map; there are {known}"
        )));
    }
    let site = site.or(sites.first().map(String::as_str));
    let scene = Scene {
        tiles: reader.rows(site).await?,
        lanes: reader.rows(site).await?,
        intersections: reader.rows(site).await?,
        trajectories: trajectories(reader, site).await?,
        ..Scene::default()
    };
    Ok((scene, sites))
}
