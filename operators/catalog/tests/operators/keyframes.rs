//! Keyframes: where they are due, which frame set serves them, and what happens where there is none.

use std::collections::BTreeMap;

use evermap_contract::Losses;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::Keyframe;
use evermap_schemas::roles::{Frame, OdometryPose};
use evermap_schemas::{ImageRef, Pose, Stamp};
use proptest::prelude::*;
use serde_json::json;

use crate::yields;

const MS: i64 = 1_000_000;

fn odometry(stamp: i64, x: f64) -> OdometryPose {
    OdometryPose {
        site: "s".into(),
        session: "a".into(),
        stamp: Stamp(stamp),
        topic: "/odom".into(),
        odom_from_vehicle: Pose {
            x,
            ..Pose::IDENTITY
        },
        speed_mps: None,
        yaw_rate_radps: None,
    }
}

fn frame(camera: &str, stamp: i64) -> Frame {
    let image = ImageRef {
        session: "a".into(),
        chunk: Some(1),
        chunk_length: 2,
        chunk_size: 3,
        compression: "zstd".into(),
        offset: stamp.unsigned_abs(),
        length: 5,
        format: "jpeg".into(),
        ..ImageRef::default()
    };
    Frame {
        site: "s".into(),
        session: "a".into(),
        stamp: Stamp(stamp),
        camera: camera.into(),
        topic: format!("/{camera}"),
        log_time: Stamp(stamp),
        image,
    }
}

fn keyframes(odometry: Vec<OdometryPose>, frames: Vec<Frame>) -> (Vec<Keyframe>, Losses) {
    let inputs = [
        inputs_of("odometry", odometry).unwrap(),
        inputs_of("frames", frames).unwrap(),
    ];
    yields("keyframes", json!({}), inputs)
}

/// 50 Hz at a steady speed.
pub fn drive(speed_mps: f64, seconds: f64) -> Vec<OdometryPose> {
    let steps = (seconds * 50.0) as i64;
    (0..=steps)
        .map(|step| odometry(step * 20 * MS, speed_mps * step as f64 * 0.02))
        .collect()
}

/// All cameras at 12.5 Hz, a little after the odometry.
fn shots(seconds: f64) -> Vec<Frame> {
    let shots = (seconds * 12.5) as i64;
    (0..shots)
        .flat_map(|shot| ["front", "left"].map(|camera| frame(camera, shot * 80 * MS + 7 * MS)))
        .collect()
}

#[test]
fn a_slow_car_gets_the_frame_set_after_every_step() {
    let (found, losses) = keyframes(drive(0.5, 10.0), shots(10.0));
    assert!(losses.is_empty(), "{losses:?}");
    assert!((24..=26).contains(&found.len()), "{}", found.len());
    for (index, keyframe) in found.iter().enumerate() {
        assert_eq!(keyframe.keyframe as usize, index);
        assert_eq!(keyframe.images.len(), 2);
        assert!(
            keyframe
                .images
                .iter()
                .all(|image| image.stamp == keyframe.stamp)
        );
        let due = 0.2 * index as f64;
        let x = 0.5 * keyframe.stamp.0 as f64 * 1e-9;
        assert!((keyframe.odom_from_vehicle.x - x).abs() < 1e-9);
        assert!((keyframe.distance_m - x).abs() < 1e-9);
        assert!(x >= due - 1e-9 && x < due + 0.5 * 0.081, "{x} for {due}");
    }
}

#[test]
fn a_fast_car_gets_every_frame_set_once() {
    let (mut found, _) = keyframes(drive(4.0, 4.0), shots(4.0));
    // The last exposure is at 3.927 s; two more points are due after it.
    assert!(
        found[50..]
            .iter()
            .all(|keyframe| keyframe.images.is_empty())
    );
    assert_eq!(found.len(), 52);
    found.truncate(50);
    assert!(found.iter().all(|keyframe| keyframe.images.len() == 2));
    assert!(
        found
            .windows(2)
            .all(|pair| pair[1].stamp.0 - pair[0].stamp.0 == 80 * MS)
    );
}

#[test]
fn without_images_keyframes_are_the_crossings() {
    let (found, _) = keyframes(drive(0.5, 10.05), vec![]);
    assert_eq!(found.len(), 26);
    for (index, keyframe) in found.iter().enumerate() {
        assert!((keyframe.odom_from_vehicle.x - 0.2 * index as f64).abs() < 1e-6);
        assert!(keyframe.images.is_empty());
    }
}

#[test]
fn where_the_cameras_pause_keyframes_go_on_without_images() {
    let frames: Vec<_> = shots(10.0)
        .into_iter()
        .filter(|frame| !(3_000 * MS..7_000 * MS).contains(&frame.stamp.0))
        .collect();
    let (found, _) = keyframes(drive(0.5, 10.0), frames);
    let bare: Vec<_> = found
        .iter()
        .filter(|keyframe| keyframe.images.is_empty())
        .collect();
    // From the first crossing after the pause began to a second before it ended, every 0.4 s.
    assert!((7..=8).contains(&bare.len()), "{}", bare.len());
    assert!(found.windows(2).all(|pair| pair[0].stamp < pair[1].stamp));
    assert!(
        found
            .iter()
            .zip(0..)
            .all(|(keyframe, index)| keyframe.keyframe == index)
    );
}

#[test]
fn cameras_out_of_step_share_a_set_within_the_gap_only() {
    let frames = vec![
        frame("left", 0),
        frame("front", 30 * MS),
        frame("rear", 60 * MS),
        frame("left", 100 * MS),
    ];
    let (found, _) = keyframes(drive(1.0, 1.0), frames);
    let cameras = |keyframe: &Keyframe| -> Vec<String> {
        keyframe
            .images
            .iter()
            .map(|image| image.camera.clone())
            .collect()
    };
    assert_eq!(cameras(&found[0]), ["front", "left"]);
    assert_eq!(found[0].images[0].stamp, Stamp(30 * MS));
    assert_eq!(found[0].images[0].image.offset, 30 * MS as u64);
}

#[test]
fn a_faster_camera_takes_no_image_from_the_slower_ones() {
    let slow = ["left", "rear", "right"];
    let shots = |camera: &'static str, first: i64, period: i64| {
        let stamps = (0..).map(move |shot| first + shot * period);
        let stamps = stamps.take_while(|ms| *ms < 10_000);
        stamps.map(move |ms| frame(camera, ms * MS))
    };
    let images_with_front_every = |period: i64| {
        let of_slow = slow.into_iter().flat_map(|camera| shots(camera, 11, 100));
        let frames = of_slow.chain(shots("front", 3, period));
        let (found, losses) = keyframes(drive(2.6, 10.0), frames.collect());
        assert!(losses.is_empty(), "{losses:?}");
        let mut images = BTreeMap::<String, usize>::new();
        for image in found.into_iter().flat_map(|keyframe| keyframe.images) {
            *images.entry(image.camera).or_default() += 1;
        }
        images
    };
    let one_rate = images_with_front_every(100);
    assert_eq!(one_rate["left"], 100);
    for (period, front) in [(40, 128), (80, 95)] {
        let images = images_with_front_every(period);
        for camera in slow {
            let (found, least) = (images[camera], one_rate[camera] - 1);
            assert!(found >= least, "{camera}: {found} at {period} ms");
        }
        assert!(images["front"] >= front, "{images:?} at {period} ms");
    }
}

#[test]
fn bad_rows_are_counted() {
    let mut rows = drive(0.5, 2.0);
    rows[10].odom_from_vehicle.x = f64::NAN;
    rows[20].odom_from_vehicle.qw = 0.0;
    rows.push(odometry(500 * MS, 77.0));
    rows.push(odometry(3_000 * MS, 900.0));
    let mut frames = shots(2.0);
    frames.push(frame("front", 7 * MS));
    let (found, losses) = keyframes(rows, frames);
    let expected = [
        ("odometry jumped", 1),
        ("odometry pose is not a rigid transform", 2),
        ("odometry stamp repeats", 1),
        ("second frame of one camera with one stamp", 1),
    ];
    assert_eq!(
        losses.0,
        expected
            .map(|(reason, count)| (reason.to_owned(), count))
            .into()
    );
    assert_eq!(found.last().unwrap().odom_from_vehicle.x, 900.0);
}

#[test]
fn frames_that_odometry_does_not_reach_are_counted_with_how_far_they_are() {
    let losses_of = |odometry: Vec<OdometryPose>| keyframes(odometry, shots(20.0)).1.0;
    let shifted = |seconds: i64| {
        let mut rows = drive(0.5, 20.0);
        let shift = |row: &mut OdometryPose| row.stamp.0 += seconds * 1_000 * MS;
        rows.iter_mut().for_each(shift);
        rows
    };
    let lost = |reason: &str, frames: u64| BTreeMap::from([(reason.to_owned(), frames)]);
    // Two cameras, 250 times: none of the frames is reached, or half of them, and a tenth of their time is borne.
    let of_all = [
        (3_620, "frame that is hours before odometry begins"),
        (120, "frame that is minutes before odometry begins"),
        (-100_000, "frame that is days after odometry ends"),
    ];
    for (seconds, reason) in of_all {
        assert_eq!(losses_of(shifted(seconds)), lost(reason, 500));
    }
    assert_eq!(
        losses_of(drive(0.5, 10.0)),
        lost("frame that is seconds after odometry ends", 200)
    );
    for seconds in [-1, 1] {
        assert!(losses_of(shifted(seconds)).is_empty());
    }
}

#[test]
fn one_pose_is_one_keyframe_and_other_sessions_stay_out() {
    let mut other = frame("front", 0);
    other.session = "b".into();
    let (found, _) = keyframes(vec![odometry(0, 0.0)], vec![other]);
    assert_eq!((found.len(), found[0].images.len()), (1, 0));
    let (none, losses) = keyframes(vec![], shots(1.0));
    assert!(none.is_empty() && losses.is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn whatever_is_driven_keyframes_are_ordered_unique_and_posed_on_the_path(
        // Milliseconds, and metres per second: no step is a jump.
        steps in prop::collection::vec((1..80_i64, -1.0..3.0_f64), 1..120),
        exposures in prop::collection::vec((0..4_000_i64, 0..3_usize), 0..120),
    ) {
        let (mut stamp, mut x) = (0, 0.0);
        let mut rows = vec![odometry(0, 0.0)];
        for (wait, speed_mps) in steps {
            stamp += wait * MS;
            x += speed_mps * wait as f64 * 1e-3;
            rows.push(odometry(stamp, x));
        }
        let frames = exposures.into_iter().map(|(at, camera)| frame(["a", "b", "c"][camera], at * MS)).collect();
        let (found, _) = keyframes(rows.clone(), frames);
        prop_assert!(found.windows(2).all(|pair| pair[0].stamp < pair[1].stamp));
        for keyframe in &found {
            let after = rows.partition_point(|row| row.stamp < keyframe.stamp).max(1);
            let (a, b) = (&rows[after - 1], &rows[after.min(rows.len() - 1)]);
            let span = (b.stamp.0 - a.stamp.0).max(1) as f64;
            let t = (keyframe.stamp.0 - a.stamp.0) as f64 / span;
            let x = a.odom_from_vehicle.x + t * (b.odom_from_vehicle.x - a.odom_from_vehicle.x);
            prop_assert!((keyframe.odom_from_vehicle.x - x).abs() < 1e-3);
            for (index, image) in keyframe.images.iter().enumerate() {
                prop_assert!((image.stamp.0 - keyframe.stamp.0).abs() <= 40 * MS);
                prop_assert!(keyframe.images[..index].iter().all(|other| other.camera < image.camera));
            }
        }
    }
}
