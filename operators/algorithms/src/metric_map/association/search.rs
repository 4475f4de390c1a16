//! Landmarks sought in the images that may show them.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::point::LineOfSight;
use super::resight::{Resighting, agreed_pose};
use super::{
    Appearance, AssociationParams, FeatureRef, Landmark, Scene, appearances, mean_direction,
    sightings,
};
use crate::geometry::pose::Pose;
use crate::metric_map::matching::{FeatureGrid, squared_distance};
use crate::metric_map::visibility::{Reaches, Seen, Visibility};

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

/// What the search needs to know of a landmark.
struct Target {
    point: Vector3<f64>,
    appearances: Vec<Appearance>,
    /// Logarithms of the appearances' ranges to the base 2.
    octaves: Vec<f64>,
    visibility: Visibility,
    /// Feature size times range, median: the landmark's own size, pixel metres.
    size_px_m: f64,
}

/// An image and a landmark that it may show.
type Candidate = (u32, u32);

/// Prepared for searching any keyframe.
pub(super) struct Search<'a> {
    scene: &'a Scene,
    poses: &'a [Pose],
    params: &'a AssociationParams,
    landmarks: &'a [Landmark],
    targets: Vec<Target>,
    reaches: Reaches,
    /// By image: the landmarks that are known there, ascending.
    known: Vec<Vec<u32>>,
}

impl<'a> Search<'a> {
    pub(super) fn new(
        scene: &'a Scene,
        poses: &'a [Pose],
        landmarks: &'a [Landmark],
        params: &'a AssociationParams,
    ) -> Self {
        let cameras = scene.map_from_cameras(poses);
        let targets: Vec<Target> = landmarks
            .par_iter()
            .map(|landmark| target(scene, &cameras, landmark, params))
            .collect();
        let visibilities = targets.iter().map(|target| &target.visibility);
        let reaches = Reaches::new((0..).zip(visibilities), &scene.cameras);
        let mut known = vec![Vec::new(); scene.images.len()];
        for (landmark, at) in landmarks.iter().zip(0..) {
            for feature in &landmark.features {
                known[feature.image as usize].push(at);
            }
        }
        Self {
            scene,
            poses,
            params,
            landmarks,
            reaches,
            targets,
            known,
        }
    }

    /// Hits of all keyframes, in the keyframes' order.
    pub(super) fn hits(&self) -> Vec<Hit> {
        let keyframes = 0..self.scene.keyframes.len() as u32;
        let found: Vec<Vec<Hit>> = keyframes
            .into_par_iter()
            .map(|keyframe| self.keyframe(keyframe))
            .collect();
        found.into_iter().flatten().collect()
    }

    /// Hits of a keyframe that agree with each other.
    fn keyframe(&self, keyframe: u32) -> Vec<Hit> {
        let images = self.scene.keyframes[keyframe as usize].images.clone();
        let grids: Vec<FeatureGrid> = images.map(|image| self.grid(image)).collect();
        let around = self
            .reaches
            .around(&self.poses[keyframe as usize].translation);
        let candidates = self.candidates(keyframe, &around);
        let (own, others): (Vec<Candidate>, Vec<Candidate>) = candidates
            .into_iter()
            .partition(|(_, landmark)| self.same_visit(*landmark, keyframe));
        let mut hits = self.agreeing(keyframe, &grids, &own, 0);
        hits.extend(self.agreeing(keyframe, &grids, &others, self.params.min_agreeing));
        hits.sort_unstable();
        hits
    }

    /// Seeks landmarks, finds the motion that the hits agree on, and seeks again from there.
    fn agreeing(
        &self,
        keyframe: u32,
        grids: &[FeatureGrid],
        candidates: &[Candidate],
        least: usize,
    ) -> Vec<Hit> {
        let AssociationParams {
            radius_px,
            agree_px,
            ..
        } = *self.params;
        let mut pose = self.poses[keyframe as usize];
        let mut hits = Vec::new();
        for (radius, from_px) in [(radius_px, radius_px), (radius_px.min(agree_px), agree_px)] {
            hits = self.seek(keyframe, &pose, grids, candidates, radius);
            if hits.len() < least {
                return Vec::new();
            }
            let seen: Vec<Resighting> = hits.iter().map(|hit| self.resighting(hit)).collect();
            pose = agreed_pose(&seen, &pose, from_px, agree_px / 2.0);
        }
        let vehicle_from_map = pose.inverse();
        hits.retain(|hit| {
            let off_px = self.resighting(hit).residual_px(&vehicle_from_map);
            off_px.is_some_and(|off_px| off_px <= agree_px)
        });
        if hits.len() < least {
            hits.clear();
        }
        hits
    }

    fn resighting(&self, hit: &Hit) -> Resighting {
        let image = hit.feature.image;
        let ray = self.scene.feature(hit.feature).ray.unwrap_or_default();
        Resighting {
            line: LineOfSight::new(&self.scene.camera(image).vehicle_from_camera, &ray),
            point: self.targets[hit.landmark as usize].point,
            px_per_rad: self.scene.px_per_rad(image),
        }
    }

    fn grid(&self, image: u32) -> FeatureGrid {
        let features = self.scene.images[image as usize].features.iter();
        let nowhere = [f64::NAN, f64::NAN];
        FeatureGrid::new(features.map(|feature| feature.ray.map_or(nowhere, |_| feature.pixel)))
    }

    /// Whether a keyframe shortly before or after saw it. Features are sorted by image, and so by keyframe.
    fn same_visit(&self, landmark: u32, keyframe: u32) -> bool {
        let keyframes = &self.scene.keyframes;
        let of = |feature: &FeatureRef| self.scene.images[feature.image as usize].keyframe;
        let first = keyframe.saturating_sub(self.params.visit_keyframes);
        let last = keyframe.saturating_add(self.params.visit_keyframes);
        let features = &self.landmarks[landmark as usize].features;
        let from = features.partition_point(|feature| of(feature) < first);
        let mut around = features[from..].iter().map(of).take_while(|at| *at <= last);
        around.any(|at| keyframes[at as usize].session == keyframes[keyframe as usize].session)
    }

    /// Landmarks that an image may show and that are not known there, by image.
    fn candidates(&self, keyframe: u32, landmarks: &[u32]) -> Vec<Candidate> {
        let images = self.scene.keyframes[keyframe as usize].images.clone();
        let mut candidates = Vec::new();
        for image in images {
            let camera = self.scene.map_from_camera(self.poses, image);
            let mut known = self.known[image as usize].iter().peekable();
            let visible = landmarks.iter().filter(|landmark| {
                while known.next_if(|known| known < landmark).is_some() {}
                known.peek() != Some(landmark)
                    && self.targets[**landmark as usize]
                        .visibility
                        .from(&camera.translation)
                    && self.pixel(**landmark, image, &camera).is_some()
            });
            candidates.extend(visible.map(|landmark| (image, *landmark)));
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

    /// The unrivalled feature of each candidate, in the images of a keyframe that stands at `pose`.
    fn seek(
        &self,
        keyframe: u32,
        pose: &Pose,
        grids: &[FeatureGrid],
        candidates: &[Candidate],
        radius_px: f64,
    ) -> Vec<Hit> {
        let first = self.scene.keyframes[keyframe as usize].images.start;
        let cameras = self.scene.keyframes[keyframe as usize].images.clone();
        let cameras: Vec<Pose> = cameras
            .map(|image| pose.compose(&self.scene.camera(image).vehicle_from_camera))
            .collect();
        let look = |(image, landmark): &Candidate| {
            let at = (image - first) as usize;
            self.look_for(*landmark, *image, &cameras[at], &grids[at], radius_px)
        };
        candidates.iter().filter_map(look).collect()
    }

    fn look_for(
        &self,
        landmark: u32,
        image: u32,
        map_from_camera: &Pose,
        grid: &FeatureGrid,
        radius_px: f64,
    ) -> Option<Hit> {
        let target = &self.targets[landmark as usize];
        let away = map_from_camera.translation - target.point;
        let range = away.norm();
        let sought = Sought {
            pixel: self.pixel(landmark, image, map_from_camera)?,
            radius_px,
            appearances: target.nearest_appearances(&(away / range), range),
            size_px: target.size_px_m / range,
        };
        let features = &self.scene.images[image as usize].features;
        let (feature, bits) = sought.unrivalled(features, grid, self.params)?;
        let feature = FeatureRef { image, feature };
        Some(Hit {
            landmark,
            feature,
            bits,
        })
    }
}

impl Target {
    /// The two appearances from the most similar places: by direction first, a range twice as far counting like a radian.
    fn nearest_appearances(
        &self,
        direction: &Vector3<f64>,
        range_m: f64,
    ) -> [Option<&Appearance>; 2] {
        let octave_here = range_m.log2();
        let mut nearest: [Option<(f64, &Appearance)>; 2] = [None, None];
        for (appearance, octave) in self.appearances.iter().zip(&self.octaves) {
            let across = (appearance.direction - direction).norm();
            let apart = across + (octave - octave_here).abs();
            if nearest[0].is_none_or(|(best, _)| apart < best) {
                nearest = [Some((apart, appearance)), nearest[0]];
            } else if nearest[1].is_none_or(|(best, _)| apart < best) {
                nearest[1] = Some((apart, appearance));
            }
        }
        nearest.map(|found| found.map(|(_, appearance)| appearance))
    }
}

/// A landmark as it should appear in an image.
struct Sought<'a> {
    pixel: [f64; 2],
    radius_px: f64,
    /// Appearances from about here.
    appearances: [Option<&'a Appearance>; 2],
    size_px: f64,
}

impl Sought<'_> {
    fn bits(&self, feature: &super::SceneFeature) -> u32 {
        let appearances = self.appearances.iter().flatten();
        appearances
            .map(|look| look.descriptor.distance(&feature.descriptor))
            .min()
            .unwrap_or(u32::MAX)
    }

    /// The feature most alike, if it is alike enough and no other one is nearly as much.
    fn unrivalled(
        &self,
        features: &[super::SceneFeature],
        grid: &FeatureGrid,
        params: &AssociationParams,
    ) -> Option<(u32, u32)> {
        let fits = |at: &u32| {
            let feature = &features[*at as usize];
            let ratio = feature.size_px / self.size_px;
            (1.0 / params.scale_factor..=params.scale_factor).contains(&ratio)
        };
        let near: Vec<(u32, u32)> = grid
            .near(self.pixel, self.radius_px)
            .filter(fits)
            .map(|at| (self.bits(&features[at as usize]), at))
            .collect();
        let (bits, best) = *near.iter().min()?;
        let at = features[best as usize].pixel;
        let rival = near
            .iter()
            .filter(|(_, other)| {
                squared_distance(features[*other as usize].pixel, at) > SAME_PLACE_PX.powi(2)
            })
            .map(|(bits, _)| *bits)
            .min();
        params.limits.accept(bits, rival).then_some((best, bits))
    }
}

fn target(
    scene: &Scene,
    cameras: &[Pose],
    landmark: &Landmark,
    params: &AssociationParams,
) -> Target {
    let sightings = sightings(scene, cameras, &landmark.point, &landmark.features);
    let features = landmark.features.iter().zip(&sightings);
    let sizes = features.map(|(feature, look)| scene.feature(*feature).size_px * look.range_m);
    let mut sizes: Vec<f64> = sizes.collect();
    sizes.sort_by(f64::total_cmp);
    let view = mean_direction(&sightings);
    let cosines = sightings.iter().map(|seen| seen.direction.dot(&view));
    let ranges = || sightings.iter().map(|seen| seen.range_m);
    let seen = Seen {
        view,
        view_cos: cosines.fold(1.0, f64::min),
        ranges_m: [
            ranges().fold(f64::INFINITY, f64::min),
            ranges().fold(0.0, f64::max),
        ],
    };
    let appearances = appearances(&sightings);
    let octaves = appearances.iter().map(|seen| seen.range_m.log2());
    Target {
        point: landmark.point,
        octaves: octaves.collect(),
        appearances,
        visibility: Visibility::new(
            landmark.point,
            &seen,
            params.view_margin_rad,
            params.scale_factor,
        ),
        size_px_m: sizes.get(sizes.len() / 2).copied().unwrap_or(0.0),
    }
}
