//! Coordinates, read into no more than an outline of them needs: they may come before the type that says what they are.

use serde::de::SeqAccess;

use crate::annotate::features::{Geometry, Point};
use crate::annotate::reading::{AnyJson, JsonToken, Lenient, OutlinePoints};
use crate::export::ON_EARTH;

/// Why a list is no line.
const NO_POSITION: &str = "feature with a position that is not a list of numbers";

/// What a geometry has as its coordinates, or what stands within them.
#[derive(Debug, Default)]
pub(super) enum WrittenCoordinates {
    /// Nothing, or what no coordinate is.
    #[default]
    Other,
    Number(f64),
    List(CoordinateList),
    /// What evermap writes of those on earth, in their place.
    OnEarth,
}

/// A list as what it may be.
#[derive(Debug, Default)]
pub(super) struct CoordinateList {
    count: usize,
    /// The first elements, as those of a position.
    numbers: [f64; 3],
    has_others: bool,
    /// The elements as the positions of a line.
    points: OutlinePoints<Point>,
    /// The first element, where it is a list: of several, none is taken.
    first: Option<Box<CoordinateList>>,
}

impl Lenient for WrittenCoordinates {
    fn found(&mut self, token: JsonToken<'_>) {
        *self = match token {
            JsonToken::Number(number) => number.as_f64().map_or(Self::Other, Self::Number),
            JsonToken::Text(text) if text == ON_EARTH => Self::OnEarth,
            JsonToken::List => Self::List(CoordinateList::default()),
            JsonToken::Text(_) | JsonToken::Truth(_) | JsonToken::Object => Self::Other,
        };
    }

    fn element<'de, A: SeqAccess<'de>>(&mut self, list: &mut A) -> Result<Option<()>, A::Error> {
        let Some(AnyJson(element)) = list.next_element::<AnyJson<Self>>()? else {
            return Ok(None);
        };
        if let Self::List(own) = self {
            own.take(element);
        }
        Ok(Some(()))
    }
}

impl CoordinateList {
    fn take(&mut self, element: WrittenCoordinates) {
        match element {
            WrittenCoordinates::Number(value) => {
                if let Some(slot) = self.numbers.get_mut(self.count) {
                    *slot = value;
                }
                self.points.end(NO_POSITION);
            }
            WrittenCoordinates::List(list) => {
                self.has_others = true;
                match list.position() {
                    Some(point) => self.points.add(point),
                    None => self.points.end(NO_POSITION),
                }
                if self.count == 0 {
                    self.first = Some(Box::new(list));
                }
            }
            WrittenCoordinates::Other | WrittenCoordinates::OnEarth => {
                self.has_others = true;
                self.points.end(NO_POSITION);
            }
        }
        self.count += 1;
    }

    fn position(&self) -> Option<Point> {
        let [x, y, z] = self.numbers;
        match self.count {
            0 | 1 => None,
            _ if self.has_others => None,
            2 => Some(([x, y], None)),
            _ => Some(([x, y], Some(z))),
        }
    }
}

impl WrittenCoordinates {
    fn into_list(self) -> Option<CoordinateList> {
        match self {
            Self::List(list) => Some(list),
            _ => None,
        }
    }

    /// The outline that coordinates of a type are.
    ///
    /// # Errors
    /// In words, for what is none.
    pub(super) fn outline(self, kind: Option<&str>) -> Result<Geometry, &'static str> {
        let list = self.into_list();
        match kind {
            Some("LineString") => Ok(Geometry::Open(points(list)?)),
            Some("MultiLineString") => Ok(Geometry::Open(points(only(list)?)?)),
            Some("Polygon") => ring(list),
            Some("MultiPolygon") => ring(only(list)?),
            _ => Err("geometry that is neither polygon nor line"),
        }
    }
}

/// The only element of a list; `None` where it is no list.
fn only(parts: Option<CoordinateList>) -> Result<Option<CoordinateList>, &'static str> {
    match parts {
        Some(parts) if parts.count == 1 => Ok(parts.first.map(|first| *first)),
        _ => Err("geometry of several parts"),
    }
}

fn ring(rings: Option<CoordinateList>) -> Result<Geometry, &'static str> {
    match rings {
        Some(rings) if rings.count == 1 => {
            let outer = rings.first.map(|first| *first);
            Ok(Geometry::Closed(points(outer)?))
        }
        Some(rings) if rings.count > 1 => Err("polygon with holes"),
        _ => Err("polygon without a ring"),
    }
}

fn points(positions: Option<CoordinateList>) -> Result<Vec<Point>, &'static str> {
    positions.ok_or(NO_POSITION)?.points.all()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use evermap_algorithms::labels::shapes::MOST_POINTS;
    use serde_json::{Value, json};

    use super::*;
    use crate::annotate::features::TOO_MANY_POINTS;

    fn outline(kind: &str, coordinates: Value) -> Result<Geometry, &'static str> {
        let read: AnyJson<WrittenCoordinates> = serde_json::from_value(coordinates).unwrap();
        read.0.outline(Some(kind))
    }

    #[test]
    fn coordinates_are_what_their_type_says() {
        let line = json!([[0, 1], [2.5, 3, 4, 5]]);
        let points = vec![([0.0, 1.0], None), ([2.5, 3.0], Some(4.0))];
        let (open, closed) = (
            Geometry::Open(points.clone()),
            Geometry::Closed(points.clone()),
        );
        assert_eq!(outline("LineString", line.clone()), Ok(open.clone()));
        assert_eq!(outline("MultiLineString", json!([line])), Ok(open));
        assert_eq!(outline("Polygon", json!([line])), Ok(closed.clone()));
        assert_eq!(outline("MultiPolygon", json!([[line]])), Ok(closed));
        assert_eq!(
            outline("LineString", json!([])),
            Ok(Geometry::Open(Vec::new()))
        );
        for (kind, coordinates, told) in [
            ("LineString", json!([[0, 1], [2]]), NO_POSITION),
            ("LineString", json!([[0, 1], [2, "3"]]), NO_POSITION),
            ("LineString", json!([[0, 1], {}]), NO_POSITION),
            ("LineString", json!([[0, 1], null]), NO_POSITION),
            ("LineString", json!([0, 1]), NO_POSITION),
            ("LineString", json!([line]), NO_POSITION),
            ("LineString", json!("0 1"), NO_POSITION),
            ("LineString", Value::Null, NO_POSITION),
            (
                "MultiLineString",
                json!([line, line]),
                "geometry of several parts",
            ),
            ("MultiLineString", json!([]), "geometry of several parts"),
            ("MultiLineString", json!([1]), NO_POSITION),
            ("Polygon", json!([line, line]), "polygon with holes"),
            ("Polygon", json!([]), "polygon without a ring"),
            ("Polygon", json!(3), "polygon without a ring"),
            ("Polygon", line.clone(), "polygon with holes"),
            ("Polygon", json!([[0, 1]]), NO_POSITION),
            ("MultiPolygon", json!([[]]), "polygon without a ring"),
            ("MultiPolygon", json!([1]), "polygon without a ring"),
            (
                "Point",
                json!([0, 1]),
                "geometry that is neither polygon nor line",
            ),
        ] {
            assert_eq!(
                outline(kind, coordinates.clone()),
                Err(told),
                "{kind} {coordinates}"
            );
        }
    }

    /// The points that are written twice in a row are one.
    #[test]
    fn no_more_points_are_held_than_an_outline_may_have() {
        let line = |count: usize, times: usize| {
            let points = (0..count * times).map(|at| json!([at / times, 0]));
            Value::Array(points.collect())
        };
        for (count, times) in [(MOST_POINTS, 1), (MOST_POINTS, 3), (1, 3 * MOST_POINTS)] {
            let read = outline("LineString", line(count, times));
            let Ok(Geometry::Open(mut points)) = read else {
                panic!("{count} {times}: {read:?}");
            };
            assert!(points.len() <= MOST_POINTS);
            points.dedup();
            assert_eq!(points.len(), count);
        }
        let many = line(MOST_POINTS + 1, 1);
        let read: AnyJson<WrittenCoordinates> = serde_json::from_value(many.clone()).unwrap();
        let list = read.0.into_list().unwrap();
        assert_eq!(list.count, MOST_POINTS + 1);
        assert_eq!(list.points.all(), Err(TOO_MANY_POINTS));
        assert_eq!(outline("LineString", many.clone()), Err(TOO_MANY_POINTS));
        assert_eq!(outline("Polygon", json!([many])), Err(TOO_MANY_POINTS));
        let behind = line(2 * MOST_POINTS, 2);
        assert_eq!(outline("LineString", behind), Err(TOO_MANY_POINTS));
    }
}
