//! How a raw image is stored, as `image['format']` says it: `mono16`, `bayer_rggb16 big-endian`, `mono16 12-bit`.

use std::fmt;

/// What stands behind the encoding of a raw image whose samples of several bytes begin with the highest.
pub const BIG_ENDIAN: &str = " big-endian";

/// What stands behind the bits that samples of 16 really have.
const BITS: &str = "-bit";

/// How many bits the samples of a camera have, of the 16 that hold each: a person says so, as images do not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct SampleBits(u8);

impl SampleBits {
    /// Those that cameras have.
    pub const ALL: [u8; 3] = [10, 12, 14];

    /// So many; `None` where cameras have others.
    pub fn new(bits: u64) -> Option<Self> {
        let bits = u8::try_from(bits).ok()?;
        Self::ALL.contains(&bits).then_some(Self(bits))
    }

    /// How many.
    pub fn get(self) -> u8 {
        self.0
    }

    /// The upper eight of a sample's bits; `None` for a sample that has more of them.
    pub fn upper_eight(self, sample: u16) -> Option<u8> {
        (sample >> self.0 == 0).then(|| (sample >> (self.0 - 8)) as u8)
    }
}

impl fmt::Display for SampleBits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// How a raw image is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawFormat<'f> {
    /// How pixels are laid out, as ROS or Foxglove names it.
    pub encoding: &'f str,
    /// Bits that samples have, where these are fewer than hold them.
    pub bits: Option<SampleBits>,
    /// Whether samples of several bytes begin with the highest.
    pub is_big_endian: bool,
}

impl<'f> RawFormat<'f> {
    /// What a format says; all of it is the encoding where nothing else is understood.
    pub fn parse(format: &'f str) -> Self {
        let big = format.strip_suffix(BIG_ENDIAN);
        let rest = big.unwrap_or(format);
        let bits = rest.rsplit_once(' ').and_then(|(encoding, said)| {
            let bits = said.strip_suffix(BITS)?.parse().ok()?;
            Some((encoding, SampleBits::new(bits)?))
        });
        Self {
            encoding: bits.map_or(rest, |(encoding, _)| encoding),
            bits: bits.map(|(_, bits)| bits),
            is_big_endian: big.is_some(),
        }
    }
}

impl fmt::Display for RawFormat<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.encoding)?;
        if let Some(bits) = self.bits {
            write!(f, " {bits}{BITS}")?;
        }
        f.write_str(if self.is_big_endian { BIG_ENDIAN } else { "" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_format_is_read_as_it_is_written() {
        for (format, encoding, bits, is_big_endian) in [
            ("mono16", "mono16", None, false),
            ("mono16 12-bit", "mono16", Some(12), false),
            (
                "bayer_rggb16 10-bit big-endian",
                "bayer_rggb16",
                Some(10),
                true,
            ),
            ("32FC1 big-endian", "32FC1", None, true),
            ("mono16 9-bit", "mono16 9-bit", None, false),
            (
                "compressedDepth 16UC1",
                "compressedDepth 16UC1",
                None,
                false,
            ),
        ] {
            let read = RawFormat::parse(format);
            let bits = bits.and_then(SampleBits::new);
            let expected = RawFormat {
                encoding,
                bits,
                is_big_endian,
            };
            assert_eq!(read, expected);
            assert_eq!(read.to_string(), format);
        }
    }

    #[test]
    fn the_upper_eight_of_fewer_bits_are_those_that_there_are() {
        let of = |bits, sample| SampleBits::new(bits).and_then(|bits| bits.upper_eight(sample));
        assert_eq!(of(10, 1023), Some(255));
        assert_eq!(of(12, 0x123), Some(0x12));
        assert_eq!(of(14, 0x3f00), Some(0xfc));
        assert_eq!(of(10, 1024), None);
        assert_eq!(SampleBits::new(16), None);
        assert_eq!(SampleBits::new(268), None);
    }
}
