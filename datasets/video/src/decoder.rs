//! From frames to pictures.

use crate::protocol::{Answer, Request};
use crate::worker::Worker;
use crate::{Codec, pool};

/// Decodes the frames of one stream in order, from a key frame on: equal bytes give equal pictures. It has a process
/// from its first frame on.
pub struct Decoder {
    codec: Codec,
    worker: Option<Worker>,
}

/// The picture that was asked for as a netpbm file, red, green and blue, or grey, of 8 bits; or why there is none.
pub type Shown = Option<Result<Vec<u8>, String>>;

/// Why a frame was not decoded, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Failure {
    /// It does not decode. What comes after it, up to the next key frame, cannot be believed.
    Frame(String),
    /// The process that decodes is not there, was killed or is stuck: nothing is known of the frame.
    Process(String),
}

impl std::fmt::Debug for Decoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Decoder({})", self.codec.name())
    }
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub fn new(codec: Codec) -> Self {
        Self {
            codec,
            worker: None,
        }
    }

    /// Decodes a frame, and gives its picture where that is asked for.
    ///
    /// # Errors
    /// When the frame does not decode, or nothing is there to decode it.
    pub fn push(&mut self, frame: &[u8], show: bool) -> Result<Shown, Failure> {
        let mut worker = match self.worker.take() {
            Some(worker) => worker,
            None => pool::take(self.codec)?,
        };
        let request = match show {
            true => Request::Show,
            false => Request::Decode,
        };
        // A process that gave no answer is not used again.
        let (answer, bytes) = worker.ask(request, frame)?;
        self.worker = Some(worker);
        let reason = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        match answer {
            Answer::Decoded => Ok(None),
            Answer::Picture => Ok(Some(Ok(bytes))),
            Answer::NoPicture => Ok(Some(Err(reason(&bytes)))),
            Answer::Broken => Err(Failure::Frame(reason(&bytes))),
        }
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        self.worker.take().into_iter().for_each(pool::put_back);
    }
}
