//! What the crate `geo` says of geometries from above.

use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, BooleanArray};
use arrow::compute::kernels::cmp::lt_eq;
use arrow::datatypes::Float64Type;
use datafusion::common::{DataFusionError, Result};
use evermap_schemas::{Geometry, Position};
use geo::relate::IntersectionMatrix;
use geo::{
    Contains, Coord, CoordsIter, Euclidean, Length, Line, LineString, Point, Polygon, Relate,
};

use crate::function::{numbers, rows};
use crate::geometries::Geometries;
use crate::geometries::distance::distance_m;
use crate::geometries::tangle::check_tangle;
use crate::guard::guarded;

/// A geometry from above.
pub(super) type Shape = geo::Geometry<f64>;

fn line(points: &[Position]) -> LineString {
    let coords = points.iter().map(|point| Coord {
        x: point.x,
        y: point.y,
    });
    coords.collect()
}

/// A geometry as `geo` has it, without heights.
fn shape(geometry: &Geometry) -> Shape {
    match geometry {
        Geometry::Point(point) => Shape::Point(Point::new(point.x, point.y)),
        Geometry::LineString(points) => Shape::LineString(line(points)),
        Geometry::Polygon(rings) => {
            let mut rings = rings.iter().map(|ring| line(ring));
            let outline = rings.next().unwrap_or_else(|| LineString::new(Vec::new()));
            Shape::Polygon(Polygon::new(outline, rings.collect()))
        }
        Geometry::MultiPoint(parts)
        | Geometry::MultiLineString(parts)
        | Geometry::MultiPolygon(parts)
        | Geometry::GeometryCollection(parts) => {
            Shape::GeometryCollection(parts.iter().map(shape).collect())
        }
    }
}

/// The edges of a geometry, and each point that stands alone as one without a length.
pub(super) fn edges(shape: &Shape) -> Vec<Line> {
    match shape {
        Shape::Point(point) => vec![Line::new(point.0, point.0)],
        Shape::LineString(line) => edges_along(line),
        Shape::Polygon(area) => {
            let rings = std::iter::once(area.exterior()).chain(area.interiors());
            rings.flat_map(edges_along).collect()
        }
        Shape::GeometryCollection(parts) => parts.iter().flat_map(edges).collect(),
        _ => Vec::new(),
    }
}

fn edges_along(line: &LineString) -> Vec<Line> {
    match line.0.as_slice() {
        [alone] => vec![Line::new(*alone, *alone)],
        _ => line.lines().collect(),
    }
}

/// Farther from the origin nothing lies, m: products of such numbers are still exact enough to tell sides.
pub(super) const FAR_M: f64 = 1e12;

/// Whether it can be computed with.
pub(super) fn is_within_reach(metres: f64) -> bool {
    metres.abs() <= FAR_M
}

fn shape_within_reach(geometry: &Geometry) -> Result<Shape> {
    let mut points = geometry.paths().into_iter().flatten();
    let is_far = |point: &&Position| !(is_within_reach(point.x) && is_within_reach(point.y));
    match points.find(is_far) {
        None => Ok(shape(geometry)),
        Some(point) => Err(DataFusionError::Execution(format!(
            "expected a geometry of finite numbers, of at most {FAR_M:e}, found a point at {}, {}",
            point.x, point.y
        ))),
    }
}

pub(super) fn get(geometries: &Geometries<'_>, row: usize) -> Result<Option<Shape>> {
    let geometry = geometries.get(row)?;
    geometry.as_ref().map(shape_within_reach).transpose()
}

/// A number of each geometry.
pub(super) fn each(columns: &[ArrayRef], of: fn(&Shape) -> f64) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    numbers(geometries.0.len(), |row| {
        let shape = get(&geometries, row)?;
        shape.map(|shape| guarded(|| of(&shape))).transpose()
    })
}

pub(super) fn length_m(shape: &Shape) -> f64 {
    match shape {
        Shape::LineString(line) => Euclidean.length(line),
        Shape::GeometryCollection(parts) => parts.iter().map(length_m).sum(),
        _ => 0.0,
    }
}

pub(super) fn pair(columns: &[ArrayRef], row: usize) -> Result<Option<[Shape; 2]>> {
    let (a, b) = (Geometries::of(columns, 0)?, Geometries::of(columns, 1)?);
    let pair = get(&a, row)?.zip(get(&b, row)?);
    Ok(pair.map(|(a, b)| [a, b]))
}

/// The distances of pairs.
pub(super) fn distances(columns: &[ArrayRef]) -> Result<ArrayRef> {
    numbers(rows(columns), |row| {
        let pair = pair(columns, row)?;
        let whole = pair.filter(|pair| pair.iter().all(|shape| shape.coords_count() > 0));
        let distance = whole.map(|[a, b]| guarded(|| distance_m(&a, &b)));
        distance.transpose()
    })
}

/// Whether pairs are at most so far apart.
pub(super) fn near(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let (found, most) = (distances(columns)?, columns.get(2));
    let most = most.and_then(|column| column.as_primitive_opt::<Float64Type>());
    let most = most.ok_or_else(|| DataFusionError::Execution("expected a distance".to_owned()))?;
    let near = lt_eq(found.as_primitive::<Float64Type>(), most)?;
    Ok(Arc::new(near))
}

/// Whether pairs stand to each other in some way.
pub(super) fn relation(
    columns: &[ArrayRef],
    holds: fn(&Shape, &Shape) -> bool,
) -> Result<ArrayRef> {
    told(columns, |a, b| guarded(|| holds(a, b)))
}

/// Whether of pairs, put in order, the second lies in the first.
pub(super) fn containing(
    columns: &[ArrayRef],
    ordered: for<'a> fn(&'a Shape, &'a Shape) -> [&'a Shape; 2],
) -> Result<ArrayRef> {
    told(columns, |a, b| {
        let [outer, inner] = ordered(a, b);
        // Of all but points it is told by where insides and borders meet.
        if !matches!(inner, Shape::Point(_)) {
            check_tangle(&[outer, inner], 0.0)?;
        }
        guarded(|| outer.contains(inner))
    })
}

/// Whether pairs stand to each other as the places say where their insides and borders meet.
pub(super) fn related(
    columns: &[ArrayRef],
    holds: fn(&IntersectionMatrix) -> bool,
) -> Result<ArrayRef> {
    told(columns, |a, b| {
        check_tangle(&[a, b], 0.0)?;
        guarded(|| holds(&a.relate(b)))
    })
}

/// Whether something holds of pairs.
fn told(columns: &[ArrayRef], of: impl Fn(&Shape, &Shape) -> Result<bool>) -> Result<ArrayRef> {
    let row = |row| {
        let pair = pair(columns, row)?;
        pair.map(|[a, b]| of(&a, &b)).transpose()
    };
    let found = (0..rows(columns)).map(row);
    Ok(Arc::new(found.collect::<Result<BooleanArray>>()?))
}
