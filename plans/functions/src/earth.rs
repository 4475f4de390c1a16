//! Places of a map's points on earth.

use arrow::array::ArrayRef;
use datafusion::common::Result;
use evermap_algorithms::geometry::geodesy::{Geodetic, MapOnEarth};
use evermap_schemas::Cell;

use crate::function::{Declaration, Kind, encoded, given, rows};

/// The function.
pub(crate) const DECLARATIONS: [Declaration; 1] = [Declaration {
    name: "geodetic",
    about: "Where on earth a point of a map is, by the layer georeference: WGS 84, degrees, and metres above the ellipsoid",
    calls: &[&[
        (
            "latitude_deg",
            Kind::Number,
            "latitude of the map's origin, as georeference has it, deg",
        ),
        ("longitude_deg", Kind::Number, "its longitude, deg"),
        (
            "height_m",
            Kind::Number,
            "its height, m; 0 where heights do not matter",
        ),
        (
            "heading_rad",
            Kind::Number,
            "direction of the map's x axis, counter-clockwise from east, rad",
        ),
        ("x", Kind::Number, "the point along x, m"),
        ("y", Kind::Number, "the point along y, m"),
        ("z", Kind::Number, "the point along z, m"),
    ]],
    result: GeodeticPosition::data_type,
    example: [
        "SELECT round(geodetic(52.25, 10.5, 80, pi() / 2, 100, 0, 0)['latitude_deg'], 6)",
        "52.250899",
    ],
    evaluate: placed,
}];

evermap_schemas::record! {
    /// A place on earth.
    pub struct GeodeticPosition {
        /// North is positive.
        latitude_deg: f64 ["deg", "WGS 84"],
        /// East is positive.
        longitude_deg: f64 ["deg", "WGS 84"],
        /// Height above the ellipsoid.
        height_m: f64 ["m", "WGS 84"],
    }
}

fn placed(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let row = |row: usize| {
        let [latitude_deg, longitude_deg, height_m, heading_rad, x, y, z] = given(columns, row)?;
        let origin = Geodetic {
            latitude_deg,
            longitude_deg,
            height_m,
        };
        let place = MapOnEarth::new(origin, heading_rad).geodetic([x, y, z]);
        Some(GeodeticPosition {
            latitude_deg: place.latitude_deg,
            longitude_deg: place.longitude_deg,
            height_m: place.height_m,
        })
    };
    encoded((0..rows(columns)).map(row).collect())
}
