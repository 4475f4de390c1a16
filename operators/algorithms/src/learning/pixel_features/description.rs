//! Which features there are: what a model must carry, so that predictions see what training saw.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{CHANNELS, sift};

/// A square of pixels beside the pixel that is described; written as `[du, dv, half]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "(i32, i32, u32)", into = "(i32, i32, u32)")]
pub struct Window {
    /// Columns from the pixel to the window's centre.
    pub du: i32,
    /// Rows from the pixel to the window's centre.
    pub dv: i32,
    /// The window is `2 half + 1` pixels wide and high.
    pub half: u32,
}

impl From<(i32, i32, u32)> for Window {
    fn from((du, dv, half): (i32, i32, u32)) -> Self {
        Self { du, dv, half }
    }
}

impl From<Window> for (i32, i32, u32) {
    fn from(Window { du, dv, half }: Window) -> Self {
        (du, dv, half)
    }
}

/// Which features pixels have, whatever the image.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct FeatureOptions {
    /// Side of a SIFT bin (px), once per scale, 1 to 32; a descriptor has 4 × 4 bins.
    #[schemars(inner(range(min = 1, max = 32)))]
    pub sift_bins_px: Vec<u32>,
    /// Where colour and texture are averaged: columns away, rows away, and h of a window that is 2 h + 1 wide (px). By
    /// default 4 about the pixel, 24 around it.
    pub windows_px: Vec<Window>,
    /// Sizes (px²) that an image is brought to for a network that photographs have taught (EfficientNet-Lite0), once per
    /// size, 4096 to 2097152; 464 values each. None by default.
    #[schemars(inner(range(min = 4096, max = 2_097_152)))]
    pub backbone_areas_px: Vec<u32>,
}

/// Which features a pixel has, in this order: SIFT at each bin size (128 values each), eight means of each window (L*,
/// a*, b*, red and green chromaticity, gradients along both axes, deviation of L*), what a network sees at each size (464
/// values each), the row, and, unless the image wraps, the column.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct FeatureDescription {
    /// What does not depend on the image.
    #[serde(flatten)]
    pub options: FeatureOptions,
    /// The last column is next to the first: full panoramas. The column is then no feature.
    pub wraps: bool,
}

/// Why features cannot be computed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FeatureError {
    /// A number of the description is out of range.
    #[error("features: expected {what}, found {found}")]
    Range {
        /// What must hold.
        what: &'static str,
        /// What was found.
        found: u64,
    },
    /// Labels of an image of another size.
    #[error("expected labels of {expected} pixels, found {found}")]
    Labels {
        /// Pixels of the image.
        expected: usize,
        /// Labels given.
        found: usize,
    },
    /// What a network sees is wanted, and it has not looked, or not as expected.
    #[error("features: {0}")]
    Backbone(String),
}

/// Values that a network has for a pixel: those of all its stages.
pub const BACKBONE_CHANNELS: usize = 464;

impl Default for FeatureOptions {
    /// What paid for itself on street scenes of 480 × 360.
    fn default() -> Self {
        let mut windows_px = centred(&[0, 2, 6, 16]);
        windows_px.extend(rings(&[(14, 4), (36, 9), (80, 18)]));
        Self {
            sift_bins_px: vec![4, 8],
            windows_px,
            backbone_areas_px: Vec::new(),
        }
    }
}

impl FeatureDescription {
    /// Number of values of a pixel.
    pub fn dimensions(&self) -> usize {
        let FeatureOptions {
            sift_bins_px,
            windows_px,
            backbone_areas_px,
        } = &self.options;
        sift_bins_px.len() * sift::DIMENSIONS
            + windows_px.len() * CHANNELS
            + backbone_areas_px.len() * BACKBONE_CHANNELS
            + if self.wraps { 1 } else { 2 }
    }

    /// Whether the features can be computed, and are no more than a tree can name.
    ///
    /// # Errors
    /// [`FeatureError::Range`].
    pub fn check(&self) -> Result<(), FeatureError> {
        let range = |what, found: u64, good: bool| match good {
            true => Ok(()),
            false => Err(FeatureError::Range { what, found }),
        };
        let FeatureOptions {
            sift_bins_px,
            windows_px,
            backbone_areas_px,
        } = &self.options;
        for bin in sift_bins_px {
            // Sums of 32⁴ weights still fit 32 bits.
            range(
                "SIFT bins of 1 to 32 px",
                (*bin).into(),
                (1..=32).contains(bin),
            )?;
        }
        for window in windows_px {
            range(
                "windows of at most 120 px to each side",
                window.half.into(),
                window.half <= 120,
            )?;
            let furthest = window.du.unsigned_abs().max(window.dv.unsigned_abs());
            range(
                "windows at most 65535 px away",
                furthest.into(),
                furthest <= 65_535,
            )?;
        }
        for area in backbone_areas_px {
            range(
                "a network's images of 4096 to 2097152 px²",
                (*area).into(),
                (4096..=2_097_152).contains(area),
            )?;
        }
        let most = sift_bins_px.len().max(windows_px.len());
        range(
            "at most 1000 windows and scales each",
            most as u64,
            most <= 1000,
        )?;
        let dimensions = self.dimensions();
        let good = (1..=32_768).contains(&dimensions);
        range("1 to 32768 features", dimensions as u64, good)
    }
}

/// Windows about the pixel itself.
fn centred(halves: &[u32]) -> Vec<Window> {
    halves
        .iter()
        .map(|&half| Window { du: 0, dv: 0, half })
        .collect()
}

/// Eight windows on each ring of (radius, half).
fn rings(rings: &[(i32, u32)]) -> Vec<Window> {
    let around = [
        (1, 0),
        (1, 1),
        (0, 1),
        (-1, 1),
        (-1, 0),
        (-1, -1),
        (0, -1),
        (1, -1),
    ];
    rings
        .iter()
        .flat_map(|&(radius, half)| {
            around.iter().map(move |&(du, dv)| Window {
                du: du * radius,
                dv: dv * radius,
                half,
            })
        })
        .collect()
}
