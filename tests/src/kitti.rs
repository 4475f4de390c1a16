//! Drives from a stretch of KITTI's sequence 00, with odometry that drifts.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::geometry::trajectory::StampedPose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::{evermap, shared, text};

/// First frame of the stretch that images are there of.
const FIRST: usize = 50;
/// Frames of the stretch.
const FRAMES: usize = 100;
/// Height of the camera above the vehicle's frame, as `evermap import kitti` has it, m.
const CAMERA_HEIGHT_M: f64 = 1.65;

/// The stretch's true poses and where its images lie.
pub struct Stretch {
    images: PathBuf,
    calibration: PathBuf,
    times: Vec<String>,
    start_from_camera: Vec<Pose>,
}

impl Stretch {
    /// The stretch; `None`, loudly, without the shared data.
    ///
    /// # Panics
    /// Where its files are not KITTI's.
    pub fn find() -> Option<Self> {
        let folder = shared("data/kitti00_seq")?;
        let poses = fs::read_to_string(shared("data/kitti_poses/00.txt")?).expect("poses are text");
        let times = fs::read_to_string(folder.join("times_00.txt")).expect("times are text");
        let stretch = |text: &str| -> Vec<String> {
            let lines = text.lines().skip(FIRST).take(FRAMES);
            lines.map(str::to_owned).collect()
        };
        let poses = stretch(&poses);
        Some(Self {
            images: folder.join("image_0"),
            calibration: folder.join("K.txt"),
            times: stretch(&times),
            start_from_camera: poses.iter().map(|line| read_pose(line)).collect(),
        })
    }

    /// Writes every `step`-th frame from `first` on as `name.mcap` in `folder`, and gives the truth
    /// at those frames. Odometry is the truth with drift: each step is off by 1 % of its length
    /// along each axis and by a quarter of a degree about each (one standard deviation). Its scale is
    /// right on average: a single camera cannot tell another.
    ///
    /// # Panics
    /// Where something cannot be written.
    pub fn write(&self, folder: &Path, name: &str, first: usize, step: usize) -> Drive {
        let frames: Vec<usize> = (first..FRAMES).step_by(step).collect();
        let images = folder.join(format!("{name}_images"));
        fs::create_dir_all(&images).expect("a folder can be made");
        let (mut times, mut poses) = (String::new(), String::new());
        let truth = self.truth(&frames);
        let drifted = drift(&truth, first as u64 + 1);
        for (k, (frame, odometry)) in frames.iter().zip(&drifted).enumerate() {
            let source = self.images.join(format!("{:06}.png", FIRST + frame));
            fs::copy(source, images.join(format!("{k:06}.png"))).expect("an image can be copied");
            times.push_str(&self.times[*frame]);
            times.push('\n');
            write_pose(&mut poses, &odometry.pose);
        }
        let (times_file, poses_file) = (
            folder.join(format!("{name}_times.txt")),
            folder.join(format!("{name}_poses.txt")),
        );
        fs::write(&times_file, times).expect("times can be written");
        fs::write(&poses_file, poses).expect("poses can be written");
        let session = folder.join(format!("{name}.mcap"));
        let arguments = [
            ("--poses", &poses_file),
            ("--times", &times_file),
            ("--images", &images),
            ("--calibration", &self.calibration),
            ("--out", &session),
        ];
        let mut line = vec!["import", "kitti"];
        line.extend(
            arguments
                .iter()
                .flat_map(|(name, path)| [*name, text(path)]),
        );
        evermap(&line).expect(0);
        Drive {
            session,
            truth,
            odometry: drifted,
        }
    }

    /// The vehicle at these frames, in the vehicle's frame at frame 0 of the sequence.
    fn truth(&self, frames: &[usize]) -> Vec<StampedPose> {
        let vehicle_from_camera = vehicle_from_camera();
        let at = |frame: &usize| {
            let pose = vehicle_from_camera
                .compose(&self.start_from_camera[*frame])
                .compose(&vehicle_from_camera.inverse());
            let seconds: f64 = self.times[*frame]
                .trim()
                .parse()
                .expect("a time is a number");
            StampedPose {
                stamp_ns: (seconds * 1e9).round() as i64,
                pose,
            }
        };
        frames.iter().map(at).collect()
    }
}

/// One drive through the stretch.
pub struct Drive {
    /// The log.
    pub session: PathBuf,
    /// The vehicle at the images.
    pub truth: Vec<StampedPose>,
    /// What the odometry says of it.
    pub odometry: Vec<StampedPose>,
}

/// Odometry that loses its way: every step's length and direction is off.
fn drift(truth: &[StampedPose], seed: u64) -> Vec<StampedPose> {
    let mut noise = Noise(seed);
    let mut found = Vec::with_capacity(truth.len());
    let mut pose = Pose::identity();
    for (k, now) in truth.iter().enumerate() {
        if let Some(before) = k.checked_sub(1).map(|before| &truth[before]) {
            let moved = before.pose.inverse().compose(&now.pose);
            let length = moved.translation.norm();
            let aside = Vector3::new(noise.next(), noise.next(), noise.next()) * 0.01 * length;
            let turned =
                Vector3::new(noise.next(), noise.next(), noise.next()) * 0.25_f64.to_radians();
            let error = Pose::new(aside, UnitQuaternion::from_scaled_axis(turned));
            pose = pose.compose(&moved).compose(&error);
        }
        found.push(StampedPose {
            stamp_ns: now.stamp_ns,
            pose,
        });
    }
    found
}

/// Nearly normal numbers: sums of twelve uniform ones of a linear congruential generator.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let uniform = || {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        };
        std::iter::repeat_with(uniform).take(12).sum::<f64>() - 6.0
    }
}

fn vehicle_from_camera() -> Pose {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = Rotation3::from_matrix_unchecked(axes);
    Pose::new(
        Vector3::new(0.0, 0.0, CAMERA_HEIGHT_M),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

fn read_pose(line: &str) -> Pose {
    let words = line.split_whitespace();
    let n: Vec<f64> = words
        .map(|word| word.parse().expect("a pose is numbers"))
        .collect();
    let matrix = Matrix3::new(n[0], n[1], n[2], n[4], n[5], n[6], n[8], n[9], n[10]);
    Pose::new(
        Vector3::new(n[3], n[7], n[11]),
        UnitQuaternion::from_matrix(&matrix),
    )
}

/// The camera's pose in its first frame, as the benchmark writes it, of a vehicle's pose.
fn write_pose(text: &mut String, start_from_vehicle: &Pose) {
    let vehicle_from_camera = vehicle_from_camera();
    let pose = vehicle_from_camera
        .inverse()
        .compose(start_from_vehicle)
        .compose(&vehicle_from_camera);
    let rotation = pose.rotation.to_rotation_matrix();
    let rows = (0..3).map(|r| {
        let row = [
            rotation[(r, 0)],
            rotation[(r, 1)],
            rotation[(r, 2)],
            pose.translation[r],
        ];
        row.map(|value| format!("{value:.12e}")).join(" ")
    });
    let rows: Vec<String> = rows.collect();
    let _ = writeln!(text, "{}", rows.join(" "));
}
