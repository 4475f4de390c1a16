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
    if skip(layout(opcode), body).is_none() {
        let found = body.len();
        return Err(format!("expected a longer record, found {found} B"));
    }
    mcap::parse_record(opcode, body).map_err(|error| error.to_string())
}

/// A part of a record's body.
enum FieldKind {
    /// So many bytes.
    Fixed(usize),
    /// Bytes behind their length in 32 bits.
    Text,
    /// Texts behind the length of all in 32 bits.
    Texts,
    /// Bytes behind their length in 64 bits.
    Data,
}

/// The parts of a record as far as they hold lengths. The `mcap` crate allocates what a length says, or slices by it,
/// before it has compared the length with the body.
fn layout(opcode: u8) -> &'static [FieldKind] {
    use FieldKind::{Data, Fixed, Text, Texts};
    match opcode {
        op::HEADER => &[Text, Text],
        op::SCHEMA => &[Fixed(2), Text, Text, Text],
        op::CHANNEL => &[Fixed(4), Text, Text, Texts],
        op::CHUNK => &[Fixed(28), Text, Data],
        op::MESSAGE_INDEX => &[Fixed(2), Text],
        op::CHUNK_INDEX => &[Fixed(32), Text, Fixed(8), Text, Fixed(16)],
        op::ATTACHMENT => &[Fixed(16), Text, Text, Data, Fixed(4)],
        op::ATTACHMENT_INDEX => &[Fixed(40), Text, Text],
        op::STATISTICS => &[Fixed(42), Text],
        op::METADATA => &[Text, Texts],
        op::METADATA_INDEX => &[Fixed(16), Text],
        _ => &[],
    }
}

/// What lies behind these parts; `None` where one of them is not all there.
fn skip<'a>(parts: &[FieldKind], body: &'a [u8]) -> Option<&'a [u8]> {
    let mut rest = body;
    for part in parts {
        rest = match part {
            FieldKind::Fixed(length) => rest.get(*length..)?,
            FieldKind::Text => text(rest)?.1,
            FieldKind::Texts => {
                let (mut texts, behind) = text(rest)?;
                while !texts.is_empty() {
                    texts = text(texts)?.1;
                }
                behind
            }
            FieldKind::Data => {
                let (length, behind) = rest.split_first_chunk::<8>()?;
                behind.get(usize::try_from(u64::from_le_bytes(*length)).ok()?..)?
            }
        };
    }
    Some(rest)
}

/// Bytes behind their length in 32 bits, and what lies behind them.
fn text(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
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
    /// What is said of messages that are late.
    pub(crate) const LATE: &str = "expected a log time before the year 2262, found a later one";

    /// Whether its log time is beyond what Arrow holds; see [`nanoseconds`].
    pub(crate) fn is_late(&self) -> bool {
        self.log_time == i64::MAX
    }

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
    fn lengths_are_compared_with_the_body_before_it_is_parsed() {
        let claim = [&[0; 4][..], &[0xFF; 4], &[b'x'; 60]].concat();
        for opcode in op::HEADER..=op::DATA_END {
            for start in 0..48 {
                let mut body = vec![0; start];
                body.extend(&claim);
                // Whatever it says, it does not allocate four gigabytes for it.
                let _ = parse(opcode, &body);
            }
            for length in 0..80 {
                let _ = parse(opcode, &vec![0xFF; length]);
            }
        }
        assert!(parse(op::HEADER, &claim).is_err());
        assert!(parse(op::HEADER, &[0; 8]).is_ok());
        let names = [
            &[0; 4][..],
            &[0; 8],
            &[9, 0, 0, 0, 1, 0, 0, 0, b'a', 0, 0, 0, 0],
        ]
        .concat();
        assert!(parse(op::CHANNEL, &names).is_ok());
        let torn = [&names[..16], &[0xFF; 4], &names[20..]].concat();
        assert!(parse(op::CHANNEL, &torn).is_err());
    }

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
