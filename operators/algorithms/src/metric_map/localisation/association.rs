//! Which feature shows which landmark: image distance and descriptor distance together.

use super::view::Sighted;
use super::{LandmarkMap, LocalisationParams};
use crate::metric_map::features::{Blur, Feature, FeatureNoise, ImageFeatures, KeyframeFeatures};
use crate::metric_map::matching::FeatureGrid;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// Squared Mahalanobis distance that 99.9 % of true features in a plane stay below.
const GATE: f64 = 13.8;
/// Bits that one unit of squared Mahalanobis distance weighs: descriptors of one landmark scatter by some 20 bits
/// between views, and both are twice the negative logarithm of a normal density: 20² / 2 of distance from the mean,
/// which lies about 50 bits off, is 4 bits per unit.
const BITS_PER_UNIT: f64 = 4.0;
/// Features and projected landmarks nearer than this are one spot of the world, found twice: no rivals.
const SAME_SPOT_PX: f64 = 3.0;

/// A feature that may show a landmark.
#[derive(Debug, Clone, Copy)]
pub(super) struct Claim {
    /// Index into the sighted landmarks.
    pub(super) sighted: usize,
    /// Index into the image's features.
    pub(super) feature: usize,
    bits: u32,
    cost: f64,
}

/// Where to search.
#[derive(Debug, Clone, Copy)]
pub(super) enum Search {
    /// As far as the covariance of the projection says.
    Covariance,
    /// A fixed radius, pixels.
    Radius(f64),
}

/// Features of one image by cells.
pub(super) struct Cells<'a> {
    pub(super) features: &'a [Feature],
    /// How inexactly they are placed.
    pub(super) blur: Blur,
    /// By feature: how much larger than the smallest ones' the variance of its place is, px².
    excess_px2: Vec<f64>,
    grid: FeatureGrid,
}

impl<'a> Cells<'a> {
    /// Of all images of a keyframe.
    pub(super) fn of_keyframe(features: &'a KeyframeFeatures, noise: &FeatureNoise) -> Vec<Self> {
        let images = features.images.iter();
        images.map(|image| Self::new(image, noise)).collect()
    }

    fn new(image: &'a ImageFeatures, noise: &FeatureNoise) -> Self {
        let features = &image.features[..];
        let blur = Blur::of_image(image);
        let excess_px2 =
            |feature: &Feature| noise.sigma_px.powi(2) * (blur.of(feature.size_px).powi(2) - 1.0);
        let place = |feature: &Feature| {
            let sound = feature.pixel.iter().all(|x| (-1.0..1e5).contains(x));
            if sound { feature.pixel } else { [f64::NAN; 2] }
        };
        Self {
            features,
            blur,
            excess_px2: features.iter().map(excess_px2).collect(),
            grid: FeatureGrid::new(features.iter().map(place)),
        }
    }
}

/// The claims that hold: best for the landmark and for the feature, and clearly better than the next landmark or
/// feature of another spot. Ordered by sighted landmark.
pub(super) fn claims(
    map: &LandmarkMap,
    sighted: &[Sighted],
    cells: &[Cells<'_>],
    search: Search,
    params: &LocalisationParams,
) -> Vec<Claim> {
    let mut parts: Vec<(usize, &[Sighted])> = Vec::new();
    let mut start = 0;
    for of_camera in sighted.chunk_by(|a, b| a.camera == b.camera) {
        parts.push((start, of_camera));
        start += of_camera.len();
    }
    let held: Vec<Vec<Claim>> = parts
        .into_par_iter()
        .map(|(start, of_camera)| {
            let camera = of_camera.first().map_or(usize::MAX, |first| first.camera);
            let Some(cells) = cells.get(camera) else {
                return Vec::new();
            };
            let all = candidates(map, of_camera, start, cells, search, params);
            mutual(all, sighted, cells.features, params.limits.match_ratio)
        })
        .collect();
    held.into_iter().flatten().collect()
}

fn candidates(
    map: &LandmarkMap,
    sighted: &[Sighted],
    start: usize,
    cells: &Cells<'_>,
    search: Search,
    params: &LocalisationParams,
) -> Vec<Claim> {
    let mut found = Vec::new();
    let most_excess = cells.excess_px2.iter().copied().fold(0.0, f64::max);
    for (offset, seen) in sighted.iter().enumerate() {
        let radius = match search {
            Search::Radius(radius) => radius,
            Search::Covariance => {
                let widest = widest(&seen.covariance) + most_excess;
                (GATE * widest).sqrt().min(params.search_px)
            }
        };
        let units = |offset_px: &Vector2<f64>, excess_px2: f64| match search {
            Search::Radius(_) => 0.0,
            Search::Covariance => {
                let covariance = seen.covariance + Matrix2::identity() * excess_px2;
                let inverse = covariance.try_inverse().unwrap_or_default();
                offset_px.dot(&(inverse * offset_px))
            }
        };
        let descriptors = &map.landmarks()[seen.landmark].descriptors;
        for index in cells.grid.near(seen.pixel.into(), radius) {
            let index = index as usize;
            let feature = &cells.features[index];
            let offset_px = Vector2::from(feature.pixel) - seen.pixel;
            let units = units(&offset_px, cells.excess_px2[index]);
            if units > GATE {
                continue;
            }
            let bits = descriptors
                .iter()
                .map(|known| known.distance(&feature.descriptor))
                .min();
            if let Some(bits) = bits.filter(|bits| *bits <= params.limits.match_bits) {
                found.push(Claim {
                    sighted: start + offset,
                    feature: index,
                    bits,
                    cost: f64::from(bits) + BITS_PER_UNIT * units,
                });
            }
        }
    }
    found
}

/// The larger eigenvalue of a symmetric matrix, and 0 at least.
fn widest(covariance: &Matrix2<f64>) -> f64 {
    let [half_sum, half_difference] =
        [1.0, -1.0].map(|sign| 0.5 * (covariance[(0, 0)] + sign * covariance[(1, 1)]));
    (half_sum + half_difference.hypot(covariance[(0, 1)])).max(0.0)
}

/// Of one image's claims, those that are best on both sides without a rival.
fn mutual(all: Vec<Claim>, sighted: &[Sighted], features: &[Feature], ratio: f64) -> Vec<Claim> {
    let feature_place = |claim: &Claim| Vector2::from(features[claim.feature].pixel);
    let landmark_place = |claim: &Claim| sighted[claim.sighted].pixel;
    let by_landmark = best(all.clone(), |claim| claim.sighted, feature_place, ratio);
    let by_feature = best(all, |claim| claim.feature, landmark_place, ratio);
    let mut held: Vec<Claim> = by_landmark
        .into_iter()
        .filter(|claim| {
            let found = by_feature.binary_search_by_key(&claim.feature, |other| other.feature);
            found.is_ok_and(|at| by_feature[at].sighted == claim.sighted)
        })
        .collect();
    held.sort_unstable_by_key(|claim| claim.sighted);
    held
}

/// The best claim of each `key`, unless one of another spot is nearly as alike. Ordered by key.
fn best(
    mut all: Vec<Claim>,
    key: impl Fn(&Claim) -> usize,
    place: impl Fn(&Claim) -> Vector2<f64>,
    ratio: f64,
) -> Vec<Claim> {
    all.sort_unstable_by(|a, b| {
        key(a)
            .cmp(&key(b))
            .then(a.cost.total_cmp(&b.cost))
            .then((a.sighted, a.feature).cmp(&(b.sighted, b.feature)))
    });
    let runs = all.chunk_by(|a, b| key(a) == key(b));
    let held = runs.filter_map(|run| {
        let (first, others) = run.split_first()?;
        let rival = |other: &&Claim| (place(other) - place(first)).norm() > SAME_SPOT_PX;
        let next = others.iter().filter(rival).map(|other| other.bits).min();
        next.is_none_or(|next| f64::from(first.bits) <= ratio * f64::from(next))
            .then_some(*first)
    });
    held.collect()
}
