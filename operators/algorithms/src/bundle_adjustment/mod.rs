//! Poses and landmarks from all observations at once.
