#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::geometry::camera::{Camera, KannalaBrandt, Model};
use crate::geometry::pose::Pose;
use crate::geometry::rig::{Rig, RigCamera};
use crate::metric_map::features::{Descriptor, Feature, ImageFeatures, KeyframeFeatures};
use crate::solving::random::SplitMix64;
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Numbers that look random.
struct Noise(SplitMix64);

impl Noise {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform(1e-12, 1.0).ln()).sqrt() * (TAU * self.uniform(0.0, 1.0)).cos()
    }

    fn descriptor(&mut self) -> Descriptor {
        let mut bytes = [0; 64];
        for eight in bytes.chunks_exact_mut(8) {
            eight.copy_from_slice(&self.0.next().to_le_bytes());
        }
        Descriptor(bytes)
    }

    /// The same corner in another image.
    fn again(&mut self, descriptor: &Descriptor, flips: usize) -> Descriptor {
        let mut again = *descriptor;
        for _ in 0..flips {
            let bit = (self.0.next() % 512) as usize;
            again.0[bit / 8] ^= 1 << (bit % 8);
        }
        again
    }
}

/// Fisheye cameras that look ahead, left, back and right.
fn rig() -> Rig {
    let lens = KannalaBrandt::new([127.0; 2], [199.5, 149.5], [0.0; 4]);
    let camera = |i: usize| {
        let yaw = i as f64 * FRAC_PI_2;
        let optical = UnitQuaternion::from_euler_angles(-FRAC_PI_2, 0.0, -FRAC_PI_2);
        let mount = Pose::from_yaw(1.5 * yaw.cos(), 0.8 * yaw.sin(), yaw);
        RigCamera {
            name: format!("camera_{i}"),
            camera: Camera::new(Model::KannalaBrandt(lens), 400, 300).with_max_angle(1.6),
            vehicle_from_camera: mount.compose(&Pose::new(Vector3::new(0.0, 0.0, 0.8), optical)),
        }
    };
    Rig {
        cameras: (0..4).map(camera).collect(),
    }
}

struct World(Vec<(Vector3<f64>, Descriptor)>);

impl World {
    /// Corners on walls and things around a square of 20 m.
    fn new(noise: &mut Noise) -> Self {
        let corner = |noise: &mut Noise| {
            let at = |noise: &mut Noise| noise.uniform(-16.0, 16.0);
            (
                Vector3::new(at(noise), at(noise), noise.uniform(0.0, 3.0)),
                noise.descriptor(),
            )
        };
        Self((0..350).map(|_| corner(noise)).collect())
    }
}

struct Simulated {
    truth: Vec<Pose>,
    odometry: Vec<Pose>,
    features: Vec<KeyframeFeatures>,
    tracks: Vec<DriveTrack>,
    first_stamp: i64,
}

/// Around a square with round corners, `loops` times, from `start` of a round on, or the other way round.
fn drive(world: &World, loops: f64, start: f64, backwards: bool, noise: &mut Noise) -> Simulated {
    let rig = rig();
    let steps = (loops * 130.0) as usize;
    let side = noise.uniform(-0.3, 0.3);
    let pose = |step: usize| {
        let turn = TAU * (start + if backwards { -1.0 } else { 1.0 } * step as f64 / 130.0);
        let radius = 9.0 + side;
        let heading = turn + if backwards { -FRAC_PI_2 } else { FRAC_PI_2 };
        Pose::from_yaw(radius * turn.cos(), radius * turn.sin(), heading)
    };
    let truth: Vec<Pose> = (0..steps).map(pose).collect();
    let mut odometry: Vec<Pose> = vec![Pose::identity()];
    for step in truth.windows(2) {
        let moved = step[0].inverse().compose(&step[1]);
        let drifted = Pose::from_yaw(
            moved.translation.x * 1.01,
            moved.translation.y * 1.01,
            moved.yaw() + 2e-4,
        );
        odometry.push(odometry[odometry.len() - 1].compose(&drifted));
    }
    let mut tracks: BTreeMap<(usize, usize), DriveTrack> = BTreeMap::new();
    let mut features = Vec::new();
    for (keyframe, pose) in truth.iter().enumerate() {
        let mut images = vec![ImageFeatures::default(); 4];
        for (c, camera) in rig.cameras.iter().enumerate() {
            let camera_from_map = pose.compose(&camera.vehicle_from_camera).inverse();
            for (corner, (at, descriptor)) in world.0.iter().enumerate() {
                let seen = camera_from_map.transform(at);
                let Some(pixel) = camera
                    .camera
                    .project(&seen)
                    .filter(|pixel| camera.camera.contains(*pixel))
                else {
                    continue;
                };
                // Far things are small, and not everything is found each time.
                if seen.norm() > 14.0 || noise.uniform(0.0, 1.0) < 0.3 {
                    continue;
                }
                let features = &mut images[c].features;
                let track = tracks.entry((corner, c)).or_default();
                track.camera = c;
                track.points.push((keyframe as u32, features.len() as u32));
                features.push(Feature {
                    pixel: pixel.map(|at| at + 0.5 * noise.normal()),
                    size_px: 8.0,
                    descriptor: noise.again(descriptor, 25),
                });
            }
        }
        features.push(KeyframeFeatures { images });
    }
    // A track ends where its corner was lost for a while.
    let cut = |track: DriveTrack| {
        let runs = track
            .points
            .chunk_by(|a, b| b.0 - a.0 < 4)
            .map(<[_]>::to_vec);
        let camera = track.camera;
        runs.map(move |points| DriveTrack { camera, points })
            .collect::<Vec<_>>()
    };
    let tracks = tracks.into_values().flat_map(cut).collect();
    Simulated {
        truth,
        odometry,
        features,
        tracks,
        first_stamp: 0,
    }
}

impl Simulated {
    fn later(mut self, stamp: i64) -> Self {
        self.first_stamp = stamp;
        self
    }

    fn drive<'a>(&'a self, rig: &'a Rig) -> Drive<'a, Infallible> {
        self.seen_by(rig, &self.features)
    }

    fn seen_by<'a, E>(&'a self, rig: &'a Rig, seen: &'a dyn FeatureSource<E>) -> Drive<'a, E> {
        let keyframes = self.odometry.iter().zip(0..);
        let keyframes = keyframes.map(|(pose, i)| DriveKeyframe {
            stamp: self.first_stamp + i,
            odom_from_vehicle: *pose,
        });
        Drive {
            rig,
            keyframes: keyframes.collect(),
            seen,
            tracks: self.tracks.clone(),
        }
    }
}

/// All in memory, by keyframe.
impl<E> FeatureSource<E> for Vec<KeyframeFeatures> {
    fn features(&self, keyframe: usize) -> Result<Cow<'_, KeyframeFeatures>, E> {
        let features = self.get(keyframe).map(Cow::Borrowed);
        Ok(features.unwrap_or_default())
    }
}

/// What cameras saw, copied each time that it is looked at, but for one keyframe.
struct Copied<'a> {
    features: &'a [KeyframeFeatures],
    missing: Option<usize>,
}

impl FeatureSource<String> for Copied<'_> {
    fn features(&self, keyframe: usize) -> Result<Cow<'_, KeyframeFeatures>, String> {
        if self.missing == Some(keyframe) {
            return Err(format!("no features of {keyframe}"));
        }
        Ok(Cow::Owned(self.features[keyframe].clone()))
    }
}

/// Translation (m) and rotation (rad) by which a loop is off.
fn off(found: &Loop, drives: &[&Simulated]) -> (f64, f64) {
    let at = |(drive, keyframe): (usize, usize)| drives[drive].truth[keyframe];
    let truth = at(found.earlier).inverse().compose(&at(found.later));
    let apart = truth.inverse().compose(&found.earlier_from_later);
    (apart.translation.norm(), apart.rotation.angle())
}

#[test]
fn a_second_round_and_another_drive_are_recognised() {
    let mut noise = Noise(SplitMix64(5));
    let world = World::new(&mut noise);
    let rig = rig();
    let first = drive(&world, 1.8, 0.0, false, &mut noise);
    let second = drive(&world, 0.5, 0.3, true, &mut noise).later(1_000_000);
    let drives = [&first, &second];
    // The later drive first: what counts is when they began.
    let given = [first.drive(&rig), second.drive(&rig)];
    let found = loops(&given, &LoopOptions::default()).unwrap();
    for found in &found {
        let (metres, radians) = off(found, &drives);
        assert!(
            metres < 0.15 && radians < 0.02,
            "{found:?} is {metres} m, {radians} rad off"
        );
        assert!(metres < 6.0 * found.sigma_m() && radians < 6.0 * found.sigma_rad() + 0.002);
        assert!(found.later.0 != found.earlier.0 || found.later.1 > found.earlier.1 + 20);
    }
    let with_loop = |drive: usize, from: usize| {
        let mut later: Vec<_> = found
            .iter()
            .map(|found| found.later)
            .filter(|later| later.0 == drive && later.1 >= from)
            .collect();
        later.dedup();
        later.len()
    };
    let (rounds, other) = (with_loop(0, 135), with_loop(1, 0));
    assert!(rounds >= 95, "{rounds} of 99");
    assert!(other >= 60, "{other} of 65");
    let swapped = [second.drive(&rig), first.drive(&rig)];
    let again = loops(&swapped, &LoopOptions::default()).unwrap();
    assert_eq!(again.len(), found.len());
    assert!(
        again
            .iter()
            .zip(&found)
            .all(|(a, b)| a.earlier_from_later == b.earlier_from_later)
    );
}

#[test]
fn another_place_is_none() {
    let mut noise = Noise(SplitMix64(6));
    let rig = rig();
    let [here, there] = [World::new(&mut noise), World::new(&mut noise)];
    let first = drive(&here, 0.6, 0.0, false, &mut noise);
    let second = drive(&there, 0.6, 0.0, false, &mut noise).later(1_000_000);
    let found = loops(
        &[first.drive(&rig), second.drive(&rig)],
        &LoopOptions::default(),
    )
    .unwrap();
    assert!(found.iter().all(|found| found.later.0 == found.earlier.0));
}

#[test]
fn nothing_is_found_in_nothing() {
    let rig = rig();
    let found = loops::<Infallible>(&[], &LoopOptions::default());
    assert!(found.unwrap().is_empty());
    let empty = vec![KeyframeFeatures::default(); 4];
    let keyframe = |stamp| DriveKeyframe {
        stamp,
        odom_from_vehicle: Pose::from_yaw(20.0 * stamp as f64, 0.0, 0.0),
    };
    let tracks = vec![
        DriveTrack {
            camera: 0,
            points: vec![(0, 0), (1, 7)],
        },
        DriveTrack {
            camera: 77,
            points: vec![(5, 0), (9, 7)],
        },
    ];
    let drive: Drive<'_, Infallible> = Drive {
        rig: &rig,
        keyframes: (0..4).map(keyframe).collect(),
        seen: &empty,
        tracks,
    };
    let found = loops(&[drive], &LoopOptions::default());
    assert!(found.unwrap().is_empty());
}

#[test]
fn features_that_are_fetched_when_they_are_looked_at_give_the_same_loops() {
    let mut noise = Noise(SplitMix64(7));
    let world = World::new(&mut noise);
    let rig = rig();
    let driven = drive(&world, 1.2, 0.0, false, &mut noise);
    let held = loops(&[driven.drive(&rig)], &LoopOptions::default()).unwrap();
    assert!(!held.is_empty());
    let copied = |missing| Copied {
        features: &driven.features,
        missing,
    };
    let (whole, torn) = (copied(None), copied(Some(100)));
    let fetched = loops(&[driven.seen_by(&rig, &whole)], &LoopOptions::default());
    assert_eq!(fetched.unwrap(), held);
    let failed = loops(&[driven.seen_by(&rig, &torn)], &LoopOptions::default());
    assert_eq!(failed.unwrap_err(), "no features of 100");
}

#[test]
fn the_vocabulary_of_documents_is_that_of_all_their_descriptors() {
    let mut noise = Noise(SplitMix64(8));
    let counts = [3, 0, 7, 1, 1, 20, 2];
    let features: Vec<KeyframeFeatures> = counts
        .iter()
        .map(|count| {
            let feature = |noise: &mut Noise| Feature {
                pixel: [0.0; 2],
                size_px: 8.0,
                descriptor: noise.descriptor(),
            };
            let features = (0..*count).map(|_| feature(&mut noise)).collect();
            KeyframeFeatures {
                images: vec![ImageFeatures::default(), ImageFeatures { features }],
            }
        })
        .collect();
    let rig = Rig::default();
    let drive: Drive<'_, Infallible> = Drive {
        rig: &rig,
        keyframes: Vec::new(),
        seen: &features,
        tracks: Vec::new(),
    };
    let documents: Vec<(usize, usize)> = (0..counts.len()).map(|at| (0, at)).collect();
    let all: Vec<Descriptor> = features
        .iter()
        .flat_map(|features| &features.images)
        .flat_map(|image| &image.features)
        .map(|feature| feature.descriptor)
        .collect();
    // All, every second, third … and just the first.
    for max_training in [100, 17, 12, 5, 2, 1] {
        let options = VocabularyOptions {
            max_training,
            leaf: 2,
            ..Default::default()
        };
        let found = super::loops::vocabulary(std::slice::from_ref(&drive), &documents, &options);
        assert_eq!(found.unwrap(), Vocabulary::train(all.iter(), &options));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]
    #[test]
    fn a_word_is_kept_by_what_looks_alike(seed in any::<u64>()) {
        let mut noise = Noise(SplitMix64(seed));
        let originals: Vec<Descriptor> = (0..40).map(|_| noise.descriptor()).collect();
        let seen: Vec<Descriptor> = (0..1200).map(|i| noise.again(&originals[i % 40], 20)).collect();
        let vocabulary = Vocabulary::train(seen.iter(), &VocabularyOptions::default());
        prop_assert!(vocabulary.words() >= 20 && vocabulary.words() <= 1200);
        let words = vocabulary.look_up(&seen);
        let of_original = vocabulary.look_up(&originals);
        let same = words.iter().enumerate().filter(|(i, word)| of_original[i % 40] == **word).count();
        prop_assert!(same > 1000, "{}", same);
        prop_assert_eq!(&vocabulary, &Vocabulary::train(seen.iter(), &VocabularyOptions::default()));
    }

    #[test]
    fn scores_are_those_of_the_definition(
        bags in prop::collection::vec(prop::collection::btree_map(0..30u32, 1..5u32, 0..12), 1..12)
    ) {
        let bags: Vec<Bag> = bags.into_iter().map(|bag| Bag { counts: bag.into_iter().collect() }).collect();
        let index = PlaceIndex::new(30, &bags);
        let weight = |bag: &Bag, word: u32| {
            let rarity = |word: u32| {
                let holding = bags.iter().filter(|bag| bag.counts.iter().any(|(w, _)| *w == word)).count();
                (bags.len() as f64 / holding as f64).ln()
            };
            let sum: f64 = bag.counts.iter().map(|(w, n)| f64::from(*n) * rarity(*w)).sum();
            let own = bag.counts.iter().find(|(w, _)| *w == word).map_or(0, |(_, n)| *n);
            if own == 0 || sum == 0.0 { 0.0 } else { f64::from(own) * rarity(word) / sum }
        };
        let naive = |a: &Bag, b: &Bag| -> f64 { (0..30).map(|word| weight(a, word).min(weight(b, word))).sum() };
        for bag in &bags {
            let scores = index.scores(bag, bags.len());
            for (score, other) in scores.iter().zip(&bags) {
                prop_assert!((f64::from(*score) - naive(bag, other)).abs() < 1e-5);
            }
            let best = index.best(bag, 3, |document| document != 0);
            prop_assert!(best.iter().all(|hit| hit.document != 0 && hit.score == scores[hit.document]));
            prop_assert!(best.windows(2).all(|pair| pair[0].score >= pair[1].score));
        }
    }
}
