//! The metric map: landmarks as dots, loop closures as threads, odometry dashed.

use crate::draw::colours::{ACCEPTED, LANDMARK, REJECTED, session};
use crate::draw::drives::{Drive, escaped};
use crate::draw::line::{path, simplified};
use crate::draw::view::View;

/// More landmarks than this are thinned out evenly: a picture has no room for them.
const MOST_LANDMARKS: usize = 40_000;

/// A loop closure, from one keyframe's place to the other's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopLine {
    /// The two places, m.
    pub ends: [[f64; 2]; 2],
    /// Whether the relaxed poses agree with it.
    pub accepted: bool,
}

/// Landmarks within the view, as dots of one path.
pub fn landmarks(view: &View, landmarks: &[[f64; 2]]) -> String {
    let every = landmarks.len().div_ceil(MOST_LANDMARKS).max(1);
    let mut dots = String::new();
    for [x, y] in view.line(landmarks.iter().step_by(every).copied()) {
        if (0.0..=view.width_px).contains(&x) && (0.0..=view.height_px).contains(&y) {
            dots.push_str(&format!("M{x:.1} {y:.1}h0"));
        }
    }
    format!(
        "<path id=\"landmarks\" d=\"{dots}\" fill=\"none\" stroke=\"{LANDMARK}\" stroke-opacity=\"0.45\" \
         stroke-width=\"1.6\" stroke-linecap=\"round\"><title>{} landmarks</title></path>\n",
        landmarks.len()
    )
}

/// Loop closures: those that the map agrees with, and on top those that it does not.
pub fn loops(view: &View, loops: &[LoopLine]) -> String {
    let mut text = String::new();
    for (accepted, colour, width) in [(true, ACCEPTED, 1.0), (false, REJECTED, 1.4)] {
        let chosen = loops.iter().filter(|line| line.accepted == accepted);
        let (mut shape, mut count) = (String::new(), 0);
        for line in chosen {
            shape.push_str(&path(&view.line(line.ends)));
            count += 1;
        }
        let name = if accepted { "accepted" } else { "rejected" };
        text.push_str(&format!(
            "<path id=\"loops-{name}\" d=\"{shape}\" fill=\"none\" stroke=\"{colour}\" stroke-opacity=\"0.7\" \
             stroke-width=\"{width}\" stroke-linecap=\"round\"><title>{count} loops {name}</title></path>\n"
        ));
    }
    text
}

/// The odometry's trajectories, dashed, in the colours of their sessions.
pub fn before(view: &View, drives: &[Drive]) -> String {
    let mut text = String::from("<g id=\"odometry\" fill=\"none\" stroke-linejoin=\"round\">\n");
    for (index, drive) in drives.iter().enumerate() {
        let mut shape = String::new();
        for stretch in drive.stretches() {
            let points = view.line(stretch.iter().copied());
            shape.push_str(&path(&simplified(&points, 0.25)));
        }
        text.push_str(&format!(
            "<path d=\"{shape}\" stroke=\"{}\" stroke-opacity=\"0.7\" stroke-width=\"1.3\" stroke-dasharray=\"5 5\">\
             <title>{}, by odometry</title></path>\n",
            session(index),
            escaped(&drive.session)
        ));
    }
    text.push_str("</g>\n");
    text
}
