//! Landmarks sought in the images that may show them.

use std::borrow::Cow;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::descriptor_source::DescriptorSource;
use super::point::LineOfSight;
use super::resight::{Resighting, agreed_pose};
use super::target::{Target, targets};
use super::{AssociationParams, FeatureRef, Landmark, Scene, SceneFeature};
use crate::geometry::pose::Pose;
use crate::metric_map::features::Descriptor;
use crate::metric_map::matching::{FeatureGrid, MatchLimits, squared_distance};
use crate::metric_map::visibility::{Reaches, Visibility};

/// A feature nearer than this to the best one, pixels, is no rival: key points of several scales lie on one corner.
const SAME_PLACE_PX: f64 = 2.0;

/// A feature that looks like a landmark, where the landmark should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Hit {
    /// Index of the landmark.
    pub landmark: u32,
    /// The feature.
    pub feature: FeatureRef,
    /// Bits in which they differ.
    pub bits: u32,
}

/// A landmark that an image may show.
#[derive(Clone, Copy)]
struct Candidate {
    image: u32,
    landmark: u32,
    /// Where the image shows it.
    pixel: [f64; 2],
    /// No feature was in the circle around it when it was sought.
    alone: bool,
}

/// An image that landmarks are sought in.
struct Image<'a> {
    grid: FeatureGrid,
    features: &'a [SceneFeature],
    /// Of the features.
    descriptors: Cow<'a, [Descriptor]>,
}

/// Prepared for searching any keyframe.
pub(super) struct Search<'a, E> {
    scene: &'a Scene,
    described: &'a dyn DescriptorSource<E>,
    poses: &'a [Pose],
    params: &'a AssociationParams,
    targets: Vec<Target>,
    /// By landmark.
    visibilities: Vec<Visibility>,
    reaches: Reaches,
    /// By image: the landmarks that are known there, ascending.
    known: Vec<Vec<u32>>,
}

impl<'a, E: Send> Search<'a, E> {
    pub(super) fn new(
        scene: &'a Scene,
        described: &'a dyn DescriptorSource<E>,
        poses: &'a [Pose],
        landmarks: &'a [Landmark],
        params: &'a AssociationParams,
    ) -> Result<Self, E> {
        let cameras = scene.map_from_cameras(poses);
        let (targets, visibilities) = targets(scene, described, &cameras, landmarks, params)?;
        let reaches = Reaches::new((0..).zip(&visibilities), &scene.cameras);
        let mut known = vec![Vec::new(); scene.images.len()];
        for (landmark, at) in landmarks.iter().zip(0..) {
            for feature in &landmark.features {
                known[feature.image as usize].push(at);
            }
        }
        Ok(Self {
            scene,
            described,
            poses,
            params,
            targets,
            visibilities,
            reaches,
            known,
        })
    }

    /// Hits of all keyframes, in the keyframes' order.
    pub(super) fn hits(&self) -> Result<Vec<Hit>, E> {
        let keyframes = 0..self.scene.keyframes.len() as u32;
        let found: Vec<Vec<Hit>> = keyframes
            .into_par_iter()
            .map_init(
                || vec![u32::MAX; self.targets.len()],
                |marks, keyframe| self.keyframe(keyframe, marks),
            )
            .collect::<Result<_, E>>()?;
        Ok(found.into_iter().flatten().collect())
    }

    /// Hits of a keyframe that agree with each other. `marks` is scratch: by landmark, the last keyframe of a thread that
    /// has it in its visit.
    fn keyframe(&self, keyframe: u32, marks: &mut [u32]) -> Result<Vec<Hit>, E> {
        for landmark in self.of_visit(keyframe) {
            marks[*landmark as usize] = keyframe;
        }
        let candidates = self.candidates(keyframe);
        if candidates.is_empty() {
            return Ok(Vec::new());
        }
        let images = self.scene.keyframes[keyframe as usize].images.clone();
        let images = images.map(|image| self.image(image));
        let images: Vec<Image<'_>> = images.collect::<Result<_, E>>()?;
        let (own, others): (Vec<Candidate>, Vec<Candidate>) = candidates
            .into_iter()
            .partition(|candidate| marks[candidate.landmark as usize] == keyframe);
        let own = self.agreeing(keyframe, &images, own, 0);
        let others = self.agreeing(keyframe, &images, others, self.params.min_agreeing);
        let mut hits: Vec<Hit> = own.into_iter().chain(others).flatten().collect();
        hits.sort_unstable();
        Ok(hits)
    }

    /// Seeks landmarks, finds the motion that the hits agree on, and seeks again from there; nothing where fewer than
    /// `least` agree.
    fn agreeing(
        &self,
        keyframe: u32,
        images: &[Image<'_>],
        mut candidates: Vec<Candidate>,
        least: usize,
    ) -> Option<Vec<Hit>> {
        let AssociationParams {
            radius_px,
            agree_px,
            ..
        } = *self.params;
        let first = self.scene.keyframes[keyframe as usize].images.start;
        let pose = &self.poses[keyframe as usize];
        let agreed = |hits: &[Hit], pose: &Pose, from_px: f64| {
            let seen: Vec<Resighting> = hits.iter().map(|hit| self.resighting(hit)).collect();
            (hits.len() >= least).then(|| agreed_pose(&seen, pose, from_px, agree_px / 2.0))
        };
        let cameras = self.cameras(keyframe, pose);
        let hits = self.seek(&cameras, first, images, &mut candidates, radius_px);
        let pose = agreed(&hits, pose, radius_px)?;
        let cameras = self.cameras(keyframe, &pose);
        let smaller_px = radius_px.min(agree_px);
        let inside_px = radius_px - smaller_px;
        candidates.retain_mut(|candidate| {
            let camera = &cameras[(candidate.image - first) as usize];
            let Some(pixel) = self.pixel(candidate.landmark, candidate.image, camera) else {
                return false;
            };
            // The smaller circle lies within the one that nothing was in.
            let inside = squared_distance(candidate.pixel, pixel) < inside_px * inside_px;
            candidate.pixel = pixel;
            !(candidate.alone && inside)
        });
        let mut hits = self.seek(&cameras, first, images, &mut candidates, smaller_px);
        let vehicle_from_map = agreed(&hits, &pose, agree_px)?.inverse();
        hits.retain(|hit| {
            let off_px = self.resighting(hit).residual_px(&vehicle_from_map);
            off_px.is_some_and(|off_px| off_px <= agree_px)
        });
        (hits.len() >= least).then_some(hits)
    }

    /// The cameras of a keyframe that stands there.
    fn cameras(&self, keyframe: u32, map_from_vehicle: &Pose) -> Vec<Pose> {
        let images = self.scene.keyframes[keyframe as usize].images.clone();
        let mounts = images.map(|image| &self.scene.camera(image).vehicle_from_camera);
        mounts
            .map(|mount| map_from_vehicle.compose(mount))
            .collect()
    }

    fn resighting(&self, hit: &Hit) -> Resighting {
        let image = hit.feature.image;
        let ray = self.scene.feature(hit.feature).ray().unwrap_or_default();
        Resighting {
            line: LineOfSight::new(&self.scene.camera(image).vehicle_from_camera, &ray),
            point: self.targets[hit.landmark as usize].point,
            px_per_rad: self.scene.px_per_rad(image),
        }
    }

    fn image(&self, image: u32) -> Result<Image<'a>, E> {
        let features = &self.scene.images[image as usize].features;
        let nowhere = [f64::NAN, f64::NAN];
        let pixel = |feature: &SceneFeature| feature.ray().map_or(nowhere, |_| feature.pixel());
        Ok(Image {
            grid: FeatureGrid::new(features.iter().map(pixel)),
            features,
            descriptors: self.described.descriptors(image)?,
        })
    }

    /// The landmarks that keyframes shortly before or after saw, and this one.
    fn of_visit(&self, keyframe: u32) -> impl Iterator<Item = &u32> {
        let keyframes = &self.scene.keyframes;
        let away = self.params.visit_keyframes;
        let end = keyframe.saturating_add(away).saturating_add(1) as usize;
        let around = &keyframes[keyframe.saturating_sub(away) as usize..end.min(keyframes.len())];
        let session = keyframes[keyframe as usize].session;
        let visit = around.iter().filter(move |other| other.session == session);
        let images = visit.flat_map(|other| other.images.clone());
        images.flat_map(|image| &self.known[image as usize])
    }

    /// Landmarks that an image may show and that are not known there, by image.
    fn candidates(&self, keyframe: u32) -> Vec<Candidate> {
        let pose = &self.poses[keyframe as usize];
        let around = self.reaches.around(&pose.translation);
        let images = self.scene.keyframes[keyframe as usize].images.clone();
        let mut candidates = Vec::new();
        for (image, camera) in images.zip(self.cameras(keyframe, pose)) {
            let mut known = self.known[image as usize].iter().peekable();
            let unknown = around.iter().filter(|landmark| {
                while known.next_if(|known| known < landmark).is_some() {}
                known.peek() != Some(landmark)
            });
            let visible = unknown.filter(|landmark| {
                self.visibilities[**landmark as usize].from(&camera.translation)
            });
            candidates.extend(visible.filter_map(|landmark| {
                Some(Candidate {
                    image,
                    landmark: *landmark,
                    pixel: self.pixel(*landmark, image, &camera)?,
                    alone: false,
                })
            }));
        }
        candidates
    }

    /// Where an image shows a landmark.
    fn pixel(&self, landmark: u32, image: u32, map_from_camera: &Pose) -> Option<[f64; 2]> {
        let ahead = self.targets[landmark as usize].point - map_from_camera.translation;
        let lens = &self.scene.camera(image).camera;
        let pixel = lens.project(&map_from_camera.rotation.inverse_transform_vector(&ahead))?;
        lens.contains(pixel).then_some(pixel)
    }

    /// The unrivalled feature of each candidate, in a keyframe's images, of which `first` is the first.
    fn seek(
        &self,
        cameras: &[Pose],
        first: u32,
        images: &[Image<'_>],
        candidates: &mut [Candidate],
        radius_px: f64,
    ) -> Vec<Hit> {
        let look = |candidate: &mut Candidate| {
            let at = (candidate.image - first) as usize;
            self.look_for(candidate, &cameras[at].translation, &images[at], radius_px)
        };
        candidates.iter_mut().filter_map(look).collect()
    }

    fn look_for(
        &self,
        candidate: &mut Candidate,
        camera: &Vector3<f64>,
        shown: &Image<'_>,
        radius_px: f64,
    ) -> Option<Hit> {
        let Candidate {
            image,
            landmark,
            pixel,
            ..
        } = *candidate;
        let mut within = shown.grid.near(pixel, radius_px).peekable();
        candidate.alone = within.peek().is_none();
        if candidate.alone {
            return None;
        }
        let target = &self.targets[landmark as usize];
        let away = camera - target.point;
        let range_m = away.norm();
        let size_px = target.size_px_m / range_m;
        let fits = |at: &u32| {
            let ratio = shown.features[*at as usize].size_px() / size_px;
            (1.0 / self.params.scale_factor..=self.params.scale_factor).contains(&ratio)
        };
        let near: Vec<u32> = within.filter(fits).collect();
        if near.is_empty() {
            return None;
        }
        let looks = target.nearest_appearances(&(away / range_m), range_m);
        let (feature, bits) = unrivalled(looks, shown, &near, &self.params.limits)?;
        Some(Hit {
            landmark,
            feature: FeatureRef { image, feature },
            bits,
        })
    }
}

/// The feature that looks most like one of the descriptors, if it is alike enough and no other one is nearly as much; and in
/// how many bits it differs.
fn unrivalled(
    looks: [Option<&Descriptor>; 2],
    image: &Image<'_>,
    near: &[u32],
    limits: &MatchLimits,
) -> Option<(u32, u32)> {
    let bits = |at: &u32| {
        let looks = looks.iter().flatten();
        let bits = looks.map(|look| look.distance(&image.descriptors[*at as usize]));
        (bits.min().unwrap_or(u32::MAX), *at)
    };
    let near: Vec<(u32, u32)> = near.iter().map(bits).collect();
    let (bits, best) = *near.iter().min()?;
    let at = image.features[best as usize].pixel();
    let elsewhere = |other: u32| {
        squared_distance(image.features[other as usize].pixel(), at) > SAME_PLACE_PX * SAME_PLACE_PX
    };
    let rivals = near.iter().filter(|(_, other)| elsewhere(*other));
    let rival = rivals.map(|(bits, _)| *bits).min();
    limits.accept(bits, rival).then_some((best, bits))
}
