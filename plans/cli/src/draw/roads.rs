//! Lanes with their direction of travel, and intersections.

use crate::draw::colours::{ARROW, BACKGROUND, INTERSECTION, LANE};
use crate::draw::line::{along, length, path, simplified};
use crate::draw::view::View;
use crate::shown::{Crossing, Lane};

/// Width of a driving lane, m.
const LANE_WIDTH_M: f64 = 2.4;
/// From one arrow to the next, px.
const ARROW_EVERY_PX: f64 = 90.0;

/// Lanes as thick translucent bands, each with arrows along it.
pub fn lanes(view: &View, lanes: &[Lane]) -> String {
    let width = (LANE_WIDTH_M * view.scale).clamp(4.0, 22.0);
    let (mut bands, mut arrows) = (String::new(), String::new());
    for lane in lanes {
        let points = view.line(lane.points.iter().map(|[x, y, _]| [*x, *y]));
        let shape = path(&simplified(&points, 0.3));
        bands.push_str(&format!(
            "<path d=\"{shape}\"><title>lane {}: {:.1} m, {}, {} to {}</title></path>\n",
            lane.lane, lane.length_m, lane.direction, lane.start_kind, lane.end_kind
        ));
        arrows.push_str(&lane_arrows(&points, &lane.direction, width));
    }
    format!(
        "<g id=\"lanes\" fill=\"none\" stroke=\"{LANE}\" stroke-opacity=\"0.42\" stroke-width=\"{width:.1}\" \
         stroke-linecap=\"round\" stroke-linejoin=\"round\">\n{bands}</g>\n\
         <path id=\"arrows\" d=\"{arrows}\" fill=\"none\" stroke=\"{ARROW}\" stroke-opacity=\"0.95\" \
         stroke-width=\"{:.1}\" stroke-linecap=\"round\" stroke-linejoin=\"round\"/>\n",
        (width * 0.16).clamp(1.4, 3.0)
    )
}

/// Chevrons that point the way the lane was driven, both where it was driven both ways, none where nobody knows.
fn lane_arrows(points: &[[f64; 2]], direction: &str, width: f64) -> String {
    let size = (width * 0.3).clamp(3.0, 6.0);
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

/// Intersections as round markers.
pub fn intersections(view: &View, intersections: &[Crossing]) -> String {
    let radius = (1.1 * view.scale).clamp(4.0, 9.0);
    let mut marks = String::new();
    for place in intersections
        .iter()
        .filter(|place| place.x.is_finite() && place.y.is_finite())
    {
        let [x, y] = view.at([place.x, place.y]);
        marks.push_str(&format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\"><title>intersection {} of {} lanes</title></circle>\n",
            place.node, place.degree
        ));
    }
    format!(
        "<g id=\"intersections\" fill=\"{INTERSECTION}\" stroke=\"{BACKGROUND}\" stroke-width=\"2\">\n{marks}</g>\n"
    )
}
