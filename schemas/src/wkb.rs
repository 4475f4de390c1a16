//! Geometries as well-known binary, written and read.
//!
//! Not by a crate: `wkb` and `geozero` bring five or six more with them, write heights only of geometries of their own
//! traits, and the latter's GeoJSON of a coordinate that is no number is no JSON.

use arrow::array::ArrayRef;
use arrow::datatypes::DataType;
use serde_json::Value;

use crate::{Bytes, Cell, Fault, Geometry, Position};

/// What ISO adds to the number of a kind whose points have heights.
pub(crate) const ISO_HEIGHT: u32 = 1000;

/// What PostGIS adds to it, and where it names a reference system.
pub(crate) const EXTENDED_HEIGHT: u32 = 0x8000_0000;
pub(crate) const EXTENDED_SYSTEM: u32 = 0x2000_0000;

/// A geometry as well-known binary (ISO WKB, little endian), in local metres: GeoParquet with `"crs": null`.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Wkb(pub Vec<u8>);

impl Wkb {
    /// A point with height.
    pub fn point(point: [f64; 3]) -> Self {
        Geometry::Point(high(&point)).to_wkb()
    }

    /// A polyline with heights.
    pub fn line_string(points: &[[f64; 3]]) -> Self {
        let line = Geometry::LineString(points.iter().map(high).collect());
        Self::written(&line, ISO_HEIGHT)
    }

    /// A polygon of one ring, flat. The ring is closed here: give each corner once.
    pub fn polygon(corners: &[[f64; 2]]) -> Self {
        let ring = corners.iter().chain(corners.first());
        let ring = ring.map(|&[x, y]| Position { x, y, z: None });
        Geometry::Polygon(vec![ring.collect()]).to_wkb()
    }

    /// What it holds: points, line strings and polygons in either byte order, flat or with heights, and collections of
    /// them.
    ///
    /// # Errors
    /// A data fault for bytes that are none of these.
    pub fn geometry(&self) -> Result<Geometry, Fault> {
        Geometry::from_wkb(&self.0)
    }

    /// The geometry as GeoJSON.
    ///
    /// # Errors
    /// As [`Wkb::geometry`].
    pub fn geojson(&self) -> Result<Value, Fault> {
        Ok(self.geometry()?.geojson())
    }

    /// A geometry whose kinds say by adding a number that there are heights, where its first point has one.
    pub(crate) fn with_heights(geometry: &Geometry, number: u32) -> Self {
        let first = geometry.paths().into_iter().flatten().next();
        let has_heights = first.is_some_and(|point| point.z.is_some());
        Self::written(geometry, if has_heights { number } else { 0 })
    }

    fn written(geometry: &Geometry, dimensions: u32) -> Self {
        let mut wkb = Self::default();
        wkb.write(geometry, dimensions);
        wkb
    }

    /// `dimensions` is added to the number of each kind; 0 for what is flat.
    fn write(&mut self, geometry: &Geometry, dimensions: u32) {
        let has_heights = dimensions != 0;
        self.0.push(1);
        self.0
            .extend((geometry.number() + dimensions).to_le_bytes());
        let position = |wkb: &mut Self, point: &Position| {
            let [x, y, z] = point.to_array();
            let numbers = [x, y, z];
            wkb.numbers(if has_heights { &numbers } else { &numbers[..2] });
        };
        let line = |wkb: &mut Self, points: &[Position]| {
            wkb.count(points.len());
            points.iter().for_each(|point| position(wkb, point));
        };
        match geometry {
            Geometry::Point(point) => position(self, point),
            Geometry::LineString(points) => line(self, points),
            Geometry::Polygon(rings) => {
                self.count(rings.len());
                rings.iter().for_each(|ring| line(self, ring));
            }
            Geometry::MultiPoint(parts)
            | Geometry::MultiLineString(parts)
            | Geometry::MultiPolygon(parts)
            | Geometry::GeometryCollection(parts) => {
                self.count(parts.len());
                parts.iter().for_each(|part| self.write(part, dimensions));
            }
        }
    }

    fn count(&mut self, count: usize) {
        self.0.extend((count as u32).to_le_bytes());
    }

    fn numbers(&mut self, numbers: &[f64]) {
        numbers
            .iter()
            .for_each(|number| self.0.extend(number.to_le_bytes()));
    }
}

fn high(&[x, y, z]: &[f64; 3]) -> Position {
    let z = Some(z);
    Position { x, y, z }
}

impl Cell for Wkb {
    fn data_type() -> DataType {
        DataType::Binary
    }
    fn encode(values: Vec<Self>) -> Result<ArrayRef, Fault> {
        Bytes::encode(values.into_iter().map(|wkb| Bytes(wkb.0)).collect())
    }
    fn decode(column: &ArrayRef) -> Result<Vec<Self>, Fault> {
        Ok(Bytes::decode(column)?
            .into_iter()
            .map(|bytes| Wkb(bytes.0))
            .collect())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    #[test]
    fn geometries_read_back() {
        let line = geojson(&Wkb::line_string(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]).0).unwrap();
        assert_eq!(
            line,
            json!({"type": "LineString", "coordinates": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]})
        );
        let point = geojson(&Wkb::point([1.0, 2.0, 3.0]).0).unwrap();
        assert_eq!(
            point,
            json!({"type": "Point", "coordinates": [1.0, 2.0, 3.0]})
        );
        let square = geojson(&Wkb::polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]).0).unwrap();
        assert_eq!(
            square["coordinates"],
            json!([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]]])
        );
        let big_endian = [
            &[0, 0, 0, 0, 1][..],
            &1.5_f64.to_be_bytes(),
            &2.5_f64.to_be_bytes(),
        ]
        .concat();
        assert_eq!(
            geojson(&big_endian).unwrap()["coordinates"],
            json!([1.5, 2.5])
        );
        let mut many = [
            &[1, 4, 0, 0, 0, 1, 0, 0, 0][..],
            &Wkb::point([1.0, 2.0, 3.0]).0,
        ]
        .concat();
        assert_eq!(
            geojson(&many).unwrap()["coordinates"],
            json!([[1.0, 2.0, 3.0]])
        );
        many.truncate(20);
        assert!(geojson(&many).is_err());
    }

    #[test]
    fn what_is_read_is_written_again() {
        let line = Wkb::line_string(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        let square = Wkb::polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]);
        for wkb in [line, square, Wkb::point([1.0, 2.0, 3.0])] {
            let geometry = wkb.geometry().unwrap();
            let both = Geometry::GeometryCollection(vec![geometry.clone(), geometry.clone()]);
            assert_eq!(geometry.to_wkb(), wkb);
            assert_eq!(both.to_wkb().geometry().unwrap(), both);
        }
    }

    #[test]
    fn what_postgis_writes_is_read_and_the_other_way() {
        let point = Wkb::point([1.0, 2.0, 3.0]).geometry().unwrap();
        let flat = Wkb::polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]);
        assert_eq!(flat.geometry().unwrap().to_ewkb(), flat.0);
        let extended = point.to_ewkb();
        assert_eq!(extended[..5], [1, 1, 0, 0, 0x80]);
        assert_eq!(Geometry::from_wkb(&extended).unwrap(), point);
        // SELECT 'SRID=4326;POINT Z (1 2 3)'::geometry, in PostGIS 3.4.
        let system = "01010000A0E6100000000000000000F03F00000000000000400000000000000840";
        let digits = (0..system.len()).step_by(2);
        let bytes: Vec<u8> = digits
            .map(|at| u8::from_str_radix(&system[at..at + 2], 16).unwrap())
            .collect();
        assert_eq!(Geometry::from_wkb(&bytes).unwrap(), point);
        let both = Geometry::GeometryCollection(vec![point.clone(), point]);
        assert_eq!(Geometry::from_wkb(&both.to_ewkb()).unwrap(), both);
    }

    fn geojson(bytes: &[u8]) -> Result<Value, Fault> {
        Wkb(bytes.to_vec()).geojson()
    }

    proptest! {
        #[test]
        fn no_bytes_cause_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let _ = geojson(&bytes);
        }
    }
}
