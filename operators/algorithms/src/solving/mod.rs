//! Least squares, what hangs together, and repeatable random numbers.
//!
//! | module | what it knows |
//! |---|---|
//! | [`least_squares`] | factors, robust losses, trust regions, sparse Cholesky |

pub mod least_squares;
pub(crate) mod median;
pub(crate) mod parts;
pub(crate) mod random;
