//! Polylines in pixels.

use evermap_algorithms::ground::segment::nearest_share;

/// From one arrow to the next, px.
const ARROW_EVERY_PX: f64 = 90.0;

/// Path data of a line.
pub fn path(points: &[[f64; 2]]) -> String {
    let mut text = String::with_capacity(points.len() * 12);
    for (index, [x, y]) in points.iter().enumerate() {
        text.push_str(&format!(
            "{}{x:.1} {y:.1}",
            if index == 0 { 'M' } else { 'L' }
        ));
    }
    text
}

/// Length, px.
pub fn length(points: &[[f64; 2]]) -> f64 {
    points
        .windows(2)
        .map(|pair| distance(pair[0], pair[1]))
        .sum()
}

/// The point and the unit direction at a distance from the start; `None` for a line without length.
pub fn along(points: &[[f64; 2]], mut at: f64) -> Option<([f64; 2], [f64; 2])> {
    let mut last = None;
    for pair in points.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let step = distance(from, to);
        if step <= 0.0 {
            continue;
        }
        let direction = [(to[0] - from[0]) / step, (to[1] - from[1]) / step];
        if at <= step {
            return Some((
                [from[0] + at * direction[0], from[1] + at * direction[1]],
                direction,
            ));
        }
        at -= step;
        last = Some((to, direction));
    }
    last
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Chevrons that point the way the lane was driven, both where it was driven both ways, none where nobody knows.
pub fn chevrons(points: &[[f64; 2]], direction: &str, size: f64) -> String {
    let length = length(points);
    if length < 4.0 * size {
        return String::new();
    }
    let count = (length / ARROW_EVERY_PX).round().clamp(1.0, 1000.0);
    let mut arrows = String::new();
    let step = length / count;
    let places = (0..count as usize).map(|k| (k as f64 + 0.5) * step);
    let mut chevron = |at: f64, sign: f64| {
        let Some(([x, y], [dx, dy])) = along(points, at) else {
            return;
        };
        let (dx, dy) = (sign * dx, sign * dy);
        let back = [x - size * dx * 0.5, y - size * dy * 0.5];
        let tip = [x + size * dx * 0.5, y + size * dy * 0.5];
        let (left, right) = (
            [back[0] - size * dy, back[1] + size * dx],
            [back[0] + size * dy, back[1] - size * dx],
        );
        arrows.push_str(&path(&[left, tip, right]));
    };
    for place in places {
        match direction {
            "forward" => chevron(place, 1.0),
            "backward" => chevron(place, -1.0),
            "both" => {
                chevron(place + size, 1.0);
                chevron(place - size, -1.0);
            }
            _ => {}
        }
    }
    arrows
}

/// The line with as few points as keep it within a tolerance (Douglas and Peucker 1973), without recursion.
pub fn simplified(points: &[[f64; 2]], tolerance_px: f64) -> Vec<[f64; 2]> {
    if points.len() < 3 {
        return points.to_vec();
    }
    let mut keep = vec![false; points.len()];
    keep[0] = true;
    keep[points.len() - 1] = true;
    let mut open = vec![(0, points.len() - 1)];
    while let Some((from, to)) = open.pop() {
        let farthest = (from + 1..to)
            .map(|index| (index, off(points[index], points[from], points[to])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((index, off)) = farthest
            && off > tolerance_px
        {
            keep[index] = true;
            open.push((from, index));
            open.push((index, to));
        }
    }
    points
        .iter()
        .zip(keep)
        .filter(|(_, keep)| *keep)
        .map(|(point, _)| *point)
        .collect()
}

/// Distance of a point from a stretch.
fn off(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let share = nearest_share(point, [from, to]);
    let nearest = [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
    distance(point, nearest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_simplified_line_stays_within_the_tolerance(
            points in proptest::collection::vec([-100.0..100.0_f64, -100.0..100.0], 0..60),
            tolerance in 0.01..10.0_f64,
        ) {
            let kept = simplified(&points, tolerance);
            prop_assert_eq!(kept.first(), points.first());
            prop_assert_eq!(kept.last(), points.last());
            for point in &points {
                let near = kept.windows(2).map(|pair| off(*point, pair[0], pair[1])).fold(f64::INFINITY, f64::min);
                prop_assert!(kept.len() < 2 || near <= tolerance + 1e-9);
            }
        }
    }

    #[test]
    fn places_along_a_line() {
        let line = [[0.0, 0.0], [0.0, 0.0], [4.0, 0.0], [4.0, 3.0]];
        assert_eq!(along(&line, 1.0), Some(([1.0, 0.0], [1.0, 0.0])));
        assert_eq!(along(&line, 5.0), Some(([4.0, 1.0], [0.0, 1.0])));
        assert_eq!(along(&line, 99.0), Some(([4.0, 3.0], [0.0, 1.0])));
        assert_eq!(along(&line[..2], 0.0), None);
        assert_eq!(length(&line), 7.0);
    }
}
