//! Functions on geometries: well-known binary, in a map's metres. Names and meanings are PostGIS's, so `st_*` look from
//! above; where heights count, it is said.

mod distance;
mod lines;
pub(crate) mod made;
pub(crate) mod parts;
mod shapes;
mod tangle;
mod text;

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BinaryArray};
use arrow::datatypes::DataType;
use datafusion::common::{DataFusionError, Result};
use evermap_schemas::{Cell, Geometry, Position, Wkb};
use geo::relate::IntersectionMatrix;
use geo::{Area, Intersects};

use crate::function::{Argument, Declaration, Kind, given, numbers, rows};

const GEOMETRY: Argument = ("geometry", Kind::Geometry, "a geometry, such as lanes have");
const A: Argument = ("a", Kind::Geometry, "a geometry");
const B: Argument = ("b", Kind::Geometry, "another geometry");
const X: Argument = ("x", Kind::Number, "a place along x, m");
const Y: Argument = ("y", Kind::Number, "a place along y, m");
const Z: Argument = ("z", Kind::Number, "its height, m");

/// The functions.
pub(crate) const DECLARATIONS: [Declaration; 20] = [
    Declaration {
        name: "st_point",
        about: "The point at a place",
        calls: &[&[X, Y], &[X, Y, Z]],
        result: <Wkb as Cell>::data_type,
        example: ["SELECT st_x(st_point(3, 4))", "3.0"],
        evaluate: point,
    },
    Declaration {
        name: "st_x",
        about: "Where a point is along x, m; null for other geometries",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: ["SELECT st_x(st_point(3, 4))", "3.0"],
        evaluate: |columns| of_point(columns, |point| Some(point.x)),
    },
    Declaration {
        name: "st_y",
        about: "Where a point is along y, m; null for other geometries",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: ["SELECT st_y(st_point(3, 4))", "4.0"],
        evaluate: |columns| of_point(columns, |point| Some(point.y)),
    },
    Declaration {
        name: "st_z",
        about: "The height of a point, m; null for other geometries and flat ones",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: ["SELECT st_z(st_point(3, 4, 5))", "5.0"],
        evaluate: |columns| of_point(columns, |point| point.z),
    },
    Declaration {
        name: "st_geomfromtext",
        about: "The geometry that a well-known text says",
        calls: &[&[("text", Kind::Text, "well-known text, such as POINT(1 2)")]],
        result: <Wkb as Cell>::data_type,
        example: ["SELECT st_y(st_geomfromtext('POINT(1 2)'))", "2.0"],
        evaluate: text::read,
    },
    Declaration {
        name: "st_astext",
        about: "The geometry as well-known text",
        calls: &[&[GEOMETRY]],
        result: || DataType::Utf8,
        example: ["SELECT st_astext(st_point(1, 2, 3))", "POINT Z(1 2 3)"],
        evaluate: text::written,
    },
    Declaration {
        name: "st_length",
        about: "Length of the lines of a geometry from above, m; 0 for points and polygons",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: [
            "SELECT st_length(st_geomfromtext('LINESTRING(0 0, 3 4, 3 10)'))",
            "11.0",
        ],
        evaluate: |columns| shapes::each(columns, shapes::length_m),
    },
    Declaration {
        name: "st_area",
        about: "Area of the polygons of a geometry from above, m²; 0 for points and lines",
        calls: &[&[GEOMETRY]],
        result: || DataType::Float64,
        example: [
            "SELECT st_area(st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'))",
            "12.0",
        ],
        evaluate: |columns| shapes::each(columns, |shape| shape.unsigned_area()),
    },
    Declaration {
        name: "st_distance",
        about: "Smallest distance between two geometries from above, m; 0 where they touch, null where one is empty",
        calls: &[&[A, B]],
        result: || DataType::Float64,
        example: [
            "SELECT st_distance(st_point(5, 3), st_geomfromtext('LINESTRING(0 0, 10 0)'))",
            "3.0",
        ],
        evaluate: shapes::distances,
    },
    Declaration {
        name: "st_intersects",
        about: "Whether two geometries have a point in common from above",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_intersects(st_geomfromtext('LINESTRING(0 0, 2 2)'), st_geomfromtext('LINESTRING(0 2, 2 0)'))",
            "true",
        ],
        evaluate: |columns| shapes::relation(columns, |a, b| a.intersects(b)),
    },
    Declaration {
        name: "st_contains",
        about: "Whether the second geometry lies in the first from above, and not on its border alone",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_contains(st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'), st_point(1, 1))",
            "true",
        ],
        evaluate: |columns| shapes::containing(columns, |a, b| [a, b]),
    },
    Declaration {
        name: "st_within",
        about: "Whether the first geometry lies in the second from above, and not on its border alone",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_within(st_point(9, 1), st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'))",
            "false",
        ],
        evaluate: |columns| shapes::containing(columns, |a, b| [b, a]),
    },
    Declaration {
        name: "st_disjoint",
        about: "Whether two geometries have no point in common from above",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_disjoint(st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'), st_point(9, 1))",
            "true",
        ],
        evaluate: |columns| shapes::related(columns, IntersectionMatrix::is_disjoint),
    },
    Declaration {
        name: "st_touches",
        about: "Whether two geometries have only points of their borders in common from above",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_touches(st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'), st_point(4, 1))",
            "true",
        ],
        evaluate: |columns| shapes::related(columns, IntersectionMatrix::is_touches),
    },
    Declaration {
        name: "st_crosses",
        about: "Whether two geometries cross from above: a line another one, or the border of a polygon",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_crosses(st_geomfromtext('LINESTRING(0 0, 4 4)'), st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'))",
            "true",
        ],
        evaluate: |columns| shapes::related(columns, IntersectionMatrix::is_crosses),
    },
    Declaration {
        name: "st_overlaps",
        about: "Whether two geometries of one kind cover a part of each other from above, and neither all of the other",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_overlaps(st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'), st_geomfromtext('POLYGON((2 1, 9 1, 9 9, 2 9, 2 1))'))",
            "true",
        ],
        evaluate: |columns| shapes::related(columns, IntersectionMatrix::is_overlaps),
    },
    Declaration {
        name: "st_equals",
        about: "Whether two geometries cover the same from above, whatever the order of their points",
        calls: &[&[A, B]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_equals(st_geomfromtext('LINESTRING(0 0, 4 4)'), st_geomfromtext('LINESTRING(4 4, 0 0)'))",
            "true",
        ],
        evaluate: |columns| shapes::related(columns, IntersectionMatrix::is_equal_topo),
    },
    Declaration {
        name: "st_dwithin",
        about: "Whether two geometries are at most so far apart from above; null where one is empty",
        calls: &[&[A, B, ("distance", Kind::Number, "a distance, m")]],
        result: || DataType::Boolean,
        example: [
            "SELECT st_dwithin(st_point(5, 3), st_geomfromtext('LINESTRING(0 0, 10 0)'), 3)",
            "true",
        ],
        evaluate: shapes::near,
    },
    Declaration {
        name: "st_hausdorffdistance",
        about: "How far two geometries differ: the largest distance of a corner of either from the other's points and lines, m, with heights; null where one has no point",
        calls: &[&[A, B]],
        result: || DataType::Float64,
        example: [
            "SELECT st_hausdorffdistance(st_point(0, 0), st_point(3, 4))",
            "5.0",
        ],
        evaluate: |columns| {
            let (a, b) = (Geometries::of(columns, 0)?, Geometries::of(columns, 1)?);
            numbers(a.0.len(), |row| {
                let pair = a.get(row)?.zip(b.get(row)?);
                Ok(pair.and_then(|(a, b)| lines::hausdorff_m(&a, &b)))
            })
        },
    },
    Declaration {
        name: "distance_along",
        about: "Length along a line, with heights, from its start to where it is nearest to a place from above, m; null for geometries that are not lines",
        calls: &[&[GEOMETRY, X, Y]],
        result: || DataType::Float64,
        example: [
            "SELECT distance_along(st_geomfromtext('LINESTRING(0 0, 10 0, 10 10)'), 12, 5)",
            "15.0",
        ],
        evaluate: along,
    },
];

/// A column of geometries.
pub(crate) struct Geometries<'a>(pub &'a BinaryArray);

impl<'a> Geometries<'a> {
    pub(crate) fn of(columns: &'a [ArrayRef], index: usize) -> Result<Self> {
        let column = columns.get(index).and_then(|column| column.as_binary_opt());
        column.map(Self).ok_or_else(|| {
            DataFusionError::Execution("expected a geometry as well-known binary".to_owned())
        })
    }

    pub(crate) fn get(&self, row: usize) -> Result<Option<Geometry>> {
        let read = |bytes| Geometry::from_wkb(bytes);
        let read = self.0.is_valid(row).then(|| read(self.0.value(row)));
        let read = read.transpose();
        read.map_err(|fault| DataFusionError::Execution(fault.message))
    }
}

/// A geometry of each row.
fn made_of(
    rows: usize,
    geometry: impl FnMut(usize) -> Result<Option<Geometry>>,
) -> Result<ArrayRef> {
    let made = (0..rows).map(geometry);
    let bytes = made.map(|made| Ok(made?.map(|made| made.to_wkb().0)));
    Ok(Arc::new(bytes.collect::<Result<BinaryArray>>()?))
}

fn of_point(columns: &[ArrayRef], of: fn(Position) -> Option<f64>) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    numbers(geometries.0.len(), |row| {
        Ok(match geometries.get(row)? {
            Some(Geometry::Point(point)) => of(point),
            _ => None,
        })
    })
}

fn point(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let point = |row: usize| match columns.len() {
        2 => given(columns, row).map(|[x, y]| Position { x, y, z: None }),
        _ => given(columns, row).map(|[x, y, z]| Position { x, y, z: Some(z) }),
    };
    made_of(rows(columns), |row| Ok(point(row).map(Geometry::Point)))
}

fn along(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    let places = columns.get(1..).unwrap_or_default();
    numbers(geometries.0.len(), |row| {
        Ok(match (geometries.get(row)?, given(places, row)) {
            (Some(Geometry::LineString(line)), Some(place)) => {
                lines::distance_along_m(&line, place)
            }
            _ => None,
        })
    })
}
