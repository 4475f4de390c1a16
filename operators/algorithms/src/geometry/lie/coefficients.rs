//! The scalar functions of the angle that exponentials and Jacobians are made of.
//!
//! All are power series in θ² whose k-th term is `(-1)^k (numerator) θ^2k / (2k + n)!`; in closed
//! form they cancel badly near 0, by θ^-5 at worst.

/// Below this θ² (0.5 rad) the series is used: its last term is then below 1e-18.
const SERIES_BELOW: f64 = 0.25;

/// Horner's rule for `Σ (-1)^k c_k x^k`.
fn alternating(x: f64, coefficients: &[f64]) -> f64 {
    coefficients
        .iter()
        .rev()
        .fold(0.0, |sum, coefficient| coefficient - x * sum)
}

/// `1/n!, 1/(n+2)!, …`, eight terms.
const fn factorials(n: u32) -> [f64; 8] {
    let mut terms = [0.0; 8];
    let mut k = 0;
    while k < 8 {
        let mut factorial = 1.0;
        let mut i = 2;
        while i <= n + 2 * k {
            factorial *= i as f64;
            i += 1;
        }
        terms[k as usize] = 1.0 / factorial;
        k += 1;
    }
    terms
}

const F2: [f64; 8] = factorials(2);
const F3: [f64; 8] = factorials(3);
const F4: [f64; 8] = factorials(4);

/// `(k + 1) / (2k + 5)!`.
const F5: [f64; 8] = {
    let mut terms = factorials(5);
    let mut k = 0;
    while k < 8 {
        terms[k] *= (k + 1) as f64;
        k += 1;
    }
    terms
};

/// `(1 - cos θ) / θ²`.
pub fn one_minus_cos(theta2: f64) -> f64 {
    if theta2 < SERIES_BELOW {
        return alternating(theta2, &F2);
    }
    (1.0 - theta2.sqrt().cos()) / theta2
}

/// `(θ - sin θ) / θ³`.
pub fn angle_minus_sin(theta2: f64) -> f64 {
    if theta2 < SERIES_BELOW {
        return alternating(theta2, &F3);
    }
    let theta = theta2.sqrt();
    (theta - theta.sin()) / (theta2 * theta)
}

/// `(θ² + 2 cos θ - 2) / 2θ⁴`.
pub(super) fn fourth(theta2: f64) -> f64 {
    if theta2 < SERIES_BELOW {
        return alternating(theta2, &F4);
    }
    (theta2 + 2.0 * theta2.sqrt().cos() - 2.0) / (2.0 * theta2 * theta2)
}

/// `(2θ - 3 sin θ + θ cos θ) / 2θ⁵`.
pub(super) fn fifth(theta2: f64) -> f64 {
    if theta2 < SERIES_BELOW {
        return alternating(theta2, &F5);
    }
    let theta = theta2.sqrt();
    let (sin, cos) = theta.sin_cos();
    (2.0 * theta - 3.0 * sin + theta * cos) / (2.0 * theta2 * theta2 * theta)
}

/// `1/θ² - cot(θ/2) / 2θ`, of the inverse Jacobians; finite up to a full turn.
pub(super) fn inverse_square(theta2: f64) -> f64 {
    if theta2 < SERIES_BELOW {
        // Bernoulli numbers: |B_2k| / (2k)!, k = 1, 2, …; all terms have one sign.
        const TERMS: [f64; 7] = [
            1.0 / 12.0,
            1.0 / 720.0,
            1.0 / 30_240.0,
            1.0 / 1_209_600.0,
            1.0 / 47_900_160.0,
            691.0 / 1_307_674_368_000.0,
            1.0 / 74_724_249_600.0,
        ];
        return TERMS
            .iter()
            .rev()
            .fold(0.0, |sum, term| term + theta2 * sum);
    }
    let theta = theta2.sqrt();
    let (sin, cos) = (0.5 * theta).sin_cos();
    (1.0 - 0.5 * theta * cos / sin) / theta2
}
