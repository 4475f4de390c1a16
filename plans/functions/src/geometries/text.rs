//! Geometries as well-known text, by the crate `wkt`.

use std::str::FromStr;
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, StringArray};
use datafusion::common::{DataFusionError, Result};
use evermap_schemas::{Geometry, Position};
use wkt::Wkt;
use wkt::types::{
    Coord, Dimension, GeometryCollection, LineString, MultiLineString, MultiPoint, MultiPolygon,
    Point, Polygon,
};

use crate::geometries::{Geometries, made_of};

/// Brackets within brackets that are read: more than any geometry has, and few enough for any stack.
const DEPTH: usize = 6;

/// The geometries that texts say.
pub(super) fn read(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let texts = columns
        .first()
        .and_then(|column| column.as_string_opt::<i32>());
    let texts = texts.ok_or_else(|| refused("a text", "another column"))?;
    made_of(texts.len(), |row| {
        let text = texts.is_valid(row).then(|| texts.value(row));
        text.map(geometry).transpose()
    })
}

fn geometry(text: &str) -> Result<Geometry> {
    let mut open = 0_usize;
    for letter in text.chars() {
        match letter {
            '(' => open += 1,
            ')' => open = open.saturating_sub(1),
            _ => {}
        }
        if open > DEPTH {
            return Err(refused("well-known text", "too many brackets"));
        }
    }
    let wkt = Wkt::<f64>::from_str(text).map_err(|error| refused("well-known text", error))?;
    from(&wkt).ok_or_else(|| refused("a geometry", "an empty point"))
}

fn refused(expected: &str, found: &str) -> DataFusionError {
    DataFusionError::Execution(format!(
        "expected {expected} such as 'POINT(1 2)', found {found}"
    ))
}

fn position(coord: &Coord<f64>) -> Position {
    Position {
        x: coord.x,
        y: coord.y,
        z: coord.z,
    }
}

fn positions(line: &LineString<f64>) -> Vec<Position> {
    line.coords().iter().map(position).collect()
}

fn rings(polygon: &Polygon<f64>) -> Geometry {
    Geometry::Polygon(polygon.rings().iter().map(positions).collect())
}

fn from(wkt: &Wkt<f64>) -> Option<Geometry> {
    let point = |point: &Point<f64>| point.coord().map(position).map(Geometry::Point);
    Some(match wkt {
        Wkt::Point(found) => point(found)?,
        Wkt::LineString(line) => Geometry::LineString(positions(line)),
        Wkt::Polygon(polygon) => rings(polygon),
        Wkt::MultiPoint(parts) => {
            Geometry::MultiPoint(parts.points().iter().map(point).collect::<Option<_>>()?)
        }
        Wkt::MultiLineString(parts) => {
            let lines = parts.line_strings().iter().map(positions);
            Geometry::MultiLineString(lines.map(Geometry::LineString).collect())
        }
        Wkt::MultiPolygon(parts) => {
            Geometry::MultiPolygon(parts.polygons().iter().map(rings).collect())
        }
        Wkt::GeometryCollection(parts) => {
            let parts = parts.geometries().iter().map(from);
            Geometry::GeometryCollection(parts.collect::<Option<_>>()?)
        }
    })
}

/// Geometries as texts.
pub(super) fn written(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    let text = |row| {
        Ok(geometries
            .get(row)?
            .map(|geometry| to(&geometry).to_string()))
    };
    let texts = (0..geometries.0.len()).map(text);
    Ok(Arc::new(texts.collect::<Result<StringArray>>()?))
}

fn coord(point: &Position) -> Coord<f64> {
    Coord {
        x: point.x,
        y: point.y,
        z: point.z,
        m: None,
    }
}

fn dimension(of: Option<&Position>) -> Dimension {
    match of.and_then(|point| point.z) {
        Some(_) => Dimension::XYZ,
        None => Dimension::XY,
    }
}

fn line(points: &[Position]) -> LineString<f64> {
    LineString::new(
        points.iter().map(coord).collect(),
        dimension(points.first()),
    )
}

fn polygon(rings: &[Vec<Position>]) -> Polygon<f64> {
    let first = rings.first().and_then(|ring| ring.first());
    Polygon::new(
        rings.iter().map(|ring| line(ring)).collect(),
        dimension(first),
    )
}

fn to(geometry: &Geometry) -> Wkt<f64> {
    let first = geometry.paths().into_iter().flatten().next();
    let dimension = dimension(first);
    match geometry {
        Geometry::Point(point) => Wkt::Point(Point::from_coord(coord(point))),
        Geometry::LineString(points) => Wkt::LineString(line(points)),
        Geometry::Polygon(rings) => Wkt::Polygon(polygon(rings)),
        Geometry::MultiPoint(parts) => {
            let points = parts.iter().filter_map(|part| match part {
                Geometry::Point(point) => Some(Point::from_coord(coord(point))),
                _ => None,
            });
            Wkt::MultiPoint(MultiPoint::new(points.collect(), dimension))
        }
        Geometry::MultiLineString(parts) => {
            let lines = parts.iter().filter_map(|part| match part {
                Geometry::LineString(points) => Some(line(points)),
                _ => None,
            });
            Wkt::MultiLineString(MultiLineString::new(lines.collect(), dimension))
        }
        Geometry::MultiPolygon(parts) => {
            let polygons = parts.iter().filter_map(|part| match part {
                Geometry::Polygon(rings) => Some(polygon(rings)),
                _ => None,
            });
            Wkt::MultiPolygon(MultiPolygon::new(polygons.collect(), dimension))
        }
        Geometry::GeometryCollection(parts) => {
            let parts = parts.iter().map(to).collect();
            Wkt::GeometryCollection(GeometryCollection::new(parts, dimension))
        }
    }
}
