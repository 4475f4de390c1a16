//! A landmark as a map keeps it: where it is, and what whoever looks for it later should expect.

use nalgebra::Vector3;

use super::appearance::{appearances, seen, sightings};
use super::point::{LandmarkPoint, Sight, triangulate};
use super::scene::{FeatureRef, Scene};
use crate::geometry::pose::Pose;
use crate::metric_map::features::Descriptor;
use crate::metric_map::visibility::ViewCone;

/// Where a landmark is, and how it has been seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// Where it is, and how sure that is.
    pub place: LandmarkPoint,
    /// Root mean square of what its features are off by, pixels.
    pub rms_px: f64,
    /// Mean direction to the cameras, a unit vector in the map.
    pub view: Vector3<f64>,
    /// Cosine of the angle between it and the direction that is most off it.
    pub view_cos: f64,
    /// Distance of the nearest camera, metres.
    pub near_m: f64,
    /// Distance of the farthest camera, metres.
    pub far_m: f64,
    /// What it looks like: the descriptors that stand for most of its features.
    pub descriptors: Vec<Descriptor>,
}

/// The landmark that shows as these features, which look like `descriptors`, with `looks` of them at most.
/// `map_from_cameras` are the poses of all images. `None` where the features cannot be triangulated.
pub fn describe(
    scene: &Scene,
    map_from_cameras: &[Pose],
    features: &[FeatureRef],
    descriptors: &[Descriptor],
    looks: usize,
) -> Option<Description> {
    let sights = features.iter();
    let sights = sights.filter_map(|feature| scene.sight(map_from_cameras, *feature));
    let sights: Vec<Sight> = sights.collect();
    let place = triangulate(&sights)?;
    let sightings = sightings(map_from_cameras, &place.point, features, descriptors);
    let ViewCone {
        view,
        view_cos,
        ranges_m: [near_m, far_m],
    } = seen(&sightings);
    let alike = appearances(&sightings).into_iter().take(looks);
    let alike = alike.map(|sighting| *sightings[sighting].descriptor);
    Some(Description {
        place,
        rms_px: rms_px(&sights, &place.point),
        view,
        view_cos,
        near_m,
        far_m,
        descriptors: alike.collect(),
    })
}

fn rms_px(sights: &[Sight], point: &Vector3<f64>) -> f64 {
    let offsets = sights.iter().filter_map(|sight| sight.off_px(point));
    let squares: f64 = offsets.map(|off_px| off_px * off_px).sum();
    (squares / sights.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::convert::Infallible;

    use super::*;
    use crate::geometry::camera::Camera;
    use crate::geometry::rig::{Rig, RigCamera};
    use crate::metric_map::features::{DESCRIPTOR_BYTES, Feature, ImageFeatures, KeyframeFeatures};

    /// A vehicle without a turn that looks along z, past a point 4 m ahead of where it begins.
    #[test]
    fn a_landmark_is_described_by_where_it_was_seen_from() {
        let k = [300.0, 300.0, 320.0, 240.0];
        let camera = Camera::from_calibration("plumb_bob", 640, 480, &k, &[]).unwrap();
        let rig = Rig {
            cameras: vec![RigCamera {
                name: "front".into(),
                camera: camera.clone(),
                vehicle_from_camera: Pose::identity(),
            }],
        };
        let point = Vector3::new(0.0, 0.0, 4.0);
        let poses = [-1.0, 0.0, 1.0].map(|x| Pose::from_yaw(x, 0.0, 0.0));
        let feature = |pose: &Pose| Feature {
            pixel: camera.project(&pose.inverse().transform(&point)).unwrap(),
            size_px: 7.0,
            descriptor: Descriptor([7; DESCRIPTOR_BYTES]),
        };
        let keyframe = |pose: &Pose| {
            let features = vec![feature(pose)];
            let images = vec![ImageFeatures { features }];
            (*pose, KeyframeFeatures { images })
        };
        let mut scene = Scene::default();
        let keyframes = poses.iter().map(keyframe).map(Ok::<_, Infallible>);
        scene.add_session(&rig, keyframes).unwrap();
        let features = [0, 1, 2].map(|image| FeatureRef { image, feature: 0 });
        let cameras = scene.map_from_cameras(&poses);

        let seen = [Descriptor([7; DESCRIPTOR_BYTES]); 3];
        let found = describe(&scene, &cameras, &features, &seen, 4).unwrap();
        assert!((found.place.point - point).norm() < 1e-6);
        assert!(found.rms_px < 1e-6);
        assert!((found.view + Vector3::z()).norm() < 1e-6);
        assert!((found.view_cos - 4.0 / 17_f64.sqrt()).abs() < 1e-6);
        assert!((found.near_m - 4.0).abs() < 1e-6);
        assert!((found.far_m - 17_f64.sqrt()).abs() < 1e-6);
        // The middle one looks like the first one, 14 degrees away; the last one, 28 degrees away, does not.
        assert_eq!(found.descriptors, seen[..2]);
        let found = describe(&scene, &cameras, &features, &seen, 1).unwrap();
        assert_eq!(found.descriptors.len(), 1);
        assert!(describe(&scene, &cameras, &features[..1], &seen[..1], 4).is_none());
    }
}
