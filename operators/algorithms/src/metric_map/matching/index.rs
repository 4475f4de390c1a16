//! The features of one image, by where they are and what they look like.

use super::grid::{FeatureGrid, squared_distance};
use crate::metric_map::features::{Descriptor, Feature, ImageFeatures, Words, distances, words};

/// Answers "which feature near here looks like this?". Features keep the index that they have in
/// their [`ImageFeatures`].
#[derive(Debug, Clone)]
pub struct ImageIndex {
    grid: FeatureGrid,
    /// By feature.
    spots: Vec<Spot>,
}

#[derive(Debug, Clone)]
struct Spot {
    pixel: [f64; 2],
    size_px: f64,
    words: Words,
}

/// The feature that looks most alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nearest {
    /// Its index in the image.
    pub feature: u32,
    /// Bits that differ, of 512.
    pub distance: u32,
    /// Distance of the next best that is another spot of the image: a second scale of the same
    /// corner does not count. `None` where there is no other.
    pub runner_up: Option<u32>,
}

impl ImageIndex {
    /// Indexes an image's features.
    pub fn new(image: &ImageFeatures) -> Self {
        let pixels = image.features.iter().map(|feature| feature.pixel);
        Self {
            grid: FeatureGrid::new(pixels),
            spots: image.features.iter().map(Spot::new).collect(),
        }
    }

    /// Of the features within `radius_px` of a pixel that `accept` (given the index) lets pass, the
    /// one whose descriptor is nearest. Of equally near ones the lowest index wins.
    pub fn nearest(
        &self,
        pixel: [f64; 2],
        radius_px: f64,
        descriptor: &Descriptor,
        mut accept: impl FnMut(u32) -> bool,
    ) -> Option<Nearest> {
        let near = self.grid.near(pixel, radius_px);
        let candidates: Vec<(u32, &Spot)> = near
            .filter(|feature| accept(*feature))
            .map(|feature| (feature, &self.spots[feature as usize]))
            .collect();
        let spots = candidates.iter().map(|(_, spot)| &spot.words);
        best_two(&candidates, &distances(spots, descriptor))
    }
}

impl Spot {
    fn new(found: &Feature) -> Self {
        Self {
            pixel: found.pixel,
            size_px: found.size_px,
            words: words(&found.descriptor),
        }
    }
}

fn best_two(candidates: &[(u32, &Spot)], distances: &[u32]) -> Option<Nearest> {
    let of = |index: &usize| (distances[*index], candidates[*index].0);
    let best = (0..candidates.len()).min_by_key(of)?;
    let (feature, spot) = candidates[best];
    let elsewhere = |other: &Spot| {
        squared_distance(spot.pixel, other.pixel).sqrt() > 0.25 * spot.size_px.max(other.size_px)
    };
    let others = candidates.iter().zip(distances);
    let runner_up = others
        .filter(|((_, other), _)| elsewhere(other))
        .map(|(_, distance)| *distance)
        .min();
    Some(Nearest {
        feature,
        distance: distances[best],
        runner_up,
    })
}
