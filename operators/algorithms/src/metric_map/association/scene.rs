//! Keyframes of any number of sessions, their images and features, in one numbering.

use std::ops::Range;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::point::Sight;
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::geometry::rig::{Rig, RigCamera};
use crate::metric_map::features::{Blur, Feature, KeyframeFeatures};

/// A feature of an image of a [`Scene`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FeatureRef {
    /// Index in [`Scene::images`].
    pub image: u32,
    /// Index in [`SceneImage::features`].
    pub feature: u32,
}

/// Where a feature is, with the ray that it was seen along, in single precision: there are millions, and it errs by a
/// ten-thousandth of a pixel. What it looks like is to be [fetched](super::DescriptorSource).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneFeature {
    pixel: [f32; 2],
    size_px: f32,
    ray: Option<Vector3<f32>>,
}

impl SceneFeature {
    fn new(camera: &Camera, feature: &Feature) -> Self {
        Self {
            pixel: feature.pixel.map(|at| at as f32),
            size_px: feature.size_px as f32,
            ray: camera.unproject(feature.pixel).map(|ray| ray.cast()),
        }
    }

    /// `[u, v]`, pixels.
    pub fn pixel(&self) -> [f64; 2] {
        self.pixel.map(f64::from)
    }

    /// Diameter of its neighbourhood, pixels.
    pub fn size_px(&self) -> f64 {
        self.size_px.into()
    }

    /// Unit vector in the optical frame; `None` where the lens has no ray for the pixel. Such features are not used.
    pub fn ray(&self) -> Option<Vector3<f64>> {
        self.ray.map(|ray| ray.cast())
    }
}

/// An image of a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneImage {
    /// Index in [`Scene::keyframes`].
    pub keyframe: u32,
    /// Index in [`Scene::cameras`].
    pub camera: u32,
    /// What it shows.
    pub features: Vec<SceneFeature>,
}

/// A keyframe of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneKeyframe {
    /// Sessions are counted from 0.
    pub session: u32,
    /// The vehicle in the session's drifting odometry frame.
    pub odom_from_vehicle: Pose,
    /// Its images: indices in [`Scene::images`], one for each camera of the session's rig, in the rig's order.
    pub images: Range<u32>,
}

/// All that was seen, without the poses.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// The rigs, by session.
    pub rigs: Vec<Rig>,
    /// The cameras of all sessions: a session's rig after another.
    pub cameras: Vec<RigCamera>,
    /// Pixels per radian at the middle of each camera's image.
    pub px_per_rad: Vec<f64>,
    /// How inexactly each camera's features are placed.
    pub blurs: Vec<Blur>,
    /// Session after session, in driven order.
    pub keyframes: Vec<SceneKeyframe>,
    /// Keyframe after keyframe.
    pub images: Vec<SceneImage>,
}

/// The features of a keyframe by camera of its rig, and their diameters (px).
fn images(rig: &Rig, features: KeyframeFeatures) -> Vec<(Vec<SceneFeature>, Vec<f64>)> {
    let mut images = features.images.into_iter();
    let of_camera = |camera: &RigCamera| {
        let features = images.next().unwrap_or_default().features;
        let seen = features.iter();
        let seen = seen.map(|feature| SceneFeature::new(&camera.camera, feature));
        let sizes = features.iter().map(|feature| feature.size_px);
        (seen.collect(), sizes.collect())
    };
    rig.cameras.iter().map(of_camera).collect()
}

/// Keyframes whose rays are worked out side by side; more would hold their features twice.
const BLOCK: usize = 64;

impl Scene {
    /// Adds a session with its keyframes in driven order: odometry pose and features. Gives the session's number.
    ///
    /// # Errors
    /// The first of the keyframes'; the scene is of no use then.
    pub fn add_session<E>(
        &mut self,
        rig: &Rig,
        keyframes: impl IntoIterator<Item = Result<(Pose, KeyframeFeatures), E>>,
    ) -> Result<u32, E> {
        let session = self.rigs.len() as u32;
        self.rigs.push(rig.clone());
        let first_camera = self.cameras.len();
        for camera in &rig.cameras {
            self.px_per_rad.push(camera.camera.px_per_rad());
            self.cameras.push(camera.clone());
        }
        let mut sizes: Vec<Vec<f64>> = vec![Vec::new(); rig.cameras.len()];
        let mut keyframes = keyframes.into_iter();
        loop {
            let block = keyframes.by_ref().take(BLOCK);
            let block: Vec<_> = block.collect::<Result<_, E>>()?;
            if block.is_empty() {
                break;
            }
            let seen = block.into_par_iter();
            let seen = seen.map(|(pose, features)| (pose, images(rig, features)));
            for (odom_from_vehicle, images) in seen.collect::<Vec<_>>() {
                let first = self.images.len() as u32;
                let keyframe = self.keyframes.len() as u32;
                for (at, (features, of_features)) in images.into_iter().enumerate() {
                    sizes[at].extend(of_features);
                    self.images.push(SceneImage {
                        keyframe,
                        camera: (first_camera + at) as u32,
                        features,
                    });
                }
                self.keyframes.push(SceneKeyframe {
                    session,
                    odom_from_vehicle,
                    images: first..self.images.len() as u32,
                });
            }
        }
        self.blurs.extend(sizes.into_iter().map(Blur::new));
        Ok(session)
    }

    /// Whether there is such a feature.
    pub fn has(&self, at: FeatureRef) -> bool {
        let image = self.images.get(at.image as usize);
        image.is_some_and(|image| (at.feature as usize) < image.features.len())
    }

    /// A feature.
    pub fn feature(&self, at: FeatureRef) -> &SceneFeature {
        &self.images[at.image as usize].features[at.feature as usize]
    }

    /// The camera that took an image.
    pub fn camera(&self, image: u32) -> &RigCamera {
        &self.cameras[self.images[image as usize].camera as usize]
    }

    /// Pixels per radian at the middle of an image.
    pub fn px_per_rad(&self, image: u32) -> f64 {
        self.px_per_rad[self.images[image as usize].camera as usize]
    }

    /// Where an image's camera was: `map_from_camera`, from the keyframes' `map_from_vehicle`.
    pub fn map_from_camera(&self, poses: &[Pose], image: u32) -> Pose {
        let vehicle = &poses[self.images[image as usize].keyframe as usize];
        vehicle.compose(&self.camera(image).vehicle_from_camera)
    }

    /// How a feature was seen, given `map_from_camera` of every image; `None` where the lens has no ray for it.
    pub fn sight(&self, map_from_cameras: &[Pose], at: FeatureRef) -> Option<Sight> {
        let px_per_rad = self.px_per_rad(at.image);
        let camera = &map_from_cameras[at.image as usize];
        let sigma_rad = self.blur(at) / px_per_rad;
        let ray = self.feature(at).ray()?;
        Some(Sight::new(camera, &ray, sigma_rad, px_per_rad))
    }

    /// How inexactly a feature is placed, in units of the smallest ones' standard deviation.
    pub fn blur(&self, at: FeatureRef) -> f64 {
        let camera = self.images[at.image as usize].camera as usize;
        self.blurs[camera].of(self.feature(at).size_px())
    }

    /// `map_from_camera` of every image.
    pub fn map_from_cameras(&self, poses: &[Pose]) -> Vec<Pose> {
        (0..self.images.len() as u32)
            .map(|image| self.map_from_camera(poses, image))
            .collect()
    }
}
