//! Drives, and stretches of them, that see nothing: the dark, tunnels, maps of odometry alone.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::super::blocks::Blocks;
use super::super::clusters::Clusters;
use super::super::decomposition::{Sessions, take};
use super::super::elimination::Layout;
use super::super::iterative::{CLUSTERS, clusters};
use super::super::schur::{Sight, ordered};
use super::super::system::System;
use super::super::*;
use super::{Drive, options};
use crate::solving::least_squares::Structure;

fn by(linear_solver: LinearSolver) -> Options {
    Options {
        linear_solver,
        ..options()
    }
}

#[test]
fn a_drive_on_odometry_alone_is_factorised_as_the_chain_that_it_is() {
    for steps in [10, 300, 3000] {
        let problem = Drive::new(steps, 0, 1).truth;
        let options = Options::default();
        let sessions = Sessions {
            held: 1,
            unknown: 1,
        };
        let taken = take(&problem, &options, sessions);
        let terms = Blocks::new(taken.blocks, &ordered(&taken.pairs));
        let (layout, system) = System::choose(
            taken.blocks,
            0,
            taken.sights,
            &terms,
            &taken.bundle,
            options.linear_solver,
        )
        .unwrap();
        assert!(matches!(system, System::Direct(_)), "{steps}");
        // A pose's block, the next one's, its session's: memory and work grow as the drive does.
        let pairs = layout.meeting(&terms);
        let pairs = pairs.iter().map(|(a, b)| (*a as usize, *b as usize));
        let structure = Structure::<6>::new(taken.blocks, pairs).unwrap();
        let entries = structure.factor_entries();
        assert!(entries < 200 * taken.blocks, "{steps}: {entries}");
    }
}

#[test]
fn a_drive_on_odometry_alone_ends_where_it_drove_whichever_way_is_taken() {
    let mut drive = Drive::new(60, 0, 2);
    let start = drive.disturbed(0.0, 0.1);
    for solver in [
        LinearSolver::Cheaper,
        LinearSolver::Factorised,
        LinearSolver::Iterative,
    ] {
        let mut found = start.clone();
        let report = solve(&mut found, &by(solver)).unwrap();
        let off = drive.error_m(&found);
        assert!(
            drive.error_m(&start) > 0.1 && off < 1e-9,
            "{solver:?}: {off} {report:?}"
        );
    }
}

#[test]
fn a_tunnel_on_the_way_is_bridged_whichever_way_is_taken() {
    let mut drive = Drive::new(90, 300, 3);
    let mut start = drive.disturbed(0.3, 0.05);
    start
        .observations
        .retain(|seen| !(30..60).contains(&seen.pose));
    let run = |solver| {
        let mut problem = start.clone();
        let cost = solve(&mut problem, &by(solver)).unwrap().summary.final_cost;
        (problem, cost)
    };
    let (direct, exact) = run(LinearSolver::Factorised);
    let (found, inexact) = run(LinearSolver::Iterative);
    assert!(inexact <= exact * (1.0 + 1e-6), "{exact} {inexact}");
    for (a, b) in direct.poses.iter().zip(&found.poses) {
        let off = a.map_from_vehicle.translation - b.map_from_vehicle.translation;
        assert!(off.norm() < 1e-4, "{off}");
    }
}

/// So many unknowns, of which these poses see the landmarks from their own index on.
fn layout(blocks: usize, poses: std::ops::Range<u32>, landmarks: u32) -> (Layout, usize) {
    let all = poses.end + landmarks;
    let sights = poses.flat_map(|block| {
        (block..block + landmarks).map(move |landmark| Sight {
            landmark,
            block,
            observation: block * landmarks + landmark - block,
        })
    });
    let identity: Vec<u32> = (0..blocks as u32).collect();
    let layout = Layout::new(all as usize, sights.collect(), &identity);
    (layout, all as usize)
}

/// The first and the last unknown of each cluster, and how many it has.
fn spans(clusters: &Clusters) -> Vec<(u32, u32, usize)> {
    let members = clusters.members();
    let span = |own: &Vec<u32>| Some((*own.first()?, *own.last()?, own.len()));
    members.iter().map(|own| span(own).unwrap()).collect()
}

#[test]
fn what_sees_nothing_is_in_runs_along_its_drive() {
    // Two drives, of which the first sees something for its first hundred poses.
    let mut kin = vec![0; 1050];
    kin.extend([1; 1050]);
    kin.extend([2, 3]);
    let (layout, landmarks) = layout(kin.len(), 0..100, 20);
    let found = clusters(&layout, landmarks, &kin);
    assert!(found.count <= CLUSTERS, "{}", found.count);
    let most = kin.len().div_ceil(CLUSTERS);
    let spans = spans(&found);
    let blind = spans.iter().filter(|(_, last, _)| *last >= 100);
    for (first, last, members) in blind.clone() {
        assert!(*first >= 100 && *members <= most);
        assert_eq!((last - first) as usize + 1, *members);
        assert_eq!(kin[*first as usize], kin[*last as usize]);
    }
    let runs = 950_usize.div_ceil(most) + 1050_usize.div_ceil(most) + 2;
    assert_eq!(blind.count(), runs);
    // What sees has its own, and they are finer than the coarsest.
    assert!(spans.len() - runs > 6, "{}", spans.len());
}

#[test]
fn no_more_clusters_move_rigidly_however_little_poses_have_in_common() {
    let (layout, landmarks) = {
        let identity: Vec<u32> = (0..3001).collect();
        let alone = identity[..3000].iter().map(|block| Sight {
            landmark: *block,
            block: *block,
            observation: *block,
        });
        (Layout::new(3000, alone.collect(), &identity), 3000)
    };
    let mut kin = vec![0; 3000];
    kin.push(1);
    let found = clusters(&layout, landmarks, &kin);
    assert_eq!(found.count, CLUSTERS);
    for (first, last, members) in spans(&found) {
        assert!((15..=16).contains(&members));
        assert_eq!((last - first) as usize + 1, members);
    }
    // Few stay as they were found.
    let few = Clusters {
        of: vec![0, 1, 0, 2],
        count: 3,
    };
    assert_eq!(few.clone().joined(3), few);
    assert_eq!(few.joined(2).of, [0, 0, 0, 1]);
}
