//! Nonlinear least squares: robust losses, one trust-region loop, block-sparse normal equations.
//!
//! Minimised is `½ Σ ρ(‖r‖²)` over residuals `r`, each weighted so that its covariance is the
//! identity. The parts are meant to be put together freely:
//!
//! ```text
//! minimise ──linearise, solve, trial_cost, accept──► impl Problem   pose graph, bundle, one pose
//!    (the loop: damping, stopping)                       │
//!                                                        ├── Loss          weights of outliers
//!                                                        ├── BlockSystem   H δ = -g, sparse
//!                                                        └── lie           residuals and steps
//! ```
//!
//! [`minimise`] knows nothing about matrices: a problem with six unknowns solves its 6×6 system
//! by hand, bundle adjustment eliminates its landmarks first, a pose graph hands its blocks to
//! [`BlockSystem`]. All three share damping, stopping and report.
//!
//! Results depend on neither the number of threads nor the order in which they finish: sums are
//! taken in a fixed order, and the factorisation of one system stays on one thread.

mod block_system;
mod loss;
mod structure;
mod trust_region;

#[cfg(test)]
mod tests;

pub use block_system::BlockSystem;
pub use loss::Loss;
pub use structure::{Slot, Structure, SystemError};
pub(crate) use trust_region::absolute_max;
pub use trust_region::{
    Linearisation, Options, Problem, Stop, Summary, TrialStep, damped_diagonal, minimise,
};
