//! Images: decoded, and by OpenCV what they show. This is the only crate that links it, and the only one that needs to.
//!
//! ```text
//!   jpeg, png, pgm … ──► decode_grey ─────────────► Grey (8 bits, rows without gaps)
//!   jpeg, png, ppm … ──► decode_colour ───────────► Rgb
//!   depth: png, pgm, pfm ► decode_depth ───────────► Grey16, the values as stored; metres in mm
//!   labels: png, pgm ──► decode_values ───────────► Grey16, the values as stored
//!   labels of maps: png ─► decode_labels ──────────► Grey, the values as stored ──► encode_png
//!   Rgb ───────────────► activations ────────────► what each stage of a network sees
//!   Grey ──────────────► PeopleDetector ──────────► windows that show people
//! ```
//! Bytes come from logs, so they may be torn or hostile. Nothing here panics on them, and nothing is allocated for a
//! size that a header merely claims: [`MAX_PIXELS`] is checked first. OpenCV's exceptions become [`ImageError`]s, and
//! its own threads are off, because images are worked on side by side already.

mod backbone;
mod decode;
mod features;
mod grey;
mod people;
mod stored;
mod threads;

pub use backbone::{Activation, activations};
pub use decode::{decode_colour, decode_grey, holds_colour, image_size};
pub use features::{Blind, DESCRIPTOR_BYTES, Detectors, FeatureParams, KeyPoints, Vignette};
pub use grey::{Grey, Grey16, ImageError, MAX_PIXELS, Rgb};
pub use people::PeopleDetector;
pub use stored::{decode_depth, decode_labels, decode_values, encode_png};
