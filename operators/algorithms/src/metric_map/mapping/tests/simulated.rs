//! A vehicle with four fisheyes that drives two loops in a hall, for tests: truth is known for everything.

use std::borrow::Cow;
use std::convert::Infallible;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::geometry::camera::{Camera, KannalaBrandt, Model};
use crate::geometry::pose::Pose;
use crate::geometry::rig::{Rig, RigCamera};
use crate::metric_map::association::{DescriptorSource, FeatureRef, Scene};
use crate::metric_map::features::{
    DESCRIPTOR_BYTES, Descriptor, Feature, ImageFeatures, KeyframeFeatures,
};
use crate::solving::random::SplitMix64;

/// Numbers that look random.
pub(crate) struct Chance(SplitMix64);

impl Chance {
    pub(crate) fn new(seed: u64) -> Self {
        Self(SplitMix64(seed))
    }

    fn next(&mut self) -> u64 {
        self.0.next()
    }

    /// In [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0.unit()
    }

    /// Of a normal distribution (sum of twelve).
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    pub(crate) fn below(&mut self, most: usize) -> usize {
        (self.next() % most.max(1) as u64) as usize
    }
}

/// What to simulate.
pub(crate) struct Hall {
    pub(crate) points: usize,
    pub(crate) keyframes: usize,
    pub(crate) loops: f64,
    pub(crate) noise_px: f64,
    /// Part of the tracks' members that are wrong.
    pub(crate) wrong: f64,
    pub(crate) odometry_scale: f64,
    pub(crate) yaw_bias_rad_per_m: f64,
    pub(crate) seed: u64,
    /// Seed of the hall itself: the same for revisits.
    pub(crate) hall: u64,
    /// A camera that sees nothing.
    pub(crate) dark: Option<usize>,
}

impl Default for Hall {
    fn default() -> Self {
        Self {
            points: 3000,
            keyframes: 120,
            loops: 2.0,
            noise_px: 0.5,
            wrong: 0.03,
            odometry_scale: 1.01,
            yaw_bias_rad_per_m: 0.002,
            seed: 7,
            hall: 1,
            dark: None,
        }
    }
}

/// One simulated session.
pub(crate) struct Simulated {
    pub(crate) rig: Rig,
    pub(crate) truth: Vec<Pose>,
    pub(crate) odometry: Vec<Pose>,
    pub(crate) features: Vec<KeyframeFeatures>,
    /// The point that each feature shows: by keyframe, camera, feature.
    pub(crate) shown: Vec<Vec<Vec<usize>>>,
    /// Camera, then keyframe and feature of each member.
    pub(crate) tracks: Vec<(usize, Vec<(usize, usize)>)>,
}

struct Mark {
    at: Vector3<f64>,
    out: Vector3<f64>,
    descriptor: Descriptor,
    size_m: f64,
}

const SIZE: [f64; 3] = [26.0, 16.0, 3.0];

fn marks(hall: &Hall) -> Vec<Mark> {
    let mut chance = Chance::new(hall.hall);
    (0..hall.points)
        .map(|_| {
            let mut at = Vector3::from_fn(|axis, _| SIZE[axis] * chance.uniform());
            let (axis, far) = ([2, 2, 0, 1, 0, 1][chance.below(6)], chance.below(2));
            at[axis] = SIZE[axis] * far as f64;
            let mut out = Vector3::zeros();
            out[axis] = if far == 1 { -1.0 } else { 1.0 };
            let mut bytes = [0; DESCRIPTOR_BYTES];
            bytes.fill_with(|| chance.next() as u8);
            Mark {
                at,
                out,
                descriptor: Descriptor(bytes),
                size_m: 0.1 + 0.2 * chance.uniform(),
            }
        })
        .collect()
}

pub(crate) fn rig() -> Rig {
    let lens = KannalaBrandt::new([127.0; 2], [199.5, 149.5], [0.0; 4]);
    let looking = |yaw: f64| {
        let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let down = UnitQuaternion::from_euler_angles(0.0, 0.3, yaw);
        down * UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
    };
    let quarter = std::f64::consts::FRAC_PI_2;
    let mounts = [
        ("front", [3.5, 0.0, 0.7], 0.0),
        ("left", [1.9, 0.95, 1.0], quarter),
        ("rear", [-0.9, 0.0, 0.9], 2.0 * quarter),
        ("right", [1.9, -0.95, 1.0], -quarter),
    ];
    let camera = |(name, at, yaw): (&str, [f64; 3], f64)| RigCamera {
        name: name.to_owned(),
        camera: Camera::new(Model::KannalaBrandt(lens), 400, 300).with_max_angle(1.6),
        vehicle_from_camera: Pose::new(Vector3::from(at), looking(yaw)),
    };
    Rig {
        cameras: mounts.into_iter().map(camera).collect(),
    }
}

/// On an ellipse with a wobble, floor that tilts.
fn truth(hall: &Hall, chance: &mut Chance) -> Vec<Pose> {
    let offset = 0.4 * (chance.uniform() - 0.5);
    (0..hall.keyframes)
        .map(|at| {
            let turn = hall.loops * std::f64::consts::TAU * at as f64 / hall.keyframes as f64;
            let (a, b) = (8.5 + offset, 4.0 + offset);
            let (x, y) = (13.0 + a * turn.cos(), 8.0 + b * turn.sin());
            let yaw = (b * turn.cos()).atan2(-a * turn.sin());
            let tilt = 0.01 * chance.normal();
            Pose::new(
                Vector3::new(x, y, 0.1 * (turn * 1.5).sin()),
                UnitQuaternion::from_euler_angles(tilt, 0.015 * (turn * 2.0).cos(), yaw),
            )
        })
        .collect()
}

fn odometry(hall: &Hall, truth: &[Pose], chance: &mut Chance) -> Vec<Pose> {
    let mut poses = vec![Pose::identity()];
    for pair in truth.windows(2) {
        let step = pair[0].inverse().compose(&pair[1]);
        let length = step.translation.norm();
        let yaw = step.yaw() + hall.yaw_bias_rad_per_m * length + 0.0005 * chance.normal();
        let (x, y) = (step.translation.x, step.translation.y);
        let noise = 0.002 * chance.normal();
        let drifting = Pose::from_yaw(
            hall.odometry_scale * x + noise,
            hall.odometry_scale * y,
            yaw,
        );
        let last = poses[poses.len() - 1];
        poses.push(last.compose(&drifting));
    }
    poses
}

/// What a camera sees: features in the marks' order, and the marks.
fn image(
    hall: &Hall,
    marks: &[Mark],
    camera: &RigCamera,
    pose: &Pose,
    chance: &mut Chance,
) -> (ImageFeatures, Vec<usize>) {
    let map_from_camera = pose.compose(&camera.vehicle_from_camera);
    let camera_from_map = map_from_camera.inverse();
    let (mut features, mut shown) = (Vec::new(), Vec::new());
    for (at, mark) in marks.iter().enumerate() {
        let away = map_from_camera.translation - mark.at;
        let range = away.norm();
        let facing = away.dot(&mark.out) / range;
        let pixel = camera.camera.project(&camera_from_map.transform(&mark.at));
        let Some([u, v]) = pixel.filter(|pixel| camera.camera.contains(*pixel)) else {
            continue;
        };
        if facing < 0.2 || range > 9.0 || chance.uniform() < 0.3 {
            continue;
        }
        let mut descriptor = mark.descriptor;
        for _ in 0..20 + chance.below(30) {
            let bit = chance.below(512);
            descriptor.0[bit / 8] ^= 1 << (bit % 8);
        }
        let mut noisy = |x: f64| x + hall.noise_px * chance.normal();
        features.push(Feature {
            pixel: [noisy(u), noisy(v)],
            size_px: 127.0 * mark.size_m / range,
            descriptor,
        });
        shown.push(at);
    }
    (ImageFeatures { features }, shown)
}

/// Follows marks through each camera's keyframes, sometimes onto a wrong feature.
fn tracks(
    hall: &Hall,
    shown: &[Vec<Vec<usize>>],
    chance: &mut Chance,
) -> Vec<(usize, Vec<(usize, usize)>)> {
    let mut tracks = Vec::new();
    for camera in 0..4 {
        let mut open: std::collections::BTreeMap<usize, Vec<(usize, usize)>> = Default::default();
        for (keyframe, images) in shown.iter().enumerate() {
            let mut next = std::collections::BTreeMap::new();
            for (feature, mark) in images[camera].iter().enumerate() {
                let wrong = chance.uniform() < hall.wrong;
                let mark = if wrong {
                    images[camera][chance.below(images[camera].len())]
                } else {
                    *mark
                };
                if next.contains_key(&mark) {
                    continue;
                }
                let mut members = open.remove(&mark).unwrap_or_default();
                members.push((keyframe, feature));
                next.insert(mark, members);
            }
            tracks.extend(open.into_values().map(|members| (camera, members)));
            open = next;
        }
        tracks.extend(open.into_values().map(|members| (camera, members)));
    }
    tracks.retain(|(_, members)| members.len() > 1);
    tracks
}

pub(crate) fn simulate(hall: &Hall) -> Simulated {
    let marks = marks(hall);
    let mut chance = Chance::new(hall.seed);
    let truth = truth(hall, &mut chance);
    let odometry = odometry(hall, &truth, &mut chance);
    let rig = rig();
    let (mut features, mut shown) = (Vec::new(), Vec::new());
    for pose in &truth {
        let mut seen = Vec::new();
        let mut images = Vec::new();
        for (at, camera) in rig.cameras.iter().enumerate() {
            let (image, marks) = if hall.dark == Some(at) {
                Default::default()
            } else {
                image(hall, &marks, camera, pose, &mut chance)
            };
            images.push(image);
            seen.push(marks);
        }
        features.push(KeyframeFeatures { images });
        shown.push(seen);
    }
    let tracks = tracks(hall, &shown, &mut chance);
    Simulated {
        rig,
        truth,
        odometry,
        features,
        shown,
        tracks,
    }
}

impl Simulated {
    /// Adds itself to a scene; gives its tracks as features of the scene, and the mark of each feature of an image.
    pub(crate) fn add_to(&self, scene: &mut Scene) -> Vec<Vec<FeatureRef>> {
        let first = scene.images.len();
        let keyframes = self
            .odometry
            .iter()
            .copied()
            .zip(self.features.iter().cloned())
            .map(Ok::<_, Infallible>);
        scene.add_session(&self.rig, keyframes).unwrap();
        let of = |camera: usize, (keyframe, feature): (usize, usize)| FeatureRef {
            image: (first + keyframe * 4 + camera) as u32,
            feature: feature as u32,
        };
        self.tracks
            .iter()
            .map(|(camera, members)| members.iter().map(|member| of(*camera, *member)).collect())
            .collect()
    }

    /// Truth with a smooth error, as pose-graph relaxation leaves it.
    pub(crate) fn guess(&self, off_m: f64, off_rad: f64) -> Vec<Pose> {
        let first = self.truth[0].inverse();
        let moved = self.truth.iter().enumerate().map(|(at, pose)| {
            let phase = at as f64 * 0.06;
            let off = Pose::new(
                Vector3::new(phase.sin(), (1.3 * phase).sin(), 0.3 * (0.7 * phase).sin()) * off_m,
                UnitQuaternion::from_scaled_axis(
                    Vector3::new(0.2, 0.2, 1.0) * (off_rad * phase.sin()),
                ),
            );
            first.compose(pose).compose(&off)
        });
        moved.collect()
    }
}

/// What sessions look like, in the order in which they are in a scene; but for one image, which is out of reach.
pub(crate) struct Album<'a> {
    pub(crate) sessions: Vec<&'a Simulated>,
    pub(crate) missing: Option<u32>,
}

impl DescriptorSource<String> for Album<'_> {
    fn descriptors(&self, image: u32) -> Result<Cow<'_, [Descriptor]>, String> {
        if self.missing == Some(image) {
            return Err(format!("no descriptors of {image}"));
        }
        let keyframes = self.sessions.iter().flat_map(|session| &session.features);
        let mut images = keyframes.flat_map(|keyframe| &keyframe.images);
        let image = images.nth(image as usize).unwrap();
        let looks = image.features.iter().map(|feature| feature.descriptor);
        Ok(Cow::Owned(looks.collect()))
    }
}
