//! A few descriptors that stand for all that were seen of a landmark.

use nalgebra::Vector3;

use super::scene::FeatureRef;
use crate::geometry::pose::Pose;
use crate::metric_map::features::Descriptor;
use crate::metric_map::visibility::ViewCone;

/// Most appearances of one landmark.
const MOST_APPEARANCES: usize = 8;
/// An appearance is of a cone of this half angle: binary descriptors survive about 25 degrees (Leutenegger, Chli &
/// Siegwart 2011, figure 6: recall of BRISK halves at 30 degrees).
const ALIKE_COS: f64 = 0.94;
/// An appearance is of ranges within this factor.
const ALIKE_RANGE_FACTOR: f64 = 1.5;
/// No camera is nearer to a landmark, metres.
const NEAREST_M: f64 = 1e-3;
/// Members of an appearance that the medoid is taken of, at most.
const MOST_MEMBERS: usize = 24;

/// How a feature shows a landmark: what an appearance is made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AppearanceSample<'a> {
    /// Unit vector from the landmark to the camera, in the map.
    pub(super) direction: Vector3<f64>,
    /// Distance of the camera, metres.
    pub(super) range_m: f64,
    /// What it looks like from there.
    pub(super) descriptor: &'a Descriptor,
}

/// How features, which look like these descriptors, show a landmark at a point, in their order. `map_from_cameras` are the
/// poses of all images.
pub(super) fn sightings<'a>(
    map_from_cameras: &[Pose],
    point: &Vector3<f64>,
    features: &[FeatureRef],
    descriptors: &'a [Descriptor],
) -> Vec<AppearanceSample<'a>> {
    let sighting = |(feature, descriptor): (&FeatureRef, &'a Descriptor)| {
        let away = map_from_cameras[feature.image as usize].translation - point;
        let range_m = away.norm().max(NEAREST_M);
        AppearanceSample {
            direction: away / range_m,
            range_m,
            descriptor,
        }
    };
    features.iter().zip(descriptors).map(sighting).collect()
}

/// Groups sightings of a landmark by direction and range, and gives the medoid of each group: the index of the sighting
/// whose descriptor is nearest to all others. Those of most members first, ties in order of first sight.
pub(super) fn appearances(sightings: &[AppearanceSample<'_>]) -> Vec<usize> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (at, sighting) in sightings.iter().enumerate() {
        let like = |group: &&mut Vec<usize>| {
            let first = &sightings[group[0]];
            let ratio = first.range_m / sighting.range_m;
            first.direction.dot(&sighting.direction) >= ALIKE_COS
                && (1.0 / ALIKE_RANGE_FACTOR..=ALIKE_RANGE_FACTOR).contains(&ratio)
        };
        match groups.iter_mut().find(like) {
            Some(group) => group.push(at),
            None => groups.push(vec![at]),
        }
    }
    groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
    groups.truncate(MOST_APPEARANCES);
    let medoids = groups.iter().map(|group| medoid(sightings, group));
    medoids.collect()
}

/// From where a landmark was seen; from above where directions cancel.
pub(super) fn seen(sightings: &[AppearanceSample<'_>]) -> ViewCone {
    let sum: Vector3<f64> = sightings.iter().map(|seen| seen.direction).sum();
    let view = sum.try_normalize(1e-6).unwrap_or_else(Vector3::z);
    let cosines = sightings.iter().map(|seen| seen.direction.dot(&view));
    let ranges = || sightings.iter().map(|seen| seen.range_m);
    ViewCone {
        view,
        view_cos: cosines.fold(1.0, f64::min),
        ranges_m: [
            ranges().fold(f64::INFINITY, f64::min),
            ranges().fold(0.0, f64::max),
        ],
    }
}

fn medoid(sightings: &[AppearanceSample<'_>], group: &[usize]) -> usize {
    let step = group.len().div_ceil(MOST_MEMBERS);
    let members = || group.iter().copied().step_by(step);
    let bits = |a: usize, b: usize| sightings[a].descriptor.distance(sightings[b].descriptor);
    let total = |at: &usize| -> u32 { members().map(|other| bits(*at, other)).sum() };
    members().min_by_key(total).unwrap_or(group[0])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::metric_map::features::DESCRIPTOR_BYTES;

    fn sighting(angle_rad: f64, range_m: f64, descriptor: &Descriptor) -> AppearanceSample<'_> {
        AppearanceSample {
            direction: Vector3::new(angle_rad.cos(), angle_rad.sin(), 0.0),
            range_m,
            descriptor,
        }
    }

    fn descriptor(first_byte: u8) -> Descriptor {
        let mut bytes = [0; DESCRIPTOR_BYTES];
        bytes[0] = first_byte;
        Descriptor(bytes)
    }

    #[test]
    fn near_sightings_share_an_appearance_and_its_medoid_is_in_the_middle() {
        let looks = [0b1111_0000, 0b0001, 0b0011, 0b0111].map(descriptor);
        let seen = [(1.5, 2.0), (0.0, 2.0), (0.1, 2.2), (0.05, 1.9)];
        let seen = seen.iter().zip(&looks);
        let seen: Vec<AppearanceSample<'_>> = seen
            .map(|((angle_rad, range_m), look)| sighting(*angle_rad, *range_m, look))
            .collect();
        assert_eq!(appearances(&seen), [2, 0]);
        assert!(appearances(&[]).is_empty());
    }

    #[test]
    fn there_are_never_too_many() {
        let look = descriptor(7);
        let around: Vec<AppearanceSample<'_>> = (0..200)
            .map(|at| sighting(f64::from(at) * 0.3, 1.0 + f64::from(at), &look))
            .collect();
        assert_eq!(appearances(&around).len(), MOST_APPEARANCES);
    }
}
