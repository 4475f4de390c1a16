//! What is sought of landmarks.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::appearance::{appearances, seen, sightings};
use super::descriptor_source::{DescriptorSource, descriptors_of};
use super::{AssociationParams, FeatureRef, Landmark, Scene};
use crate::geometry::pose::Pose;
use crate::metric_map::features::Descriptor;
use crate::metric_map::visibility::Visibility;
use crate::solving::median::median;

/// Features of landmarks whose descriptors are held at a time, about; those that stand for a landmark stay.
const AT_A_TIME: usize = 1 << 18;

/// What a landmark looks like from about a place.
struct Appearance {
    /// Unit vector from the landmark to the camera.
    direction: Vector3<f32>,
    /// Logarithm of the camera's distance to the base 2.
    octave: f32,
    descriptor: Descriptor,
}

/// What the search needs to know of a landmark.
pub(super) struct Target {
    pub(super) point: Vector3<f64>,
    appearances: Vec<Appearance>,
    /// Feature size times range, median: the landmark's own size, pixel metres.
    pub(super) size_px_m: f64,
}

impl Target {
    /// What it looks like from the two most similar places: by direction first, a range twice as far counting like
    /// a radian.
    pub(super) fn nearest_appearances(
        &self,
        direction: &Vector3<f64>,
        range_m: f64,
    ) -> [Option<&Descriptor>; 2] {
        let (direction, octave): (Vector3<f32>, f32) = (direction.cast(), range_m.log2() as f32);
        let mut nearest: [Option<(f32, &Descriptor)>; 2] = [None, None];
        for appearance in &self.appearances {
            let across = (appearance.direction - direction).norm();
            let apart = across + (appearance.octave - octave).abs();
            let found = Some((apart, &appearance.descriptor));
            if nearest[0].is_none_or(|(best, _)| apart < best) {
                nearest = [found, nearest[0]];
            } else if nearest[1].is_none_or(|(best, _)| apart < best) {
                nearest[1] = found;
            }
        }
        nearest.map(|found| found.map(|(_, descriptor)| descriptor))
    }
}

/// What is sought of landmarks, and from where they may be seen, in their order. Of their descriptors, those that stand for
/// one are held; the others are looked at part by part.
///
/// # Errors
/// As [`DescriptorSource::descriptors`].
pub(super) fn targets<E: Send>(
    scene: &Scene,
    described: &dyn DescriptorSource<E>,
    cameras: &[Pose],
    landmarks: &[Landmark],
    params: &AssociationParams,
) -> Result<(Vec<Target>, Vec<Visibility>), E> {
    let mut targets = Vec::with_capacity(landmarks.len());
    let mut visibilities = Vec::with_capacity(landmarks.len());
    for part in parts(landmarks, AT_A_TIME) {
        let with_descriptors = with_descriptors(described, part)?;
        let (of_part, seen_from): (Vec<Target>, Vec<Visibility>) = with_descriptors
            .par_iter()
            .map(|(landmark, descriptors)| target(scene, cameras, landmark, descriptors, params))
            .unzip();
        targets.extend(of_part);
        visibilities.extend(seen_from);
    }
    Ok((targets, visibilities))
}

/// The landmarks in their order, in parts of about as many features.
fn parts(landmarks: &[Landmark], features: usize) -> impl Iterator<Item = &[Landmark]> {
    let mut in_part = 0;
    landmarks.chunk_by(move |before, _| {
        in_part += before.features.len();
        let full = in_part >= features;
        if full {
            in_part = 0;
        }
        !full
    })
}

/// Landmarks with the descriptors of their features.
fn with_descriptors<'l, E: Send>(
    described: &dyn DescriptorSource<E>,
    landmarks: &'l [Landmark],
) -> Result<Vec<(&'l Landmark, Vec<Descriptor>)>, E> {
    let features = landmarks.iter().flat_map(|landmark| &landmark.features);
    let features: Vec<FeatureRef> = features.copied().collect();
    let mut descriptors = descriptors_of(described, &features)?.into_iter();
    let own = |landmark: &'l Landmark| {
        let own = descriptors.by_ref().take(landmark.features.len());
        (landmark, own.collect())
    };
    Ok(landmarks.iter().map(own).collect())
}

/// What is sought of a landmark whose features look like these descriptors, and from where it may be seen.
fn target(
    scene: &Scene,
    cameras: &[Pose],
    landmark: &Landmark,
    descriptors: &[Descriptor],
    params: &AssociationParams,
) -> (Target, Visibility) {
    let sightings = sightings(cameras, &landmark.point, &landmark.features, descriptors);
    let features = landmark.features.iter().zip(&sightings);
    let sizes = features.map(|(feature, look)| scene.feature(*feature).size_px() * look.range_m);
    let appearance = |at: usize| Appearance {
        direction: sightings[at].direction.cast(),
        octave: sightings[at].range_m.log2() as f32,
        descriptor: *sightings[at].descriptor,
    };
    let visibility = Visibility::new(
        landmark.point,
        &seen(&sightings),
        params.view_margin_rad,
        params.scale_factor,
    );
    let target = Target {
        point: landmark.point,
        appearances: appearances(&sightings)
            .into_iter()
            .map(appearance)
            .collect(),
        size_px_m: median(sizes.collect()).unwrap_or(0.0),
    };
    (target, visibility)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_all_landmarks_in_their_order_and_end_where_they_are_full() {
        let landmark = |(id, features): (u32, usize)| Landmark {
            id,
            point: Vector3::zeros(),
            features: vec![
                FeatureRef {
                    image: 0,
                    feature: 0
                };
                features
            ],
        };
        let landmarks = (0..).zip([3, 3, 3, 9, 0, 2, 1]).map(landmark);
        let landmarks: Vec<Landmark> = landmarks.collect();
        let names = |part: &[Landmark]| part.iter().map(|one| one.id).collect::<Vec<_>>();
        let found: Vec<Vec<u32>> = parts(&landmarks, 5).map(names).collect();
        assert_eq!(found, [vec![0, 1], vec![2, 3], vec![4, 5, 6]]);
        assert_eq!(parts(&[], 5).count(), 0);
    }
}
