//! Geometries as well-known binary, written and read.
//!
//! Not by a crate: `wkb` and `geozero` bring five or six more with them, write heights only of geometries of their own
//! traits, and the latter's GeoJSON of a coordinate that is no number is no JSON.

use arrow::array::ArrayRef;
use arrow::datatypes::DataType;
use serde_json::{Value, json};

use crate::{Bytes, Cell, Fault};

/// A geometry as well-known binary (ISO WKB, little endian), in local metres: GeoParquet with `"crs": null`.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Wkb(pub Vec<u8>);

impl Wkb {
    /// A point with height.
    pub fn point([x, y, z]: [f64; 3]) -> Self {
        let mut wkb = Self::header(1001);
        wkb.numbers(&[x, y, z]);
        wkb
    }

    /// A polyline with heights.
    pub fn line_string(points: &[[f64; 3]]) -> Self {
        let mut wkb = Self::header(1002);
        wkb.0.extend((points.len() as u32).to_le_bytes());
        points.iter().for_each(|point| wkb.numbers(point));
        wkb
    }

    /// A polygon of one ring, flat. The ring is closed here: give each corner once.
    pub fn polygon(corners: &[[f64; 2]]) -> Self {
        let mut wkb = Self::header(3);
        wkb.0.extend(1_u32.to_le_bytes());
        wkb.0.extend((corners.len() as u32 + 1).to_le_bytes());
        corners
            .iter()
            .chain(corners.first())
            .for_each(|corner| wkb.numbers(corner));
        wkb
    }

    /// The geometry as GeoJSON: points, line strings and polygons in either byte order, flat or with heights, and
    /// collections of them.
    ///
    /// # Errors
    /// A data fault for bytes that are none of these.
    pub fn geojson(&self) -> Result<Value, Fault> {
        let bytes = self.0.as_slice();
        let mut cursor = Cursor {
            bytes,
            little: true,
        };
        cursor.geometry(0).ok_or_else(|| {
            Fault::data(format!(
                "expected a point, line string or polygon as WKB, found {} other bytes",
                bytes.len()
            ))
        })
    }

    fn header(kind: u32) -> Self {
        let mut bytes = vec![1];
        bytes.extend(kind.to_le_bytes());
        Self(bytes)
    }

    fn numbers(&mut self, numbers: &[f64]) {
        numbers
            .iter()
            .for_each(|number| self.0.extend(number.to_le_bytes()));
    }
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

struct Cursor<'b> {
    bytes: &'b [u8],
    little: bool,
}

impl Cursor<'_> {
    /// The next bytes, little endian.
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.bytes.split_first_chunk::<N>()?;
        self.bytes = rest;
        let mut head = *head;
        if !self.little {
            head.reverse();
        }
        Some(head)
    }

    fn number(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn real(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn geometry(&mut self, depth: u8) -> Option<Value> {
        self.little = match self.take::<1>()? {
            [0] => false,
            [1] => true,
            _ => return None,
        };
        let kind = self.number()?;
        let dimensions = match kind / 1000 {
            0 => 2,
            1 => 3,
            _ => return None,
        };
        let nested = |name: &str, parts: Option<Vec<Value>>| {
            let coordinates = parts?
                .into_iter()
                .map(|mut part| part["coordinates"].take());
            Some(json!({ "type": name, "coordinates": coordinates.collect::<Vec<_>>() }))
        };
        match kind % 1000 {
            1 => Some(json!({ "type": "Point", "coordinates": self.position(dimensions)? })),
            2 => Some(json!({ "type": "LineString", "coordinates": self.positions(dimensions)? })),
            3 => Some(json!({ "type": "Polygon", "coordinates": self.rings(dimensions)? })),
            4 => nested("MultiPoint", self.parts(depth)),
            5 => nested("MultiLineString", self.parts(depth)),
            6 => nested("MultiPolygon", self.parts(depth)),
            7 => Some(json!({ "type": "GeometryCollection", "geometries": self.parts(depth)? })),
            _ => None,
        }
    }

    fn position(&mut self, dimensions: usize) -> Option<Vec<f64>> {
        (0..dimensions).map(|_| self.real()).collect()
    }

    fn positions(&mut self, dimensions: usize) -> Option<Vec<Vec<f64>>> {
        let count = self.number()?;
        (0..count).map(|_| self.position(dimensions)).collect()
    }

    fn rings(&mut self, dimensions: usize) -> Option<Vec<Vec<Vec<f64>>>> {
        let count = self.number()?;
        (0..count).map(|_| self.positions(dimensions)).collect()
    }

    fn parts(&mut self, depth: u8) -> Option<Vec<Value>> {
        let count = self.number()?;
        if depth >= 4 {
            return None;
        }
        (0..count).map(|_| self.geometry(depth + 1)).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

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
