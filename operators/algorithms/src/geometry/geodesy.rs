//! Places on earth: the ellipsoid WGS 84, and planes that touch it.

use nalgebra::{Matrix3, Rotation2, Vector2, Vector3};

/// Half the equator's diameter, metres (NIMA TR8350.2).
const EQUATOR_M: f64 = 6_378_137.0;
/// Flattening.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// The first eccentricity, squared.
const ECCENTRICITY_2: f64 = FLATTENING * (2.0 - FLATTENING);

/// A place in WGS 84.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geodetic {
    /// Degrees, north is positive.
    pub latitude_deg: f64,
    /// Degrees, east is positive, in [-180, 180].
    pub longitude_deg: f64,
    /// Metres above the ellipsoid.
    pub height_m: f64,
}

impl Geodetic {
    /// From the earth's centre, metres: x to where the zero meridian meets the equator, z to the north pole.
    pub fn to_earth(self) -> Vector3<f64> {
        let (sin_lat, cos_lat) = self.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude_deg.to_radians().sin_cos();
        let normal = normal_m(sin_lat);
        let across = (normal + self.height_m) * cos_lat;
        let up = (normal * (1.0 - ECCENTRICITY_2) + self.height_m) * sin_lat;
        Vector3::new(across * cos_lon, across * sin_lon, up)
    }

    /// The place of a point given from the earth's centre, metres: Bowring's formula, repeated until it stands still. At
    /// the earth's centre, where nothing says which latitude, the equator's.
    pub fn from_earth(point: &Vector3<f64>) -> Self {
        let across = point.x.hypot(point.y);
        let mut reduced = (point.z).atan2(across * (1.0 - FLATTENING));
        let mut latitude = 0.0;
        for _ in 0..5 {
            let (sin, cos) = reduced.sin_cos();
            let polar = EQUATOR_M * (1.0 - FLATTENING);
            let second_2 = ECCENTRICITY_2 / (1.0 - ECCENTRICITY_2);
            latitude = (point.z + second_2 * polar * sin.powi(3))
                .atan2(across - ECCENTRICITY_2 * EQUATOR_M * cos.powi(3));
            reduced = ((1.0 - FLATTENING) * latitude.sin()).atan2(latitude.cos());
        }
        let (sin, cos) = latitude.sin_cos();
        // Of two formulas, one fails at the poles; this one nowhere.
        let height_m =
            across * cos + point.z * sin - EQUATOR_M * (1.0 - ECCENTRICITY_2 * sin * sin).sqrt();
        Self {
            latitude_deg: latitude.to_degrees(),
            longitude_deg: point.y.atan2(point.x).to_degrees(),
            height_m,
        }
    }

    /// Radius of the sphere that fits the ellipsoid best here: the geometric mean of its two radii of curvature, metres.
    pub fn radius_m(&self) -> f64 {
        let normal = normal_m(self.latitude_deg.to_radians().sin());
        let meridian = normal.powi(3) * (1.0 - ECCENTRICITY_2) / EQUATOR_M.powi(2);
        (normal * meridian).sqrt()
    }
}

/// Distance from the surface to the axis along the plumb line, metres.
fn normal_m(sin_latitude: f64) -> f64 {
    EQUATOR_M / (1.0 - ECCENTRICITY_2 * sin_latitude * sin_latitude).sqrt()
}

/// The plane that touches the earth at a place: east, north and up from there, metres.
#[derive(Debug, Clone, Copy)]
pub struct Tangent {
    earth_from_origin: Vector3<f64>,
    tangent_from_earth: Matrix3<f64>,
}

impl Tangent {
    /// At a place.
    pub fn at(origin: Geodetic) -> Self {
        let (sin_lat, cos_lat) = origin.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = origin.longitude_deg.to_radians().sin_cos();
        #[rustfmt::skip]
        let tangent_from_earth = Matrix3::new(
            -sin_lon,           cos_lon,           0.0,
            -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat,
            cos_lat * cos_lon,  cos_lat * sin_lon,  sin_lat,
        );
        Self {
            earth_from_origin: origin.to_earth(),
            tangent_from_earth,
        }
    }

    /// East, north and up of a place.
    pub fn enu(&self, place: Geodetic) -> Vector3<f64> {
        self.tangent_from_earth * (place.to_earth() - self.earth_from_origin)
    }

    /// The place of east, north and up.
    pub fn geodetic(&self, enu: &Vector3<f64>) -> Geodetic {
        let earth = self.tangent_from_earth.transpose() * enu + self.earth_from_origin;
        Geodetic::from_earth(&earth)
    }
}

/// Where a map lies on earth: its z axis is the plumb line at its origin.
#[derive(Debug, Clone, Copy)]
pub struct MapOnEarth {
    tangent: Tangent,
    east_north_from_map: Rotation2<f64>,
}

impl MapOnEarth {
    /// By where the map's origin lies, and the direction of its x axis, counter-clockwise from east (rad).
    pub fn new(origin: Geodetic, heading_rad: f64) -> Self {
        Self {
            tangent: Tangent::at(origin),
            east_north_from_map: Rotation2::new(heading_rad),
        }
    }

    /// East and north of the origin of a point of the map, metres.
    pub fn turned(&self, x: f64, y: f64) -> [f64; 2] {
        (self.east_north_from_map * Vector2::new(x, y)).into()
    }

    /// The place of a point of the map (m).
    pub fn geodetic(&self, [x, y, z]: [f64; 3]) -> Geodetic {
        let [east, north] = self.turned(x, y);
        self.tangent.geodetic(&Vector3::new(east, north, z))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn place(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Geodetic {
        Geodetic {
            latitude_deg,
            longitude_deg,
            height_m,
        }
    }

    #[test]
    fn places_that_everybody_knows() {
        let equator = place(0.0, 90.0, 10.0).to_earth();
        assert!((equator - Vector3::new(0.0, 6_378_147.0, 0.0)).norm() < 1e-8);
        let pole = place(90.0, 0.0, 0.0).to_earth();
        assert!((pole.z - 6_356_752.314_245).abs() < 1e-6);
        assert!(pole.xy().norm() < 1e-8);
        // The mean of a degree of the meridian between 51.5° and 52.5° N is 111.2656 km (NIMA TR8350.2).
        let tangent = Tangent::at(place(52.0, 13.0, 0.0));
        let north = tangent.enu(place(52.5, 13.0, 0.0)) - tangent.enu(place(51.5, 13.0, 0.0));
        assert!((north.y - 111_265.0).abs() < 5.0, "{}", north.y);
        assert!((place(52.0, 0.0, 0.0).radius_m() - 6_382_300.0).abs() < 1_000.0);
    }

    proptest! {
        #[test]
        fn places_come_back(lat in -90.0..90.0_f64, lon in -179.99..179.99_f64, height in -5e3..1e6_f64) {
            let given = place(lat, lon, height);
            let found = Geodetic::from_earth(&given.to_earth());
            prop_assert!((found.latitude_deg - lat).abs() < 1e-11, "{found:?}");
            prop_assert!((found.height_m - height).abs() < 1e-6, "{found:?}");
            prop_assert!((found.to_earth() - given.to_earth()).norm() < 1e-6);
        }

        #[test]
        fn points_of_a_plane_come_back(
            lat in -89.0..89.0_f64,
            lon in -180.0..180.0_f64,
            enu in prop::array::uniform3(-1e5..1e5_f64),
        ) {
            let tangent = Tangent::at(place(lat, lon, 100.0));
            let enu = Vector3::from(enu);
            prop_assert!((tangent.enu(tangent.geodetic(&enu)) - enu).norm() < 1e-6);
        }
    }
}
