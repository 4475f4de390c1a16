//! Drives over hills, with what wheels and an IMU make of them.
#![allow(clippy::unwrap_used)]

use nalgebra::{Matrix3, Rotation3};

use super::*;
use crate::solving::random::SplitMix64;

/// Where a vehicle is at a second.
type Truth<'a> = &'a dyn Fn(f64) -> Pose;

const STEP_S: f64 = 1e-3;

/// A vehicle on a surface `z = height(x, y)`, along `way(t)`.
fn on_wheels(way: &dyn Fn(f64) -> [f64; 2], height: &dyn Fn(f64, f64) -> f64, t: f64) -> Pose {
    let [x, y] = way(t);
    let place = |t: f64| {
        let [x, y] = way(t);
        Vector3::new(x, y, height(x, y))
    };
    let slope = |dx: f64, dy: f64| (height(x + dx, y + dy) - height(x - dx, y - dy)) / 2e-3;
    let up = Vector3::new(-slope(1e-3, 0.0), -slope(0.0, 1e-3), 1.0).normalize();
    let ahead = (place(t + STEP_S) - place(t - STEP_S)).normalize();
    let left = up.cross(&ahead).normalize();
    let axes = Matrix3::from_columns(&[left.cross(&up), left, up]);
    let rotation = Rotation3::from_matrix_unchecked(axes);
    Pose::new(place(t), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Rate of turn along the vehicle's own axes.
fn rate(truth: Truth<'_>, t: f64) -> Vector3<f64> {
    let [before, after] = [-STEP_S, STEP_S].map(|step| truth(t + step).rotation);
    so3::log(&(before.inverse() * after)) / (2.0 * STEP_S)
}

/// What an IMU at a mount measures at 100 Hz, with noise (rad/s, m/s²) and a bias.
fn imu(truth: Truth<'_>, mount: &Pose, seconds: f64, noise: [f64; 2], bias: f64) -> Vec<ImuSample> {
    let mut random = SplitMix64(7);
    let mut draw = |sd: f64| {
        let uniform = Vector3::from_fn(|_, _| 2.0 * random.unit() - 1.0);
        uniform * sd * 3f64.sqrt()
    };
    let place = |t: f64| truth(t).transform(&mount.translation);
    let sample = |step: usize| {
        let t = step as f64 * 0.01;
        let h = 0.02;
        let moved = (place(t + h) - 2.0 * place(t) + place(t - h)) / (h * h);
        let felt = moved + Vector3::z() * GRAVITY_MPS2;
        let imu_from_vehicle = mount.rotation.inverse();
        let felt = imu_from_vehicle * (truth(t).rotation.inverse() * felt);
        ImuSample {
            stamp: (t * 1e9) as i64,
            angular_velocity: imu_from_vehicle * rate(truth, t)
                + draw(noise[0])
                + Vector3::new(bias, -bias, bias),
            specific_force: felt + draw(noise[1]),
        }
    };
    (0..=(seconds * 100.0) as usize).map(sample).collect()
}

/// What wheels count at 50 Hz: ways and turns in the vehicle's own plane.
fn wheels(truth: Truth<'_>, seconds: f64) -> Vec<(i64, Pose)> {
    let mut pose = Pose::identity();
    let mut odometry = vec![(0, pose)];
    let ticks = |way: f64| (way / 0.004).round() * 0.004;
    let mut way = 0.0;
    for k in 1..=(seconds * 50.0) as usize {
        let [before, after] = [k - 1, k].map(|k| truth(k as f64 * 0.02));
        let moved = step(&before, &after);
        let counted = ticks(way);
        way += moved.translation.x;
        let turned = so3::log(&moved.rotation).z;
        pose = pose.compose(&Pose::from_yaw(ticks(way) - counted, 0.0, turned));
        odometry.push((k as i64 * 20_000_000, pose));
    }
    odometry
}

/// Stands, then drives in bends over hills of this height, and slows down now and then.
fn over_hills(height_m: f64, t: f64) -> Pose {
    let way = |t: f64| {
        let t = (t - 2.0).max(0.0) - 2.0 * ((t - 2.0).max(0.0) / 2.0).tanh();
        let along = 5.0 * t + 4.0 * (t / 3.0).sin();
        [along, 12.0 * (along / 25.0).sin()]
    };
    let height = |x: f64, y: f64| height_m * (1.0 - (x / 20.0).cos()) + 0.03 * y;
    // At a stand the way has no direction: the vehicle creeps.
    on_wheels(
        &|t| {
            let [x, y] = way(t);
            [x + 1e-3 * t, y]
        },
        &height,
        t,
    )
}

fn lean(pose: &Pose, truth: &Pose) -> f64 {
    let up = |pose: &Pose| pose.rotation.inverse() * Vector3::z();
    up(pose).angle(&up(truth)).to_degrees()
}

const NOISE: [f64; 2] = [0.004, 0.08];

fn mount() -> Pose {
    let turned = so3::exp(&Vector3::new(0.3, -0.2, 1.5));
    Pose::new(Vector3::new(0.8, 0.2, 0.5), turned)
}

#[test]
fn slopes_and_heights_are_those_of_the_road() {
    let truth = |t: f64| over_hills(1.0, t);
    let odometry = wheels(&truth, 60.0);
    let imu = imu(&truth, &mount(), 60.0, NOISE, 0.01);
    let found = upright(&odometry, &imu, &mount()).unwrap();
    let leans: Vec<f64> = odometry
        .iter()
        .zip(&found)
        .map(|((stamp, _), pose)| lean(pose, &truth(*stamp as f64 * 1e-9)))
        .collect();
    let rms = (leans.iter().map(|lean| lean * lean).sum::<f64>() / leans.len() as f64).sqrt();
    let steepest = leans.iter().copied().fold(0.0, f64::max);
    assert!(rms < 0.15 && steepest < 0.6, "{rms}°, at most {steepest}°");
    let heights = odometry.iter().zip(&found).map(|((stamp, _), pose)| {
        let truth = truth(*stamp as f64 * 1e-9).translation.z - truth(0.0).translation.z;
        (pose.translation.z - truth).abs()
    });
    // 280 m of way; the wheels alone are off by all of the 2 m that the hills are high.
    let off = heights.fold(0.0, f64::max);
    assert!(off < 0.3, "{off} m");
}

#[test]
fn a_level_drive_stays_level_and_keeps_its_way() {
    let truth = |t: f64| over_hills(0.0, t);
    let level = |t: f64| {
        let at = truth(t);
        Pose::from_yaw(at.translation.x, at.translation.y, at.yaw())
    };
    let odometry = wheels(&level, 60.0);
    let imu = imu(&level, &mount(), 60.0, NOISE, 0.01);
    let found = upright(&odometry, &imu, &mount()).unwrap();
    for ((_, wheels), pose) in odometry.iter().zip(&found) {
        assert!(lean(pose, wheels) < 0.4, "{}°", lean(pose, wheels));
        let off = pose.translation - wheels.translation;
        assert!(off.norm() < 0.3, "{off:?}");
    }
}

#[test]
fn silence_is_bridged_and_the_rest_is_as_it_was() {
    let truth = |t: f64| over_hills(1.0, t);
    let odometry = wheels(&truth, 60.0);
    let mut imu = imu(&truth, &mount(), 60.0, NOISE, 0.01);
    let silent = 25_000_000_000..30_000_000_000;
    imu.retain(|sample| !silent.contains(&sample.stamp));
    let found = upright(&odometry, &imu, &mount()).unwrap();
    for ((stamp, _), pose) in odometry.iter().zip(&found) {
        let off = lean(pose, &truth(*stamp as f64 * 1e-9));
        let most = if silent.contains(stamp) { 10.0 } else { 0.8 };
        assert!(off < most, "{off}° at {stamp}");
    }
}

#[test]
fn jumps_of_the_odometry_stay_what_they_are() {
    let truth = |t: f64| over_hills(1.0, t);
    let mut odometry = wheels(&truth, 40.0);
    let start = odometry[1000].1;
    for (_, pose) in &mut odometry[1000..] {
        *pose = start.inverse().compose(pose);
    }
    let imu = imu(&truth, &mount(), 40.0, NOISE, 0.01);
    let found = upright(&odometry, &imu, &mount()).unwrap();
    for (at, pair) in found.windows(2).enumerate() {
        let way = |a: &Pose, b: &Pose| (a.translation - b.translation).norm();
        let before = way(&odometry[at].1, &odometry[at + 1].1);
        assert!((way(&pair[0], &pair[1]) - before).abs() < 1e-9);
    }
    let off = lean(&found[1500], &truth(30.0));
    assert!(off < 0.6, "{off}°");
}

/// On one long turn nothing tells a scale from a bias but its size.
#[test]
fn degrees_for_radians_on_one_long_turn_are_no_bias() {
    let truth = |t: f64| {
        let angle = 0.2 * t;
        let place = Vector3::new(10.0 * angle.sin(), 10.0 - 10.0 * angle.cos(), 0.0);
        Pose::new(place, so3::exp(&Vector3::new(0.0, 0.0, angle)))
    };
    let odometry = wheels(&truth, 30.0);
    let good = imu(&truth, &mount(), 30.0, NOISE, 0.01);
    assert!(upright(&odometry, &good, &mount()).is_ok());
    let degrees = |sample: &ImuSample| ImuSample {
        angular_velocity: sample.angular_velocity.map(f64::to_degrees),
        ..*sample
    };
    let degrees: Vec<ImuSample> = good.iter().map(degrees).collect();
    let refused = upright(&odometry, &degrees, &mount()).unwrap_err();
    assert_eq!(refused, InertialError::TurnsOtherwise);
}

#[test]
fn an_imu_that_makes_no_sense_is_refused() {
    let truth = |t: f64| over_hills(1.0, t);
    let odometry = wheels(&truth, 30.0);
    let good = imu(&truth, &mount(), 30.0, NOISE, 0.0);
    let upside_down = Pose::new(Vector3::zeros(), so3::exp(&Vector3::new(3.1, 0.0, 0.0)));
    let refused = |imu: &[ImuSample], mount: &Pose| upright(&odometry, imu, mount).unwrap_err();
    assert_eq!(refused(&good[..900], &mount()), InertialError::Silent);
    assert_eq!(refused(&[], &mount()), InertialError::Silent);
    let turned = mount().compose(&upside_down);
    assert_eq!(refused(&good, &turned), InertialError::TurnsOtherwise);
    let changed = |change: &dyn Fn(Vector3<f64>) -> Vector3<f64>| {
        let change = |sample: &ImuSample| ImuSample {
            specific_force: change(sample.specific_force),
            ..*sample
        };
        good.iter().map(change).collect::<Vec<_>>()
    };
    let in_g = changed(&|force| force / GRAVITY_MPS2);
    assert_eq!(refused(&in_g, &mount()), InertialError::NoGravity);
    let left_handed = changed(&|force| -force);
    assert_eq!(refused(&left_handed, &mount()), InertialError::NotUpright);
    assert_eq!(upright(&[], &good, &mount()), Err(InertialError::Silent));
}

#[test]
fn nothing_finite_is_made_infinite() {
    let odometry: Vec<(i64, Pose)> = [5, 5, 3, i64::MAX, i64::MIN, 7, 900_000_000]
        .map(|stamp| (stamp, Pose::from_yaw(1e300, -1e300, 1.0)))
        .to_vec();
    let numbers = [f64::NAN, 1e308, -1e308, 0.0];
    let imu: Vec<ImuSample> = (0..400i64)
        .map(|k| ImuSample {
            stamp: (k - 200) * 10_000_000,
            angular_velocity: Vector3::repeat(numbers[k as usize % 4]),
            specific_force: Vector3::repeat(numbers[k as usize / 3 % 4]),
        })
        .collect();
    for pose in upright(&odometry, &imu, &mount()).into_iter().flatten() {
        assert!(pose.rotation.into_inner().norm().is_finite());
    }
}
