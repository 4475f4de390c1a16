//! Jacobians against numeric ones, drives with known truth, false loops.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Matrix6, Vector3, Vector6};
use proptest::prelude::*;

use super::consensus::{PoseVote, Rules, agree};
use super::robust::{CUTOFF_SPATIAL, relax_robustly};
use super::*;
use crate::geometry::lie::se3;
use crate::solving::least_squares::Loss;

mod rounds;
mod valleys;

use rounds::{
    Noise, error, honest, is_found_as_well_as_by_who_knows, jacobians_are_derivatives, rounds,
};

fn spatial() -> impl Strategy<Value = Pose> {
    (
        prop::array::uniform3(-5.0..5.0f64),
        prop::array::uniform3(-1.7..1.7f64),
    )
        .prop_map(|(t, r)| {
            Pose::new(
                Vector3::from(t),
                crate::geometry::lie::so3::exp(&Vector3::from(r)),
            )
        })
}

fn block(turns: f64) -> Pose {
    let angle = turns * std::f64::consts::TAU;
    let mut pose = Pose::from_yaw(10.0 * angle.cos(), 10.0 * angle.sin(), angle);
    pose.translation.z = 0.5 * angle.sin();
    se3::plus(
        &pose,
        &Vector6::new(0.0, 0.0, 0.0, 0.02 * angle.sin(), 0.0, 0.0),
    )
}

proptest! {
    #[test]
    fn spatial_jacobians(measured in spatial(), from in spatial(), to in spatial()) {
        jacobians_are_derivatives(measured, from, to);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_fifth_of_false_loops_is_found_in_space(seed in any::<u64>()) {
        let (mut graph, truth, is_false) = rounds(block, 0.2, seed);
        let honest = honest(&graph, &is_false);
        let doubted: Vec<bool> = (0..graph.edges.len()).map(|edge| edge >= truth.len() - 1).collect();
        let weights = relax_robustly(&mut graph, &doubted, CUTOFF_SPATIAL, &options()).unwrap().weights;
        is_found_as_well_as_by_who_knows(&graph, &weights, &is_false, &honest, CUTOFF_SPATIAL);
    }

    #[test]
    fn relaxed_costs_are_minima(seed in any::<u64>()) {
        let (mut graph, _, _) = rounds(block, 0.0, seed);
        let summary = relax(&mut graph, &options()).unwrap();
        prop_assert!(summary.converged());
        prop_assert!((graph.cost() - summary.final_cost).abs() < 1e-9 * summary.final_cost);
        let mut noise = Noise(seed);
        let best = graph.cost();
        for pose in &mut graph.poses[1..] {
            *pose = se3::plus(pose, &noise.twist(1e-3));
        }
        prop_assert!(graph.cost() > best);
    }

    #[test]
    fn a_drive_is_found_among_false_sightings(seed in any::<u64>(), lies in 0..12usize) {
        let mut noise = Noise(seed);
        let map_from_drive = Pose::from_yaw(7.0, -3.0, 2.0);
        let sighting = |path: f64, at: Pose| PoseVote {
            drive_from_vehicle: Pose::from_yaw(path, 0.1 * path, 0.0),
            map_from_vehicle: at,
            path_m: path,
            sigma_m: 0.05,
            sigma_rad: 0.01,
        };
        let rules = Rules { walk_m: 0.1, walk_rad: 0.01, sigmas: 3.0, place_m: 1.0, places: 3 };
        let anywhere = |noise: &mut Noise| Pose::from_yaw(40.0 * noise.uniform(), 40.0 * noise.uniform(), 6.0 * noise.uniform());
        let mut sightings: Vec<_> = (0..lies)
            .map(|lie| { let at = anywhere(&mut noise); sighting(lie as f64, at) })
            .collect();
        prop_assert!(agree(&sightings, &rules).is_none());
        for place in 0..5 {
            let path = 2.0 * f64::from(place);
            let at = map_from_drive.compose(&Pose::from_yaw(path, 0.1 * path, 0.0));
            sightings.push(sighting(path, se3::plus(&at, &noise.twist(0.005))));
        }
        let found = agree(&sightings, &rules).unwrap();
        prop_assert!((found.map_from_drive.translation - map_from_drive.translation).norm() < 0.5);
        prop_assert!(found.sightings.iter().filter(|sighting| **sighting >= lies).count() == 5);
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let (mut graph, _, _) = rounds(block, 0.1, 11);
        pool.install(|| relax(&mut graph, &options()).unwrap());
        graph.poses.iter().map(Pose::to_array).collect::<Vec<_>>()
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn one_place_seen_often_is_one_place() {
    assert_eq!(consensus::places([0.0, 0.2, 0.4, 0.6], 1.0), 1);
    assert_eq!(consensus::places([3.0, 0.0, 1.5, f64::NAN], 1.0), 3);
}

/// Drives round the block, each in a frame of its own, with loops to the first and to themselves.
fn neighbours(
    seed: u64,
    lies: f64,
) -> (
    Vec<Vec<drives::DrivePose>>,
    Vec<drives::LoopConstraint>,
    Vec<Vec<Pose>>,
) {
    let mut noise = Noise(seed);
    let mut all_drives = Vec::new();
    let mut truths: Vec<Vec<Pose>> = Vec::new();
    for drive in 0..3 {
        let truth: Vec<Pose> = (0..250)
            .map(|step| block(0.1 * f64::from(drive) + f64::from(step) / 160.0))
            .collect();
        let mut odom = Pose::from_yaw(100.0 * noise.normal(), 0.0, noise.normal());
        let scale = 1.0 + 0.01 * noise.normal();
        let mut path_m = 0.0;
        let mut chain = vec![drives::DrivePose {
            odom_from_vehicle: odom,
            path_m,
            known: None,
        }];
        for pair in truth.windows(2) {
            let mut step = pair[0].inverse().compose(&pair[1]);
            path_m += step.translation.norm();
            // Wheels know neither height nor slope.
            step = Pose::from_yaw(
                step.translation.x * scale,
                step.translation.y * scale,
                step.yaw() + 2e-4 * noise.normal() + 3e-4,
            );
            odom = odom.compose(&step);
            chain.push(drives::DrivePose {
                odom_from_vehicle: odom,
                path_m,
                known: None,
            });
        }
        all_drives.push(chain);
        truths.push(truth);
    }
    let mut loops = Vec::new();
    for later in 0..3 {
        for step in (0..250).step_by(4) {
            let lie = noise.uniform() < lies;
            let other = if step >= 160 && noise.uniform() < 0.5 {
                later
            } else {
                0
            };
            let keyframe = if lie {
                (noise.uniform() * 250.0) as usize
            } else {
                let at = &truths[later][step].translation;
                let range = if other == later {
                    0..step.saturating_sub(100).max(1)
                } else {
                    0..250
                };
                let near = |k: &usize| ((truths[other][*k].translation - at).norm() * 1e6) as u64;
                range.min_by_key(near).unwrap()
            };
            if other == later && (step < 160 || keyframe >= step) {
                continue;
            }
            let mut error = noise.twist(0.01);
            if lie {
                error = noise.twist(0.1);
                error[0] = 10.0 + 10.0 * noise.uniform();
            }
            let between = truths[other][keyframe]
                .inverse()
                .compose(&truths[later][step]);
            loops.push(drives::LoopConstraint {
                later: drives::KeyframeRef {
                    drive: later,
                    keyframe: step,
                },
                earlier: drives::KeyframeRef {
                    drive: other,
                    keyframe,
                },
                earlier_from_later: se3::plus(&between, &error),
                sigma_m: 0.02,
                sigma_rad: 0.01,
            });
        }
    }
    (all_drives, loops, truths)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]

    #[test]
    fn drives_are_joined_in_spite_of_false_loops(seed in any::<u64>()) {
        let (drives, loops, truths) = neighbours(seed, 0.2);
        let joined = drives::join(&drives, &loops, &[], Some(0), &Default::default()).unwrap();
        // As somebody joins them who knows which are false.
        let honest: Vec<_> = loops.iter().filter(|given| {
            let at = |place: drives::KeyframeRef| truths[place.drive][place.keyframe];
            let between = at(given.earlier).inverse().compose(&at(given.later));
            se3::minus(&given.earlier_from_later, &between).norm() < 1.0
        }).copied().collect();
        let best = drives::join(&drives, &honest, &[], Some(0), &Default::default()).unwrap();
        for (poses, best) in joined.poses.iter().zip(&best.poses) {
            let off = error(poses.as_ref().unwrap(), best.as_ref().unwrap());
            prop_assert!(off < 0.5, "{off}");
        }
        let map_from_truth = truths[0][0].inverse();
        for (poses, truth) in joined.poses.iter().zip(&truths) {
            let truth: Vec<_> = truth.iter().map(|pose| map_from_truth.compose(pose)).collect();
            let error = error(poses.as_ref().unwrap(), &truth);
            // Half a round of 63 m is driven before the first loop.
            prop_assert!(error < 2.0, "{error}");
        }
        prop_assert_eq!(joined.poses[0].as_ref().unwrap()[0], Pose::identity());
    }

    #[test]
    fn drives_of_another_place_stay_out(seed in any::<u64>()) {
        // All loops between drives are false; or there are just two places.
        let (drives, mut loops, _) = neighbours(seed, 0.0);
        let mut noise = Noise(seed);
        for given in &mut loops {
            if given.later.drive == 1 && given.earlier.drive == 0 {
                given.earlier_from_later = Pose::from_yaw(30.0 * noise.normal(), 30.0 * noise.normal(), 6.0 * noise.uniform());
            }
        }
        loops.retain(|given| given.later.drive != 2 || given.earlier.drive == 2 || given.later.keyframe < 5);
        let joined = drives::join(&drives, &loops, &[], Some(0), &Default::default()).unwrap();
        let placed: Vec<_> = joined.poses.iter().map(Option::is_some).collect();
        prop_assert_eq!(placed, vec![true, false, false]);
    }

    #[test]
    fn known_poses_and_fixes_define_the_map(seed in any::<u64>()) {
        let (mut drives, loops, truths) = neighbours(seed, 0.1);
        for (at, truth) in drives[0].iter_mut().zip(&truths[0]) {
            at.known = Some(*truth);
        }
        let joined = drives::join(&drives, &loops, &[], None, &Default::default()).unwrap();
        prop_assert_eq!(joined.poses[0].as_ref().unwrap(), &truths[0]);
        prop_assert!(error(joined.poses[1].as_ref().unwrap(), &truths[1]) < 0.2);
        // The same by fixes alone, of which some are wrong.
        drives[0].iter_mut().for_each(|at| at.known = None);
        let mut noise = Noise(seed);
        let fixes: Vec<_> = (0..250).step_by(5).map(|keyframe| {
            let size = if noise.uniform() < 0.2 { 2.0 } else { 0.01 };
            drives::FixConstraint {
                at: drives::KeyframeRef { drive: 1, keyframe },
                map_from_vehicle: se3::plus(&truths[1][keyframe], &noise.twist(size)),
                covariance: Matrix6::identity() * 1e-4,
            }
        }).collect();
        let joined = drives::join(&drives[..2], &[], &fixes, None, &Default::default()).unwrap();
        prop_assert!(joined.poses[0].is_none());
        prop_assert!(error(joined.poses[1].as_ref().unwrap(), &truths[1]) < 0.6);
    }
}
