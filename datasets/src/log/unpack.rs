//! Decompression that goes as far as the data are sound, whole or piece by piece.
//!
//! What a chunk claims to hold is not believed beyond what its bytes can make likely: memory grows with what comes out.

use std::cell::RefCell;
use std::io::{self, BufReader, ErrorKind, Read};

use bytes::Bytes;
use zstd::bulk::Decompressor;
use zstd::stream::raw::{DParameter, Decoder, InBuffer, Operation, OutBuffer};

use crate::log::chunk::Damage;
use crate::losses::Reason;

mod lz4;

use lz4::Lz4;

/// Chunks that claim to be larger than this after decompression are not believed.
pub const LARGEST_CHUNK: u64 = 2 << 30;

/// A claim of so many bytes for each compressed one is believed at once: real chunks shrink less.
const LIKELY_RATIO: u64 = 64;
/// And of this many for any chunk.
const LIKELY_BYTES: u64 = 1 << 20;

/// Bytes that zstd may look back, 2^26: its levels up to 19 look back less.
const WINDOW_LOG: u32 = 26;

/// Decompresses a chunk's data; an uncompressed chunk is not copied. Beside what came out, what was wrong where that is
/// not what the chunk claims: then it is as much as came out before the damage.
///
/// # Errors
/// When the compression is not known, or the claim is beyond any chunk.
pub fn unpack(
    compression: &str,
    data: Bytes,
    size: u64,
) -> Result<(Bytes, Option<Damage>), Damage> {
    check_claim(compression, size)?;
    if compression.is_empty() {
        let bytes = data.slice(..data.len().min(size as usize));
        let damage = wrong_size(bytes.len() as u64, size);
        return Ok((bytes, damage));
    }
    let likely = LIKELY_BYTES + LIKELY_RATIO * data.len() as u64;
    if size <= likely
        && let Ok(bytes) = at_once(compression, &data, size as usize)
    {
        return Ok((bytes.into(), None));
    }
    let mut bytes = Vec::new();
    let mut reader = reader(compression, &data[..])?;
    let damage = match as_it_comes(&mut reader, size + 1, &mut bytes) {
        Ok(()) => wrong_size(bytes.len() as u64, size),
        Err(error) => Some((Reason::BadCompression, error.to_string())),
    };
    bytes.truncate(size as usize);
    Ok((bytes.into(), damage))
}

/// Whether a chunk may be what it says.
///
/// # Errors
/// As [`unpack`].
pub(crate) fn check_claim(compression: &str, size: u64) -> Result<(), Damage> {
    let bad = |detail| Err((Reason::BadCompression, detail));
    if !matches!(compression, "" | "zstd" | "lz4") {
        let shown: String = compression.chars().take(40).collect();
        return bad(format!(
            "expected zstd, lz4 or no compression, found {shown:?}"
        ));
    }
    if size > LARGEST_CHUNK {
        return bad(format!(
            "expected a chunk of at most {LARGEST_CHUNK} B, found one that claims to hold {size} B"
        ));
    }
    Ok(())
}

/// What a reader has, up to so many bytes. Room is made by what came, four times as much each time: what is left behind as
/// it grows is small beside it.
fn as_it_comes(reader: &mut impl Read, most: u64, bytes: &mut Vec<u8>) -> io::Result<()> {
    loop {
        let came = bytes.len() as u64;
        let room = (3 * came).max(LIKELY_BYTES).min(most - came);
        bytes.try_reserve_exact(room as usize)?;
        let read = reader.by_ref().take(room).read_to_end(bytes)? as u64;
        if read < room || room == 0 {
            return Ok(());
        }
    }
}

fn wrong_size(found: u64, claimed: u64) -> Option<Damage> {
    (found != claimed).then(|| {
        let detail = format!("expected {claimed} B after decompression, found {found}");
        (Reason::BadCompression, detail)
    })
}

thread_local! {
    /// What zstd needs for itself, which is as large as some chunks.
    static ZSTD: RefCell<Option<Decompressor<'static>>> = const { RefCell::new(None) };
}

/// The fast way, where nothing is wrong.
fn at_once(compression: &str, data: &[u8], size: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(size)?;
    if compression == "zstd" {
        ZSTD.with_borrow_mut(|kept| {
            let zstd = match kept {
                Some(zstd) => zstd,
                None => kept.insert(Decompressor::new()?),
            };
            zstd.decompress_to_buffer(data, &mut bytes)
        })?;
    } else {
        let lz4 = Lz4::new(data);
        lz4.take(size as u64 + 1).read_to_end(&mut bytes)?;
    }
    match bytes.len() == size {
        true => Ok(bytes),
        false => Err(ErrorKind::InvalidData.into()),
    }
}

/// The decompressed bytes of a reader. Where the data are damaged it fails only after all that lies before.
///
/// # Errors
/// When the compression is not known, or its library fails.
pub(crate) fn reader<'a>(
    compression: &str,
    data: impl Read + Send + 'a,
) -> Result<Box<dyn Read + Send + 'a>, Damage> {
    Ok(match compression {
        "" => Box::new(data),
        "lz4" => Box::new(Lz4::new(BufReader::new(data))),
        _ => {
            Box::new(Zstd::new(data).map_err(|error| (Reason::BadCompression, error.to_string()))?)
        }
    })
}

/// zstd frames, block by block: whatever a decoder is given with a damaged block, it does not hand out.
struct Zstd<R> {
    data: R,
    decoder: Decoder<'static>,
    /// Bytes read that the decoder has not taken yet.
    input: Vec<u8>,
    taken: usize,
    /// Bytes that the decoder asks for next; 0 between frames.
    wanted: usize,
    /// The decoder may hold more than it has handed out.
    full: bool,
}

impl<R: Read> Zstd<R> {
    fn new(data: R) -> io::Result<Self> {
        let mut decoder = Decoder::new()?;
        decoder.set_parameter(DParameter::WindowLogMax(WINDOW_LOG))?;
        Ok(Self {
            data,
            decoder,
            input: Vec::new(),
            taken: 0,
            wanted: 0,
            full: false,
        })
    }

    /// Reads what the decoder asks for. It asks for a block with the head of the next one: that is read apart, so that
    /// a damaged head costs nothing that lies before it.
    fn refill(&mut self) -> io::Result<bool> {
        const HEAD: usize = 3;
        // No block is larger. What the decoder would only pass over may claim to be.
        const BLOCK: usize = 128 << 10;
        let wanted = match self.wanted {
            0 => 1,
            few @ 1..=HEAD => few,
            many => (many - HEAD).min(BLOCK),
        };
        self.taken = 0;
        self.input.resize(wanted, 0);
        let mut filled = 0;
        while filled < wanted {
            match self.data.read(&mut self.input[filled..]) {
                Ok(0) => break,
                Ok(read) => filled += read,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.input.truncate(filled);
        Ok(filled > 0)
    }
}

impl<R: Read> Read for Zstd<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if bytes.is_empty() {
            return Ok(0);
        }
        loop {
            if self.taken == self.input.len() && !self.full && !self.refill()? {
                return match self.wanted {
                    0 => Ok(0),
                    more => Err(io::Error::new(
                        ErrorKind::UnexpectedEof,
                        format!("expected {more} more B of a zstd frame, found its end"),
                    )),
                };
            }
            let mut input = InBuffer::around(&self.input[self.taken..]);
            let mut output = OutBuffer::around(&mut bytes[..]);
            self.wanted = self.decoder.run(&mut input, &mut output)?;
            self.taken += input.pos();
            let written = output.pos();
            // At the end of a frame there is nothing left: asked for more, the decoder would begin another one.
            self.full = written == bytes.len() && self.wanted > 0;
            if written > 0 {
                return Ok(written);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Words that compress a little, and do not come again.
    fn text() -> Vec<u8> {
        let mut state = 7_u64;
        let words = (0..120_000).map(|_| {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            format!("{} ", (state >> 33) % 99_991)
        });
        words.collect::<String>().into_bytes()
    }

    fn packed(compression: &str, text: &[u8]) -> Vec<u8> {
        if compression == "zstd" {
            return zstd::bulk::compress(text, 3).unwrap();
        }
        let blocks =
            lz4_flex::frame::FrameInfo::new().block_size(lz4_flex::frame::BlockSize::Max64KB);
        let mut lz4 = lz4_flex::frame::FrameEncoder::with_frame_info(blocks, Vec::new());
        io::Write::write_all(&mut lz4, text).unwrap();
        lz4.finish().unwrap()
    }

    #[test]
    fn what_shrank_beyond_belief_comes_out_as_it_comes_and_no_more_than_is_claimed() {
        const ZEROS: u64 = 9 << 20;
        let zeros = packed("zstd", &vec![0; ZEROS as usize]);
        for claimed in [ZEROS, ZEROS - 1, ZEROS + 1, 2 * ZEROS] {
            let (found, damage) = unpack("zstd", zeros.clone().into(), claimed).unwrap();
            assert_eq!(found.len() as u64, claimed.min(ZEROS));
            assert_eq!(damage.is_some(), claimed != ZEROS, "{damage:?}");
        }
        let mut bytes = Vec::new();
        as_it_comes(&mut io::repeat(0), ZEROS, &mut bytes).unwrap();
        assert_eq!(bytes.capacity() as u64, ZEROS);
    }

    #[test]
    fn what_lies_before_the_damage_comes_out() {
        let text = text();
        for compression in ["zstd", "lz4"] {
            let whole = packed(compression, &text);
            let size = text.len() as u64;
            let open = |data: &[u8]| unpack(compression, Bytes::copy_from_slice(data), size);
            let (bytes, damage) = open(&whole).unwrap();
            assert!(bytes == text && damage.is_none(), "{damage:?}");
            let mut longest = 0;
            for parts in 0..40 {
                let cut = whole.len() * parts / 40;
                let (bytes, damage) = open(&whole[..cut]).unwrap();
                assert!(damage.is_some(), "{compression} cut at {cut}");
                assert!(text.starts_with(&bytes) && bytes.len() >= longest);
                longest = bytes.len();
            }
            assert!(
                longest > text.len() / 2,
                "{compression}: {longest} B before the last cut"
            );
            let mut flipped = whole.clone();
            let middle = flipped.len() * 3 / 4;
            flipped[middle..middle + 40].fill(0xFF);
            let (bytes, _) = open(&flipped).unwrap();
            assert!(bytes.len() > text.len() / 3 && text.starts_with(&bytes[..text.len() / 3]));
        }
    }

    #[test]
    fn a_claim_is_not_allocated_and_an_overflow_is_cut() {
        let data = Bytes::from(packed("zstd", b"few"));
        let (bytes, damage) = unpack("zstd", data.clone(), LARGEST_CHUNK).unwrap();
        assert_eq!(&bytes[..], b"few");
        assert!(damage.unwrap().1.contains("expected 2147483648 B"));
        unpack("zstd", data.clone(), LARGEST_CHUNK + 1).unwrap_err();
        unpack("rar", data.clone(), 3).unwrap_err();
        // A frame to be passed over, of 4 GiB, as it says.
        let skipped = [&[0x50, 0x2A, 0x4D, 0x18, 0xFF, 0xFF, 0xFF, 0xFF], &data[..]].concat();
        let mut skipping = Zstd::new(&skipped[..]).unwrap();
        skipping.read_to_end(&mut Vec::new()).unwrap_err();
        assert!(skipping.input.capacity() <= 1 << 20);
        let zeros = Bytes::from(packed("zstd", &vec![0; 8 << 20]));
        let (bytes, damage) = unpack("zstd", zeros.clone(), 8 << 20).unwrap();
        assert!(bytes.len() == 8 << 20 && damage.is_none());
        let (bytes, _) = unpack("zstd", zeros, 1000).unwrap();
        assert_eq!(bytes.len(), 1000);
    }
}
