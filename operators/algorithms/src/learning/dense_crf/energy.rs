//! How good a labelling is, and how close a distribution is to the field's.

use super::mean_field::{Kernel, RandomField};
use super::{CrfError, Marginals, Unary};
use crate::learning::permutohedral::{BLOCK, Eight, Value};

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
            .map_or(0.0, |kernel| joint(kernel, &self.order, marginals))
            + self
                .smoothness
                .as_ref()
                .map_or(0.0, |kernel| joint(kernel, &self.order, marginals));
        Ok((own, joint))
    }
}

/// `w Σ Q k Q`, eight classes after the other.
fn joint<const V: usize>(kernel: &Kernel<V>, order: &[u32], marginals: &Marginals) -> f64 {
    let classes = marginals.classes;
    let mut sum = 0.0;
    for first in (0..classes).step_by(8) {
        let eight = |pixel: &u32| {
            let of_pixel = *pixel as usize * classes;
            let mut eight = Eight([0.0; 8]);
            let given = &marginals.probabilities[of_pixel + first..of_pixel + classes];
            for (lane, q) in eight.0.iter_mut().zip(given) {
                *lane = *q;
            }
            [eight]
        };
        let given: Vec<[Eight; 1]> = order.iter().map(eight).collect();
        let mut buffer = kernel.lattice.buffer();
        for (block, given) in given.chunks(BLOCK).enumerate() {
            kernel.lattice.splat(block, given, buffer.values_mut());
        }
        let factor = kernel.lattice.constant() * kernel.weight;
        kernel.lattice.blur(&mut buffer, factor);
        for (block, given) in given.chunks(BLOCK).enumerate() {
            let mut filtered = [<[Eight; 1]>::ZERO; BLOCK];
            let filtered = &mut filtered[..given.len()];
            kernel.lattice.slice(block, buffer.values(), filtered);
            for ([given], [filtered]) in given.iter().zip(filtered.iter()) {
                let lanes = given.0.iter().zip(&filtered.0);
                sum += lanes
                    .map(|(a, b)| f64::from(*a) * f64::from(*b))
                    .sum::<f64>();
            }
        }
    }
    sum
}
