//! Whether frames follow those before them, and why they are refused that do not.

use std::fmt::Debug;

/// Why a frame is refused that needs another one.
pub(crate) const MISSING: &str = "refers to one that did not come";

/// Why a frame is refused that was there before.
pub(crate) const AGAIN: &str = "came before";

/// What has come of a stream.
pub(crate) trait Follow: Debug + Send {
    /// Looks at a frame; one that is refused is as if it had not come.
    ///
    /// # Errors
    /// In words, where a frame that it needs is missing, or it was there before.
    fn follow(&mut self, frame: &[u8]) -> Result<(), String>;
}

#[cfg(test)]
pub(crate) mod asked {
    //! What tests of both formats ask.
    #![allow(clippy::unwrap_used)]
    use super::Follow;

    pub(crate) fn followed<P: Follow + Default>(frames: &[Vec<u8>]) -> Vec<Result<(), String>> {
        let mut pictures = P::default();
        let frames = frames.iter().map(|frame| pictures.follow(frame));
        frames.collect()
    }

    pub(crate) fn all_follow<P: Follow + Default>(frames: &[Vec<u8>]) {
        assert_eq!(followed::<P>(frames), vec![Ok(()); frames.len()]);
    }

    /// Frames that are cut follow, and those with a bit flipped end in no panic.
    pub(crate) fn torn_ones_are_left_to_the_decoder<P: Follow + Default>(frames: &[Vec<u8>]) {
        for frame in frames {
            for length in 0..frame.len() {
                let mut pictures = P::default();
                pictures.follow(&frame[..length]).unwrap();
                for flipped in 0..8 {
                    let mut forged = frame.clone();
                    forged[length] ^= 1 << flipped;
                    pictures.follow(&forged).ok();
                }
            }
        }
    }
}
