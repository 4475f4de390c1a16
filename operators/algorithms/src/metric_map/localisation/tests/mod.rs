#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod drawing;
pub(super) mod world;

use super::*;
use crate::geometry::pose::Pose;
use crate::metric_map::features::{FeatureNoise, KeyframeFeatures};
use crate::solving::random::SplitMix64;
use std::cell::Cell;
use world::{Imaging, World};

/// Proposes what it is told, keyframe by keyframe.
struct Told {
    poses: Vec<Vec<Pose>>,
    features: Vec<*const KeyframeFeatures>,
    asked: Cell<usize>,
}

impl Recognise for Told {
    fn propose(&self, features: &KeyframeFeatures) -> Vec<Pose> {
        self.asked.set(self.asked.get() + 1);
        let found = self
            .features
            .iter()
            .position(|known| std::ptr::eq(*known, features));
        found
            .map(|index| self.poses[index].clone())
            .unwrap_or_default()
    }
}

/// Errors of a localised drive.
#[derive(Debug)]
struct Score {
    localised: usize,
    lost: usize,
    median_m: f64,
    p99_m: f64,
    max_m: f64,
    median_deg: f64,
    /// Mean squared Mahalanobis error over its expectation, 6.
    nees: f64,
}

fn score(found: &[KeyframeLocalisation], truth: &[Pose]) -> Score {
    let known = found
        .iter()
        .zip(truth)
        .filter(|(found, _)| found.state != State::Lost);
    let errors: Vec<_> = known
        .map(|(found, truth)| {
            let pose = found.fix.as_ref().unwrap().pose;
            let off = motion::difference(&pose.pose, truth);
            let nees = off.dot(&pose.covariance.cholesky().unwrap().solve(&off));
            (
                off.fixed_rows::<3>(0).norm(),
                off.fixed_rows::<3>(3).norm(),
                nees,
            )
        })
        .collect();
    let sorted = |pick: fn(&(f64, f64, f64)) -> f64| {
        let mut all: Vec<f64> = errors.iter().map(pick).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let (metres, radians) = (sorted(|e| e.0), sorted(|e| e.1));
    let at = |all: &[f64], share: f64| {
        all.get(((all.len() as f64 * share) as usize).min(all.len().saturating_sub(1)))
            .copied()
            .unwrap_or(0.0)
    };
    Score {
        localised: errors.len(),
        lost: found.len() - errors.len(),
        median_m: at(&metres, 0.5),
        p99_m: at(&metres, 0.99),
        max_m: at(&metres, 1.0),
        median_deg: at(&radians, 0.5).to_degrees(),
        nees: errors.iter().map(|e| e.2).sum::<f64>() / errors.len().max(1) as f64 / 6.0,
    }
}

struct Case {
    world: World,
    map: LandmarkMap,
    truth: Vec<Pose>,
    odometry: Vec<Pose>,
    features: Vec<KeyframeFeatures>,
}

impl Case {
    fn new(seed: u64, world: World, imaging: Imaging, scale: f64, changed: f64) -> Self {
        let mut random = SplitMix64(seed);
        let mapped = world::oval(0.0, 0.0);
        let map = world.map(&mapped, &mut random);
        let now = world.changed(seed, changed);
        let truth = world::oval(0.3, 0.13);
        let odometry = world::odometry(&truth, scale, 0.003, &mut random);
        let features = truth
            .iter()
            .map(|pose| now.features(pose, &imaging, &mut random))
            .collect();
        Self {
            world,
            map,
            truth,
            odometry,
            features,
        }
    }

    /// Places are recognised to some centimetres.
    fn told(&self, random: &mut SplitMix64) -> Told {
        let near = |pose: &Pose| {
            let mut by = nalgebra::Vector6::zeros();
            by.iter_mut()
                .enumerate()
                .for_each(|(axis, x)| *x = random.normal() * if axis < 3 { 0.05 } else { 0.01 });
            vec![motion::moved(pose, &by)]
        };
        Told {
            poses: self.truth.iter().map(near).collect(),
            features: self.features.iter().map(std::ptr::from_ref).collect(),
            asked: Cell::new(0),
        }
    }

    fn localise(&self, places: &dyn Recognise) -> Vec<KeyframeLocalisation> {
        // These maps are where the world is: errors of their landmarks are independent.
        let params = LocalisationParams {
            map_m: 0.0,
            map_rad: 0.0,
            ..LocalisationParams::default()
        };
        let localiser = Localiser::new(&self.world.rig, &self.map, params);
        localiser.localise(&world::drive(&self.odometry, &self.features), places)
    }
}

fn good(score: &Score) {
    assert!(
        score.median_m <= 0.03 && score.median_deg <= 0.3,
        "{score:?}"
    );
    assert!(score.p99_m <= 0.13 && score.max_m <= 0.5, "{score:?}");
    assert!((0.3..2.0).contains(&score.nees), "{score:?}");
}

#[test]
fn a_revisit_is_localised_from_end_to_end() {
    for seed in 1..=2 {
        let case = Case::new(seed, World::new(seed, 2500), Imaging::default(), 1.01, 0.0);
        let told = case.told(&mut SplitMix64(seed));
        let found = case.localise(&told);
        let score = score(&found, &case.truth);
        good(&score);
        assert_eq!(score.lost, 0);
        assert_eq!(told.asked.get(), 1);
    }
}

/// Localises and scores.
fn run(name: &str, case: &Case, places: &dyn Recognise) -> (Vec<KeyframeLocalisation>, Score) {
    let found = case.localise(places);
    let score = score(&found, &case.truth);
    assert_eq!(found.len(), case.truth.len(), "{name}: {score:?}");
    (found, score)
}

#[test]
fn much_has_changed_and_a_camera_is_dark_and_odometry_is_wrong() {
    for seed in 1..=2 {
        let dark = Imaging {
            dark: Some(seed as usize % 4),
            ..Imaging::default()
        };
        let case = Case::new(seed, World::new(seed, 2500), dark, 1.05, 0.4);
        let (_, score) = run(
            "changed, dark, 5 %",
            &case,
            &case.told(&mut SplitMix64(seed)),
        );
        good(&score);
        assert!(score.lost <= 3, "{score:?}");
    }
}

#[test]
fn few_landmarks_are_either_enough_or_not_used() {
    for count in [100, 300, 600] {
        let case = Case::new(5, World::new(5, count), Imaging::default(), 1.02, 0.0);
        let (_, score) = run(
            &format!("{count} points"),
            &case,
            &case.told(&mut SplitMix64(5)),
        );
        assert!(score.max_m <= 0.5, "{score:?}");
        assert!(score.localised == 0 || score.nees < 2.5, "{score:?}");
    }
}

#[test]
fn a_kidnapped_vehicle_is_found_again() {
    let mut case = Case::new(7, World::new(7, 2500), Imaging::default(), 0.99, 0.1);
    // Keyframes 45 to 64 are cut out, and odometry does not know: it goes on where it was.
    let steps: Vec<Pose> = case
        .odometry
        .windows(2)
        .map(|pair| pair[0].inverse().compose(&pair[1]))
        .collect();
    case.truth.drain(45..65);
    case.features.drain(45..65);
    case.odometry.truncate(45);
    for index in 45..case.truth.len() {
        let on =
            case.odometry[index - 1].compose(&steps[if index == 45 { 43 } else { index + 19 }]);
        case.odometry.push(on);
    }
    let (found, score) = run("kidnapped", &case, &case.told(&mut SplitMix64(7)));
    good(&score);
    assert!(score.lost <= 2, "{score:?}");
    let recovered = found
        .iter()
        .filter(|found| found.state == State::Recovered)
        .count();
    assert_eq!(recovered, 2);
}

#[test]
fn places_that_look_alike_are_not_confused() {
    for seed in 1..=2 {
        for share in [0.5, 0.8] {
            let world = World::new(seed, 2500).repeated(5.0, share);
            let case = Case::new(seed, world, Imaging::default(), 1.0, 0.3);
            let mut told = case.told(&mut SplitMix64(seed));
            // The place itself is proposed last, after those that look like it.
            for poses in &mut told.poses {
                let aliases = [5.0, -5.0, 10.0].map(|off| {
                    let mut alias = poses[0];
                    alias.translation.x += off;
                    alias
                });
                poses.splice(0..0, aliases);
            }
            let (_, score) = run(&format!("repeated {share}"), &case, &told);
            assert!(score.max_m <= 0.5, "{score:?}");
            assert!(score.localised == 0 || score.median_m <= 0.03, "{score:?}");
        }
    }
}

#[test]
fn a_session_of_another_place_stays_lost() {
    let mut case = Case::new(11, World::new(11, 2500), Imaging::default(), 1.0, 0.0);
    let other = World::new(12, 2500);
    let mut random = SplitMix64(3);
    case.features = case
        .truth
        .iter()
        .map(|pose| other.features(pose, &Imaging::default(), &mut random))
        .collect();
    let told = case.told(&mut SplitMix64(2));
    let (_, score) = run("another place", &case, &told);
    assert_eq!(score.localised, 0, "{score:?}");
}

#[test]
fn nothing_breaks_it() {
    let case = Case::new(13, World::new(13, 500), Imaging::default(), 1.0, 0.0);
    let told = case.told(&mut SplitMix64(1));
    let empty = LandmarkMap::new(Vec::new());
    let localiser = Localiser::new(&case.world.rig, &empty, LocalisationParams::default());
    let drive = world::drive(&case.odometry, &case.features);
    assert!(
        localiser
            .localise(&drive, &told)
            .iter()
            .all(|found| found.state == State::Lost)
    );
    let localiser = Localiser::new(&case.world.rig, &case.map, LocalisationParams::default());
    assert!(localiser.localise(&[], &told).is_empty());
    let mut broken = case.features.clone();
    broken[3].images.clear();
    broken[4].images[1].features[0].pixel = [f64::NAN, f64::INFINITY];
    broken[5] = KeyframeFeatures::default();
    let mut odometry = case.odometry.clone();
    odometry[8].translation.x = f64::NAN;
    assert_eq!(
        localiser
            .localise(&world::drive(&odometry, &broken), &told)
            .len(),
        odometry.len()
    );
    let senseless = LocalisationParams {
        features: FeatureNoise { sigma_px: 4.0 },
        ..LocalisationParams::default()
    };
    assert!(senseless.check().is_err());
}

#[test]
fn places_are_recognised() {
    let case = Case::new(21, World::new(21, 2500), Imaging::default(), 1.02, 0.3);
    let params = LocalisationParams::default();
    let places = Places::new(&case.world.rig, &case.map, &params);
    let mut right = 0;
    for (features, truth) in case.features.iter().zip(&case.truth).step_by(5) {
        let near = |pose: &Pose| motion::difference(pose, truth).norm() < 0.1;
        right += usize::from(places.propose(features).first().is_some_and(near));
    }
    assert!(right >= 20, "{right}");
    let (_, score) = run("recognised", &case, &places);
    good(&score);
    assert!(score.lost == 0, "{score:?}");
}

#[test]
fn among_repetitions_and_in_another_place_it_is_never_wrong() {
    for (seed, share) in [(22, 0.5), (23, 0.8), (24, 0.95)] {
        let world = World::new(seed, 2500).repeated(5.0, share);
        let case = Case::new(seed, world, Imaging::default(), 1.0, 0.3);
        let places = Places::new(&case.world.rig, &case.map, &LocalisationParams::default());
        let (_, score) = run(&format!("repeated {share}"), &case, &places);
        assert!(score.max_m <= 0.5, "{score:?}");
    }
    let mut case = Case::new(25, World::new(25, 2500), Imaging::default(), 1.0, 0.0);
    let other = World::new(26, 2500);
    let mut random = SplitMix64(3);
    case.features = case
        .truth
        .iter()
        .map(|pose| other.features(pose, &Imaging::default(), &mut random))
        .collect();
    let places = Places::new(&case.world.rig, &case.map, &LocalisationParams::default());
    let (_, score) = run("another place", &case, &places);
    assert_eq!(score.localised, 0, "{score:?}");
}
