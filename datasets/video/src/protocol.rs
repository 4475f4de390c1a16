//! What goes through the pipes between a decoder and its process: a byte that says what it is, a length (4 bytes, little
//! end first), and that many bytes.

use std::io::{self, ErrorKind, Read, Write};

use crate::Codec;

/// What a decoder asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// The frames that follow are of another stream. No bytes.
    Begin(Codec),
    /// Decode a frame. Its bytes.
    Decode,
    /// Decode a frame and give its picture. Its bytes.
    Show,
}

/// What comes back, once for each request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Done. No bytes.
    Decoded,
    /// Done: the picture as a netpbm file, red, green and blue, or grey, of 8 bits.
    Picture,
    /// Done, but there is no picture. The reason.
    NoPicture,
    /// Not done, and what follows in the stream cannot be decoded either. The reason.
    Broken,
}

/// What either side sends.
pub trait Word: Copy + PartialEq + 'static {
    /// All of them, each with its byte.
    const ALL: [(u8, Self); 4];

    /// Writes it, with the bytes that belong to it.
    ///
    /// # Errors
    /// Where the pipe breaks, or the bytes are more than a length can say.
    fn send(self, pipe: &mut impl Write, bytes: &[u8]) -> io::Result<()> {
        let length = u32::try_from(bytes.len()).map_err(io::Error::other)?;
        for (byte, _) in Self::ALL.iter().filter(|(_, known)| *known == self) {
            pipe.write_all(&[*byte])?;
        }
        pipe.write_all(&length.to_le_bytes())?;
        pipe.write_all(bytes)?;
        pipe.flush()
    }

    /// Reads the next one; `None` at the end. A length is believed no further than bytes come.
    ///
    /// # Errors
    /// Where the pipe breaks, or what comes is none of them.
    fn receive(pipe: &mut impl Read) -> io::Result<Option<(Self, Vec<u8>)>> {
        let mut byte = [0];
        if pipe.read(&mut byte)? == 0 {
            return Ok(None);
        }
        let known = Self::ALL.into_iter().find(|(known, _)| *known == byte[0]);
        let (_, word) = known.ok_or(ErrorKind::InvalidData)?;
        let mut length = [0; 4];
        pipe.read_exact(&mut length)?;
        let length = u64::from(u32::from_le_bytes(length));
        let mut bytes = Vec::new();
        pipe.take(length).read_to_end(&mut bytes)?;
        match bytes.len() as u64 == length {
            true => Ok(Some((word, bytes))),
            false => Err(ErrorKind::UnexpectedEof.into()),
        }
    }
}

impl Word for Request {
    const ALL: [(u8, Self); 4] = [
        (1, Self::Begin(Codec::H264)),
        (2, Self::Begin(Codec::H265)),
        (3, Self::Decode),
        (4, Self::Show),
    ];
}

impl Word for Answer {
    const ALL: [(u8, Self); 4] = [
        (1, Self::Decoded),
        (2, Self::Picture),
        (3, Self::NoPicture),
        (4, Self::Broken),
    ];
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_is_sent_is_received_and_what_is_cut_is_told() {
        let mut pipe = Vec::new();
        Request::Begin(Codec::H265).send(&mut pipe, &[]).unwrap();
        Request::Show.send(&mut pipe, &[7; 300]).unwrap();
        let mut read = pipe.as_slice();
        let mut next = || Request::receive(&mut read);
        assert_eq!(next().unwrap(), Some((Request::Begin(Codec::H265), vec![])));
        assert_eq!(next().unwrap(), Some((Request::Show, vec![7; 300])));
        assert_eq!(next().unwrap(), None);
        for length in 6..pipe.len() {
            let mut cut = &pipe[5..length];
            assert!(Request::receive(&mut cut).is_err(), "{length}");
        }
        assert!(Answer::receive(&mut &[9, 0, 0, 0, 0][..]).is_err());
    }
}
