//! Trajectories, one colour a session.

use crate::draw::colours::{BACKGROUND, session};
use crate::draw::line::{path, simplified};
use crate::draw::view::View;

/// Where one session drove.
#[derive(Debug, Clone, PartialEq)]
pub struct Drive {
    /// Name of the session.
    pub session: String,
    /// Positions in the map, in order of time, m.
    pub points: Vec<[f64; 2]>,
}

impl Drive {
    /// The driven stretches: a step much longer than the others is no driven path but a reset, or a hole in the log.
    pub fn stretches(&self) -> Vec<&[[f64; 2]]> {
        let steps: Vec<f64> = self
            .points
            .windows(2)
            .map(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1]))
            .collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted
            .get(sorted.len() * 9 / 10)
            .copied()
            .unwrap_or_default();
        let longest = (10.0 * usual).max(5.0);
        let mut stretches = Vec::new();
        let mut from = 0;
        for (index, step) in steps.iter().enumerate() {
            if !step.is_finite() || *step > longest {
                stretches.push(&self.points[from..=index]);
                from = index + 1;
            }
        }
        stretches.push(&self.points[from..]);
        stretches
    }

    /// Length of the driven stretches, m.
    pub fn length_m(&self) -> f64 {
        self.stretches()
            .into_iter()
            .map(crate::draw::line::length)
            .sum()
    }
}

/// Thin lines, a ring where each begins.
pub fn drives(view: &View, drives: &[Drive]) -> String {
    let mut text = String::from(
        "<g id=\"trajectories\" fill=\"none\" stroke-linejoin=\"round\" stroke-linecap=\"round\">\n",
    );
    for (index, drive) in drives.iter().enumerate() {
        let colour = session(index);
        let mut shape = String::new();
        for stretch in drive.stretches() {
            shape.push_str(&path(&simplified(
                &view.line(stretch.iter().copied()),
                0.25,
            )));
        }
        text.push_str(&format!(
            "<path d=\"{shape}\" stroke=\"{colour}\" stroke-opacity=\"0.9\" stroke-width=\"1.8\"><title>{}: {:.1} m</title></path>\n",
            escaped(&drive.session),
            drive.length_m()
        ));
        if let Some([x, y]) = view.line(drive.points.first().copied()).first() {
            text.push_str(&format!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{BACKGROUND}\" stroke=\"{colour}\" stroke-width=\"2\"/>\n"
            ));
        }
    }
    text.push_str("</g>\n");
    text
}

/// Text that is safe inside XML and HTML.
pub fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            letter if letter.is_control() => safe.push(' '),
            letter => safe.push(letter),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_no_driven_path() {
        let mut points: Vec<[f64; 2]> = (0..20).map(|k| [f64::from(k) * 0.2, 0.0]).collect();
        points.extend((0..20).map(|k| [100.0 + f64::from(k) * 0.2, 0.0]));
        let drive = Drive {
            session: "a".into(),
            points,
        };
        assert_eq!(drive.stretches().len(), 2);
        assert!((drive.length_m() - 7.6).abs() < 1e-9);
        assert_eq!(
            Drive {
                session: "a".into(),
                points: vec![]
            }
            .length_m(),
            0.0
        );
    }
}
