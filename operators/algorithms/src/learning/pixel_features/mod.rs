//! What a classifier of pixels sees of a pixel: dense SIFT, colour, the means of windows around it, what a network that
//! photographs have taught sees there, and where it is.
//!
//! ```text
//!            ┌─► luma ─► gradient ─► 8 directions ─► tents ─► SIFT at each bin size ──┐
//!   RGB ─────┤                                                                        ├─► bytes of one pixel
//!            ├─► L*a*b*, chromaticity, gradient ─► integral images ─► window means ───┤
//!            └─► network, at several sizes ─► maps of each stage ─────────────────────┘
//! ```
//! All values are bytes: a forest then splits by histograms of 256 bins, and a row of pixels fits the cache.

mod boxes;
mod colour;
mod description;
mod linear;
mod maps;
mod sampling;
mod sift;
mod smooth;

#[cfg(test)]
mod tests;

use boxes::Integrals;
pub use description::{
    BACKBONE_CHANNELS, FeatureDescription, FeatureError, FeatureOptions, Window,
};
pub use linear::LinearFeatures;
pub use maps::FeatureMap;
pub use sampling::{LabelledFeatures, SamplingOptions, labelled_features};
use sift::DenseSift;
use smooth::Edge;

use crate::learning::dense_crf::ColourView;

/// L*, a*, b*, two chromaticities, two gradients, squared L*.
const CHANNELS: usize = 8;

/// What a network sees of an image that is brought to so many pixels, stage by stage: [`BACKBONE_CHANNELS`] in all.
pub type Backbone = fn(&ColourView<'_>, u32) -> Result<Vec<FeatureMap>, String>;

/// For features without a network.
pub const NO_BACKBONE: Backbone = |_, _| Err("expected a network, found none".to_owned());

/// The features of all pixels of an image, ready to be read.
pub struct PixelFeatures {
    description: FeatureDescription,
    width: usize,
    height: usize,
    sift: Vec<DenseSift>,
    /// Where there are windows.
    colour: Option<Integrals<CHANNELS>>,
    maps: Vec<FeatureMap>,
}

impl PixelFeatures {
    /// Prepares an image: red, green, blue.
    ///
    /// # Errors
    /// [`FeatureError`] for a description that is out of range, and where the network fails.
    pub fn new(
        description: &FeatureDescription,
        image: &ColourView<'_>,
        backbone: Backbone,
    ) -> Result<Self, FeatureError> {
        description.check()?;
        let size = [image.width(), image.height()];
        let edge = Edge::of(description.wraps);
        let luma = colour::luma(image);
        let sift = description.options.sift_bins_px.iter();
        Ok(Self {
            sift: sift
                .map(|bin| DenseSift::new(&luma, size, *bin as usize, edge))
                .collect(),
            colour: (!description.options.windows_px.is_empty())
                .then(|| Integrals::new(channels(image, &luma, edge), size, edge)),
            maps: maps(&description.options.backbone_areas_px, image, backbone)?,
            description: description.clone(),
            width: image.width(),
            height: image.height(),
        })
    }

    /// Width and height of the image, px.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// How many features a pixel has.
    pub fn dimensions(&self) -> usize {
        self.description.dimensions()
    }

    /// Writes the features of a pixel; positions beyond the image stand for the nearest pixel. `out` has room for
    /// [`FeatureDescription::dimensions`] values; what does not fit is left out.
    pub fn write(&self, u: usize, v: usize, out: &mut [u8]) {
        let (u, v) = (u.min(self.width - 1), v.min(self.height - 1));
        let mut rest = out;
        for sift in &self.sift {
            let Some((part, after)) = rest.split_at_mut_checked(sift::DIMENSIONS) else {
                return;
            };
            sift.write(u, v, part);
            rest = after;
        }
        let windows = self.description.options.windows_px.iter();
        for (window, colour) in windows.zip(self.colour.iter().cycle()) {
            let Some((part, after)) = rest.split_at_mut_checked(CHANNELS) else {
                return;
            };
            part.copy_from_slice(&window_means(colour, u, v, window));
            rest = after;
        }
        for map in &self.maps {
            let Some((part, after)) = rest.split_at_mut_checked(map.channels) else {
                return;
            };
            map.write(u, v, part);
            rest = after;
        }
        for (out, value) in rest.iter_mut().zip(self.position(u, v)) {
            *out = value;
        }
    }

    /// Row, and column where the image has two ends, each as a share of the image.
    fn position(&self, u: usize, v: usize) -> impl Iterator<Item = u8> {
        let share = |at: usize, length: usize| (at * 256 / length) as u8;
        let row = share(v, self.height);
        let column = (!self.description.wraps).then(|| share(u, self.width));
        std::iter::once(row).chain(column)
    }
}

/// Means of a window of a pixel.
fn window_means(
    colour: &Integrals<CHANNELS>,
    u: usize,
    v: usize,
    window: &Window,
) -> [u8; CHANNELS] {
    let (u, v) = (
        u as isize + window.du as isize,
        v as isize + window.dv as isize,
    );
    let (sums, count) = colour.around(u, v, window.half as usize);
    let scale = (count.max(1) as f32).recip();
    let means = sums.map(|sum| sum as f32 * scale);
    let deviation = (means[7] - means[0] * means[0]).max(0.0).sqrt();
    let byte = |value: f32| (value + 0.5) as u8;
    let [l, a, b, red, green, gx, gy, _] = means;
    [l, a, b, red, green, gx, gy, 2.0 * deviation].map(byte)
}

/// What the network sees at each size.
fn maps(
    areas_px: &[u32],
    image: &ColourView<'_>,
    backbone: Backbone,
) -> Result<Vec<FeatureMap>, FeatureError> {
    let mut all = Vec::new();
    for area in areas_px {
        let maps = backbone(image, *area).map_err(FeatureError::Backbone)?;
        let channels: usize = maps.iter().map(|map| map.channels).sum();
        if channels != BACKBONE_CHANNELS || !maps.iter().all(FeatureMap::is_whole) {
            let found = format!("expected {BACKBONE_CHANNELS} values, found {channels}");
            return Err(FeatureError::Backbone(found));
        }
        all.extend(maps);
    }
    Ok(all)
}

/// The channels of each pixel.
fn channels<'a>(
    image: &'a ColourView<'_>,
    luma: &'a [u32],
    edge: Edge,
) -> impl Iterator<Item = [u32; CHANNELS]> + 'a {
    let (width, height) = (image.width(), image.height());
    image
        .pixels()
        .iter()
        .enumerate()
        .map(move |(index, pixel)| {
            let (u, v) = ((index % width) as isize, (index / width) as isize);
            let at = |u: isize, v: isize| {
                luma[Edge::Repeat.index(v, height) * width + edge.index(u, width)]
            };
            let [l, a, b, red, green] = colour::channels(*pixel).map(u32::from);
            // Four times the gradient in grey values per pixel: texture is weak.
            let gx = at(u + 1, v).abs_diff(at(u - 1, v)) / 8;
            let gy = at(u, v + 1).abs_diff(at(u, v - 1)) / 8;
            [l, a, b, red, green, gx.min(255), gy.min(255), l * l]
        })
}
