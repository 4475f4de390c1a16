//! Key points with binary descriptors, as BRISK yields them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::processor::{each, vectorised};

/// Bytes of a descriptor.
pub const DESCRIPTOR_BYTES: usize = 64;

/// A binary descriptor of 512 bits (BRISK).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Descriptor(pub [u8; DESCRIPTOR_BYTES]);

impl Descriptor {
    /// Bits that differ, 0 to 512.
    pub fn distance(&self, other: &Self) -> u32 {
        // Without a processor's own instruction, counting takes eight times as long.
        vectorised(
            #[inline(always)]
            || distance(&words(self), &words(other)),
        )
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

/// Bits in which each of several descriptors differs from one.
pub(crate) fn distances<'a>(
    several: impl Iterator<Item = &'a Words>,
    one: &Descriptor,
) -> Vec<u32> {
    let one = words(one);
    each(
        several,
        #[inline(always)]
        |other| distance(other, &one),
    )
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
    /// Standard deviation of the smallest features' places in the image (px); that of larger ones grows with the 0.75th
    /// power of their size. Half a pixel: residuals of maps have 0.42 px on a real camera (KITTI), 0.31 to 0.35 px on
    /// simulated fisheyes that others made, and are a fifth smaller than the noise where four features show a landmark;
    /// under true poses it is 0.45 px.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub sigma_px: f64,
}

impl Default for FeatureNoise {
    fn default() -> Self {
        Self { sigma_px: 0.5 }
    }
}

/// Growth of a feature's standard deviation with its size.
const BLUR_POWER: f64 = 0.75;
/// Features larger than this many times the smallest ones are placed no worse.
const MOST_BLUR: f64 = 8.0;

/// How inexactly the features of a camera are placed, in units of the smallest ones' standard deviation. A corner found
/// at a coarse scale is placed to a part of that scale's pixels, so nearly in proportion to its size. Measured on
/// renderings with truth: 1.6 at twice the smallest size, 2.3 at three times; on a real camera 2.1 and 2.8.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blur {
    smallest_px: f64,
}

impl Blur {
    /// Of a camera, by the sizes of its features (px). The small ones are the first decile.
    pub fn new(sizes_px: impl IntoIterator<Item = f64>) -> Self {
        let sizes = sizes_px.into_iter();
        let mut sizes: Vec<f64> = sizes
            .filter(|size| *size > 0.0 && size.is_finite())
            .collect();
        sizes.sort_by(f64::total_cmp);
        Self {
            smallest_px: sizes.get(sizes.len() / 10).copied().unwrap_or(1.0),
        }
    }

    /// Of one image.
    pub fn of_image(image: &ImageFeatures) -> Self {
        Self::new(image.features.iter().map(|feature| feature.size_px))
    }

    /// Of a feature of this size (px): 1 or more.
    pub fn of(&self, size_px: f64) -> f64 {
        (size_px / self.smallest_px)
            .clamp(1.0, MOST_BLUR)
            .powf(BLUR_POWER)
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
