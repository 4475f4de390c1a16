//! Geometries as they are read from well-known binary.

use serde_json::{Value, json};

use crate::wkb::{EXTENDED_HEIGHT, EXTENDED_SYSTEM, ISO_HEIGHT};
use crate::{Fault, Wkb};

/// Collections within collections that are followed.
const DEPTH: u8 = 4;

/// A point of a geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Position {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Height; `None` where the geometry is flat.
    pub z: Option<f64>,
}

impl Position {
    /// `[x, y, z]`, a flat one at height 0.
    pub fn to_array(self) -> [f64; 3] {
        [self.x, self.y, self.z.unwrap_or(0.0)]
    }

    fn numbers(self) -> Vec<f64> {
        [self.x, self.y].into_iter().chain(self.z).collect()
    }
}

/// A geometry of simple features.
#[derive(Debug, Clone, PartialEq)]
pub enum Geometry {
    /// A point.
    Point(Position),
    /// A polyline.
    LineString(Vec<Position>),
    /// A polygon: its outline, then its holes, each closed.
    Polygon(Vec<Vec<Position>>),
    /// Points.
    MultiPoint(Vec<Geometry>),
    /// Polylines.
    MultiLineString(Vec<Geometry>),
    /// Polygons.
    MultiPolygon(Vec<Geometry>),
    /// Geometries of any kind.
    GeometryCollection(Vec<Geometry>),
}

impl Geometry {
    /// Reads well-known binary, ISO or as PostGIS extends it, in either byte order. A reference system is passed over.
    ///
    /// # Errors
    /// A data fault for bytes that are no geometry, or one of a kind that is none of these.
    pub fn from_wkb(bytes: &[u8]) -> Result<Self, Fault> {
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

    /// The geometry as well-known binary, ISO, little endian; with heights where its first point has one.
    pub fn to_wkb(&self) -> Wkb {
        Wkb::with_heights(self, ISO_HEIGHT)
    }

    /// The geometry as extended well-known binary, which PostGIS has, without a reference system.
    pub fn to_ewkb(&self) -> Vec<u8> {
        Wkb::with_heights(self, EXTENDED_HEIGHT).0
    }

    /// The kind's number in well-known binary.
    pub(crate) fn number(&self) -> u32 {
        match self {
            Self::Point(_) => 1,
            Self::LineString(_) => 2,
            Self::Polygon(_) => 3,
            Self::MultiPoint(_) => 4,
            Self::MultiLineString(_) => 5,
            Self::MultiPolygon(_) => 6,
            Self::GeometryCollection(_) => 7,
        }
    }

    /// The kind, as GeoJSON and GeoParquet name it.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Point(_) => "Point",
            Self::LineString(_) => "LineString",
            Self::Polygon(_) => "Polygon",
            Self::MultiPoint(_) => "MultiPoint",
            Self::MultiLineString(_) => "MultiLineString",
            Self::MultiPolygon(_) => "MultiPolygon",
            Self::GeometryCollection(_) => "GeometryCollection",
        }
    }

    /// The geometry as GeoJSON.
    pub fn geojson(&self) -> Value {
        let key = match self {
            Self::GeometryCollection(_) => "geometries",
            _ => "coordinates",
        };
        json!({ "type": self.kind(), key: self.coordinates() })
    }

    fn coordinates(&self) -> Value {
        let line = |points: &[Position]| -> Value {
            let points = points.iter().map(|point| json!(point.numbers()));
            points.collect()
        };
        match self {
            Self::Point(point) => json!(point.numbers()),
            Self::LineString(points) => line(points),
            Self::Polygon(rings) => rings.iter().map(|ring| line(ring)).collect(),
            Self::MultiPoint(parts) | Self::MultiLineString(parts) | Self::MultiPolygon(parts) => {
                parts.iter().map(Self::coordinates).collect()
            }
            Self::GeometryCollection(parts) => parts.iter().map(Self::geojson).collect(),
        }
    }

    /// The geometry with each of its points somewhere else.
    #[must_use]
    pub fn moved(&self, to: &impl Fn(Position) -> Position) -> Self {
        let line = |points: &Vec<Position>| points.iter().map(|point| to(*point)).collect();
        let all = |parts: &Vec<Self>| parts.iter().map(|part| part.moved(to)).collect();
        match self {
            Self::Point(point) => Self::Point(to(*point)),
            Self::LineString(points) => Self::LineString(line(points)),
            Self::Polygon(rings) => Self::Polygon(rings.iter().map(line).collect()),
            Self::MultiPoint(parts) => Self::MultiPoint(all(parts)),
            Self::MultiLineString(parts) => Self::MultiLineString(all(parts)),
            Self::MultiPolygon(parts) => Self::MultiPolygon(all(parts)),
            Self::GeometryCollection(parts) => Self::GeometryCollection(all(parts)),
        }
    }

    /// Its points part by part: a point alone, a polyline, each ring of a polygon; collections one after the other.
    pub fn paths(&self) -> Vec<&[Position]> {
        match self {
            Self::Point(point) => vec![std::slice::from_ref(point)],
            Self::LineString(points) => vec![points],
            Self::Polygon(rings) => rings.iter().map(Vec::as_slice).collect(),
            Self::MultiPoint(parts)
            | Self::MultiLineString(parts)
            | Self::MultiPolygon(parts)
            | Self::GeometryCollection(parts) => parts.iter().flat_map(Self::paths).collect(),
        }
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

    fn geometry(&mut self, depth: u8) -> Option<Geometry> {
        self.little = match self.take::<1>()? {
            [0] => false,
            [1] => true,
            _ => return None,
        };
        let said = self.number()?;
        let kind = said & !(EXTENDED_HEIGHT | EXTENDED_SYSTEM);
        if said & EXTENDED_SYSTEM != 0 {
            self.number()?;
        }
        let dimensions = match (kind / 1000, said & EXTENDED_HEIGHT) {
            (0, 0) => 2,
            (0, _) | (1, 0) => 3,
            _ => return None,
        };
        match kind % 1000 {
            1 => self.position(dimensions).map(Geometry::Point),
            2 => self.positions(dimensions).map(Geometry::LineString),
            3 => self.rings(dimensions).map(Geometry::Polygon),
            4 => self.parts(depth).map(Geometry::MultiPoint),
            5 => self.parts(depth).map(Geometry::MultiLineString),
            6 => self.parts(depth).map(Geometry::MultiPolygon),
            7 => self.parts(depth).map(Geometry::GeometryCollection),
            _ => None,
        }
    }

    fn position(&mut self, dimensions: usize) -> Option<Position> {
        Some(Position {
            x: self.real()?,
            y: self.real()?,
            z: match dimensions {
                3 => Some(self.real()?),
                _ => None,
            },
        })
    }

    fn positions(&mut self, dimensions: usize) -> Option<Vec<Position>> {
        let count = self.number()?;
        (0..count).map(|_| self.position(dimensions)).collect()
    }

    fn rings(&mut self, dimensions: usize) -> Option<Vec<Vec<Position>>> {
        let count = self.number()?;
        (0..count).map(|_| self.positions(dimensions)).collect()
    }

    fn parts(&mut self, depth: u8) -> Option<Vec<Geometry>> {
        let count = self.number()?;
        if depth >= DEPTH {
            return None;
        }
        (0..count).map(|_| self.geometry(depth + 1)).collect()
    }
}
