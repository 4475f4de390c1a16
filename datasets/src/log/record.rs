//! The record framing of MCAP: an opcode, a length, a body.
//!
//! Parsing of bodies is the `mcap` crate's; this module adds what torn files need: lengths are checked before
//! anything is sliced, and the two records that are read by the million (message and frame) cost no allocation.

use mcap::records::{Record, op};

/// First and last bytes of every MCAP file.
pub const MAGIC: &[u8] = &[0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n'];
/// Bytes of a record before its body: opcode and length.
pub const FRAME: u64 = 9;
/// Bytes of a message record's body before its payload.
pub const MESSAGE_HEAD: usize = 22;
/// Bytes of a footer record with its frame.
pub const FOOTER: u64 = FRAME + 20;

/// Splits `bytes` into opcode, body and the number of bytes used; `None` where the record is not complete.
pub fn split(bytes: &[u8]) -> Option<(u8, &[u8], usize)> {
    let (opcode, length) = frame(bytes)?;
    let end = usize::try_from(length.checked_add(FRAME)?).ok()?;
    Some((opcode, bytes.get(FRAME as usize..end)?, end))
}

/// Opcode and body length from the first nine bytes of a record.
pub fn frame(bytes: &[u8]) -> Option<(u8, u64)> {
    let (opcode, rest) = bytes.split_first()?;
    Some((*opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}

/// Parses a record's body.
///
/// # Errors
/// In words, where the body is malformed or an attachment does not match its checksum.
pub fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
    if opcode == op::ATTACHMENT {
        check_attachment(body)?;
    }
    mcap::parse_record(opcode, body).map_err(|error| error.to_string())
}

/// The `mcap` crate slices attachment bodies by lengths that it has not compared with the body.
fn check_attachment(body: &[u8]) -> Result<(), String> {
    let sound = || {
        // Two times, name, media type, data with its length, checksum.
        let rest = skip_text(skip_text(body.get(16..)?)?)?;
        let length = u64::from_le_bytes(*rest.first_chunk()?);
        let end = length.checked_add(8 + 4)?;
        (end <= rest.len() as u64).then_some(())
    };
    sound().ok_or_else(|| "an attachment whose length is wrong".to_owned())
}

fn skip_text(bytes: &[u8]) -> Option<&[u8]> {
    let length = u32::from_le_bytes(*bytes.first_chunk()?) as usize;
    bytes.get(4..)?.get(length..)
}

/// A message record, without its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MessageHead {
    /// Channel that it was sent on.
    pub channel: u16,
    /// Counter of the publisher.
    pub sequence: u32,
    /// When it was recorded, ns since the epoch.
    pub log_time: i64,
    /// When it was published, ns since the epoch.
    pub publish_time: i64,
}

impl MessageHead {
    /// From a message record's body; `None` where it is too short.
    pub fn parse(body: &[u8]) -> Option<Self> {
        Some(Self {
            channel: u16::from_le_bytes(*body.first_chunk()?),
            sequence: u32::from_le_bytes(*body.get(2..)?.first_chunk()?),
            log_time: nanoseconds(u64::from_le_bytes(*body.get(6..)?.first_chunk()?)),
            publish_time: nanoseconds(u64::from_le_bytes(*body.get(14..)?.first_chunk()?)),
        })
    }
}

/// MCAP counts nanoseconds in 64 bits without a sign, Arrow with one: what does not fit (after the year 2262) becomes
/// the last instant that does.
pub fn nanoseconds(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_split_only_when_it_is_complete() {
        let record = [5, 2, 0, 0, 0, 0, 0, 0, 0, 7, 8, 9];
        assert_eq!(split(&record), Some((5, &[7, 8][..], 11)));
        for length in 0..11 {
            assert_eq!(split(&record[..length]), None);
        }
        assert_eq!(split(&[5, 255, 255, 255, 255, 255, 255, 255, 255]), None);
    }
}
