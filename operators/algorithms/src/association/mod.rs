//! Which features of which keyframes show the same landmark.
