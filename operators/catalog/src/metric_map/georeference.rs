#![doc = include_str!("georeference.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::geodesy::Geodetic;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::georeference::{
    AntennaFix, Placement, PlacementError, placement,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{AntennaPosition, Georeference, Sources, VehiclePose};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct Georeferences;

/// What is known of places.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct GeoreferenceParams {
    /// Where maps lie that somebody surveyed, by site: latitude and longitude (deg) and height (m) of the map's origin in WGS
    /// 84, and the direction of its x axis, counter-clockwise from east (deg).
    pub origins: BTreeMap<String, [f64; 4]>,
}

impl Operator for Georeferences {
    const NAME: &'static str = "georeference";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("georeference.md");
    type Params = GeoreferenceParams;
    type Output = Georeference;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<VehiclePose>("poses");
        let positions = Port::site::<AntennaPosition>("antenna_positions");
        Work::group(poses, Key::SITE, vec![positions], place)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let mut origins = params.origins.iter();
        match origins.find_map(|(site, place)| Some((site, misplaced(*place)?))) {
            Some((site, (expected, found))) => Err(Fault::user(format!(
                "`origins` of {site}: expected latitude, longitude, height and heading, {expected}, found {found}"
            ))
            .at(format!("origins.{site}"))),
            None => Ok(()),
        }
    }
}

/// What holds for the number that makes an origin no place on earth, and that number.
fn misplaced([latitude, longitude, height, heading]: [f64; 4]) -> Option<(&'static str, f64)> {
    let limits = [
        (latitude, 90.0, "the latitude between -90 and 90°"),
        (longitude, 180.0, "the longitude between -180 and 180°"),
        (height, f64::MAX, "a finite height"),
        (heading, f64::MAX, "a finite heading"),
    ];
    let mut limits = limits.into_iter();
    let (found, _, expected) = limits.find(|(value, most, _)| !(-most..=*most).contains(value))?;
    Some((expected, found))
}

fn place(
    params: &GeoreferenceParams,
    poses: Vec<VehiclePose>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = poses[0].site.clone();
    if let Some(given) = params.origins.get(&site) {
        return emit.rows(vec![surveyed(site, *given)]);
    }
    let rows: Vec<AntennaPosition> = sides.rows("antenna_positions")?;
    let (fixes, sources) = on_map(&poses, &rows);
    match placement(&fixes) {
        Ok(found) => emit.rows(vec![found_row(site, &found, fixes.len(), sources)]),
        // Nobody promised fixes.
        Err(PlacementError::TooFew) if rows.is_empty() => Ok(()),
        Err(PlacementError::TooFew) => {
            emit.skip("site with too few GNSS fixes to say where it lies", 1);
            Ok(())
        }
        Err(PlacementError::NoHeading) => {
            emit.skip("site whose GNSS fixes do not say how it is turned", 1);
            Ok(())
        }
    }
}

/// The antennas on the map, by session and time, and the drives that they are of.
fn on_map(poses: &[VehiclePose], rows: &[AntennaPosition]) -> (Vec<AntennaFix>, Sources) {
    let by_stamp: BTreeMap<(&str, Stamp), &VehiclePose> = poses
        .iter()
        .map(|pose| ((pose.session.as_str(), pose.stamp), pose))
        .collect();
    let mut sessions: BTreeMap<&str, usize> = BTreeMap::new();
    let mut sources = Sources::default();
    let mut fixes = Vec::with_capacity(rows.len());
    for row in rows {
        let pose = by_stamp.get(&(row.session.as_str(), row.keyframe_stamp));
        let pose = pose.and_then(|pose| Pose::from_array(pose.map_from_vehicle.to_array()).ok());
        let Some(pose) = pose else {
            continue;
        };
        let number = sessions.len();
        let session = *sessions.entry(&row.session).or_insert(number);
        sources.add(&row.session, row.stamp, row.stamp);
        fixes.push(fix(session, &pose, row));
    }
    (fixes, sources)
}

fn fix(session: usize, pose: &Pose, row: &AntennaPosition) -> AntennaFix {
    AntennaFix {
        session,
        seconds: row.stamp.0 as f64 * 1e-9,
        map: pose.transform(&Vector3::new(row.x, row.y, row.z)),
        earth: Geodetic {
            latitude_deg: row.latitude_deg,
            longitude_deg: row.longitude_deg,
            height_m: row.height_m.unwrap_or_default(),
        },
        has_height: row.height_m.is_some(),
        sd_m: [row.horizontal_sd_m, row.vertical_sd_m],
    }
}

fn found_row(site: String, found: &Placement, fixes: usize, sources: Sources) -> Georeference {
    Georeference {
        site,
        latitude_deg: found.origin.latitude_deg,
        longitude_deg: found.origin.longitude_deg,
        height_m: found.height_sd_m.map(|_| found.origin.height_m),
        heading_rad: found.heading_rad,
        covariance: Some(found.covariance.transpose().as_slice().to_vec()),
        height_sd_m: found.height_sd_m,
        fixes: fixes as u32,
        outliers: found.outliers as u32,
        noise_m: Some(found.noise_m),
        drift_m: Some(found.drift.map_or(0.0, |[sd_m, _]| sd_m)),
        drift_s: found.drift.map(|[_, seconds]| seconds),
        sources: sources.into_rows(),
    }
}

fn surveyed(
    site: String,
    [latitude_deg, longitude_deg, height_m, heading]: [f64; 4],
) -> Georeference {
    Georeference {
        site,
        latitude_deg,
        longitude_deg,
        height_m: Some(height_m),
        heading_rad: heading.to_radians(),
        covariance: None,
        height_sd_m: None,
        fixes: 0,
        outliers: 0,
        noise_m: None,
        drift_m: None,
        drift_s: None,
        sources: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_contract::Entry;
    use serde_json::json;

    #[test]
    fn places_that_are_none_are_refused_with_the_number_that_is_wrong() {
        let faults = |place: [f64; 4]| {
            let given = json!({ "origins": { "lot": [52.0, 10.0, 80.0, 30.0], "moon": place } });
            Entry::of::<Georeferences>().faults(&given)
        };
        assert!(faults([-90.0, 180.0, -4.0, 400.0]).is_empty());
        let expected = "`origins` of moon: expected latitude, longitude, height and heading,";
        for (place, wrong) in [
            (
                [152.25, 10.5, 80.0, 0.0],
                "the latitude between -90 and 90°, found 152.25",
            ),
            (
                [52.25, -190.5, 80.0, 0.0],
                "the longitude between -180 and 180°, found -190.5",
            ),
        ] {
            let found = faults(place);
            assert_eq!(found.len(), 1);
            assert_eq!((&*found[0].param, &*found[0].entry), ("origins", "moon"));
            assert_eq!(found[0].message, format!("{expected} {wrong}"));
        }
        assert_eq!(
            misplaced([0.0, 0.0, f64::NAN, 0.0]).unwrap().0,
            "a finite height"
        );
    }
}
