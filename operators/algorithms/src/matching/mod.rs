//! Descriptors to descriptors.
