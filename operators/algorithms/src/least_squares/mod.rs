//! Factors, robust losses, trust regions, sparse Cholesky.
