//! Whole worlds, small.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::canvas::Canvas;
use super::cars::parked_cars;
use super::exposure::Exposure;
use super::rig::{RigCamera, rig};
use super::scene::Scene;
use super::{Layout, Studio, Visit};
use crate::render::Lens;
use crate::vehicle::Wheels;
use crate::{CarPark, Progress, WorldError, car_park};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

fn small() -> CarPark {
    CarPark {
        width_px: 160,
        height_px: 120,
        revisits: 1,
        loops: 0.03,
        floor_texels_per_m: 25.0,
        ..CarPark::default()
    }
}

/// All files below a folder and their bytes.
pub(crate) fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            let below = contents(&path);
            files.extend(below.into_iter().map(|(k, v)| (format!("{name}/{k}"), v)));
        } else {
            files.insert(name, fs::read(&path).unwrap());
        }
    }
    files
}

fn simulated(world: &CarPark, threads: usize) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| car_park(world, folder.path(), &mut |_| {}, &|| false))
        .unwrap();
    contents(folder.path())
}

#[test]
fn bytes_do_not_depend_on_threads_but_on_the_seed() {
    let world = small();
    let one = simulated(&world, 1);
    let three = simulated(&world, 3);
    assert_eq!(
        one.keys().collect::<Vec<_>>(),
        three.keys().collect::<Vec<_>>()
    );
    for (name, bytes) in &one {
        assert!(*bytes == three[name], "{name} differs");
    }
    let expected = [
        "initial.mcap",
        "revisit_1.mcap",
        "truth/bays.geojson",
        "truth/initial.tum",
    ];
    assert!(expected.iter().all(|name| one.contains_key(*name)));
    assert!(one.keys().all(|name| !name.contains(".evermap-")));
    let other = simulated(&CarPark { seed: 2, ..world }, 2);
    for name in ["initial.mcap", "truth/overhead.png", "truth/cars.json"] {
        assert!(
            one[name] != other[name],
            "{name} does not depend on the seed"
        );
    }
}

/// The stamp at the beginning of a message.
pub(crate) fn stamp_of(payload: &[u8]) -> u64 {
    let word = |at: usize| u64::from(u32::from_le_bytes(payload[at..at + 4].try_into().unwrap()));
    word(4) * 1_000_000_000 + word(8)
}

#[test]
fn sessions_read_back_with_the_stamps_of_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let world = small();
    let mut told = 0;
    let summary = car_park(
        &world,
        folder.path(),
        &mut |progress| {
            told += 1;
            assert!(progress.all_images <= progress.all_images_total);
        },
        &|| false,
    )
    .unwrap();
    assert_eq!(
        told,
        summary.sessions.iter().map(|s| 4 * s.shots).sum::<usize>()
    );
    for session in &summary.sessions {
        let truth = summary.truth.join(format!("{}.tum", session.name));
        let truth = fs::read_to_string(truth).unwrap();
        let stamps: Vec<u64> = truth
            .lines()
            .skip(1)
            .map(|line| {
                line.split(' ')
                    .next()
                    .unwrap()
                    .replace('.', "")
                    .parse()
                    .unwrap()
            })
            .collect();
        assert_eq!(stamps.len(), session.shots);
        let bytes = fs::read(&session.path).unwrap();
        assert_eq!(bytes.len() as u64, session.bytes);
        let counts = check_session(&bytes, &stamps, &world);
        assert_eq!(counts.values().sum::<u64>(), session.messages);
        assert_eq!(counts["/tf_static"], 1);
        let odometry = (session.duration_s * world.odometry_rate_hz).floor() as u64 + 1;
        assert_eq!(counts["/odom"], odometry);
        for camera in ["front", "left", "rear", "right"] {
            for leaf in ["image/compressed", "camera_info"] {
                let count = counts[&format!("/camera/{camera}/{leaf}")];
                assert_eq!(count, session.shots as u64);
            }
        }
    }
}

/// Order, stamps, pictures and summary of a file; the number of messages of each topic.
fn check_session(bytes: &[u8], stamps: &[u64], world: &CarPark) -> BTreeMap<String, u64> {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    assert!(!summary.chunk_indexes.is_empty());
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    let mut last = 0;
    for message in mcap::MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        assert!(message.log_time >= last);
        last = message.log_time;
        let topic = message.channel.topic.clone();
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(
            (&*message.channel.message_encoding, &*schema.encoding),
            ("cdr", "ros2msg")
        );
        let count = counts.entry(topic.clone()).or_default();
        if topic.starts_with("/camera") {
            assert_eq!(stamp_of(&message.data), stamps[*count as usize]);
        }
        if topic.ends_with("compressed") && *count == 0 {
            let start = message
                .data
                .windows(3)
                .position(|w| w == [0xff, 0xd8, 0xff])
                .unwrap();
            let jpeg = zune_jpeg::zune_core::bytestream::ZCursor::new(&message.data[start..]);
            let mut decoder = zune_jpeg::JpegDecoder::new(jpeg);
            let pixels = decoder.decode().unwrap();
            assert_eq!(decoder.dimensions(), Some((160, 120)));
            let mean = pixels.iter().map(|p| f64::from(*p)).sum::<f64>() / pixels.len() as f64;
            assert!((30.0..180.0).contains(&mean), "{topic}: mean grey {mean}");
        }
        if topic.starts_with("/camera") || topic == "/odom" {
            assert_eq!(message.publish_time, stamp_of(&message.data));
        }
        *count += 1;
    }
    let stats = summary.stats.unwrap();
    assert_eq!(stats.message_count, counts.values().sum::<u64>());
    assert!(stats.message_start_time >= world.start_ns);
    counts
}

fn studio_parts(world: &CarPark, session: usize) -> (Layout, Visit, Vec<Lens>) {
    let layout = Layout::new(world);
    let visit = Visit::new(world, &layout, session);
    let lenses = rig(world).iter().map(RigCamera::lens).collect();
    (layout, visit, lenses)
}

/// White discs on the ground of the bays must appear where calibration and true pose say.
#[test]
fn floor_marks_appear_where_the_truth_projects_them() {
    let world = CarPark {
        width_px: 640,
        height_px: 480,
        occupancy: 0.0,
        floor_texels_per_m: 80.0,
        loops: 1.0,
        ..CarPark::default()
    };
    let (layout, visit, lenses) = studio_parts(&world, 0);
    let mut floor = Canvas::new(layout.width_m, layout.depth_m, 80.0, 20);
    let marks: Vec<[f64; 2]> = layout
        .bays
        .iter()
        .map(|bay| [bay.rect.x0 + 0.6, bay.rect.centre()[1] - 0.6])
        .collect();
    for mark in &marks {
        floor.disc(*mark, 0.1, 220.0, 1.0);
    }
    let scene = Scene::build(&world, &layout, &floor, &visit);
    let rig = rig(&world);
    let studio = Studio {
        seed: world.seed,
        lenses: &lenses,
        visit: &visit,
        scene,
        exposure: Exposure::of_session(&world, 0),
    };
    let mut errors = [Vec::new(), Vec::new(), Vec::new(), Vec::new()];
    for (shot, stamp) in visit.session.stamps.iter().enumerate().step_by(7) {
        let pose = visit.session.map_from_vehicle(*stamp);
        for (camera, lens) in rig.iter().enumerate() {
            let image = studio.image(shot, camera);
            let camera_from_map = pose.compose(&lens.topics.vehicle_from_camera).inverse();
            for [x, y] in &marks {
                let point = Vector3::new(*x, *y, layout.ground.height(*y));
                let own = camera_from_map.transform(&point);
                let Some(pixel) = lens.camera.project(&own) else {
                    continue;
                };
                if own.norm() < 5.5
                    && own.z > 0.0
                    && let Some(found) = blob(&image, 640, 480, pixel)
                {
                    errors[camera].push((found[0] - pixel[0]).hypot(found[1] - pixel[1]));
                }
            }
        }
    }
    for (errors, camera) in errors.iter_mut().zip(&rig) {
        errors.sort_by(f64::total_cmp);
        assert!(errors.len() > 15, "{}: {} marks", camera.name, errors.len());
        let (median, most) = (errors[errors.len() / 2], errors[errors.len() * 8 / 10]);
        assert!(
            median < 0.3 && most < 1.0,
            "{}: {median} {most} px",
            camera.name
        );
    }
}

/// Centre of the bright blob around a pixel; `None` without contrast or at the border.
fn blob(image: &[u8], width: usize, height: usize, [u, v]: [f64; 2]) -> Option<[f64; 2]> {
    let reach = 11.0;
    let inside = u > reach && v > reach && u < width as f64 - reach && v < height as f64 - reach;
    if !inside {
        return None;
    }
    let (u0, v0) = ((u - reach) as usize + 1, (v - reach) as usize + 1);
    let size = 2 * reach as usize - 1;
    let window = (0..size * size).map(|k| (u0 + k % size, v0 + k / size));
    let grey = |(x, y): (usize, usize)| f64::from(image[y * width + x]);
    let peak = window.clone().map(grey).fold(0.0, f64::max);
    let (mut sum, mut at) = (0.0, [0.0; 2]);
    for place in window {
        let weight = (grey(place) - 0.4 * peak).max(0.0);
        sum += weight;
        at = [
            at[0] + weight * place.0 as f64,
            at[1] + weight * place.1 as f64,
        ];
    }
    (peak > 70.0 && sum > 3.0 * peak * 0.6).then(|| at.map(|part| part / sum))
}

#[test]
fn visitors_change_and_residents_stay() {
    let world = CarPark {
        seed: 5,
        ..CarPark::default()
    };
    let layout = Layout::new(&world);
    let sessions: Vec<_> = (0..3).map(|k| parked_cars(&world, &layout, k)).collect();
    let bays = |k: usize| sessions[k].iter().map(|car| car.bay).collect::<Vec<_>>();
    assert_ne!(bays(0), bays(1));
    assert_ne!(bays(1), bays(2));
    let residents = |k: usize| {
        let mut cars = sessions[k].clone();
        cars.retain(|car| car.resident);
        cars
    };
    assert!(!residents(0).is_empty());
    assert_eq!(residents(0), residents(1));
    let share =
        sessions.iter().map(Vec::len).sum::<usize>() as f64 / (3 * layout.bays.len()) as f64;
    assert!((share - world.occupancy).abs() < 0.15, "{share}");
}

#[test]
fn a_world_that_is_stopped_keeps_whole_sessions_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let is_over = AtomicBool::new(false);
    let tell = &mut |now: Progress| {
        is_over.store(now.session == "revisit_1", Ordering::Relaxed);
    };
    let is_stopped = || is_over.load(Ordering::Relaxed);
    let error = car_park(&small(), folder.path(), tell, &is_stopped).unwrap_err();
    assert!(matches!(error, WorldError::Stopped), "{error}");
    let left = contents(folder.path());
    let left = left.keys().filter(|name| !name.starts_with("truth/"));
    assert_eq!(left.collect::<Vec<_>>(), ["initial.mcap"]);
}

#[test]
fn unusable_parameters_are_all_named() {
    let world = CarPark {
        width_px: 0,
        rate_hz: f64::NAN,
        loops: -1.0,
        dark_camera: Some("top".to_owned()),
        ..CarPark::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let error = car_park(&world, folder.path(), &mut |_| {}, &|| false).unwrap_err();
    let WorldError::Parameters { faults } = error else {
        panic!("{error}")
    };
    assert_eq!(faults.len(), 4, "{faults:?}");
    assert!(contents(folder.path()).is_empty());
}

/// The messages of a topic.
pub(crate) fn messages(file: &[u8], topic: &str) -> Vec<Vec<u8>> {
    mcap::MessageStream::new(file)
        .unwrap()
        .map(Result::unwrap)
        .filter(|message| message.channel.topic == topic)
        .map(|message| message.data.into_owned())
        .collect()
}

#[test]
fn a_session_left_out_leaves_the_others_as_they_are() {
    let world = small();
    let all = simulated(&world, 2);
    let later = simulated(&CarPark { skip: 1, ..world }, 2);
    assert!(!later.contains_key("initial.mcap"));
    for name in ["revisit_1.mcap", "truth/initial.tum", "truth/overhead.png"] {
        assert!(all[name] == later[name], "{name}");
    }
}

#[test]
fn a_dark_camera_sees_noise_and_the_others_what_they_saw() {
    let world = small();
    let light = simulated(&world, 2);
    let camera = Some("rear".to_owned());
    let dark = simulated(
        &CarPark {
            dark_camera: camera,
            ..world
        },
        2,
    );
    let of = |files: &BTreeMap<String, Vec<u8>>, name: &str| {
        let topic = format!("/camera/{name}/image/compressed");
        messages(&files["initial.mcap"], &topic)
    };
    assert_eq!(of(&light, "left"), of(&dark, "left"));
    for message in of(&dark, "rear") {
        let start = message.windows(3).position(|w| w == [0xff, 0xd8, 0xff]);
        let jpeg = zune_jpeg::zune_core::bytestream::ZCursor::new(&message[start.unwrap()..]);
        let pixels = zune_jpeg::JpegDecoder::new(jpeg).decode().unwrap();
        assert!(pixels.iter().all(|pixel| *pixel < 24));
    }
}

#[test]
fn a_calibration_that_is_off_changes_what_is_published_and_no_image() {
    let world = small();
    let off = CarPark {
        calibration_error_px: 0.5,
        ..world.clone()
    };
    for (right, wrong) in rig(&world).iter().zip(rig(&off)) {
        assert_eq!(right.topics.centre, right.optics.centre());
        assert_eq!((right.optics, &right.camera), (wrong.optics, &wrong.camera));
        let [u, v] = wrong.topics.centre;
        let apart = (u - right.topics.centre[0]).hypot(v - right.topics.centre[1]);
        assert!((apart - 0.5).abs() < 1e-9);
    }
    let (right, wrong) = (simulated(&world, 2), simulated(&off, 2));
    let of = |files: &BTreeMap<String, Vec<u8>>, leaf: &str| {
        messages(&files["initial.mcap"], &format!("/camera/front/{leaf}"))
    };
    assert!(of(&right, "image/compressed") == of(&wrong, "image/compressed"));
    assert!(of(&right, "camera_info") != of(&wrong, "camera_info"));
}

#[test]
fn odometry_is_as_wrong_as_it_was_asked_to_be() {
    let world = small();
    let wrong = CarPark {
        odometry_scale_error: 0.05,
        ..world.clone()
    };
    for session in 0..3 {
        let [a, b] = [&world, &wrong]
            .map(|world| Wheels::new(50.0, world.seed, session, world.odometry_scale_error).errors);
        assert!((b.scale - a.scale - 0.05).abs() < 1e-12);
        assert_eq!((a.track, a.yaw_bias), (b.track, b.yaw_bias));
    }
}
