//! H.264 and H.265 frames to pixels, and back for simulated worlds. The only crate that links FFmpeg.
//!
//! A frame is Annex B bytes, one frame a message, as `foxglove.CompressedVideo` asks for: parameter sets stand before
//! each key frame. This crate knows no logs: who decodes gives it the frames in order, from a key frame on.

mod codec;
mod colour;
mod decoder;
mod encoder;

pub use codec::Codec;
pub use colour::{Colours, Matrix, Scale};
pub use decoder::{Decoder, LARGEST_PICTURE, Picture};
pub use encoder::{Encoder, Samples, Style};

/// Sets FFmpeg up. It prints nothing by itself: what is wrong with a frame is told by the results.
fn prepare() -> Result<(), String> {
    ffmpeg_next::log::set_level(ffmpeg_next::log::Level::Quiet);
    ffmpeg_next::init().map_err(|error| format!("FFmpeg cannot be set up: {error}"))
}
