//! H.264 and H.265 frames to pictures, and back for tests. The only crate that links FFmpeg.
//!
//! [`serve`] is all that the program `evermap-video` does: a process for each decoder that is at work, so that a frame
//! that crashes FFmpeg ends nothing but its own stream, and that the program that asks starts without FFmpeg's
//! libraries. `evermap_video::Decoder` is at the other end.

mod encoder;
mod serve;
mod stream;

pub use encoder::{Encoder, Samples, Style};
pub use serve::serve;
pub use stream::{Picture, Stream};

use evermap_video::Codec;
use ffmpeg_next::codec::Id;

/// Sets FFmpeg up. It prints nothing by itself: what is wrong with a frame is told by the results.
fn prepare() -> Result<(), String> {
    ffmpeg_next::log::set_level(ffmpeg_next::log::Level::Quiet);
    ffmpeg_next::init().map_err(|error| format!("FFmpeg cannot be set up: {error}"))
}

fn id(codec: Codec) -> Id {
    match codec {
        Codec::H264 => Id::H264,
        Codec::H265 => Id::HEVC,
    }
}
