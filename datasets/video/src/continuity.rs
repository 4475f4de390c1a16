//! Whether frames follow each other, by the heads of their slices: a decoder goes on without one that is missing, and
//! shows others that are wrong.

use crate::gap::{Follow, MISSING};
use crate::{Codec, h264, h265};

/// What has come of a stream.
#[derive(Debug)]
pub struct Continuity {
    codec: Codec,
    pictures: Box<dyn Follow>,
    /// The last frame that follows those before it.
    last: Vec<u8>,
    /// Whether frames are missing since the last key frame.
    is_broken: bool,
}

impl Continuity {
    /// That of a stream of which nothing has come.
    pub fn new(codec: Codec) -> Self {
        Self {
            codec,
            pictures: match codec {
                Codec::H264 => Box::new(h264::Pictures::default()),
                Codec::H265 => Box::new(h265::Pictures::default()),
            },
            last: Vec::new(),
            is_broken: false,
        }
    }

    /// Looks at the next frame, and says whether it is to be decoded: a message that is there twice says nothing new. A
    /// head that is not understood is left to the decoder, and so is what follows up to the next key frame.
    ///
    /// # Errors
    /// In words, when frames that it needs did not come, or it came before. So it is with those after it, up to the next
    /// key frame.
    pub fn follow(&mut self, frame: &[u8]) -> Result<bool, String> {
        if self.is_broken && !self.codec.has_key(frame) {
            return Err(MISSING.to_owned());
        }
        let followed = self.pictures.follow(frame);
        if followed.is_err() && self.last == frame {
            return Ok(false);
        }
        self.is_broken = followed.is_err();
        followed?;
        frame.clone_into(&mut self.last);
        Ok(true)
    }
}
