//! What the bytes of a frame say without being decoded (ITU-T H.264 and H.265, Annex B and table 7-1 of each).

use crate::bits::units;

/// A video format that is decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Codec {
    /// ITU-T H.264, AVC.
    H264,
    /// ITU-T H.265, HEVC.
    H265,
}

/// What a unit of the bytes is, as far as it matters where decoding can begin.
#[derive(PartialEq, Eq)]
enum NalKind {
    /// A sequence parameter set: size and profile.
    Parameters,
    /// Pixels of a picture that refers to none before it.
    Key,
    /// Pixels of any other picture.
    Other,
    /// Whatever else: picture parameters, delimiters, notes.
    Aside,
}

impl Codec {
    /// The codec that a reference's format names: `h264` or `h265`.
    pub fn named(format: &str) -> Option<Self> {
        match format {
            "h264" => Some(Self::H264),
            "h265" => Some(Self::H265),
            _ => None,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::H264 => "h264",
            Self::H265 => "h265",
        }
    }

    /// Whether decoding can begin with this frame: a key frame with its parameter set before it.
    pub fn begins(self, frame: &[u8]) -> bool {
        let mut parameters = false;
        for unit in units(frame) {
            match self.part(unit[0]) {
                NalKind::Parameters => parameters = true,
                NalKind::Key => return parameters,
                NalKind::Other => return false,
                NalKind::Aside => {}
            }
        }
        false
    }

    /// Whether a picture of it refers to none before it.
    pub(crate) fn has_key(self, frame: &[u8]) -> bool {
        units(frame).any(|unit| self.part(unit[0]) == NalKind::Key)
    }

    fn part(self, head: u8) -> NalKind {
        match self {
            Self::H264 => match head & 0x1f {
                7 => NalKind::Parameters,
                5 => NalKind::Key,
                1..=4 => NalKind::Other,
                _ => NalKind::Aside,
            },
            Self::H265 => match (head >> 1) & 0x3f {
                33 => NalKind::Parameters,
                16..=21 => NalKind::Key,
                0..=31 => NalKind::Other,
                _ => NalKind::Aside,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoding_begins_where_parameters_and_a_key_frame_are() {
        let (sets, idr) = ([0, 0, 0, 1, 0x67, 9, 0, 0, 1, 0x68, 9], [0, 0, 1, 0x65, 9]);
        assert!(Codec::H264.begins(&[&sets[..], &idr].concat()));
        assert!(!Codec::H264.begins(&idr));
        assert!(!Codec::H264.begins(&sets));
        assert!(!Codec::H264.begins(&[&sets[..], &[0, 0, 1, 0x41, 9], &idr].concat()));
        let (sets, cra) = ([0, 0, 1, 0x42, 1], [0, 0, 1, 0x2a, 1]);
        assert!(Codec::H265.begins(&[sets, cra].concat()));
        assert!(!Codec::H265.begins(&[sets, [0, 0, 1, 0x02, 1], cra].concat()));
        for hostile in [&[][..], &[0, 0, 1], &[0, 0], &[0xff; 9]] {
            assert!(!Codec::H264.begins(hostile) && !Codec::H265.begins(hostile));
        }
    }
}
