//! Outlines of labels: which are boxes, where their middle is, which cross themselves.
//!
//! Outlines are given in the map, as drawn, and kept in a frame of the label's own: its origin is the label's middle, its z
//! axis the map's, its x axis a box's length (a half turn of it is the same box; corner 0 is in front, to the left), else
//! the map's x axis.

use nalgebra::{UnitQuaternion, Vector3};

use crate::geometry::pose::Pose;

/// A quadrilateral counts as a box where no corner is farther than this share of its diagonal from the rectangle's: what is
/// left of a rectangle that was written in pixels.
const BOX_SHARE: f64 = 0.01;

/// Outlines of more points than this are left out: to find out whether they cross themselves takes the square of it.
pub const MOST_POINTS: usize = 4096;

/// An outline in a frame of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// The frame in the map.
    pub map_from_label: Pose,
    /// Points in that frame, m.
    pub points: Vec<[f64; 3]>,
}

impl Outline {
    /// Of points in the map, about a middle, with the x axis at `yaw_rad`.
    fn about(middle: Vector3<f64>, yaw_rad: f64, points: &[[f64; 3]]) -> Self {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let map_from_label = Pose::new(middle, turn);
        let label_from_map = map_from_label.inverse();
        let own = |point: &[f64; 3]| label_from_map.transform(&Vector3::from(*point)).into();
        Self {
            map_from_label,
            points: points.iter().map(own).collect(),
        }
    }
}

/// Length (x) and width (y) of a box in its own frame, m.
pub fn size(corners: &[[f64; 3]]) -> Option<[f64; 2]> {
    let [corner, ..] = corners else { return None };
    (corners.len() == 4).then(|| [2.0 * corner[0].abs(), 2.0 * corner[1].abs()])
}

/// Whether these are the corners of a box about its own frame, from front left counter-clockwise; to a millimetre.
pub fn is_box(corners: &[[f64; 3]]) -> bool {
    let Some([length, width]) = size(corners) else {
        return false;
    };
    let (x, y) = (length / 2.0, width / 2.0);
    let expected = [[x, y], [-x, y], [-x, -y], [x, -y]];
    let off = |axis: usize, (found, expected): (&[f64; 3], &[f64; 2])| {
        (found[axis] - expected[axis]).abs() > 1e-3
    };
    let wrong = |pair: (&[f64; 3], &[f64; 2])| off(0, pair) || off(1, pair);
    length > 0.0 && width > 0.0 && !corners.iter().zip(&expected).any(wrong)
}

/// The box with these corners, in turn around it in either sense; `None` where they are no rectangle from above. Its length
/// is the longer side; it lies flat, at their mean height.
pub fn oriented_box(corners: &[[f64; 3]]) -> Option<Outline> {
    let [a, b, c, d]: [Vector3<f64>; 4] = corners
        .iter()
        .map(|corner| Vector3::from(*corner))
        .collect::<Vec<_>>()
        .try_into()
        .ok()?;
    let middle = (a + b + c + d) / 4.0;
    // Half the mean of opposite sides.
    let (one, other) = ((b - a + c - d).xy() / 4.0, (c - b + d - a).xy() / 4.0);
    let (along, across) = if one.norm() >= other.norm() {
        (one, other)
    } else {
        (other, one)
    };
    let yaw_rad = along.y.atan2(along.x);
    let (forward, left) = (along.norm(), across.norm());
    if !(left > 0.0 && forward.is_finite()) {
        return None;
    }
    let points = [
        [forward, left],
        [-forward, left],
        [-forward, -left],
        [forward, -left],
    ];
    let found = Outline {
        points: points.map(|[x, y]| [x, y, 0.0]).to_vec(),
        ..Outline::about(middle, yaw_rad, &[])
    };
    let off = |corner: &Vector3<f64>| {
        let distances = found.points.iter().map(|point| {
            let point = found.map_from_label.transform(&Vector3::from(*point));
            (point - corner).xy().norm()
        });
        distances.fold(f64::INFINITY, f64::min)
    };
    let tolerance = BOX_SHARE * 2.0 * forward.hypot(left);
    [a, b, c, d]
        .iter()
        .all(|corner| off(corner) <= tolerance)
        .then_some(found)
}

/// A polygon, each corner once, about its centre of area.
pub fn polygon(corners: &[[f64; 3]]) -> Outline {
    Outline::about(centroid(corners), 0.0, corners)
}

/// A polyline, about the point halfway along it.
pub fn polyline(points: &[[f64; 3]]) -> Outline {
    Outline::about(halfway(points), 0.0, points)
}

/// Centre of the area that corners enclose; their mean where that is nothing. Heights are their mean.
fn centroid(corners: &[[f64; 3]]) -> Vector3<f64> {
    let mean: Vector3<f64> = corners
        .iter()
        .map(|c| Vector3::from(*c))
        .sum::<Vector3<f64>>()
        / corners.len().max(1) as f64;
    let own = |corner: &[f64; 3]| (Vector3::from(*corner) - mean).xy();
    let (mut twice_area, mut moment) = (0.0, nalgebra::Vector2::zeros());
    for (corner, next) in edges(corners) {
        let (a, b) = (own(&corner), own(&next));
        let cross = a.perp(&b);
        twice_area += cross;
        moment += (a + b) * cross;
    }
    let span = corners.iter().map(|c| own(c).norm()).fold(0.0, f64::max);
    if twice_area.abs() <= 1e-9 * span * span {
        return mean;
    }
    let centre = moment / (3.0 * twice_area);
    mean + Vector3::new(centre.x, centre.y, 0.0)
}

/// What corners enclose, seen from above, m².
pub fn area(corners: &[[f64; 3]]) -> f64 {
    let Some([x, y, _]) = corners.first() else {
        return 0.0;
    };
    // From the first one, as products of large coordinates are rounded.
    let twice = edges(corners).map(|(a, b)| (a[0] - x) * (b[1] - y) - (b[0] - x) * (a[1] - y));
    twice.sum::<f64>().abs() / 2.0
}

/// The point at half the length of a polyline.
fn halfway(points: &[[f64; 3]]) -> Vector3<f64> {
    let points: Vec<Vector3<f64>> = points.iter().map(|point| Vector3::from(*point)).collect();
    let lengths = points.windows(2).map(|ends| (ends[1] - ends[0]).norm());
    let mut left = lengths.clone().sum::<f64>() / 2.0;
    for (ends, length) in points.windows(2).zip(lengths) {
        if length > 0.0 && left <= length {
            return ends[0] + (ends[1] - ends[0]) * (left / length);
        }
        left -= length;
    }
    points.first().copied().unwrap_or_default()
}

/// Where two edges of a polygon cross or lie on each other that are no neighbours, seen from above, m; `None` for a simple
/// polygon. Takes time with the square of the corners.
pub fn crossing(corners: &[[f64; 3]]) -> Option<[f64; 2]> {
    let edges: Vec<_> = edges(corners).collect();
    for (index, one) in edges.iter().enumerate() {
        for (other_index, other) in edges.iter().enumerate().skip(index + 2) {
            let neighbours = index == 0 && other_index == edges.len() - 1;
            if !neighbours && let Some(place) = meet(one, other) {
                return Some(place);
            }
        }
    }
    None
}

type Edge = ([f64; 3], [f64; 3]);

/// The edges of a closed outline.
fn edges(corners: &[[f64; 3]]) -> impl Iterator<Item = Edge> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(a, b)| (*a, *b))
}

/// A point that two edges share, from above.
fn meet((a, b): &Edge, (c, d): &Edge) -> Option<[f64; 2]> {
    let side = |p: &[f64; 3], q: &[f64; 3], r: &[f64; 3]| {
        (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    };
    let within = |p: &[f64; 3], q: &[f64; 3], r: &[f64; 3]| {
        (0..2).all(|axis| r[axis] >= p[axis].min(q[axis]) && r[axis] <= p[axis].max(q[axis]))
    };
    let (of_c, of_d) = (side(a, b, c), side(a, b, d));
    let (of_a, of_b) = (side(c, d, a), side(c, d, b));
    if of_c * of_d < 0.0 && of_a * of_b < 0.0 {
        let share = of_a / (of_a - of_b);
        return Some([0, 1].map(|axis| a[axis] + share * (b[axis] - a[axis])));
    }
    let touching = [
        (of_c, a, b, c),
        (of_d, a, b, d),
        (of_a, c, d, a),
        (of_b, c, d, b),
    ];
    let touch = touching
        .into_iter()
        .find(|(side, p, q, r)| *side == 0.0 && within(p, q, r));
    touch.map(|(_, _, _, r)| [r[0], r[1]])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn corners(length: f64, width: f64, at: Pose) -> Vec<[f64; 3]> {
        let (x, y) = (length / 2.0, width / 2.0);
        let corners = [[x, y], [-x, y], [-x, -y], [x, -y]];
        let placed = |[x, y]: [f64; 2]| at.transform(&Vector3::new(x, y, 0.0)).into();
        corners.map(placed).to_vec()
    }

    proptest! {
        #[test]
        fn a_rectangle_is_a_box_however_it_is_written(
            size in (1.0..9.0_f64, 1.0..9.0_f64), at in prop::array::uniform3(-50.0..50.0_f64),
            first in 0..4_usize, turned in any::<bool>()
        ) {
            let mut drawn = corners(size.0, size.1, Pose::from_yaw(at[0], at[1], at[2]));
            drawn.rotate_left(first);
            if turned {
                drawn.reverse();
            }
            let found = oriented_box(&drawn).unwrap();
            let [length, width] = super::size(&found.points).unwrap();
            prop_assert!((length - size.0.max(size.1)).abs() < 1e-9 && (width - size.0.min(size.1)).abs() < 1e-9);
            for point in &found.points {
                let point = found.map_from_label.transform(&Vector3::from(*point));
                let nearest = drawn.iter().map(|corner| (Vector3::from(*corner) - point).norm());
                prop_assert!(nearest.fold(f64::INFINITY, f64::min) < 1e-9);
            }
            prop_assert!(crossing(&drawn).is_none() && is_box(&found.points));
        }
    }

    #[test]
    fn what_is_no_rectangle_is_no_box() {
        let at = Pose::identity();
        assert!(oriented_box(&corners(5.0, 2.0, at)[..3]).is_none());
        let mut skew = corners(5.0, 2.0, at);
        skew[0][0] += 0.5;
        assert!(oriented_box(&skew).is_none());
        assert!(oriented_box(&[[1.0, 1.0, 0.0]; 4]).is_none());
        assert!(!is_box(&[[1.0, 1.0, 0.0]; 4]) && !is_box(&skew));
    }

    #[test]
    fn a_box_on_a_slope_is_as_large_as_it_is_from_above() {
        let mut drawn = corners(5.0, 2.4, Pose::from_yaw(3.0, 4.0, 0.7));
        drawn
            .iter_mut()
            .for_each(|corner| corner[2] = 0.15 * corner[0]);
        let found = oriented_box(&drawn).unwrap();
        let [length, width] = size(&found.points).unwrap();
        assert!((length - 5.0).abs() < 1e-9 && (width - 2.4).abs() < 1e-9);
        assert!((found.map_from_label.translation.z - 0.45).abs() < 1e-9);
    }

    #[test]
    fn the_area_of_corners_is_the_same_far_away() {
        for away in [0.0, 5e6] {
            let at = Pose::from_yaw(away, -away, 0.0);
            assert!((area(&corners(5.0, 2.0, at)) - 10.0).abs() < 1e-6);
        }
        assert_eq!(area(&[[0.0; 3], [1.0, 1.0, 0.0], [3.0, 3.0, 9.0]]), 0.0);
        assert_eq!(area(&[]), 0.0);
    }

    #[test]
    fn outlines_lie_about_their_middle() {
        let triangle = [[0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, 3.0, 1.0]];
        let found = polygon(&triangle);
        let middle = found.map_from_label.translation;
        assert!((middle - Vector3::new(1.0, 1.0, 1.0)).norm() < 1e-12);
        assert!((Vector3::from(found.points[1]) - Vector3::new(2.0, -1.0, 0.0)).norm() < 1e-12);
        let line = polyline(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 5.0, 0.0]]);
        assert_eq!(line.map_from_label.translation, Vector3::new(1.0, 2.0, 0.0));
        let nothing = polyline(&[[2.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
        assert_eq!(nothing.map_from_label.translation.x, 2.0);
    }

    #[test]
    fn a_bow_tie_crosses_itself_and_a_hook_does_not() {
        let flat = |points: &[[f64; 2]]| -> Vec<[f64; 3]> {
            points.iter().map(|[x, y]| [*x, *y, 0.0]).collect()
        };
        let tie = flat(&[[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]]);
        assert_eq!(crossing(&tie), Some([1.0, 1.0]));
        let hook = flat(&[
            [0.0, 0.0],
            [3.0, 0.0],
            [3.0, 3.0],
            [2.0, 3.0],
            [2.0, 1.0],
            [0.0, 1.0],
        ]);
        assert_eq!(crossing(&hook), None);
        let touching = flat(&[[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [2.0, 0.0], [0.0, 2.0]]);
        assert_eq!(crossing(&touching), Some([2.0, 0.0]));
    }
}
