//! Directions seen from above.

/// From one position to another, seen from above.
pub(super) fn ahead(from: &[f64; 3], to: &[f64; 3]) -> [f64; 2] {
    [to[0] - from[0], to[1] - from[1]]
}

/// The same direction with length 1; the x axis for no direction.
pub(super) fn unit(v: [f64; 2]) -> [f64; 2] {
    let length = v[0].hypot(v[1]);
    if length > 0.0 && length.is_finite() {
        [v[0] / length, v[1] / length]
    } else {
        [1.0, 0.0]
    }
}

pub(super) fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// A quarter turn to the left.
pub(super) fn left(v: [f64; 2]) -> [f64; 2] {
    [-v[1], v[0]]
}

/// The position moved sideways.
pub(super) fn shifted(p: &[f64; 3], course: [f64; 2], left_m: f64) -> [f64; 3] {
    let side = left(course);
    [p[0] + left_m * side[0], p[1] + left_m * side[1], p[2]]
}
