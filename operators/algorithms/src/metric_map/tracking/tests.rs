#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::metric_map::features::{DESCRIPTOR_BYTES, Descriptor, Feature};

fn camera() -> Camera {
    Camera::from_calibration(
        "equidistant",
        400,
        300,
        &[128.0, 0.0, 199.5, 0.0, 128.0, 149.5, 0.0, 0.0, 1.0],
        &[0.0; 4],
    )
    .unwrap()
}

/// A random number from 0 to 1, the same for the same words.
fn hash(words: [u64; 3]) -> f64 {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    for word in words {
        state = (state ^ word).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        state ^= state >> 29;
    }
    (state >> 11) as f64 / (1_u64 << 53) as f64
}

/// A descriptor of its own for each point, with some bits flipped for each view.
fn descriptor(point: u64, view: u64) -> Descriptor {
    let mut bytes = [0; DESCRIPTOR_BYTES];
    for bit in 0..512 {
        let flipped = hash([point + 1, 1000 + view, bit]) < 0.08;
        if (hash([point + 1, 0, bit]) < 0.5) != flipped {
            bytes[bit as usize / 8] |= 1 << (bit % 8);
        }
    }
    Descriptor(bytes)
}

/// The camera drives sideways and forward and turns slowly, past a hall of points.
struct World {
    points: Vec<Vector3<f64>>,
    poses: Vec<Pose>,
}

impl World {
    fn new(views: u32) -> Self {
        let axis = |point: u64, axis: u64, span: f64| (hash([7, point, axis]) - 0.5) * span;
        let points = (0..400).map(|point| {
            Vector3::new(
                axis(point, 0, 24.0),
                axis(point, 1, 5.0),
                axis(point, 2, 24.0),
            )
        });
        let pose = |view: u32| {
            let t = f64::from(view);
            let turn = Vector3::new(0.002 * (t * 1.7).sin(), 0.02 * t, 0.003 * (t * 0.9).cos());
            let at = Vector3::new(0.3 * t, 0.01 * (t * 1.3).sin(), 0.2 * t);
            Pose::new(at, UnitQuaternion::from_scaled_axis(turn))
        };
        Self {
            points: points.collect(),
            poses: (0..views).map(pose).collect(),
        }
    }

    /// What a view sees, and which point each feature is.
    fn look(&self, view: usize, moving: bool) -> (ImageFeatures, Vec<usize>) {
        let camera = camera();
        let (mut image, mut names) = (ImageFeatures::default(), Vec::new());
        for (index, point) in self.points.iter().enumerate() {
            let walked = if moving && index % 10 == 0 {
                0.3 * view as f64
            } else {
                0.0
            };
            let seen = self.poses[view]
                .inverse()
                .transform(&(point + Vector3::y() * walked));
            let Some(pixel) = camera.project(&seen).filter(|at| camera.contains(*at)) else {
                continue;
            };
            let noise = |axis| (hash([index as u64, view as u64, axis]) - 0.5) * 1.2;
            if seen.norm() < 0.6 || hash([index as u64, view as u64, 9]) < 0.1 {
                continue;
            }
            image.features.push(Feature {
                pixel: [pixel[0] + noise(0), pixel[1] + noise(1)],
                size_px: 12.0,
                descriptor: descriptor(index as u64, view as u64),
            });
            names.push(index);
        }
        (image, names)
    }
}

/// Tracks, as the points that their sightings show.
fn followed(world: &World, moving: bool, drift: f64) -> Vec<Vec<usize>> {
    let looks: Vec<_> = (0..world.poses.len())
        .map(|view| world.look(view, moving))
        .collect();
    let views: Vec<CameraFrame<'_>> = looks
        .iter()
        .zip(&world.poses)
        .zip(0_u32..)
        .map(|(((features, _), pose), view)| {
            let scaled = Pose::new(pose.translation * (1.0 + drift), pose.rotation);
            let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(
                0.4 * drift * f64::from(view).sin(),
                drift * 0.1 * f64::from(view),
                0.0,
            ));
            CameraFrame {
                stretch: 0,
                odom_from_camera: Pose::new(scaled.translation, scaled.rotation * tilt),
                features,
            }
        })
        .collect();
    let found = tracks(&camera(), &views, &TrackParams::default());
    let name = |at: &Sighting| looks[at.view as usize].1[at.feature as usize];
    found
        .iter()
        .map(|track| track.iter().map(name).collect())
        .collect()
}

#[test]
fn points_are_followed_through_noise_gaps_and_drifting_odometry() {
    let world = World::new(12);
    let tracks = followed(&world, false, 0.01);
    let sightings: usize = tracks.iter().map(Vec::len).sum();
    let pure = tracks
        .iter()
        .filter(|track| track.iter().all(|point| *point == track[0]))
        .count();
    assert!(tracks.len() > 150, "{}", tracks.len());
    assert!(
        sightings > 6 * tracks.len(),
        "{sightings} in {}",
        tracks.len()
    );
    assert!(
        pure * 100 >= tracks.len() * 98,
        "{pure} of {}",
        tracks.len()
    );
}

#[test]
fn what_moves_by_itself_is_not_followed_far() {
    let world = World::new(12);
    let tracks = followed(&world, true, 0.0);
    let of = |moving: bool| {
        let track = tracks
            .iter()
            .filter(move |track| (track[0] % 10 == 0) == moving);
        let points = if moving { 40.0 } else { 360.0 };
        track.map(Vec::len).sum::<usize>() as f64 / points
    };
    assert!(of(true) < 0.5 * of(false), "{} {}", of(true), of(false));
}

#[test]
fn the_order_is_that_of_first_sight_and_features_are_used_once() {
    let world = World::new(6);
    let looks: Vec<_> = (0..6).map(|view| world.look(view, false).0).collect();
    let views: Vec<_> = looks
        .iter()
        .zip(&world.poses)
        .map(|(features, pose)| CameraFrame {
            stretch: 0,
            odom_from_camera: *pose,
            features,
        })
        .collect();
    let params = TrackParams {
        max_points: 4,
        min_points: 2,
        ..TrackParams::default()
    };
    let found = tracks(&camera(), &views, &params);
    assert!(found.is_sorted() && found.iter().all(|track| (2..=4).contains(&track.len())));
    assert!(
        found
            .iter()
            .all(|track| track.is_sorted_by(|a, b| a.view < b.view))
    );
    let mut all: Vec<_> = found.into_iter().flatten().collect();
    let length = all.len();
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), length);
}

#[test]
fn nothing_gives_no_tracks() {
    let none = ImageFeatures::default();
    let pose = |x: f64| Pose::from_yaw(x, 0.0, 0.0);
    let view = |x: f64| CameraFrame {
        stretch: 0,
        odom_from_camera: pose(x),
        features: &none,
    };
    assert!(tracks(&camera(), &[], &TrackParams::default()).is_empty());
    assert!(
        tracks(
            &camera(),
            &[view(0.0), view(f64::NAN)],
            &TrackParams::default()
        )
        .is_empty()
    );
    let world = World::new(2);
    let (features, _) = world.look(0, false);
    let far = [0.0, 50.0].map(|x| CameraFrame {
        stretch: 0,
        odom_from_camera: pose(x),
        features: &features,
    });
    assert!(tracks(&camera(), &far, &TrackParams::default()).is_empty());
}
