//! Pieces of lines on the ground.

/// Where on a piece of a line it is nearest to a place: 0 at its first end, 1 at its last; 0 where it has no length.
pub fn nearest_share([x, y]: [f64; 2], [[ax, ay], [bx, by]]: [[f64; 2]; 2]) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let squared = dx * dx + dy * dy;
    let along = ((x - ax) * dx + (y - ay) * dy) / squared;
    if squared > 0.0 {
        along.clamp(0.0, 1.0)
    } else {
        0.0
    }
}
