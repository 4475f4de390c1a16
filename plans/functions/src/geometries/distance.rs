//! How far geometries are from each other, from above.
//!
//! Not by `geo`: of two open lines whose boxes lie apart it overlooks the edges at their last corners, of lines of one
//! point it panics, and beside an empty part of a collection everything is near.

use geo::{Coord, CoordsIter, Distance, Euclidean, Intersects, Line, Point};
use rstar::RTree;
use rstar::primitives::CachedEnvelope;

use crate::geometries::shapes::{Shape, edges};

/// As many edges are looked through; of more a tree is made.
const FEW: usize = 16;

/// The distance of two geometries, 0 where they touch; infinite where one has no point.
pub(super) fn distance_m(a: &Shape, b: &Shape) -> f64 {
    if a.intersects(b) {
        return 0.0;
    }
    // Of edges that do not cross, one is nearest to the other at one of its ends.
    from_corners_m(a, edges(b)).min(from_corners_m(b, edges(a)))
}

/// The least distance of a corner of a geometry from edges of another one.
fn from_corners_m(shape: &Shape, edges: Vec<Line>) -> f64 {
    if shape.coords_count().min(edges.len()) <= FEW {
        let least_m = |corner: Coord| {
            let each = edges.iter().map(|edge| Euclidean.distance(corner, edge));
            each.fold(f64::INFINITY, f64::min)
        };
        return shape
            .coords_iter()
            .map(least_m)
            .fold(f64::INFINITY, f64::min);
    }
    let tree = RTree::bulk_load(edges.into_iter().map(CachedEnvelope::new).collect());
    let nearest_m = |corner: Coord| {
        let nearest: &Line = tree.nearest_neighbor(&Point(corner))?;
        Some(Euclidean.distance(corner, nearest))
    };
    let nearest_m = shape.coords_iter().filter_map(nearest_m);
    nearest_m.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use geo::{LineString, Polygon};
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    type Place = [f64; 2];

    /// A part of a geometry; rings are open.
    #[derive(Debug, Clone)]
    enum Part {
        Point(Place),
        Line(Vec<Place>),
        Area(Vec<Vec<Place>>),
    }

    impl Part {
        fn shape(&self) -> Shape {
            let line = |places: &Vec<Place>| LineString::from(places.clone());
            match self {
                Self::Point([x, y]) => Shape::Point(Point::new(*x, *y)),
                Self::Line(places) => Shape::LineString(line(places)),
                Self::Area(rings) => Shape::Polygon(Polygon::new(
                    line(&rings[0]),
                    rings[1..].iter().map(line).collect(),
                )),
            }
        }

        fn edges(&self) -> Vec<[Place; 2]> {
            let along = |places: &Vec<Place>| -> Vec<[Place; 2]> {
                places.windows(2).map(|pair| [pair[0], pair[1]]).collect()
            };
            match self {
                Self::Point(place) => vec![[*place, *place]],
                Self::Line(places) => along(places),
                Self::Area(rings) => {
                    let closed = |ring: &Vec<Place>| {
                        along(&ring.iter().chain(ring.first()).copied().collect())
                    };
                    rings.iter().flat_map(closed).collect()
                }
            }
        }

        /// Whether a place is inside; what is said of its border does not matter.
        fn covers(&self, [x, y]: Place) -> bool {
            let Self::Area(_) = self else {
                return false;
            };
            let crosses = |[[ax, ay], [bx, by]]: &[Place; 2]| {
                (*ay > y) != (*by > y) && x < (bx - ax) * (y - ay) / (by - ay) + ax
            };
            let border = self.edges();
            let crossed = border.iter().filter(|edge| crosses(edge)).count();
            crossed % 2 == 1
        }
    }

    /// Whether edges cross within both.
    fn cross([a, b]: [Place; 2], [c, d]: [Place; 2]) -> bool {
        let side = |a: Place, b: Place, c: Place| {
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
    }

    fn from_edge([x, y]: Place, [[ax, ay], [bx, by]]: [Place; 2]) -> f64 {
        let (dx, dy) = (bx - ax, by - ay);
        let squared = dx * dx + dy * dy;
        let share = match squared > 0.0 {
            true => (((x - ax) * dx + (y - ay) * dy) / squared).clamp(0.0, 1.0),
            false => 0.0,
        };
        (ax + share * dx - x).hypot(ay + share * dy - y)
    }

    /// The distance of all edges from all edges.
    fn naive(a: &Part, b: &Part) -> f64 {
        let mut least = f64::INFINITY;
        for edge in a.edges() {
            for other in b.edges() {
                let covered =
                    edge.iter().any(|end| b.covers(*end)) || other.iter().any(|end| a.covers(*end));
                if covered || cross(edge, other) {
                    return 0.0;
                }
                let ends = edge.map(|end| from_edge(end, other)).into_iter();
                let ends = ends.chain(other.map(|end| from_edge(end, edge)));
                least = ends.fold(least, f64::min);
            }
        }
        least
    }

    fn place() -> impl Strategy<Value = Place> {
        [-15_i32..15, -15_i32..15].prop_map(|place| place.map(f64::from))
    }

    fn point() -> impl Strategy<Value = Part> {
        place().prop_map(Part::Point)
    }

    fn line() -> impl Strategy<Value = Part> {
        let corners = prop_oneof![9 => 2_usize..6, 1 => 20_usize..40];
        corners
            .prop_flat_map(|corners| vec(place(), corners))
            .prop_map(Part::Line)
    }

    /// A rectangle, with a hole where there is room.
    fn area() -> impl Strategy<Value = Part> {
        let sides = [1_i32..12, 1_i32..12].prop_map(|sides| sides.map(f64::from));
        (place(), sides).prop_map(|([x, y], [width, height])| {
            let ring = |rim: f64| {
                let (west, east) = (x + rim, x + width - rim);
                let (south, north) = (y + rim, y + height - rim);
                vec![[west, south], [east, south], [east, north], [west, north]]
            };
            let hole = (width.min(height) > 2.0).then(|| ring(1.0));
            Part::Area([ring(0.0)].into_iter().chain(hole).collect())
        })
    }

    /// A geometry of each kind: of one part, and of several.
    fn kinds() -> impl Strategy<Value = Vec<Vec<Part>>> {
        (
            [vec(point(), 1), vec(point(), 2..4)],
            [vec(line(), 1), vec(line(), 2..4)],
            [vec(area(), 1), vec(area(), 2..4)],
        )
            .prop_map(|(points, lines, areas)| [points, lines, areas].concat())
    }

    fn shape(parts: &[Part]) -> Shape {
        match parts {
            [part] => part.shape(),
            parts => Shape::GeometryCollection(parts.iter().map(Part::shape).collect()),
        }
    }

    proptest! {
        #[test]
        fn geometries_of_all_kinds_are_as_far_apart_as_their_nearest_edges(
            some in kinds(),
            others in kinds(),
        ) {
            for (a, b) in some.iter().flat_map(|a| others.iter().map(move |b| (a, b))) {
                let pairs = a.iter().flat_map(|a| b.iter().map(move |b| naive(a, b)));
                let expected = pairs.fold(f64::INFINITY, f64::min);
                let found = distance_m(&shape(a), &shape(b));
                prop_assert!((found - expected).abs() < 1e-9, "{a:?} {b:?}: {found}, {expected}");
            }
        }
    }

    #[test]
    fn the_last_corners_of_open_lines_count() {
        let line = |places: &[Place]| Shape::LineString(places.iter().copied().collect());
        let bent = line(&[[1.0, 3.0], [0.0, 2.0], [6.0, 8.0]]);
        let straight = line(&[[11.0, 8.0], [7.0, 8.0]]);
        assert_eq!(distance_m(&bent, &straight), 1.0);
        assert_eq!(distance_m(&straight, &bent), 1.0);
    }

    #[test]
    fn lines_of_one_point_and_empty_parts_are_no_exceptions() {
        let alone = Shape::LineString(LineString::from(vec![[3.0, 4.0]]));
        let origin = Shape::Point(Point::new(0.0, 0.0));
        let empty = Shape::LineString(LineString::new(Vec::new()));
        let parts = Shape::GeometryCollection([empty.clone(), alone.clone()].into_iter().collect());
        for (a, b, expected) in [
            (&alone, &origin, 5.0),
            (&alone, &alone, 0.0),
            (&parts, &origin, 5.0),
            (&origin, &parts, 5.0),
            (&empty, &origin, f64::INFINITY),
        ] {
            assert_eq!(distance_m(a, b), expected, "{a:?} {b:?}");
        }
    }
}
