//! What a geometry is made of, as it is stored: its kind, its points, how far it reaches.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, Int64Array, StringArray};
use arrow::datatypes::DataType;
use datafusion::common::Result;
use evermap_schemas::{Cell, Geometry, Position, Wkb};

use crate::function::{Declaration, numbers};
use crate::geometries::{GEOMETRY, Geometries, made_of};

/// The functions.
pub(crate) const DECLARATIONS: [Declaration; 9] = [
    Declaration {
        name: "st_geometrytype",
        about: "The kind of a geometry: ST_Point, ST_LineString, ST_Polygon, ST_MultiPoint, …",
        calls: &[&[GEOMETRY]],
        result: || DataType::Utf8,
        example: ["SELECT st_geometrytype(st_point(1, 2))", "ST_Point"],
        evaluate: |columns| texts(columns, |geometry| format!("ST_{}", geometry.kind())),
    },
    Declaration {
        name: "st_asgeojson",
        about: "The geometry as GeoJSON, in the map's metres",
        calls: &[&[GEOMETRY]],
        result: || DataType::Utf8,
        example: [
            "SELECT st_asgeojson(st_point(1, 2))",
            r#"{"type":"Point","coordinates":[1.0,2.0]}"#,
        ],
        evaluate: |columns| texts(columns, |geometry| geometry.geojson().to_string()),
    },
    Declaration {
        name: "st_npoints",
        about: "How many points a geometry has",
        calls: &[&[GEOMETRY]],
        result: || DataType::Int64,
        example: [
            "SELECT st_npoints(st_geomfromtext('LINESTRING(0 1, 3 4, 3 10)'))",
            "3",
        ],
        evaluate: |columns| {
            let geometries = Geometries::of(columns, 0)?;
            let count = |row| {
                let geometry = geometries.get(row)?;
                Ok(geometry.map(|geometry| points(&geometry).count() as i64))
            };
            let counts = (0..geometries.0.len()).map(count);
            Ok(Arc::new(counts.collect::<Result<Int64Array>>()?))
        },
    },
    Declaration {
        name: "st_startpoint",
        about: "The first point of a line; null for other geometries",
        calls: &[&[GEOMETRY]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_astext(st_startpoint(st_geomfromtext('LINESTRING(0 1, 3 4, 3 10)')))",
            "POINT(0 1)",
        ],
        evaluate: |columns| end(columns, <[Position]>::first),
    },
    Declaration {
        name: "st_endpoint",
        about: "The last point of a line; null for other geometries",
        calls: &[&[GEOMETRY]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_astext(st_endpoint(st_geomfromtext('LINESTRING(0 1, 3 4, 3 10)')))",
            "POINT(3 10)",
        ],
        evaluate: |columns| end(columns, <[Position]>::last),
    },
    Declaration {
        name: "st_xmin",
        about: "The smallest x of a geometry, m; null where it is empty",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: [
            "SELECT st_xmin(st_geomfromtext('LINESTRING(0 1, 3 4, 3 10)'))",
            "0.0",
        ],
        evaluate: |columns| extreme(columns, |at| at.x, f64::min),
    },
    Declaration {
        name: "st_xmax",
        about: "The largest x of a geometry, m; null where it is empty",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: [
            "SELECT st_xmax(st_geomfromtext('LINESTRING(0 1, 3 4, 3 10)'))",
            "3.0",
        ],
        evaluate: |columns| extreme(columns, |at| at.x, f64::max),
    },
    Declaration {
        name: "st_ymin",
        about: "The smallest y of a geometry, m; null where it is empty",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: [
            "SELECT st_ymin(st_geomfromtext('LINESTRING(0 1, 3 4, 3 10)'))",
            "1.0",
        ],
        evaluate: |columns| extreme(columns, |at| at.y, f64::min),
    },
    Declaration {
        name: "st_ymax",
        about: "The largest y of a geometry, m; null where it is empty",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: [
            "SELECT st_ymax(st_geomfromtext('LINESTRING(0 1, 3 4, 3 10)'))",
            "10.0",
        ],
        evaluate: |columns| extreme(columns, |at| at.y, f64::max),
    },
];

fn points(geometry: &Geometry) -> impl Iterator<Item = Position> {
    geometry.paths().into_iter().flatten().copied()
}

/// The smallest or the largest coordinate of each geometry along an axis.
fn extreme(
    columns: &[ArrayRef],
    along: fn(Position) -> f64,
    better: fn(f64, f64) -> f64,
) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    numbers(geometries.0.len(), |row| {
        let geometry = geometries.get(row)?;
        Ok(geometry.and_then(|geometry| points(&geometry).map(along).reduce(better)))
    })
}

fn texts(columns: &[ArrayRef], text: fn(&Geometry) -> String) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    let rows = 0..geometries.0.len();
    let texts = rows.map(|row| Ok(geometries.get(row)?.as_ref().map(text)));
    Ok(Arc::new(texts.collect::<Result<StringArray>>()?))
}

/// A point of each line.
fn end(columns: &[ArrayRef], which: fn(&[Position]) -> Option<&Position>) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    made_of(geometries.0.len(), |row| {
        Ok(match geometries.get(row)? {
            Some(Geometry::LineString(line)) => which(&line).copied().map(Geometry::Point),
            _ => None,
        })
    })
}
