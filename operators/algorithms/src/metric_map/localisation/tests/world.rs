//! A rig with four fisheyes in a room whose surfaces are covered with points.

use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::geometry::rig::{Rig, RigCamera};
use crate::metric_map::features::{
    DESCRIPTOR_BYTES, Descriptor, Feature, ImageFeatures, KeyframeFeatures,
};
use crate::metric_map::localisation::{DriveKeyframe, LandmarkMap, MapLandmark};
use crate::solving::random::SplitMix64;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Any descriptor.
fn drawn_descriptor(random: &mut SplitMix64) -> Descriptor {
    let mut bytes = [0; DESCRIPTOR_BYTES];
    bytes.fill_with(|| random.next() as u8);
    Descriptor(bytes)
}

/// A descriptor with each bit turned with a probability.
fn turned(random: &mut SplitMix64, descriptor: &Descriptor, probability: f64) -> Descriptor {
    let mut turned = *descriptor;
    for byte in &mut turned.0 {
        for bit in 0..8 {
            if random.unit() < probability {
                *byte ^= 1 << bit;
            }
        }
    }
    turned
}

/// Four cameras as on the paper's car: 127 px/rad, 400 × 300, front, left, rear, right.
pub(in crate::metric_map::localisation) fn rig() -> Rig {
    let mounts = [
        ("front", 0.0, [3.6, 0.0]),
        ("left", 90.0, [2.0, 0.9]),
        ("rear", 180.0, [-0.6, 0.0]),
        ("right", -90.0, [2.0, -0.9]),
    ];
    let mut cameras: Vec<RigCamera> = mounts
        .into_iter()
        .map(|(name, yaw, [x, y]): (_, f64, [f64; 2])| {
            // Optical axes: z forward, x right, y down; tilted 20° towards the ground.
            let level = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
            let tilt = Rotation3::from_axis_angle(&Vector3::y_axis(), 20f64.to_radians());
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw.to_radians());
            let rotation = turn * tilt * Rotation3::from_matrix_unchecked(level);
            let k = [127.0, 0.0, 199.5, 0.0, 127.0, 149.5, 0.0, 0.0, 1.0];
            let camera = Camera::from_calibration("equidistant", 400, 300, &k, &[]).unwrap();
            RigCamera {
                name: name.to_owned(),
                camera: camera.with_max_angle(1.6),
                vehicle_from_camera: Pose::new(
                    Vector3::new(x, y, 0.9),
                    UnitQuaternion::from_rotation_matrix(&rotation),
                ),
            }
        })
        .collect();
    cameras.sort_by(|a, b| a.name.cmp(&b.name));
    Rig { cameras }
}

/// A point on a surface.
#[derive(Clone)]
pub(super) struct Point {
    pub(super) position: Vector3<f64>,
    pub(super) normal: Vector3<f64>,
    pub(super) descriptor: Descriptor,
}

#[derive(Clone)]
pub(super) struct World {
    pub(super) points: Vec<Point>,
    pub(super) rig: Rig,
}

/// How images differ from perfect ones.
#[derive(Clone, Copy)]
pub(super) struct Imaging {
    pub(super) noise_px: f64,
    /// Share of visible points that are detected.
    pub(super) detected: f64,
    /// Probability that a descriptor's bit turns.
    pub(super) turned: f64,
    /// Features per image that show nothing of the map.
    pub(super) clutter: usize,
    /// Camera that sees nothing.
    pub(super) dark: Option<usize>,
}

impl Default for Imaging {
    fn default() -> Self {
        Self {
            noise_px: 0.5,
            detected: 0.5,
            turned: 0.06,
            clutter: 60,
            dark: None,
        }
    }
}

impl World {
    /// A room of 30 × 16 × 3 m with `count` points; points look like one of 60 kinds, more or less.
    pub(super) fn new(seed: u64, count: usize) -> Self {
        let mut random = SplitMix64(seed);
        let kinds: Vec<_> = (0..60).map(|_| drawn_descriptor(&mut random)).collect();
        let points = (0..count)
            .map(|_| {
                let kind = kinds[random.next() as usize % kinds.len()];
                let descriptor = turned(&mut random, &kind, 0.2);
                surface_point(&mut random, descriptor)
            })
            .collect();
        Self { points, rig: rig() }
    }

    /// A room built from one drawing: most of its points are where any such room has them, and look like one of 20 kinds
    /// but for their wear; the others are its own.
    pub(super) fn drawn(seed: u64) -> Self {
        let mut drawing = SplitMix64(77);
        let kinds: Vec<_> = (0..20).map(|_| drawn_descriptor(&mut drawing)).collect();
        let mut wear = SplitMix64(seed);
        let drawn: Vec<Point> = (0..1500)
            .map(|index| {
                let descriptor = turned(&mut wear, &kinds[index % kinds.len()], 0.03);
                surface_point(&mut drawing, descriptor)
            })
            .collect();
        let mut world = Self::new(seed, 1000);
        world.points.extend(drawn);
        world
    }

    /// The same room where every stretch of `period` metres along x shows the same points.
    pub(super) fn repeated(mut self, period: f64, share: f64) -> Self {
        let mut random = SplitMix64(99);
        let pattern: Vec<Point> = self
            .points
            .iter()
            .filter(|point| point.position.x < period)
            .cloned()
            .collect();
        self.points.retain(|_| random.unit() > share);
        let stretches = (30.0 / period) as usize;
        for stretch in 0..stretches {
            for point in pattern.iter().filter(|_| random.unit() < share) {
                let mut point = point.clone();
                point.position.x += period * stretch as f64;
                self.points.push(point);
            }
        }
        self
    }

    /// The room after some time: a share of its points is gone, as many new ones have come.
    pub(super) fn changed(&self, seed: u64, share: f64) -> Self {
        let mut random = SplitMix64(seed);
        let mut changed = self.clone();
        for point in &mut changed.points {
            if random.unit() < share {
                let descriptor = drawn_descriptor(&mut random);
                *point = surface_point(&mut random, descriptor);
            }
        }
        changed
    }

    fn visible(&self, point: &Point, eye: &Vector3<f64>) -> bool {
        let away = eye - point.position;
        let range = away.norm();
        (0.5..9.0).contains(&range) && away.dot(&point.normal) > 0.2 * range
    }

    pub(super) fn features(
        &self,
        pose: &Pose,
        imaging: &Imaging,
        random: &mut SplitMix64,
    ) -> KeyframeFeatures {
        let images = self.rig.cameras.iter().enumerate().map(|(index, mounted)| {
            if imaging.dark == Some(index) {
                return ImageFeatures::default();
            }
            let map_from_camera = pose.compose(&mounted.vehicle_from_camera);
            let camera_from_map = map_from_camera.inverse();
            let mut features: Vec<Feature> = Vec::new();
            for point in &self.points {
                if !self.visible(point, &map_from_camera.translation) {
                    continue;
                }
                let pixel = mounted
                    .camera
                    .project(&camera_from_map.transform(&point.position));
                let Some(pixel) = pixel.filter(|pixel| mounted.camera.contains(*pixel)) else {
                    continue;
                };
                if random.unit() < imaging.detected {
                    features.push(Feature {
                        pixel: pixel.map(|x| x + imaging.noise_px * random.normal()),
                        size_px: 8.0,
                        descriptor: turned(random, &point.descriptor, imaging.turned),
                    });
                }
            }
            for _ in 0..imaging.clutter {
                let like = random.next() as usize % self.points.len();
                features.push(Feature {
                    pixel: [400.0 * random.unit(), 300.0 * random.unit()],
                    size_px: 8.0,
                    descriptor: turned(random, &self.points[like].descriptor, 0.15),
                });
            }
            ImageFeatures { features }
        });
        KeyframeFeatures {
            images: images.collect(),
        }
    }

    /// The map that a perfect mapping of a drive would make, with landmarks off by about a centimetre.
    pub(super) fn map(&self, poses: &[Pose], random: &mut SplitMix64) -> LandmarkMap {
        let eyes: Vec<(u32, Vector3<f64>, Pose, usize)> = poses
            .iter()
            .enumerate()
            .flat_map(|(index, pose)| {
                self.rig
                    .cameras
                    .iter()
                    .enumerate()
                    .map(move |(camera, mounted)| {
                        let map_from_camera = pose.compose(&mounted.vehicle_from_camera);
                        (
                            index as u32,
                            map_from_camera.translation,
                            map_from_camera.inverse(),
                            camera,
                        )
                    })
            })
            .collect();
        let landmarks = self.points.iter().filter_map(|point| {
            let seen: Vec<_> = eyes
                .iter()
                .filter(|(_, eye, camera_from_map, camera)| {
                    let lens = &self.rig.cameras[*camera].camera;
                    self.visible(point, eye)
                        && lens
                            .project(&camera_from_map.transform(&point.position))
                            .is_some_and(|pixel| lens.contains(pixel))
                        && random.unit() < 0.5
                })
                .collect();
            landmark(point, &seen, random)
        });
        LandmarkMap::new(landmarks.collect())
    }
}

fn landmark(
    point: &Point,
    seen: &[&(u32, Vector3<f64>, Pose, usize)],
    random: &mut SplitMix64,
) -> Option<MapLandmark> {
    if seen.len() < 3 {
        return None;
    }
    let directions: Vec<_> = seen
        .iter()
        .map(|(_, eye, ..)| (eye - point.position).normalize())
        .collect();
    let ranges = seen
        .iter()
        .map(|(_, eye, ..)| (eye - point.position).norm());
    let view = directions.iter().sum::<Vector3<f64>>().normalize();
    let mut seen_from: Vec<u32> = seen.iter().map(|(place, ..)| *place).collect();
    seen_from.dedup();
    let jitter = Vector3::from_fn(|_, _| 0.004 * random.normal());
    Some(MapLandmark {
        position: point.position + jitter + view * (0.01 * random.normal()),
        sigma_m: 0.011,
        view_cos: directions
            .iter()
            .map(|direction| direction.dot(&view))
            .fold(1.0, f64::min),
        view,
        near_m: ranges.clone().fold(f64::INFINITY, f64::min),
        far_m: ranges.fold(0.0, f64::max),
        descriptors: vec![turned(random, &point.descriptor, 0.03)],
        seen_from,
    })
}

fn surface_point(random: &mut SplitMix64, descriptor: Descriptor) -> Point {
    let [length, width, height] = [30.0, 16.0, 3.0];
    let [a, b] = [random.unit(), random.unit()];
    let (position, normal) = match random.next() % 8 {
        0 => ([a * length, 0.0, b * height], [0.0, 1.0, 0.0]),
        1 => ([a * length, width, b * height], [0.0, -1.0, 0.0]),
        2 => ([0.0, a * width, b * height], [1.0, 0.0, 0.0]),
        3 => ([length, a * width, b * height], [-1.0, 0.0, 0.0]),
        4..=6 => ([a * length, b * width, 0.0], [0.0, 0.0, 1.0]),
        _ => ([a * length, b * width, height], [0.0, 0.0, -1.0]),
    };
    Point {
        position: position.into(),
        normal: normal.into(),
        descriptor,
    }
}

/// Poses 0.4 m apart once around an oval, `offset_m` to the left; floor sloping by up to 1.5 %.
pub(super) fn oval(offset_m: f64, phase: f64) -> Vec<Pose> {
    let steps = 110;
    let poses = (0..steps).map(|step| {
        let turn = std::f64::consts::TAU * (f64::from(step) / f64::from(steps) + phase);
        let (radius_x, radius_y) = (9.0 - offset_m, 4.0 - offset_m);
        let (x, y) = (15.0 + radius_x * turn.cos(), 8.0 + radius_y * turn.sin());
        let heading = (radius_y * turn.cos()).atan2(-radius_x * turn.sin());
        let tilt = 0.012 * (0.5 * x).sin();
        let planar = Pose::from_yaw(x, y, heading);
        let roll = UnitQuaternion::from_euler_angles(tilt, -tilt, 0.0);
        Pose::new(
            planar.translation + Vector3::z() * (0.05 * tilt.sin()),
            planar.rotation * roll,
        )
    });
    poses.collect()
}

/// Planar odometry of a drive: scale wrong by a factor, yaw drifting, a little noise.
pub(super) fn odometry(
    poses: &[Pose],
    scale: f64,
    drift_rad_per_m: f64,
    random: &mut SplitMix64,
) -> Vec<Pose> {
    let mut odometry = vec![Pose::identity()];
    let mut at = Pose::identity();
    for pair in poses.windows(2) {
        let step = pair[0].inverse().compose(&pair[1]);
        let path = step.translation.norm();
        let (x, y) = (step.translation.x * scale, step.translation.y * scale);
        let yaw = step.yaw() + drift_rad_per_m * path + 0.001 * random.normal();
        at = at.compose(&Pose::from_yaw(
            x + 0.002 * random.normal(),
            y + 0.002 * random.normal(),
            yaw,
        ));
        odometry.push(at);
    }
    odometry
}

pub(super) fn drive<'a>(
    odometry: &[Pose],
    features: &'a [KeyframeFeatures],
) -> Vec<DriveKeyframe<'a>> {
    let pairs = odometry.iter().zip(features);
    pairs
        .map(|(odom, features)| DriveKeyframe {
            odom_from_vehicle: *odom,
            features,
        })
        .collect()
}
