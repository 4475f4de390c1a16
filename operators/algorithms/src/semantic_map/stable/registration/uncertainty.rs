//! How sure an alignment is.
//!
//! A sandwich (Huber 1967, White 1980; by clusters, Liang & Zeger 1986): by how much what tiles of the image say differs,
//! seen through how steeply the loss bends. The step of Gauss–Newton takes it to bend by squares of derivatives, and that is
//! several times too much: in images years apart part of a derivative is noise, aliasing or shade, which the other image does
//! not have, and what is far off weighs less the farther it goes (Robinson & Milanfar 2004 have what gradients with noise do
//! to registration). On simulated streets of 256 to 1024 px columns the loss bends by 0.1 to 0.4 of it along what is known
//! least, and standard deviations came out 2 to 10 times too small. So its bend is measured.
//!
//! What is the same in all tiles no sandwich knows of: between four pixels, inverse range is taken to be straight, and on a
//! plane it is a cosine. That is worked out.

use nalgebra::Matrix6;

use super::alignment::{Aligner, Estimate, Fit, Normal, Unknowns, scaled};

/// The bend is measured so many standard deviations to both sides, of those that are too small: about what an estimate may
/// be off by. One to eight of them say the same.
const WIDTH: f64 = 4.0;
/// The loss bends by at least this share of what derivatives say, along any axis: less is lost in the noise of measuring it.
/// Chosen on simulated streets of 256 and 512 px, where a fiftieth says too little of what is known and a tenth too much.
const LEAST_BEND: f64 = 0.05;

impl Aligner<'_> {
    /// The covariance of `reference_from_other` along the axes of the other (m, rad), at an estimate where it was just
    /// aligned. `None` where it is no number.
    pub fn covariance(&mut self, estimate: &Estimate, fit: &Fit) -> Option<Matrix6<f64>> {
        self.see(estimate);
        let (normal, _) = self.normal(fit.deviations);
        // Residuals hang together within tiles, as they are of the same things: what tiles say apart is independent.
        let scatter = scatter(&self.pulls(fit.deviations));
        let everywhere = self.pull_of_range(fit.deviations, straightened(self.pixel_rad()));
        let naive = inverse(&normal)?;
        let too_small = naive * scatter * naive;
        let steps = Unknowns::from_fn(|row, _| {
            let variance = too_small[(row, row)].max(naive[(row, row)]);
            WIDTH * variance.sqrt()
        });
        let bread = inverse_bend(&normal, &self.bend(estimate, fit, &steps))?;
        let off = bread * everywhere;
        let all = bread * scatter * bread + off * off.transpose();
        let covariance = all.fixed_view::<6, 6>(0, 0).into_owned();
        let sound = covariance.iter().all(|value| value.is_finite());
        sound.then(|| (covariance + covariance.transpose()) * 0.5)
    }

    /// Second derivatives of the loss around an estimate, from what pulls at it these steps to both sides. Points are seen
    /// from there afterwards.
    fn bend(&mut self, estimate: &Estimate, fit: &Fit, steps: &Unknowns) -> Normal {
        let mut bend = Normal::zeros();
        for unknown in 0..8 {
            let mut step = Unknowns::zeros();
            step[unknown] = steps[unknown];
            let mut pull = |step: &Unknowns| {
                self.see(&estimate.moved(step));
                let pulls = self.pulls(fit.deviations);
                pulls.into_iter().sum::<Unknowns>()
            };
            let change = pull(&step) - pull(&-step);
            bend.set_column(unknown, &(change / (2.0 * steps[unknown])));
        }
        (bend + bend.transpose()) * 0.5
    }
}

/// How far tiles pull apart.
fn scatter(pulls: &[Unknowns]) -> Normal {
    let mut scatter = Normal::zeros();
    for pull in pulls {
        scatter.ger(1.0, pull, pull, 1.0);
    }
    scatter
}

/// By which share of itself, about, the inverse range of a plane is off, at the mean over the places between four pixels:
/// along a great circle it is a cosine, which what is straight between pixels at a distance p misses by p²/12 of it, and so
/// along rows and columns. All points of the ground are, and so the height: by 0.15 mm in 1.5 m at 256 px columns.
fn straightened(pixel_rad: f64) -> f64 {
    pixel_rad * pixel_rad / 6.0
}

fn inverse(normal: &Normal) -> Option<Normal> {
    let (ones, scale) = scaled(normal)?;
    Some(stretched(&ones.cholesky()?.inverse(), &scale))
}

/// The inverse of how the loss bends: along each of the axes on which that is a share of what derivatives say, at least
/// [`LEAST_BEND`] of it and at most all.
fn inverse_bend(normal: &Normal, bend: &Normal) -> Option<Normal> {
    let (ones, scale) = scaled(normal)?;
    let bend = stretched(bend, &scale);
    if !bend.iter().all(|value| value.is_finite()) {
        return None;
    }
    let lower = ones.cholesky()?.l();
    let half = lower.solve_lower_triangular(&bend)?;
    let shares = lower.solve_lower_triangular(&half.transpose())?;
    let along = ((shares + shares.transpose()) * 0.5).symmetric_eigen();
    let mut axes = lower.tr_solve_lower_triangular(&along.eigenvectors)?;
    for (mut axis, share) in axes.column_iter_mut().zip(along.eigenvalues.iter()) {
        axis /= share.clamp(LEAST_BEND, 1.0).sqrt();
    }
    Some(stretched(&(axes * axes.transpose()), &scale))
}

/// Rows and columns times a scale.
fn stretched(matrix: &Normal, scale: &Unknowns) -> Normal {
    Normal::from_fn(|row, column| matrix[(row, column)] * scale[row] * scale[column])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Units that differ by orders of magnitude, and unknowns that hang together.
    fn normal() -> Normal {
        let scale = Unknowns::from_fn(|row, _| 10_f64.powi(row as i32 - 4));
        let together =
            Normal::from_fn(|row, column| 0.3_f64.powi((row as i32 - column as i32).abs()));
        stretched(&together, &scale)
    }

    #[test]
    fn a_loss_that_bends_less_is_surer_of_less() {
        let normal = normal();
        let naive = inverse(&normal).unwrap();
        for (share, believed) in [
            (1.0, 1.0),
            (0.25, 0.25),
            (0.01, LEAST_BEND),
            (-1.0, LEAST_BEND),
            (7.0, 1.0),
        ] {
            let found = inverse_bend(&normal, &(normal * share)).unwrap();
            // Nothing in the inverse is far from zero but for a band along the diagonal.
            let difference = Normal::from_fn(|row, column| {
                let size = (naive[(row, row)] * naive[(column, column)]).sqrt();
                (found[(row, column)] * believed - naive[(row, column)]) / size
            });
            assert!(difference.amax() < 1e-4, "{share}: {difference}");
        }
        assert_eq!(inverse_bend(&normal, &(normal * f64::NAN)), None);
    }
}
