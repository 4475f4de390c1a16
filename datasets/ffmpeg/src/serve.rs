//! What the process of a decoder does until nobody asks any more.

use std::io::{self, Read, Write};

use evermap_video::Codec;
use evermap_video::protocol::{Answer, Request, Word};

use crate::Stream;

/// Answers requests until their end.
///
/// # Errors
/// Where a pipe breaks, or what comes is no request.
pub fn serve(mut requests: impl Read, mut answers: impl Write) -> io::Result<()> {
    let mut decoding = Decoding::none();
    while let Some((request, frame)) = Request::receive(&mut requests)? {
        let (answer, bytes) = match request {
            Request::Begin(codec) => decoding.begin(codec),
            Request::Decode => decoding.decode(&frame, false),
            Request::Show => decoding.decode(&frame, true),
        };
        answer.send(&mut answers, &bytes)?;
    }
    Ok(())
}

/// A stream, and how many of its frames have come.
struct Decoding {
    stream: Result<Stream, String>,
    frames: i64,
}

impl Decoding {
    fn none() -> Self {
        Self {
            stream: Err("no stream has begun".to_owned()),
            frames: 0,
        }
    }

    fn begin(&mut self, codec: Codec) -> (Answer, Vec<u8>) {
        *self = Self {
            stream: Stream::new(codec),
            frames: 0,
        };
        match &self.stream {
            Ok(_) => (Answer::Decoded, Vec::new()),
            Err(reason) => (Answer::Broken, reason.clone().into_bytes()),
        }
    }

    fn decode(&mut self, frame: &[u8], show: bool) -> (Answer, Vec<u8>) {
        self.frames += 1;
        let number = self.frames;
        let stream = self.stream.as_mut().map_err(|reason| reason.clone());
        let pictures = match stream.and_then(|stream| stream.push(number, frame)) {
            Ok(pictures) => pictures,
            Err(reason) => return (Answer::Broken, reason.into_bytes()),
        };
        if !show {
            return (Answer::Decoded, Vec::new());
        }
        let own = pictures.iter().find(|picture| picture.index == number);
        let file = match own {
            Some(picture) => picture.file(),
            None => Err("waits for later ones to decode, or is there twice".to_owned()),
        };
        match file {
            Ok(file) => (Answer::Picture, file),
            Err(reason) => (Answer::NoPicture, reason.into_bytes()),
        }
    }
}
