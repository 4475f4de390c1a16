//! Key points and what they look like: BRISK, spread over the image.
//!
//! ```text
//!   Grey ─► resize ─► detect, threshold by the image's own contrast ─► blind areas out
//!                                                                            │
//!   KeyPoints ◄─ full image's pixels ◄─ describe ◄─ refine ◄─ spread evenly ◄┘
//! ```
//! Stefan Leutenegger, Margarita Chli, Roland Siegwart: *BRISK: Binary Robust Invariant Scalable Keypoints*, ICCV
//! 2011; OpenCV's implementation.

mod brisk;
mod spread;
mod vignette;

pub use brisk::Detectors;
pub use vignette::Vignette;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::grey::checked_pixels;
use crate::{Grey, ImageError};

/// Bytes of a BRISK descriptor.
pub const DESCRIPTOR_BYTES: usize = 64;

/// Images are halved while they stay at least this wide (px), so that 1280 becomes 640, as in paper 1. Narrower ones
/// are enlarged to it: measured on 400 px fisheyes, features then lie 12 % more exactly and 4 % more tracks hold.
const WIDE_ENOUGH_PX: u32 = 600;

/// Enlarging further shows nothing new.
const MOST_ENLARGED: f64 = 2.0;

/// How features are found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct FeatureParams {
    /// Features are found in the image resized by this factor; coordinates are always those of the full image. 0: halved
    /// while it stays at least 600 px wide, so that 1280 × 960 is worked on at half resolution, as in paper 1; narrower
    /// ones are enlarged to 600 px, at most twofold. Measured at 400 × 300: features then lie 12 % more exactly.
    #[schemars(range(min = 0.0, max = 8.0))]
    pub scale: f64,
    /// The most features of one image. With 500, four cameras give 2000 rays per keyframe, of which some hundred remain
    /// after tracking: plenty for a pose.
    pub count: u32,
    /// Octaves of BRISK's scale space, each with one layer between it and the next; 0: one size only.
    pub octaves: u32,
    /// Corners with less contrast than this are noise (grey values of 255). JPEG's and a sensor's noise is 2 to 3.
    #[schemars(range(min = 1, max = 255))]
    pub min_contrast: u32,
}

impl Default for FeatureParams {
    fn default() -> Self {
        Self {
            scale: 0.0,
            count: 500,
            octaves: 2,
            min_contrast: 5,
        }
    }
}

impl FeatureParams {
    /// The scale for an image of this width.
    pub fn scale_for(&self, width: u32) -> f64 {
        if self.scale > 0.0 {
            return self.scale;
        }
        if width < WIDE_ENOUGH_PX {
            return (f64::from(WIDE_ENOUGH_PX) / f64::from(width.max(1))).min(MOST_ENLARGED);
        }
        let halvings = (0..16).take_while(|n| (width >> (n + 1)) >= WIDE_ENOUGH_PX);
        0.5_f64.powi(halvings.count() as i32)
    }
}

/// The features of one image: lists of equal length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct KeyPoints {
    /// Columns in the full image (px); 0 is the centre of the first pixel.
    pub u: Vec<f32>,
    /// Rows in the full image (px); 0 is the centre of the first pixel.
    pub v: Vec<f32>,
    /// Diameters of the neighbourhoods (px of the full image).
    pub size_px: Vec<f32>,
    /// [`DESCRIPTOR_BYTES`] for each.
    pub descriptors: Vec<u8>,
}

impl KeyPoints {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.u.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.u.is_empty()
    }
}

/// Where a feature must not lie, in the full image's pixels: polygons, such as the outline of the vehicle's own body, and a
/// mask.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Blind {
    /// Each a ring of `[u, v]`; fewer than three corners cover nothing.
    pub polygons: Vec<Vec<[f64; 2]>>,
    /// An image of the same size, not 0 where no feature may lie.
    pub mask: Option<Grey>,
}

impl Blind {
    /// Whether a pixel lies in one of the polygons (even-odd rule), or the mask covers it.
    pub fn covers(&self, pixel: [f64; 2]) -> bool {
        let masked = |mask: &Grey| mask.at(pixel).is_some_and(|value| value > 0);
        self.polygons.iter().any(|ring| inside(ring, pixel))
            || self.mask.as_ref().is_some_and(masked)
    }

    /// An image of this size, 255 at each pixel that it [covers](Blind::covers) and 0 elsewhere; a mask of another size
    /// covers nothing.
    ///
    /// # Errors
    /// [`ImageError::Size`] for an image without pixels, or with too many.
    pub fn painted(&self, width: u32, height: u32) -> Result<Grey, ImageError> {
        let pixels = checked_pixels(width, height)?;
        let mask = self
            .mask
            .as_ref()
            .filter(|mask| (mask.width, mask.height) == (width, height));
        let data = mask.map_or_else(
            || vec![0; pixels],
            |mask| {
                let covered = mask
                    .data
                    .iter()
                    .map(|value| if *value > 0 { u8::MAX } else { 0 });
                covered.collect()
            },
        );
        let mut painted = Grey {
            width,
            height,
            data,
        };
        for ring in &self.polygons {
            for (row, line) in painted.data.chunks_exact_mut(width as usize).enumerate() {
                let mut at: Vec<f64> = crossings(ring, row as f64).collect();
                at.sort_by(f64::total_cmp);
                // Numbers below zero, or beyond the image, become its ends.
                let ends = |u: &f64| (u.ceil() as usize).min(width as usize);
                for pair in at.as_chunks::<2>().0 {
                    let [begin, end] = [ends(&pair[0]), ends(&pair[1])];
                    if let Some(covered) = line.get_mut(begin..end) {
                        covered.fill(u8::MAX);
                    }
                }
            }
        }
        Ok(painted)
    }
}

fn inside(ring: &[[f64; 2]], [u, v]: [f64; 2]) -> bool {
    crossings(ring, v).filter(|crossing| u < *crossing).count() % 2 == 1
}

/// Where a ring crosses a row: an even number of times.
fn crossings(ring: &[[f64; 2]], v: f64) -> impl Iterator<Item = f64> {
    let before = ring.iter().cycle().skip(ring.len().saturating_sub(1));
    let sides = ring.iter().zip(before);
    let crossed = sides.filter(move |(a, b)| (a[1] > v) != (b[1] > v));
    crossed.map(move |(a, b)| a[0] + (v - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
}

#[cfg(test)]
mod tests;
