#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub(super) mod world;

use super::*;
use crate::features::KeyframeFeatures;
use crate::pose::Pose;
use std::cell::Cell;
use world::{Imaging, Random, World};

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
        let mut random = Random(seed);
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
    fn told(&self, random: &mut Random) -> Told {
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
        let localiser =
            Localiser::new(&self.world.rig, &self.map, LocalisationParams::default()).unwrap();
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
    for seed in 1..=3 {
        let case = Case::new(seed, World::new(seed, 6000), Imaging::default(), 1.01, 0.0);
        let told = case.told(&mut Random(seed));
        let start = std::time::Instant::now();
        let found = case.localise(&told);
        let score = score(&found, &case.truth);
        eprintln!(
            "{} landmarks, {score:?} {:?} {} asked",
            case.map.len(),
            start.elapsed(),
            told.asked.get()
        );
        good(&score);
        assert_eq!(score.lost, 0);
        assert_eq!(told.asked.get(), 1);
    }
}
