//! Labels as versions of a map place them: each as often as there are versions that have it.

use std::collections::BTreeMap;

use crate::draw::viewport::round_length;
use crate::draw::{Mark, Outline, Scene};
use crate::shown::Label;

/// Labels by the number of the version that places them.
pub type Placings = BTreeMap<u64, Vec<Label>>;

/// How far from its newest outline the farthest one is drawn (m): a fifth of a parking space's width.
const FARTHEST_M: f64 = 0.5;
/// Less than this is no motion (m).
const NOTHING_M: f64 = 1e-5;

impl Scene {
    /// The same place with its labels as versions place them: over the ground and the lanes, without all else. What was
    /// rejected is not there. Outlines are so many times farther from the newest one of their label than they are that they
    /// are seen apart.
    pub fn with_placings(self, placings: &Placings) -> Self {
        let shown = |label: &&Label| label.standing != "rejected";
        let all = placings.iter().flat_map(|(version, labels)| {
            labels.iter().filter(shown).map(move |it| (*version, it))
        });
        let newest: BTreeMap<&str, &Label> =
            all.clone().map(|(_, it)| (it.label.as_str(), it)).collect();
        let off_m = |label: &Label| apart_m(label, newest[label.label.as_str()]);
        let most_m = all.clone().map(|(_, it)| off_m(it)).fold(0.0, f64::max);
        let stretch = stretch(most_m);
        let outlines = all.map(|(version, label)| Outline {
            mark: Mark::Version(version),
            title: format!(
                "{} {} in version {version}: {:.0} mm off the newest",
                label.kind,
                label.label,
                1e3 * off_m(label)
            ),
            said: true,
            closed: label.shape != "polyline",
            points: stretched(label, newest[label.label.as_str()], stretch),
        });
        let outlines = outlines.collect();
        let mut notes = vec![format!("apart, at most {:.0} mm", 1e3 * most_m)];
        if stretch > 1.0 {
            notes.push(format!("distance drawn {stretch} times longer"));
        }
        Self {
            tiles: self.tiles,
            lanes: self.lanes,
            heading_rad: self.heading_rad,
            outlines,
            notes,
            ..Self::default()
        }
    }
}

/// How many times longer than they are distances are drawn, the longest of which is this (m).
fn stretch(most_m: f64) -> f64 {
    if most_m > NOTHING_M {
        round_length(FARTHEST_M / most_m).max(1.0)
    } else {
        1.0
    }
}

/// Corners of two outlines from above, where they have as many.
fn pairs(one: &Label, other: &Label) -> impl Iterator<Item = [[f64; 2]; 2]> {
    let alike = one.points.len() == other.points.len();
    let pairs = one.points.iter().zip(&other.points).filter(move |_| alike);
    pairs.map(|(a, b)| [[a[0], a[1]], [b[0], b[1]]])
}

/// How far the farthest corners of two outlines are apart from above (m); 0 where they have not as many.
fn apart_m(one: &Label, other: &Label) -> f64 {
    let apart = pairs(one, other).map(|[a, b]| (a[0] - b[0]).hypot(a[1] - b[1]));
    apart.filter(|it| it.is_finite()).fold(0.0, f64::max)
}

/// An outline from above, so many times farther from another one than it is; as it is where they have not as many corners.
fn stretched(one: &Label, from: &Label, times: f64) -> Vec<[f64; 2]> {
    if one.points.len() != from.points.len() {
        return one.points.iter().map(|[x, y, _]| [*x, *y]).collect();
    }
    let corner = |[at, from]: [[f64; 2]; 2]| [0, 1].map(|k| from[k] + times * (at[k] - from[k]));
    pairs(one, from).map(corner).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::draw::tests::scene;
    use crate::draw::{Canvas, draw};

    /// A space whose corner lies there.
    fn space(label: &str, standing: &str, x: f64) -> Label {
        let corners = [[x, 10.0], [x + 5.0, 10.0], [x + 5.0, 12.4], [x, 12.4]];
        Label {
            site: "lot".into(),
            label: label.into(),
            kind: "parking_space".into(),
            standing: standing.into(),
            shape: "box".into(),
            points: corners.map(|[x, y]| [x, y, 0.0]).to_vec(),
        }
    }

    #[test]
    fn seven_versions_of_a_label_are_seven_outlines() {
        let off_m = [0.004, -0.002, 0.001, 0.0, 0.003, 0.001, 0.0];
        let placings: Placings = (1..=7)
            .zip(off_m)
            .map(|(version, off)| {
                let labels = [
                    space("one", "accepted", 20.0 + off),
                    space("two", "rejected", 40.0),
                ];
                (version, labels.to_vec())
            })
            .collect();
        let scene = scene().with_placings(&placings);
        // 4 mm times 100 are 0.4 m; 200 times would be 0.8.
        assert_eq!(
            scene.notes,
            ["apart, at most 4 mm", "distance drawn 100 times longer"]
        );
        let corners: Vec<f64> = scene.outlines.iter().map(|it| it.points[0][0]).collect();
        let expected = off_m.map(|off| 20.0 + 100.0 * off);
        assert_eq!(corners.len(), 7);
        for (found, expected) in corners.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{corners:?}");
        }
        assert!(scene.outlines[0].title.contains("version 1: 4 mm off"));
        let svg = draw(&scene, Canvas::default()).unwrap().svg;
        let outlines = svg.split("<g id=\"outlines\"").nth(1).unwrap();
        let outlines = outlines.split("</g>").next().unwrap();
        assert_eq!(outlines.matches("<path").count(), 7);
        let colours: std::collections::BTreeSet<String> =
            scene.outlines.iter().map(|it| it.mark.colour()).collect();
        assert_eq!(colours.len(), 7, "each version has its own");
    }

    #[test]
    fn what_stays_and_what_is_far_apart_is_drawn_as_it_is() {
        let of = |to: f64| -> Placings {
            let versions = [(1, 20.0), (3, to)];
            let placed = versions.map(|(version, x)| (version, vec![space("one", "drawn", x)]));
            placed.into()
        };
        for (to, told) in [(20.0, "0 mm"), (22.0, "2000 mm")] {
            let scene = scene().with_placings(&of(to));
            assert_eq!(scene.notes, [format!("apart, at most {told}")]);
            assert_eq!(scene.outlines[0].points[0], [20.0, 10.0]);
        }
        // An outline that was drawn anew, with other corners, has no distance.
        let mut placings = of(20.001);
        let newest = placings.last_entry().unwrap().into_mut();
        newest[0].points.truncate(3);
        assert_eq!(scene().with_placings(&placings).notes.len(), 1);
    }
}
