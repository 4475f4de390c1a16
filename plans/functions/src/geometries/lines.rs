//! Distances between points and lines.

use evermap_algorithms::ground::segment::nearest_share;
use evermap_schemas::{Geometry, Position};
use nalgebra::Vector3;

/// The largest distance of a corner of either geometry from the other, metres, with heights; `None` where one has no
/// point.
pub(super) fn hausdorff_m(a: &Geometry, b: &Geometry) -> Option<f64> {
    if a == b && a.paths().iter().any(|path| !path.is_empty()) {
        return Some(0.0);
    }
    Some(farthest_m(a, b)?.max(farthest_m(b, a)?))
}

/// The largest distance of a corner of one geometry from another.
fn farthest_m(of: &Geometry, from: &Geometry) -> Option<f64> {
    let corners = of.paths().into_iter().flatten();
    let lines = from.paths();
    let distances = corners.map(|corner| {
        let to = lines.iter().map(|line| distance_m(vector(corner), line));
        to.min_by(f64::total_cmp)
    });
    let distances: Option<Vec<f64>> = distances.collect();
    distances?.into_iter().max_by(f64::total_cmp)
}

/// The distance of a place from a line or, where there is one point, from it; infinite where there is none.
fn distance_m(place: Vector3<f64>, line: &[Position]) -> f64 {
    let pieces = line.windows(2).filter_map(|piece| match piece {
        [from, to] => Some(from_piece_m(place, [vector(from), vector(to)])),
        _ => None,
    });
    let ends = line.first().map(|point| (vector(point) - place).norm());
    pieces.chain(ends).fold(f64::INFINITY, f64::min)
}

fn from_piece_m(place: Vector3<f64>, [from, to]: [Vector3<f64>; 2]) -> f64 {
    let piece = to - from;
    let squared = piece.norm_squared();
    let share = if squared > 0.0 {
        ((place - from).dot(&piece) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (from + piece * share - place).norm()
}

fn vector(point: &Position) -> Vector3<f64> {
    Vector3::from(point.to_array())
}

/// The length along a line, with heights, to where it is nearest to a place from above; the first such where there are
/// several, `None` where there is none.
pub(super) fn distance_along_m(line: &[Position], place: [f64; 2]) -> Option<f64> {
    let mut before_m = 0.0;
    let mut nearest: Option<(f64, f64)> = None;
    for piece in line.windows(2) {
        let [from, to] = piece else { continue };
        let share = nearest_share(place, [[from.x, from.y], [to.x, to.y]]);
        let length_m = (vector(to) - vector(from)).norm();
        let at = [
            from.x + (to.x - from.x) * share,
            from.y + (to.y - from.y) * share,
        ];
        let away_m = (at[0] - place[0]).hypot(at[1] - place[1]);
        if nearest.is_none_or(|(least_m, _)| away_m < least_m) {
            nearest = Some((away_m, before_m + length_m * share));
        }
        before_m += length_m;
    }
    nearest.map(|(_, along_m)| along_m)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::Wkb;

    fn line(points: &[[f64; 3]]) -> Geometry {
        Wkb::line_string(points).geometry().unwrap()
    }

    #[test]
    fn a_line_with_more_points_has_not_moved_and_one_beside_has() {
        let straight = line(&[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]);
        let finer = line(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [10.0, 0.0, 0.0]]);
        let bent = line(&[[0.0, 0.0, 0.0], [5.0, 0.0, 2.0], [10.0, 0.0, 0.0]]);
        let none = line(&[]);
        assert_eq!(hausdorff_m(&straight, &finer), Some(0.0));
        assert_eq!(hausdorff_m(&straight, &bent), Some(2.0));
        assert_eq!(hausdorff_m(&bent, &straight), Some(2.0));
        let longer = line(&[[0.0, 0.0, 0.0], [14.0, 0.0, 0.0]]);
        assert_eq!(hausdorff_m(&straight, &longer), Some(4.0));
        assert_eq!(hausdorff_m(&straight, &none), None);
        assert_eq!(hausdorff_m(&none, &none), None);
    }

    #[test]
    fn lengths_along_a_line_count_climbs() {
        let points = [[0.0, 0.0, 0.0], [3.0, 0.0, 4.0], [3.0, 6.0, 4.0]];
        let Geometry::LineString(line) = line(&points) else {
            return;
        };
        let along = |x, y| distance_along_m(&line, [x, y]).unwrap();
        for (place, expected) in [
            ([-1.0, 0.0], 0.0),
            ([1.5, -1.0], 2.5),
            ([4.0, 2.0], 7.0),
            ([3.0, 9.0], 11.0),
        ] {
            assert!((along(place[0], place[1]) - expected).abs() < 1e-12);
        }
        assert_eq!(distance_along_m(&line[..1], [0.0, 0.0]), None);
    }
}
