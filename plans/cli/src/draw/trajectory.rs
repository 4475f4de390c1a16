//! Where sessions drove.

/// Where one session drove.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Name of the session.
    pub session: String,
    /// Positions in the map, in order of time, m.
    pub points: Vec<[f64; 2]>,
}

impl Trajectory {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_no_driven_path() {
        let mut points: Vec<[f64; 2]> = (0..20).map(|k| [f64::from(k) * 0.2, 0.0]).collect();
        points.extend((0..20).map(|k| [100.0 + f64::from(k) * 0.2, 0.0]));
        let driven = Trajectory {
            session: "a".into(),
            points,
        };
        assert_eq!(driven.stretches().len(), 2);
        assert!((driven.length_m() - 7.6).abs() < 1e-9);
        assert_eq!(
            Trajectory {
                session: "a".into(),
                points: vec![]
            }
            .length_m(),
            0.0
        );
    }
}
