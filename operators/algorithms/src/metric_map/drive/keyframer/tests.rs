use std::collections::BTreeMap;

use super::*;

const S: i64 = 1_000_000_000;

/// Stamps (s), path (m) and numbers of exposures of a drive along x, at one metre of baseline.
fn drive(odometry: &[(i64, f64)], frames: &[(i64, &str)]) -> Vec<(i64, f64, usize)> {
    let params = KeyframeParams {
        baseline_m: 1.0,
        ..KeyframeParams::default()
    };
    let exposures = frames.iter().map(|(second, camera)| Exposure {
        stamp: second * S,
        camera: (*camera).to_owned(),
        image: (),
    });
    let mut keyframer = Keyframer::new(params, exposures.collect());
    let mut found = Vec::new();
    for (second, x) in odometry {
        found.extend(keyframer.push(second * S, &Pose::from_yaw(*x, 0.0, 0.0)));
    }
    found.extend(keyframer.finish());
    assert!(
        (0..)
            .zip(&found)
            .all(|(number, keyframe)| keyframe.number == number)
    );
    let short = |of: Keyframe<()>| (of.stamp / S, of.distance_m, of.exposures.len());
    found.into_iter().map(short).collect()
}

#[test]
fn a_due_point_is_served_by_the_next_frame_set() {
    let odometry = [(0, 0.0), (1, 0.5), (2, 1.5), (3, 2.5)];
    let frames = [(0, "a"), (0, "b"), (1, "a"), (2, "a"), (2, "b"), (3, "b")];
    let found = drive(&odometry, &frames);
    assert_eq!(found, [(0, 0.0, 2), (2, 1.5, 2), (3, 2.5, 1)]);
}

#[test]
fn nobody_waits_longer_than_allowed() {
    let odometry = [(0, 0.0), (5, 5.0), (10, 10.0)];
    let found = drive(&odometry, &[(3, "a"), (10, "a")]);
    // The sets of 3 s and 10 s serve whoever is due up to a second earlier.
    let bare: Vec<_> = found
        .iter()
        .filter(|found| found.2 == 0)
        .map(|found| found.0)
        .collect();
    assert_eq!(bare, [0, 1, 4, 5, 6, 7, 8]);
    assert_eq!(found.len(), 9);
}

#[test]
fn path_goes_on_over_a_jump_but_no_frame_set_lies_in_it() {
    let odometry = [(0, 0.0), (2, 2.0), (4, 300.0), (5, 301.0)];
    let found = drive(&odometry, &[(3, "a"), (5, "a")]);
    assert_eq!(found, [(0, 0.0, 0), (1, 1.0, 0), (2, 2.0, 0), (5, 3.0, 1)]);
}

#[test]
fn no_frame_set_serves_a_due_point_of_another_stretch() {
    let mut keyframer = Keyframer::new(
        KeyframeParams {
            baseline_m: 1.0,
            ..KeyframeParams::default()
        },
        vec![Exposure {
            stamp: 26 * S / 10,
            camera: "a".into(),
            image: (),
        }],
    );
    let odometry = [(0, 0.0), (20, 2.0), (25, 300.0), (35, 301.0)];
    let mut found = Vec::new();
    for (tenth, x) in odometry {
        let pose = Pose::from_yaw(x, 0.0, 0.0);
        found.extend(keyframer.push(tenth * S / 10, &pose));
    }
    found.extend(keyframer.finish());
    let short = found
        .iter()
        .map(|of| (of.stamp * 10 / S, of.stretch, of.exposures.len()));
    let expected = [(0, 0, 0), (10, 0, 0), (20, 0, 0), (26, 1, 1), (35, 1, 0)];
    assert_eq!(short.collect::<Vec<_>>(), expected);
}

/// 10 s at 2.6 m/s: a keyframe is due every 77 ms.
const DRIVE_S: i64 = 10;

/// Frames of one camera: every so many ms, after the first.
fn shots(first_ms: i64, period_ms: i64) -> Vec<i64> {
    let until_ms = DRIVE_S * 1000;
    let frames = (0..).map(|frame| first_ms + frame * period_ms);
    frames.take_while(|ms| *ms < until_ms).collect()
}

/// The numbers of images by camera, of all cameras by name and frames (ms).
fn images(cameras: &[(&str, Vec<i64>)]) -> BTreeMap<String, usize> {
    let mut exposures = Vec::new();
    for (camera, frames) in cameras {
        exposures.extend(frames.iter().map(|ms| Exposure {
            stamp: ms * S / 1000,
            camera: (*camera).to_owned(),
            image: (),
        }));
    }
    let mut keyframer = Keyframer::new(KeyframeParams::default(), exposures);
    let mut found = Vec::new();
    for message in 0..=DRIVE_S * 50 {
        let pose = Pose::from_yaw(message as f64 * 0.052, 0.0, 0.0);
        found.extend(keyframer.push(message * S / 50, &pose));
    }
    found.extend(keyframer.finish());
    assert!(found.is_sorted_by_key(|keyframe| keyframe.stamp));
    let mut images = BTreeMap::new();
    for exposure in found.into_iter().flat_map(|keyframe| keyframe.exposures) {
        *images.entry(exposure.camera).or_default() += 1;
    }
    images
}

/// Three cameras at 10 Hz that do not expose at once.
fn slow() -> Vec<(&'static str, Vec<i64>)> {
    vec![
        ("left", shots(11, 100)),
        ("rear", shots(18, 100)),
        ("right", shots(30, 100)),
    ]
}

/// Such cameras beside a front one of these frames: each has as many images as without it, but for one at the ends. The
/// images of the front.
fn beside(cameras: &[(&'static str, Vec<i64>)], front: Vec<i64>) -> usize {
    let alone = images(cameras);
    let mut all = cameras.to_vec();
    all.push(("front", front));
    let mut together = images(&all);
    let of_front = together.remove("front").unwrap_or(0);
    for (camera, images) in alone {
        let found = together.remove(&camera).unwrap_or(0);
        assert!(found + 1 >= images, "{camera}: {found} of {images}");
    }
    of_front
}

#[test]
fn a_faster_camera_takes_no_image_from_slower_ones() {
    let alone = images(&slow());
    assert!(alone.len() == 3 && alone.values().all(|images| *images >= 97));
    // Hertz: 100, 60, 25, 20, 12.5 and 11. Where front frames are rarer than due points, a set of the slower cameras may have
    // none within 40 ms, and takes the due point of one.
    for (period_ms, least) in [
        (10, 128),
        (17, 128),
        (40, 128),
        (50, 120),
        (80, 95),
        (90, 90),
    ] {
        let of_front = beside(&slow(), shots(3, period_ms));
        assert!(of_front >= least, "{of_front} at {period_ms} ms");
    }
}

#[test]
fn jitter_and_dropped_frames_of_rigs_with_several_rates_take_no_image_either() {
    let shaken = |frames: Vec<i64>, drop: i64, seed: i64| -> Vec<i64> {
        let frames = frames.into_iter().zip(seed..);
        let kept = frames.filter(|(_, at): &(i64, i64)| at * 7 % 10 >= drop);
        kept.map(|(ms, at)| ms + at * 37 % 11 - 5).collect()
    };
    let cameras: Vec<_> = slow()
        .into_iter()
        .zip(1..)
        .map(|((camera, frames), seed)| (camera, shaken(frames, 1, seed)))
        .collect();
    for period_ms in [40, 80] {
        for drop in [0, 1, 3] {
            let of_front = beside(&cameras, shaken(shots(3, period_ms), drop, 0));
            assert!(of_front >= 60, "{of_front} at {period_ms} ms");
        }
    }
}

#[test]
fn a_camera_that_stops_or_begins_late_leaves_the_others_as_they_are() {
    let half = |frames: Vec<i64>, late: bool| -> Vec<i64> {
        let kept = frames.into_iter().filter(|ms| (*ms >= 5000) == late);
        kept.collect()
    };
    for late in [false, true] {
        beside(&slow(), half(shots(3, 40), late));
        // Slow cameras that are dead: whatever front gives serves, as many as without them.
        let mut cameras: Vec<_> = slow()
            .into_iter()
            .map(|(camera, frames)| (camera, half(frames, late)))
            .collect();
        cameras.push(("front", shots(3, 40)));
        let found = images(&cameras);
        let front = images(&[("front", shots(3, 40))])["front"];
        assert!(found["front"] + 2 >= front, "{found:?}, not {front}");
        assert!(found["left"] >= 48, "{found:?}");
    }
}

#[test]
fn a_rare_camera_is_given_what_it_has_and_takes_no_image_from_faster_ones() {
    let front = images(&[("front", shots(3, 40))])["front"];
    let found = images(&[("front", shots(3, 40)), ("top", shots(215, 1000))]);
    assert_eq!(found["top"], 10);
    assert!(found["front"] + 2 >= front, "{found:?}, not {front}");
}

#[test]
fn a_set_without_slow_cameras_waits_for_the_next_due_point_alone() {
    // Front at 25 Hz and left at 10 Hz; the vehicle stands still from 1 s to 5 s.
    let mut exposures = Vec::new();
    for (camera, first_ms, period_ms) in [("front", 3, 40), ("left", 11, 100)] {
        exposures.extend(shots(first_ms, period_ms).into_iter().map(|ms| Exposure {
            stamp: ms * S / 1000,
            camera: camera.to_owned(),
            image: (),
        }));
    }
    let mut keyframer = Keyframer::new(KeyframeParams::default(), exposures);
    let mut early = Vec::new();
    for message in 0..=250_i64 {
        let x = message.min(50) as f64 * 0.021;
        early.extend(keyframer.push(message * S / 50, &Pose::from_yaw(x, 0.0, 0.0)));
    }
    // The last metre is reached at 0.95 s: whether the set of 0.963 s serves, or that of 1.011 s, is open until it moves on.
    assert_eq!(early.len(), 5);
    let last = keyframer.finish();
    let cameras = |of: &Keyframe<()>| of.exposures.len();
    assert_eq!(last.iter().map(cameras).collect::<Vec<_>>(), [2]);
    assert_eq!(last[0].stamp, 1_011 * S / 1000);
}
