//! LZ4 frames, one behind the other: their decoder ends with the first, and takes the end of the data for the end of a frame.

use std::io::{self, ErrorKind, Read};

use lz4_flex::frame::FrameDecoder;

/// Frames with these numbers, but for the last four bits, hold nothing of the data.
const SKIPPED: u32 = 0x184D_2A50;
/// Frames of this number end with the data.
const LEGACY: u32 = 0x184C_2102;

/// The content of frames.
pub(super) struct Lz4<R: Read> {
    decoder: FrameDecoder<Ahead<R>>,
    /// Whether the decoder is within a frame.
    within: bool,
    /// Whether that frame has no mark at its end.
    endless: bool,
}

impl<R: Read> Lz4<R> {
    pub fn new(data: R) -> Self {
        Self {
            decoder: FrameDecoder::new(Ahead::new(data)),
            within: false,
            endless: false,
        }
    }

    /// Goes to the next frame that holds something; whether there is one.
    fn begin(&mut self) -> io::Result<bool> {
        let data = self.decoder.get_mut();
        loop {
            let number = data.peek()?;
            if number.is_empty() {
                return Ok(false);
            }
            let number = number.first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
            if number.is_none_or(|number| number & !0xF != SKIPPED) {
                self.endless = number == Some(LEGACY);
                self.within = true;
                return Ok(true);
            }
            data.skip_frame()?;
        }
    }

    /// Leaves a frame.
    fn end(&mut self) -> io::Result<()> {
        self.within = false;
        match self.decoder.get_ref().ended && !self.endless {
            true => Err(cut("expected the end mark of an LZ4 frame, found its end")),
            false => Ok(()),
        }
    }
}

impl<R: Read> Read for Lz4<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if bytes.is_empty() {
            return Ok(0);
        }
        while self.within || self.begin()? {
            let read = self.decoder.read(bytes)?;
            if read > 0 {
                return Ok(read);
            }
            self.end()?;
        }
        Ok(0)
    }
}

fn cut(detail: impl Into<String>) -> io::Error {
    io::Error::new(ErrorKind::UnexpectedEof, detail.into())
}

/// Data of which the next four bytes can be seen before they are read.
struct Ahead<R> {
    data: R,
    seen: [u8; 4],
    /// The part of those that is not read yet.
    start: usize,
    end: usize,
    /// Whether somebody wanted to read on behind the last byte.
    ended: bool,
}

impl<R: Read> Ahead<R> {
    fn new(data: R) -> Self {
        Self {
            data,
            seen: [0; 4],
            start: 0,
            end: 0,
            ended: false,
        }
    }

    /// The next bytes: four, or as many as there are.
    fn peek(&mut self) -> io::Result<&[u8]> {
        self.seen.copy_within(self.start..self.end, 0);
        (self.start, self.end) = (0, self.end - self.start);
        while self.end < self.seen.len() {
            match self.data.read(&mut self.seen[self.end..]) {
                Ok(0) => break,
                Ok(read) => self.end += read,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(&self.seen[..self.end])
    }

    /// Goes behind a frame that holds nothing: its number, its length, as many bytes.
    fn skip_frame(&mut self) -> io::Result<()> {
        let (mut number, mut length) = ([0; 4], [0; 4]);
        self.read_exact(&mut number)?;
        self.read_exact(&mut length)?;
        let length = u64::from(u32::from_le_bytes(length));
        let skipped = io::copy(&mut self.take(length), &mut io::sink())?;
        match skipped < length {
            true => Err(cut(format!(
                "expected {length} B of an LZ4 frame that is skipped, found {skipped}"
            ))),
            false => Ok(()),
        }
    }
}

impl<R: Read> Read for Ahead<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let seen = &self.seen[self.start..self.end];
        if !seen.is_empty() {
            let read = seen.len().min(bytes.len());
            bytes[..read].copy_from_slice(&seen[..read]);
            self.start += read;
            return Ok(read);
        }
        let read = self.data.read(bytes)?;
        self.ended |= read == 0 && !bytes.is_empty();
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn packed(text: &[u8]) -> Vec<u8> {
        let mut lz4 = lz4_flex::frame::FrameEncoder::new(Vec::new());
        io::Write::write_all(&mut lz4, text).unwrap();
        lz4.finish().unwrap()
    }

    /// A frame that holds nothing, of so many bytes as it claims.
    fn skipped(last: u8, claimed: u32, bytes: &[u8]) -> Vec<u8> {
        [&[last, 0x2A, 0x4D, 0x18][..], &claimed.to_le_bytes(), bytes].concat()
    }

    /// Data that come three bytes at a time.
    struct Slowly<'a>(&'a [u8]);

    impl Read for Slowly<'_> {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let most = bytes.len().min(3);
            self.0.read(&mut bytes[..most])
        }
    }

    /// What comes out of data, and what is wrong with them.
    fn found(data: &[u8]) -> (String, Option<String>) {
        let [at_once, slowly] = [
            &mut Lz4::new(data) as &mut dyn Read,
            &mut Lz4::new(Slowly(data)),
        ]
        .map(|lz4| {
            let mut bytes = Vec::new();
            let error = lz4.read_to_end(&mut bytes).err();
            let text = String::from_utf8(bytes).unwrap();
            (text, error.map(|error| error.to_string()))
        });
        assert_eq!(at_once, slowly);
        at_once
    }

    #[test]
    fn frames_that_hold_nothing_are_skipped_wherever_they_are() {
        let (one, two) = (packed(b"one "), packed(b"two"));
        let nothing = [skipped(0x50, 5, b"notes"), skipped(0x5F, 0, b"")].concat();
        for frames in [
            vec![&nothing, &one, &two],
            vec![&one, &nothing, &two],
            vec![&one, &two, &nothing],
        ] {
            let data = frames.into_iter().flatten().copied().collect::<Vec<u8>>();
            assert_eq!(found(&data), ("one two".to_owned(), None));
        }
        assert_eq!(found(&[]), (String::new(), None));
        let (text, error) = found(&[one, skipped(0x51, u32::MAX, b"few")].concat());
        assert_eq!(text, "one ");
        let expected = "expected 4294967295 B of an LZ4 frame that is skipped, found 3";
        assert_eq!(error.unwrap(), expected);
    }

    #[test]
    fn rubbish_behind_frames_and_an_end_that_is_cut_off_are_told() {
        let whole = packed(b"one");
        for length in 1..=8 {
            let rubbish = [&whole[..], &b"rubbish!"[..length]].concat();
            let (text, error) = found(&rubbish);
            assert_eq!(text, "one");
            assert!(error.is_some(), "{length} B of rubbish");
        }
        for cut in 1..=4 {
            let (text, error) = found(&whole[..whole.len() - cut]);
            assert_eq!(text, "one");
            let expected = "expected the end mark of an LZ4 frame, found its end";
            assert_eq!(error.unwrap(), expected);
        }
    }

    #[test]
    fn a_frame_of_the_old_format_ends_with_the_data() {
        let block = lz4_flex::block::compress(b"of old");
        let length = (block.len() as u32).to_le_bytes();
        let data = [&LEGACY.to_le_bytes()[..], &length, &block].concat();
        assert_eq!(found(&data), ("of old".to_owned(), None));
    }
}
