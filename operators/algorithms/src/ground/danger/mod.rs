//! Where people are, from where they were seen and how often anybody looked: the dynamic map of paper 1 (V-C).
//!
//! The ground is cut into square cells, time into looks. In one look at a cell somebody is there or not; the map has the
//! probability x of it. Three things speak for it, each with a weight that is a number of looks:
//!
//! ```text
//!   what ground of its kind is like    a (x_i - x0_i)²            prior_looks     Eq. 2, first sum
//!   what its neighbours are like       t (x_i - x_j)²             tie_looks       Eq. 2, second sum, each edge once
//!   what was seen there                n_i (x_i - k_i / n_i)²     looks itself    Eq. 3
//! ```
//! The paper leaves all weights out and has no n: where nothing is seen nothing is said, and a probability never falls. Here
//! a look in which nobody was there counts as much as one in which somebody was. The minimum is one linear system,
//! `(a + n_i + Σ t) x_i - Σ t x_j = a x0_i + k_i`, solved exactly ([`DangerField`]). Without ties it is `(a x0 + k) / (a + n)`,
//! the mean of the posterior of a binomial with a beta prior, for which the Gaussian stands. The matrix is a
//! diagonally dominant M-matrix, so each x is a weighted mean of priors and shares of looks: it cannot leave \[0, 1\], and the
//! clamp that a Gaussian needs in general only rounds here.
//!
//! | module | what it knows |
//! |---|---|
//! | [`exposure`] | which cells an image would show a person in, counted once a look |
//! | [`presence`] | in how many looks somebody was in a cell, from positions with covariance |
//! | [`field`] | the exact solve |
//! | [`foretelling`] | priors and weights by how well the visits before foretell each next one |
//! | [`speed`] | metres per second, linear in the probability |

pub mod exposure;
pub mod field;
pub mod foretelling;
pub mod presence;
pub mod speed;
#[cfg(test)]
mod tests;

pub use field::DangerField;
