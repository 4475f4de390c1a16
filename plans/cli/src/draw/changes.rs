//! What changed between two versions: what is gone, what is new, and which way the rest moved.

use crate::draw::line::path;
use crate::draw::viewport::{Viewport, round_length};

/// How long the longest motion is drawn, px; all others to the same scale.
const LONGEST_PX: f64 = 60.0;

/// What changed since a version.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Changes {
    /// Number of the version before.
    pub since: u64,
    /// Points, lines and outlines that are in the version before only, m.
    pub gone: Vec<Vec<[f64; 2]>>,
    /// Points, lines and outlines that are in the later version only, m.
    pub new: Vec<Vec<[f64; 2]>>,
    /// Points of rows that are in both: where they were and where they are, m.
    pub moved: Vec<[[f64; 2]; 2]>,
}

impl Changes {
    /// Whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        self.gone.is_empty() && self.new.is_empty() && self.moved.is_empty()
    }

    /// All places, m.
    pub fn points(&self) -> impl Iterator<Item = [f64; 2]> {
        let lines = self.gone.iter().chain(&self.new).flatten();
        lines.chain(self.moved.as_flattened()).copied()
    }

    /// How far the farthest point moved, m.
    pub fn most_m(&self) -> f64 {
        let lengths = self.moved.iter();
        let lengths = lengths.map(|[from, to]| (to[0] - from[0]).hypot(to[1] - from[1]));
        lengths
            .filter(|length| length.is_finite())
            .fold(0.0, f64::max)
    }

    /// How many times longer than they are motions are drawn.
    pub fn stretch(&self, viewport: &Viewport) -> f64 {
        let longest_px = self.most_m() * viewport.scale;
        if longest_px > 0.0 {
            round_length(LONGEST_PX / longest_px).max(1.0)
        } else {
            1.0
        }
    }

    /// Path data of motions, from where a point is: the other end is where it was, so many times farther.
    pub fn motions(&self, viewport: &Viewport) -> String {
        let stretch = self.stretch(viewport);
        let motion = |[from, to]: &[[f64; 2]; 2]| {
            let was = [0, 1].map(|axis| to[axis] + stretch * (from[axis] - to[axis]));
            path(&viewport.line([was, *to]))
        };
        self.moved.iter().map(motion).collect()
    }
}

/// Path data of points (as dots), lines and outlines.
pub fn shapes(shapes: &[Vec<[f64; 2]>], viewport: &Viewport) -> String {
    let shape = |points: &Vec<[f64; 2]>| {
        let line = path(&viewport.line(points.iter().copied()));
        if points.len() == 1 { line + "h0" } else { line }
    };
    shapes.iter().map(shape).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_are_drawn_to_one_scale_that_shows_the_longest() {
        let viewport = Viewport::of([0.0, 0.0, 100.0, 60.0], 1000);
        let changes = Changes {
            moved: vec![
                [[10.0, 10.0], [10.004, 10.0]],
                [[20.0, 10.0], [20.0, 10.001]],
            ],
            ..Changes::default()
        };
        let stretch = changes.stretch(&viewport);
        let longest_px = 0.004 * stretch * viewport.scale;
        assert!(
            (LONGEST_PX / 2.5..=LONGEST_PX).contains(&longest_px),
            "{longest_px}"
        );
        let [x, y] = viewport.at([10.004, 10.0]);
        let was = x - longest_px;
        let drawn = changes.motions(&viewport);
        assert!(
            drawn.starts_with(&format!("M{was:.1} {y:.1}L{x:.1} {y:.1}M")),
            "{drawn}"
        );
        // What moved by metres is drawn as it is, what did not move at all too.
        for moved in [vec![[[0.0, 0.0], [90.0, 0.0]]], vec![]] {
            let changes = Changes {
                moved,
                ..Changes::default()
            };
            assert_eq!(changes.stretch(&viewport), 1.0);
        }
    }

    #[test]
    fn points_are_dots() {
        let viewport = Viewport::of([0.0, 0.0, 100.0, 60.0], 1000);
        let drawn = shapes(&[vec![[1.0, 1.0]], vec![[1.0, 1.0], [2.0, 1.0]]], &viewport);
        assert_eq!(drawn.matches("h0").count(), 1, "{drawn}");
    }
}
