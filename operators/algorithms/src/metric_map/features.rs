//! Key points with binary descriptors, as BRISK yields them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Bytes of a descriptor.
pub const DESCRIPTOR_BYTES: usize = 64;

/// A binary descriptor of 512 bits (BRISK).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Descriptor(pub [u8; DESCRIPTOR_BYTES]);

impl Descriptor {
    /// Bits that differ, 0 to 512.
    pub fn distance(&self, other: &Self) -> u32 {
        distance(&words(self), &words(other))
    }
}

const WORDS: usize = DESCRIPTOR_BYTES / 8;

/// A descriptor as the processor counts it.
pub(crate) type Words = [u64; WORDS];

/// The words of a descriptor.
pub(crate) fn words(descriptor: &Descriptor) -> Words {
    let (eights, _) = descriptor.0.as_chunks::<8>();
    std::array::from_fn(|word| u64::from_le_bytes(eights[word]))
}

/// Bits that differ. Always inlined, so that it is compiled for the instructions of whoever calls.
#[inline(always)]
pub(crate) fn distance(a: &Words, b: &Words) -> u32 {
    let mut bits = 0;
    for word in 0..WORDS {
        bits += (a[word] ^ b[word]).count_ones();
    }
    bits
}

/// One key point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feature {
    /// Where: `[u, v]`, pixels of the full image; the centre of the first pixel is (0, 0).
    pub pixel: [f64; 2],
    /// Diameter of the key point's neighbourhood, pixels of the full image. Localisation noise grows with it.
    pub size_px: f64,
    /// What it looks like.
    pub descriptor: Descriptor,
}

/// How exactly features lie: a parameter of all that weigh them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct FeatureNoise {
    /// Standard deviation of the smallest features' places in the image (px): corners of a few pixels, odometry that
    /// does not know the vehicle's nodding. Where sizes count, that of larger ones grows with the 0.75th power of them.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub sigma_px: f64,
}

impl Default for FeatureNoise {
    fn default() -> Self {
        Self { sigma_px: 1.0 }
    }
}

/// The features of one image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImageFeatures {
    /// The features; elsewhere a feature is named by its index in here.
    pub features: Vec<Feature>,
}

/// The features of one keyframe: an image per camera of the rig, in the rig's order; empty where a camera gave none.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct KeyframeFeatures {
    /// The images.
    pub images: Vec<ImageFeatures>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_counts_the_bits_that_differ() {
        let zeros = Descriptor([0; DESCRIPTOR_BYTES]);
        let mut some = zeros;
        some.0[0] = 0b101;
        some.0[63] = 0xff;
        assert_eq!(zeros.distance(&some), 10);
        assert_eq!(some.distance(&some), 0);
        assert_eq!(zeros.distance(&Descriptor([0xff; DESCRIPTOR_BYTES])), 512);
    }
}
