//! What a classifier learns from one labelled image.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Backbone, FeatureDescription, FeatureError, PixelFeatures};
use crate::learning::dense_crf::ColourView;
use crate::solving::random::SplitMix64;

/// Samples of one image.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LabelledFeatures {
    /// Class of each sample.
    pub labels: Vec<u8>,
    /// Features of one sample after the other.
    pub values: Vec<u8>,
    /// Number of labelled pixels of each class, whether sampled or not.
    pub class_pixels: Vec<u64>,
}

/// Labelled pixels of one image, by class.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct SampledPixels {
    /// Index of each pixel, row by row, increasing within a class.
    pub(super) pixels: Vec<u32>,
    /// Class of each.
    pub(super) labels: Vec<u8>,
    /// Number of labelled pixels of each class, whether sampled or not.
    pub(super) class_pixels: Vec<u64>,
}

/// How pixels are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SamplingOptions {
    /// About how many pixels of an image.
    pub samples: u32,
    /// Only pixels whose row and column are multiples of this (px).
    pub stride_px: u32,
    /// A class with n pixels gets samples in proportion to `n^(1 - balance)`: 1 gives every class as many, 0 every pixel
    /// the same chance.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub balance: f64,
    /// As many samples again from the image's mirror image, as a street has two sides: with contiguous folds of CamVid
    /// 1 % more pixels are right, and 1 % more of an average class.
    pub mirror: bool,
    /// Where random numbers start; those of an image also depend on its stamp.
    pub seed: u64,
}

impl Default for SamplingOptions {
    fn default() -> Self {
        Self {
            samples: 2000,
            stride_px: 1,
            balance: 0.5,
            mirror: true,
            seed: 1,
        }
    }
}

/// Features of some labelled pixels of an image; `labels` row by row. Labels of `classes` and above stand for no class.
///
/// # Errors
/// [`FeatureError::Labels`] where there are not as many labels as pixels, else as [`PixelFeatures::new`].
pub fn labelled_features(
    description: &FeatureDescription,
    image: &ColourView<'_>,
    labels: &[u8],
    classes: usize,
    options: &SamplingOptions,
    backbone: Backbone,
) -> Result<LabelledFeatures, FeatureError> {
    let expected = image.pixels().len();
    if labels.len() != expected {
        let found = labels.len();
        return Err(FeatureError::Labels { expected, found });
    }
    let mut result = LabelledFeatures::default();
    result.add(description, image, labels, classes, options, backbone)?;
    if options.mirror {
        let class_pixels = std::mem::take(&mut result.class_pixels);
        let colours = mirrored(image.pixels(), image.width());
        let size = [image.width(), image.height()].map(|side| side as u32);
        if let Some(image) = ColourView::new(size[0], size[1], colours.as_flattened()) {
            let labels = mirrored(labels, image.width());
            result.add(description, &image, &labels, classes, options, backbone)?;
        }
        result.class_pixels = class_pixels;
    }
    Ok(result)
}

/// Every row from right to left.
fn mirrored<T: Copy>(pixels: &[T], width: usize) -> Vec<T> {
    let rows = pixels.chunks(width.max(1));
    rows.flat_map(|row| row.iter().rev().copied()).collect()
}

impl LabelledFeatures {
    fn add(
        &mut self,
        description: &FeatureDescription,
        image: &ColourView<'_>,
        labels: &[u8],
        classes: usize,
        options: &SamplingOptions,
        backbone: Backbone,
    ) -> Result<(), FeatureError> {
        let features = PixelFeatures::new(description, image, backbone)?;
        let width = image.width();
        let chosen = sample_pixels(labels, width, classes, options);
        let (from, dimensions) = (self.values.len(), description.dimensions());
        self.values
            .resize(from + chosen.pixels.len() * dimensions, 0);
        let room = self.values[from..].chunks_exact_mut(dimensions);
        for (pixel, out) in chosen.pixels.iter().zip(room) {
            let pixel = *pixel as usize;
            features.write(pixel % width, pixel / width, out);
        }
        self.labels.extend(chosen.labels);
        self.class_pixels = chosen.class_pixels;
        Ok(())
    }
}

/// Chooses pixels of a label image, `width` values to a row. Labels of `classes` and above stand for no class. Of each
/// class, the pixels are as far apart as the order of rows allows, at random places in between; a class that has fewer
/// pixels than its share gives all.
pub(super) fn sample_pixels(
    labels: &[u8],
    width: usize,
    classes: usize,
    options: &SamplingOptions,
) -> SampledPixels {
    let stride = options.stride_px.max(1) as usize;
    let width = width.max(1);
    let mut class_pixels = vec![0_u64; classes];
    let mut open = vec![Vec::new(); classes];
    for (index, label) in labels.iter().enumerate() {
        let class = usize::from(*label);
        if class >= classes {
            continue;
        }
        class_pixels[class] += 1;
        if (index / width).is_multiple_of(stride) && (index % width).is_multiple_of(stride) {
            open[class].push(index as u32);
        }
    }
    let shares: Vec<f64> = open
        .iter()
        .map(|pixels| match pixels.len() {
            0 => 0.0,
            n => (n as f64).powf(1.0 - options.balance),
        })
        .collect();
    let all: f64 = shares.iter().sum();
    let mut random = SplitMix64(options.seed);
    let mut result = SampledPixels {
        class_pixels,
        ..SampledPixels::default()
    };
    for (class, (pixels, share)) in open.iter().zip(shares).enumerate() {
        let wanted = (f64::from(options.samples) * share / all).ceil() as usize;
        let taken = wanted.min(pixels.len());
        for step in 0..taken {
            let [from, to] = [step, step + 1].map(|step| step * pixels.len() / taken);
            result.pixels.push(pixels[from + random.below(to - from)]);
            result.labels.push(class as u8);
        }
    }
    result
}
