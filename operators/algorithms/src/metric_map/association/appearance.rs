//! A few descriptors that stand for all that were seen of a landmark.

use nalgebra::Vector3;

use super::scene::{FeatureRef, Scene};
use crate::geometry::pose::Pose;
use crate::metric_map::features::Descriptor;

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

/// One appearance of a landmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    /// Unit vector from the landmark to the camera, in the map.
    pub direction: Vector3<f64>,
    /// Distance of the camera, metres.
    pub range_m: f64,
    /// What it looks like from there.
    pub descriptor: Descriptor,
    /// Sightings that look like this.
    pub members: u32,
}

/// How features show a landmark at a point, each an appearance of its own. `map_from_cameras` are the poses of all images.
pub fn sightings(
    scene: &Scene,
    map_from_cameras: &[Pose],
    point: &Vector3<f64>,
    features: &[FeatureRef],
) -> Vec<Appearance> {
    let sighting = |feature: &FeatureRef| {
        let away = map_from_cameras[feature.image as usize].translation - point;
        let range_m = away.norm().max(NEAREST_M);
        Appearance {
            direction: away / range_m,
            range_m,
            descriptor: scene.feature(*feature).descriptor,
            members: 1,
        }
    };
    features.iter().map(sighting).collect()
}

/// Groups sightings of a landmark (each an appearance of its own: direction, range, descriptor) by direction and range,
/// and gives the medoid of each group: the sighting whose descriptor is nearest to all others. Most members first,
/// ties in order of first sight.
pub fn appearances(sightings: &[Appearance]) -> Vec<Appearance> {
    let mut groups: Vec<Vec<&Appearance>> = Vec::new();
    for sighting in sightings {
        let like = |group: &&mut Vec<&Appearance>| {
            let first = group[0];
            let ratio = first.range_m / sighting.range_m;
            first.direction.dot(&sighting.direction) >= ALIKE_COS
                && (1.0 / ALIKE_RANGE_FACTOR..=ALIKE_RANGE_FACTOR).contains(&ratio)
        };
        match groups.iter_mut().find(like) {
            Some(group) => group.push(sighting),
            None => groups.push(vec![sighting]),
        }
    }
    let mut found: Vec<Appearance> = groups.iter().map(|group| medoid(group)).collect();
    found.sort_by_key(|look| std::cmp::Reverse(look.members));
    found.truncate(MOST_APPEARANCES);
    found
}

/// Mean direction to the cameras, a unit vector; up where directions cancel.
pub fn mean_direction(sightings: &[Appearance]) -> Vector3<f64> {
    let sum: Vector3<f64> = sightings.iter().map(|look| look.direction).sum();
    sum.try_normalize(1e-6).unwrap_or_else(Vector3::z)
}

fn medoid(group: &[&Appearance]) -> Appearance {
    let step = group.len().div_ceil(MOST_MEMBERS);
    let members: Vec<&&Appearance> = group.iter().step_by(step).collect();
    let total = |look: &Appearance| -> u32 {
        let bits = members
            .iter()
            .map(|other| look.descriptor.distance(&other.descriptor));
        bits.sum()
    };
    let best = members
        .iter()
        .min_by_key(|look| total(look))
        .map_or(group[0], |look| **look);
    Appearance {
        members: group.len() as u32,
        ..*best
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::metric_map::features::DESCRIPTOR_BYTES;

    fn sighting(angle_rad: f64, range_m: f64, first_byte: u8) -> Appearance {
        let mut bytes = [0; DESCRIPTOR_BYTES];
        bytes[0] = first_byte;
        Appearance {
            direction: Vector3::new(angle_rad.cos(), angle_rad.sin(), 0.0),
            range_m,
            descriptor: Descriptor(bytes),
            members: 1,
        }
    }

    #[test]
    fn near_sightings_share_an_appearance_and_its_medoid_is_in_the_middle() {
        let found = appearances(&[
            sighting(0.0, 2.0, 0b0001),
            sighting(0.1, 2.2, 0b0011),
            sighting(0.05, 1.9, 0b0111),
            sighting(1.5, 2.0, 0b1111_0000),
        ]);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].descriptor.0[0], found[0].members), (0b0011, 3));
        assert_eq!(found[1].descriptor.0[0], 0b1111_0000);
        assert!(appearances(&[]).is_empty());
    }

    #[test]
    fn there_are_never_too_many() {
        let around: Vec<Appearance> = (0..200)
            .map(|at| sighting(f64::from(at) * 0.3, 1.0 + f64::from(at), 7))
            .collect();
        assert_eq!(appearances(&around).len(), MOST_APPEARANCES);
    }
}
