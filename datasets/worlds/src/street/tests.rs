//! Whole streets, small.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::views::StreetLabels;
use crate::car_park::tests::{contents, messages, stamp_of};
use crate::{LabelKind, STREET_CLASSES, Street, WorldError, street, street_labels};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::fs;
use std::sync::atomic::{AtomicUsize, Ordering};

fn small() -> Street {
    Street {
        width_px: 128,
        height_px: 42,
        length_m: 90.0,
        spacing_m: 15.0,
        ..Street::default()
    }
}

fn simulated(world: &Street, threads: usize) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| street(world, folder.path(), &mut |_| {}, &|| false))
        .unwrap();
    contents(folder.path())
}

#[test]
fn bytes_do_not_depend_on_threads_but_on_the_seed() {
    let world = small();
    let (one, three) = (simulated(&world, 1), simulated(&world, 3));
    assert!(one == three);
    for name in [
        "visit_a/visit_a.mcap",
        "visit_a/trajectory.tum",
        "visit_a/static_labels/000005.png",
        "visit_b/cars.json",
        "truth/classes.json",
    ] {
        assert!(one.contains_key(name), "{name}");
    }
    assert!(one.keys().all(|name| !name.contains(".evermap-")));
    let other = simulated(&Street { seed: 2, ..world }, 2);
    for name in [
        "visit_a/visit_a.mcap",
        "truth/world.json",
        "visit_a/cars.json",
    ] {
        assert!(one[name] != other[name], "{name}");
    }
    assert!(one["visit_a/cars.json"] != one["visit_b/cars.json"]);
}

#[test]
fn sessions_hold_their_topics_and_say_what_labels_mean() {
    let folder = tempfile::tempdir().unwrap();
    let world = small();
    let mut told = 0;
    let summary = street(
        &world,
        folder.path(),
        &mut |now| {
            told += 1;
            assert!(now.all_images <= now.all_images_total);
        },
        &|| false,
    )
    .unwrap();
    assert_eq!(told, 12);
    for session in &summary.sessions {
        let bytes = fs::read(&session.path).unwrap();
        assert_eq!((bytes.len() as u64, session.shots), (session.bytes, 6));
        let truth = fs::read_to_string(session.path.with_file_name("trajectory.tum")).unwrap();
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
        for leaf in [
            "image/compressed",
            "depth",
            "labels",
            "labels_noisy",
            "camera_info",
        ] {
            let found = messages(&bytes, &format!("/panorama/{leaf}"));
            let found: Vec<u64> = found.iter().map(|message| stamp_of(message)).collect();
            assert_eq!(found, stamps, "{leaf}");
        }
        assert_eq!(messages(&bytes, "/tf_static").len(), 1);
        assert!(messages(&bytes, "/odom").len() > 1000);
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let index = summary
            .metadata_indexes
            .iter()
            .find(|index| index.name == "label_classes");
        let at = index.expect("no record label_classes").offset as usize;
        let record = String::from_utf8_lossy(&bytes[at..at + 200]).into_owned();
        assert!(STREET_CLASSES.iter().all(|name| record.contains(name)));
    }
}

#[test]
fn without_colour_there_are_labels_odometry_and_truth() {
    let world = Street {
        colour: false,
        visits: 1,
        ..small()
    };
    let with = simulated(
        &Street {
            colour: true,
            ..world.clone()
        },
        2,
    );
    let without = simulated(&world, 2);
    let of = |files: &BTreeMap<String, Vec<u8>>, topic: &str| {
        messages(&files["visit_a/visit_a.mcap"], topic)
    };
    assert!(of(&without, "/panorama/depth").is_empty());
    for topic in ["/panorama/labels", "/panorama/labels_noisy", "/odom"] {
        assert!(of(&with, topic) == of(&without, topic), "{topic}");
    }
    assert!(without.contains_key("visit_a/static_labels/000000.png"));
}

fn labels_of(world: &Street) -> StreetLabels {
    street_labels(world).unwrap()
}

#[test]
fn every_class_appears_and_cars_come_and_go() {
    let world = Street {
        width_px: 256,
        height_px: 83,
        spacing_m: 10.0,
        ..Street::default()
    };
    for seed in [1, 8] {
        let labels = labels_of(&Street {
            seed,
            ..world.clone()
        });
        let mut counts = [[0_usize; 9]; 2];
        for (kind, counts) in [LabelKind::Exact, LabelKind::WithoutCars]
            .into_iter()
            .zip(&mut counts)
        {
            for view in labels.views(0, kind) {
                view.labels
                    .iter()
                    .for_each(|label| counts[usize::from(*label)] += 1);
            }
        }
        let [exact, bare] = counts;
        for (name, count) in STREET_CLASSES.iter().zip(exact) {
            assert!(count > 300, "{name}: {count} pixels");
        }
        assert_eq!(bare[7], 0, "a car without cars");
        assert_eq!(exact.iter().sum::<usize>(), bare.iter().sum::<usize>());
    }
}

/// A pixel's point, put into the next panorama, lies as far away as that one says and is of the
/// same class, where it is not hidden.
#[test]
fn neighbouring_panoramas_agree_about_ranges_and_classes() {
    let world = Street {
        width_px: 512,
        height_px: 166,
        ..Street::default()
    };
    let labels = labels_of(&world);
    let lens = &labels.lens;
    let (mut seen, mut same, mut all) = (0, 0, 0);
    for index in [20, 90, 150] {
        let sights = [0, 1].map(|next| labels.sight(0, index + next));
        let bare = sights.each_ref().map(|sight| &sight.bare);
        let found = [0, 1].map(|k| labels.scenery.classes(&sights[k], bare[k]));
        let map_from_panorama = [0, 1].map(|next| {
            labels
                .pose(0, index + next)
                .unwrap()
                .1
                .compose(&lens.vehicle_from_camera)
        });
        let ([focal, _], [cx, cy]) = (labels.camera.focal, labels.camera.centre);
        for pixel in 0..found[0].len() {
            let range = f64::from(bare[0].range_m[pixel]);
            if range > 25.0 {
                continue;
            }
            let longitude = ((pixel % 512) as f64 - cx) / focal;
            let latitude = ((pixel / 512) as f64 - cy) / focal;
            let ray = Vector3::new(
                latitude.cos() * longitude.sin(),
                latitude.sin(),
                latitude.cos() * longitude.cos(),
            );
            let point = map_from_panorama[0].transform(&(range * ray));
            let own = map_from_panorama[1].inverse().transform(&point);
            let u = (cx + focal * own.x.atan2(own.z)).round() as i64;
            let v = (cy + focal * (own.y / own.norm()).asin()).round() as i64;
            if !(0..166).contains(&v) {
                continue;
            }
            let there = v as usize * 512 + u.rem_euclid(512) as usize;
            all += 1;
            if (f64::from(bare[1].range_m[there]) / own.norm() - 1.0).abs() < 0.03 {
                seen += 1;
                same += usize::from(found[1][there] == found[0][pixel]);
            }
        }
    }
    assert!(all > 50_000);
    assert!(f64::from(seen) > 0.85 * f64::from(all), "{seen} of {all}");
    assert!(same as f64 > 0.975 * f64::from(seen), "{same} of {seen}");
}

fn wrong(labels: &StreetLabels, visit: usize, index: usize) -> Vec<bool> {
    let [exact, noisy] = [LabelKind::Exact, LabelKind::Noisy]
        .map(|kind| labels.view(visit, index, kind).unwrap().labels);
    exact.iter().zip(noisy).map(|(a, b)| *a != b).collect()
}

#[test]
fn noise_has_its_share_hangs_together_and_comes_back() {
    for (seed, share) in [(1, 0.18), (3, 0.18), (4, 0.3)] {
        let world = Street {
            seed,
            label_noise: share,
            width_px: 512,
            height_px: 166,
            ..Street::default()
        };
        let labels = labels_of(&world);
        let (mut errors, mut pixels, mut beside, mut again, mut by_chance) = (0, 0, 0, 0, 0.0);
        for index in (0..200).step_by(20) {
            // The next view is a metre and a half on: most of what is far is where it was.
            let (here, next) = (wrong(&labels, 0, index), wrong(&labels, 0, index + 1));
            let count = |wrong: &[bool]| wrong.iter().filter(|wrong| **wrong).count();
            by_chance += (count(&here) * count(&next)) as f64 / here.len() as f64;
            errors += count(&here);
            beside += here.windows(2).filter(|pair| pair[0] && pair[1]).count();
            again += here.iter().zip(&next).filter(|(a, b)| **a && **b).count();
            pixels += here.len();
        }
        let found = errors as f64 / pixels as f64;
        assert!(
            (found - share).abs() < 0.15 * share,
            "seed {seed}: {found} for {share}"
        );
        assert!(
            beside as f64 > 0.7 * errors as f64,
            "{beside} of {errors} hang together"
        );
        assert!(
            again as f64 > 1.4 * by_chance,
            "{again} come back, {by_chance} by chance"
        );
    }
    let exact = Street {
        label_noise: 0.0,
        ..small()
    };
    assert!(wrong(&labels_of(&exact), 0, 3).iter().all(|wrong| !wrong));
}

#[test]
fn any_number_of_views_in_any_order() {
    let labels = labels_of(&small());
    let views: Vec<_> = labels.views(1, LabelKind::Noisy).collect();
    assert_eq!(views.len(), 6);
    assert_eq!(labels.view(1, 4, LabelKind::Noisy).as_ref(), views.get(4));
    assert!(labels.view(0, 6, LabelKind::Exact).is_none());
    assert!(labels.view(2, 0, LabelKind::Exact).is_none());
    assert_eq!(labels.views(2, LabelKind::Exact).count(), 0);
}

#[test]
fn a_street_that_is_stopped_leaves_no_half_visit() {
    let folder = tempfile::tempdir().unwrap();
    let stopped_at = |asked: usize| {
        let so_far = AtomicUsize::new(0);
        let is_stopped = || so_far.fetch_add(1, Ordering::Relaxed) >= asked;
        let error = street(&small(), folder.path(), &mut |_| {}, &is_stopped).unwrap_err();
        assert!(matches!(error, WorldError::Stopped), "{error}");
        let left = fs::read_dir(folder.path()).unwrap();
        let left = left.map(|entry| entry.unwrap().file_name());
        left.collect::<Vec<_>>()
    };
    // While the street is built, and then.
    assert!(stopped_at(0).is_empty());
    assert_eq!(stopped_at(1), ["truth"]);
}

#[test]
fn unusable_parameters_are_all_named() {
    let world = Street {
        visits: 0,
        spacing_m: f64::NAN,
        height_px: 1000,
        ..Street::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let error = street(&world, folder.path(), &mut |_| {}, &|| false).unwrap_err();
    let WorldError::Parameters { faults } = error else {
        panic!("{error}")
    };
    assert_eq!(faults.len(), 3, "{faults:?}");
    assert!(contents(folder.path()).is_empty());
}

#[test]
fn mistakes_come_back_in_another_visit_as_much_as_is_asked() {
    // Of the pixels that are wrong in both visits, how many more than by chance.
    let both = |repeated_mistakes: f64| {
        let labels = labels_of(&Street {
            repeated_mistakes,
            width_px: 512,
            height_px: 166,
            ..Street::default()
        });
        let (mut both, mut by_chance) = (0, 0.0);
        for index in (0..200).step_by(20) {
            let wrong = [0, 1].map(|visit| wrong(&labels, visit, index));
            let [a, b] = [0, 1].map(|visit| wrong[visit].iter().filter(|wrong| **wrong).count());
            by_chance += (a * b) as f64 / wrong[0].len() as f64;
            let pairs = wrong[0].iter().zip(&wrong[1]);
            both += pairs.filter(|(a, b)| **a && **b).count();
        }
        both as f64 / by_chance
    };
    let [none, half, all] = [0.0, 0.5, 1.0].map(both);
    assert!(
        none < half && half < all && all > 1.2 * none,
        "{none} {half} {all}"
    );
}
