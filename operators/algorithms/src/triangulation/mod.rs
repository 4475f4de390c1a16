//! Points from rays.
