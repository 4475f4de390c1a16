//! How good a labelling is, and how close a distribution is to the field's.

use super::mean_field::{Kernel, RandomField};
use super::{CrfError, Marginals, Unary};
use crate::permutohedral::{Eight, Value};

impl RandomField {
    /// The Gibbs energy of a labelling, up to what is equal for all labellings:
    /// `Σ_i u_i(x_i) - ½ Σ_i Σ_j [x_i = x_j] Σ_m w_m k_m(i, j)`, every pixel being its own neighbour, too. A pixel with
    /// a label that is no class has no part in it.
    ///
    /// # Errors
    /// [`CrfError::Size`] for costs or labels of another number of pixels.
    pub fn energy(&self, unary: &Unary, labels: &[u8]) -> Result<f64, CrfError> {
        self.fits(self.pixels(), labels.len())?;
        let mut probabilities = vec![0.0; unary.costs.len()];
        for (of_pixel, label) in probabilities.chunks_exact_mut(unary.classes).zip(labels) {
            if let Some(sure) = of_pixel.get_mut(usize::from(*label)) {
                *sure = 1.0;
            }
        }
        let sure = Marginals {
            classes: unary.classes,
            probabilities,
        };
        let (own, joint) = self.parts(unary, &sure)?;
        Ok(own - 0.5 * joint)
    }

    /// What mean field makes small, up to a constant: `Σ_i Σ_l Q ln Q + Σ_i Σ_l Q u - Σ_i Σ_l Q Σ_m w_m (k_m Q)`. The
    /// last part counts every pair twice, as in the reference implementation's function of the same name.
    ///
    /// # Errors
    /// As [`RandomField::energy`].
    pub fn divergence(&self, unary: &Unary, marginals: &Marginals) -> Result<f64, CrfError> {
        let (own, joint) = self.parts(unary, marginals)?;
        let entropy = |q: &f32| f64::from(*q) * f64::from(q.max(1e-20)).ln();
        Ok(marginals.probabilities.iter().map(entropy).sum::<f64>() + own - joint)
    }

    /// `Σ Q u` and `Σ Q Σ w k Q`.
    fn parts(&self, unary: &Unary, marginals: &Marginals) -> Result<(f64, f64), CrfError> {
        self.fits(unary.classes * self.pixels(), unary.costs.len())?;
        self.fits(unary.costs.len(), marginals.probabilities.len())?;
        let pairs = marginals.probabilities.iter().zip(&unary.costs);
        let own = pairs
            .map(|(q, cost)| f64::from(*q) * f64::from(*cost))
            .sum();
        let joint = self
            .appearance
            .as_ref()
            .map_or(0.0, |kernel| joint(kernel, marginals))
            + self
                .smoothness
                .as_ref()
                .map_or(0.0, |kernel| joint(kernel, marginals));
        Ok((own, joint))
    }
}

/// `w Σ Q k Q`, eight classes after the other.
fn joint<const V: usize>(kernel: &Kernel<V>, marginals: &Marginals) -> f64 {
    let classes = marginals.classes;
    let mut sum = 0.0;
    for first in (0..classes).step_by(8) {
        let eight = |of_pixel: &[f32]| {
            let mut eight = Eight([0.0; 8]);
            for (lane, q) in eight.0.iter_mut().zip(&of_pixel[first..]) {
                *lane = *q;
            }
            [eight]
        };
        let given: Vec<[Eight; 1]> = marginals
            .probabilities
            .chunks_exact(classes)
            .map(eight)
            .collect();
        let mut filtered = vec![<[Eight; 1]>::ZERO; given.len()];
        let mut buffer = kernel.lattice.buffer();
        kernel.lattice.splat(0, &given, buffer.values_mut());
        kernel
            .lattice
            .blur(&mut buffer, kernel.lattice.constant() * kernel.weight);
        kernel.lattice.slice(0, buffer.values(), &mut filtered);
        for ([given], [filtered]) in given.iter().zip(&filtered) {
            let lanes = given.0.iter().zip(&filtered.0);
            sum += lanes
                .map(|(a, b)| f64::from(*a) * f64::from(*b))
                .sum::<f64>();
        }
    }
    sum
}
