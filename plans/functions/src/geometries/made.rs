//! Geometries that are made of geometries, from above, by the crate `geo`: what comes out is flat.

use arrow::array::{Array, ArrayRef};
use datafusion::common::{DataFusionError, Result};
use evermap_schemas::{Cell, Geometry, Position, Wkb};
use geo::convex_hull::graham_hull;
use geo::{
    BooleanOps, BoundingRect, Buffer, Centroid, CoordsIter, LineString, MultiLineString,
    MultiPolygon, Polygon, Rect,
};

use crate::function::{Argument, Declaration, Kind, given, rows};
use crate::geometries::shapes::{FAR_M, Shape, get, is_within_reach, pair};
use crate::geometries::tangle::check_tangle;
use crate::geometries::{A, B, GEOMETRY, Geometries, made_of};
use crate::guard::guarded;

const DISTANCE: Argument = (
    "distance",
    Kind::Number,
    "how far, m; of a polygon also below 0",
);

const SIDES: [Argument; 4] = [
    ("west", Kind::Number, "the smallest x, m"),
    ("south", Kind::Number, "the smallest y, m"),
    ("east", Kind::Number, "the largest x, m"),
    ("north", Kind::Number, "the largest y, m"),
];

/// The functions.
pub(crate) const DECLARATIONS: [Declaration; 8] = [
    Declaration {
        name: "st_makeenvelope",
        about: "The rectangle along the axes between two corners, as a polygon",
        calls: &[&SIDES],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_within(st_point(1, 2), st_makeenvelope(0, 0, 4, 3))",
            "true",
        ],
        evaluate: rectangles,
    },
    Declaration {
        name: "st_centroid",
        about: "The middle of a geometry: of its areas, else of its lines, else of its points; null where it is empty",
        calls: &[&[GEOMETRY]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_astext(st_centroid(st_geomfromtext('LINESTRING(0 0, 4 2)')))",
            "POINT(2 1)",
        ],
        evaluate: |columns| {
            each(columns, |shape| {
                let middle = shape.centroid()?;
                Some(Geometry::Point(flat(middle.0)))
            })
        },
    },
    Declaration {
        name: "st_envelope",
        about: "The rectangle along the axes that a geometry fills, as a polygon; null where it is empty",
        calls: &[&[GEOMETRY]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_area(st_envelope(st_geomfromtext('LINESTRING(0 0, 4 2)')))",
            "8.0",
        ],
        evaluate: |columns| {
            each(columns, |shape| {
                Some(polygon(&shape.bounding_rect()?.to_polygon()))
            })
        },
    },
    Declaration {
        name: "st_convexhull",
        about: "The smallest polygon without dents around a geometry; null where it is empty",
        calls: &[&[GEOMETRY]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_area(st_convexhull(st_geomfromtext('LINESTRING(0 0, 4 0, 4 2, 1 1)')))",
            "5.0",
        ],
        evaluate: |columns| {
            each(columns, |shape| {
                let mut points: Vec<_> = shape.coords_iter().collect();
                let hull = (!points.is_empty()).then(|| graham_hull(&mut points, false))?;
                Some(polygon(&Polygon::new(hull, Vec::new())))
            })
        },
    },
    Declaration {
        name: "st_buffer",
        about: "All that is within a distance of a geometry, as polygons with rounded corners",
        calls: &[&[GEOMETRY, DISTANCE]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_contains(st_buffer(st_point(0, 0), 2), st_point(1, 1))",
            "true",
        ],
        evaluate: buffers,
    },
    Declaration {
        name: "st_intersection",
        about: "What two geometries have in common: areas of polygons, and of lines what lies in polygons",
        calls: &[&[A, B]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_length(st_intersection(st_geomfromtext('LINESTRING(0 1, 9 1)'), st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))')))",
            "4.0",
        ],
        evaluate: |columns| both(columns, intersection),
    },
    Declaration {
        name: "st_union",
        about: "All that either of two geometries of polygons covers",
        calls: &[&[A, B]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_area(st_union(st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'), st_geomfromtext('POLYGON((0 0, 1 0, 1 9, 0 9, 0 0))')))",
            "18.0",
        ],
        evaluate: |columns| both(columns, union),
    },
    Declaration {
        name: "st_difference",
        about: "What the first of two geometries, of polygons or lines, covers and the second, of polygons, does not",
        calls: &[&[A, B]],
        result: <Wkb as Cell>::data_type,
        example: [
            "SELECT st_area(st_difference(st_geomfromtext('POLYGON((0 0, 4 0, 4 3, 0 3, 0 0))'), st_geomfromtext('POLYGON((0 0, 1 0, 1 9, 0 9, 0 0))')))",
            "9.0",
        ],
        evaluate: |columns| both(columns, difference),
    },
];

fn flat(point: geo::Coord) -> Position {
    Position {
        x: point.x,
        y: point.y,
        z: None,
    }
}

fn polygon(shape: &Polygon) -> Geometry {
    let ring = |ring: &LineString| ring.coords().map(|point| flat(*point)).collect();
    let rings = std::iter::once(shape.exterior()).chain(shape.interiors());
    Geometry::Polygon(rings.map(ring).collect())
}

/// One polygon as such; none and several as a geometry of polygons.
fn polygons(found: &MultiPolygon) -> Geometry {
    match found.0.as_slice() {
        [one] => polygon(one),
        all => Geometry::MultiPolygon(all.iter().map(polygon).collect()),
    }
}

/// One line as such; none and several as a geometry of lines.
fn polylines(found: &MultiLineString) -> Geometry {
    let line =
        |line: &LineString| Geometry::LineString(line.coords().map(|at| flat(*at)).collect());
    match found.0.as_slice() {
        [one] => line(one),
        all => Geometry::MultiLineString(all.iter().map(line).collect()),
    }
}

fn each(columns: &[ArrayRef], make: fn(&Shape) -> Option<Geometry>) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    made_of(geometries.0.len(), |row| match get(&geometries, row)? {
        Some(shape) => guarded(|| make(&shape)),
        None => Ok(None),
    })
}

fn rectangles(columns: &[ArrayRef]) -> Result<ArrayRef> {
    made_of(rows(columns), |row| {
        let sides = given(columns, row);
        Ok(sides.map(|[west, south, east, north]| {
            let corner = |x: f64, y: f64| geo::Coord { x, y };
            polygon(&Rect::new(corner(west, south), corner(east, north)).to_polygon())
        }))
    })
}

fn buffers(columns: &[ArrayRef]) -> Result<ArrayRef> {
    let geometries = Geometries::of(columns, 0)?;
    let distances = columns.get(1..).unwrap_or_default();
    made_of(geometries.0.len(), |row| {
        let distance = given(distances, row);
        let Some((shape, [distance])) = get(&geometries, row)?.zip(distance) else {
            return Ok(None);
        };
        if !is_within_reach(distance) {
            return Err(DataFusionError::Execution(format!(
                "expected a distance of at most {FAR_M:e} m, found {distance}"
            )));
        }
        check_tangle(&[&shape], distance)?;
        guarded(|| Some(polygons(&shape.buffer(distance))))
    })
}

fn both(
    columns: &[ArrayRef],
    make: fn(&Extended, &Extended) -> Result<Geometry>,
) -> Result<ArrayRef> {
    made_of(rows(columns), |row| {
        let Some([a, b]) = pair(columns, row)? else {
            return Ok(None);
        };
        check_tangle(&[&a, &b], 0.0)?;
        let (a, b) = (Extended::of(&a)?, Extended::of(&b)?);
        guarded(|| make(&a, &b))?.map(Some)
    })
}

/// The parts of a geometry that have an extent.
#[derive(Default)]
struct Extended {
    areas: Vec<Polygon>,
    lines: Vec<LineString>,
}

impl Extended {
    fn of(shape: &Shape) -> Result<Self> {
        let mut extended = Self::default();
        extended.add(shape)?;
        Ok(extended)
    }

    fn add(&mut self, shape: &Shape) -> Result<()> {
        match shape {
            Shape::Polygon(area) => self.areas.push(area.clone()),
            Shape::LineString(line) => self.lines.push(line.clone()),
            Shape::GeometryCollection(parts) => parts.iter().try_for_each(|part| self.add(part))?,
            _ => return Err(unfit("polygons or lines", "a point")),
        }
        Ok(())
    }

    /// The polygons, where there are no lines.
    fn areas(&self) -> Result<MultiPolygon> {
        match self.lines.is_empty() {
            true => Ok(MultiPolygon::new(self.areas.clone())),
            false => Err(unfit("polygons", "a line")),
        }
    }

    /// The lines, where there are no polygons.
    fn lines(&self) -> Option<MultiLineString> {
        let only = self.areas.is_empty() && !self.lines.is_empty();
        only.then(|| MultiLineString::new(self.lines.clone()))
    }
}

fn unfit(expected: &str, found: &str) -> DataFusionError {
    DataFusionError::Execution(format!(
        "expected {expected}, found {found}; st_buffer makes polygons of points and lines"
    ))
}

fn intersection(a: &Extended, b: &Extended) -> Result<Geometry> {
    Ok(match (a.lines(), b.lines()) {
        (Some(lines), _) => polylines(&b.areas()?.clip(&lines, false)),
        (None, Some(lines)) => polylines(&a.areas()?.clip(&lines, false)),
        (None, None) => polygons(&a.areas()?.intersection(&b.areas()?)),
    })
}

fn difference(a: &Extended, b: &Extended) -> Result<Geometry> {
    let areas = b.areas()?;
    Ok(match a.lines() {
        Some(lines) => polylines(&areas.clip(&lines, true)),
        None => polygons(&a.areas()?.difference(&areas)),
    })
}

fn union(a: &Extended, b: &Extended) -> Result<Geometry> {
    Ok(polygons(&a.areas()?.union(&b.areas()?)))
}
