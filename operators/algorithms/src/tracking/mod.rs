//! Features followed through a camera's keyframes.
