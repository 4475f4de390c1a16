//! H.264 and H.265 frames to pictures, and whether they follow each other; luma and chroma to colours.
//!
//! ```text
//!  Decoder ─► idle workers ─► Worker: evermap-video
//!    push        │  take         │ stdin   requests, with frames
//!                ◄── put back ───┘ stdout  answers, with pictures
//! ```
//! FFmpeg runs in a process of its own (`datasets/ffmpeg`): a frame that crashes it, or on which it hangs, breaks its own
//! stream and nothing else; and whatever decodes no video starts without FFmpeg's hundred libraries.
//!
//! A frame is Annex B bytes, one frame a message, as `foxglove.CompressedVideo` asks for: parameter sets stand before
//! each key frame. This crate knows no logs: who decodes gives it the frames in order, from a key frame on.

mod bits;
mod codec;
mod colour;
mod continuity;
mod decoder;
mod gap;
mod h264;
mod h265;
mod pool;
pub mod protocol;
mod worker;

pub use codec::Codec;
pub use colour::{Colours, Matrix, Scale};
pub use continuity::Continuity;
pub use decoder::{Decoder, Failure, Shown};
