//! A binary vocabulary, and keyframes that look alike.
