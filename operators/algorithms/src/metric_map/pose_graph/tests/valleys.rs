//! Starts in wrong valleys, and certificates that tell them from the best.

use std::f64::consts::TAU;

use super::super::certificate::{GAP, Optimality, certify, lower_bound, quadratic};
use nalgebra::Matrix3;

use crate::solving::least_squares::Options;

use super::super::chordal::{Chordal, chordal, start};
use super::super::chords::Chords;
use super::*;

/// A ring of poses, each measured from the one before, the first from the last. It begins wound up: every pose turned
/// a little further than the one before, by a full turn in all. No small motion undoes a full turn.
fn wound_ring(noise_seed: u64) -> SpatialGraph {
    let n = 24;
    let mut noise = Noise(noise_seed);
    let at = |k: usize| {
        let angle = TAU * k as f64 / n as f64;
        Pose::from_yaw(4.0 * angle.cos(), 4.0 * angle.sin(), angle)
    };
    let edge = |from: usize| {
        let to = (from + 1) % n;
        let turn = [1.0, 1.0, 1.0, 1e4, 1e4, 1e4];
        Edge {
            from,
            to,
            measured: se3::plus(&at(from).inverse().compose(&at(to)), &noise.twist(0.01)),
            information: Matrix6::from_diagonal(&Vector6::from(turn)),
            loss: Loss::Quadratic,
        }
    };
    let edges = (0..n).map(edge).collect();
    let wound = |k: usize| at(k).compose(&Pose::from_yaw(0.0, 0.0, TAU * k as f64 / n as f64));
    let mut fixed = vec![false; n];
    fixed[0] = true;
    Graph {
        poses: (0..n).map(wound).collect(),
        fixed,
        edges,
    }
}

#[test]
fn a_ring_is_unwound_and_certified() {
    let mut wound = wound_ring(3);
    let mut ring = wound.clone();
    // It creeps along for hundreds of rounds.
    let patient = Options {
        max_iterations: 2000,
        ..options()
    };
    let summary = relax(&mut wound, &patient).unwrap();
    assert!(summary.converged(), "{summary:?}");
    assert_eq!(certify(&wound).unwrap(), Optimality::NotOptimal);

    assert!(start(&mut ring).unwrap());
    relax(&mut ring, &options()).unwrap();
    assert!(
        ring.cost() < 1e-3 * wound.cost(),
        "{} {}",
        ring.cost(),
        wound.cost()
    );
    assert_eq!(certify(&ring).unwrap(), Optimality::Optimal);
    // Nor does the bound at the wrong minimum lie above the right one.
    let bound = lower_bound(&wound).unwrap();
    assert!(bound.is_none_or(|bound| bound <= ring.cost()), "{bound:?}");
}

#[test]
fn fixed_poses_stay_and_take_part() {
    let mut ring = wound_ring(5);
    start(&mut ring).unwrap();
    relax(&mut ring, &options()).unwrap();
    // Held there, another pose pulls the ring out of shape.
    ring.fixed[12] = true;
    ring.poses[12] = ring.poses[12].compose(&Pose::from_yaw(0.3, 0.2, 0.02));
    let held = ring.poses[12];
    let free = ring.cost();
    ring.poses = chordal(&ring, &[]).unwrap();
    assert_eq!(
        (ring.poses[0], ring.poses[12]),
        (Pose::from_yaw(4.0, 0.0, 0.0), held)
    );
    relax(&mut ring, &options()).unwrap();
    assert!(ring.cost() < free);
    assert_eq!(certify(&ring).unwrap(), Optimality::Optimal);
}

#[test]
fn parts_that_nothing_connects_have_one_certificate() {
    let mut graph = wound_ring(1);
    let second = wound_ring(2);
    let n = graph.poses.len();
    graph.poses.extend(&second.poses);
    graph.fixed.extend(vec![false; n]);
    graph.edges.extend(second.edges.iter().map(|edge| Edge {
        from: edge.from + n,
        to: edge.to + n,
        ..*edge
    }));
    start(&mut graph).unwrap();
    relax(&mut graph, &options()).unwrap();
    assert_eq!(certify(&graph).unwrap(), Optimality::Optimal);
    let empty = SpatialGraph {
        poses: vec![Pose::identity(); 2],
        fixed: vec![],
        edges: vec![],
    };
    assert_eq!(certify(&empty).unwrap(), Optimality::Optimal);
}

/// Information of all kinds: equal along the axes, along those of position, or none of it.
fn information() -> impl Strategy<Value = Matrix6<f64>> {
    let root = prop::collection::vec(-1.0..1.0f64, 36);
    (root, 0..3usize).prop_map(|(root, kind)| {
        let root = Matrix6::from_row_slice(&root);
        let mut any = root.transpose() * root + Matrix6::identity();
        if kind < 2 {
            any.fixed_view_mut::<3, 3>(0, 3).fill(0.0);
            any.fixed_view_mut::<3, 3>(3, 0).fill(0.0);
            any.fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&Matrix3::from_diagonal_element(2.0));
        }
        if kind < 1 {
            any.fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&Matrix3::from_diagonal_element(3.0));
        }
        any
    })
}

fn homogeneous(pose: &Pose) -> SMatrix<f64, 3, 4> {
    let mut top = SMatrix::<f64, 3, 4>::zeros();
    top.fixed_columns_mut::<3>(0)
        .copy_from(&pose.rotation_matrix());
    top.set_column(3, &pose.translation);
    top
}

proptest! {
    #[test]
    fn the_form_of_an_edge_touches_its_cost_from_below(
        measured in spatial(), from in spatial(), off in prop::array::uniform6(-0.05..0.05f64),
        far in spatial(), other in spatial(), information in information(),
    ) {
        let edge = Edge { from: 0, to: 1, measured, information, loss: Loss::Quadratic };
        let to = se3::plus(&from.compose(&measured), &Vector6::from(off));
        let form = quadratic(&edge, &from, &to);
        jacobians_are_derivatives(Chords::<Pose, 3, 4>(measured), Chords(from), Chords(other));
        let value = |from: &Pose, to: &Pose| {
            let [a, b] = [homogeneous(from), homogeneous(to)];
            form.constant
                + (a * form.from * a.transpose()).trace()
                + (b * form.to * b.transpose()).trace()
                + 2.0 * (a * form.cross * b.transpose()).trace()
        };
        let cost = |from: &Pose, to: &Pose| {
            let r = Pose::residual(&measured, from, to);
            0.5 * r.dot(&(information * r))
        };
        // The angle is at most 0.09 rad. Where position and rotation are not coupled, chords fall short by its square.
        let equal = information.fixed_view::<3, 3>(0, 3).amax() == 0.0;
        let part = if equal { 0.01 } else { 0.3 };
        prop_assert!((value(&from, &to) - cost(&from, &to)).abs() <= part * cost(&from, &to) + 1e-9);
        if equal {
            prop_assert!(value(&far, &other) <= cost(&far, &other) + 1e-9);
            prop_assert!(value(&from, &other) <= cost(&from, &other) + 1e-9);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn the_bound_meets_the_cost_at_the_best_and_passes_it_nowhere(seed in any::<u64>(), off in 0.0..0.3f64) {
        let (mut graph, _, _) = rounds(block, 0.0, seed);
        relax(&mut graph, &options()).unwrap();
        let best = graph.cost();
        let bound = lower_bound(&graph).unwrap().unwrap();
        prop_assert!(bound <= best && best - bound <= GAP * best, "{bound} {best}");
        prop_assert_eq!(certify(&graph).unwrap(), Optimality::Optimal);
        let mut noise = Noise(seed);
        for pose in &mut graph.poses[1..] {
            *pose = se3::plus(pose, &noise.twist(off));
        }
        if let Some(bound) = lower_bound(&graph).unwrap() {
            prop_assert!(bound <= best, "{bound} {best}");
        }
    }

    #[test]
    fn what_is_best_under_unequal_information_is_never_called_otherwise(seed in any::<u64>()) {
        // Along chords the bound may be too short to say, as of seed 17082872600856739991 by 1.4 %.
        prop_assert_ne!(certify(&unequal(seed)).unwrap(), Optimality::NotOptimal);
    }

    #[test]
    fn edges_alone_lead_to_the_minimum(seed in any::<u64>()) {
        let (mut graph, _, _) = rounds(block, 0.0, seed);
        relax(&mut graph, &options()).unwrap();
        let best = graph.cost();
        for pose in &mut graph.poses[1..] {
            *pose = Pose::identity();
        }
        prop_assert!(start(&mut graph).unwrap());
        relax(&mut graph, &options()).unwrap();
        prop_assert!((graph.cost() - best).abs() < 1e-5 * best);
    }
}

/// A relaxed graph whose information is unequal, as odometry's is: height, roll and pitch are known worse or better than what
/// wheels measure.
fn unequal(seed: u64) -> Graph<Pose, 6> {
    let (mut graph, _, _) = rounds(block, 0.0, seed);
    let unequal = Vector6::new(1.0, 1.0, 3.0, 0.5, 0.5, 1.0);
    for edge in &mut graph.edges {
        edge.information *= Matrix6::from_diagonal(&unequal);
    }
    start(&mut graph).unwrap();
    relax(&mut graph, &options()).unwrap();
    graph
}

#[test]
fn unequal_information_is_certified_too() {
    for seed in 1..=24 {
        let found = certify(&unequal(seed)).unwrap();
        assert_eq!(found, Optimality::Optimal, "{seed}");
    }
}

/// From odometry alone, all loops are found to be false here, and the drive ends 20 m off.
#[test]
fn false_loops_are_found_where_odometry_lost_its_heading() {
    let mut exact = 0;
    for seed in 1..=11 {
        let (mut graph, truth, is_false) = rounds(block, 0.2, seed);
        let chain = truth.len() - 1;
        // A gyro's bias: a turn and a half in all.
        let bias = Pose::from_yaw(0.0, 0.0, 1.5 * TAU / chain as f64);
        let unsure = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 1.0, 1.0, 0.1));
        for step in 0..chain {
            let edge = &mut graph.edges[step];
            edge.measured = edge.measured.compose(&bias);
            edge.information *= unsure;
            graph.poses[step + 1] = graph.poses[step].compose(&edge.measured);
        }
        let mut from_truth = graph.clone();
        from_truth.poses = truth;
        let honest = honest(&from_truth, &is_false);
        let doubted: Vec<bool> = (0..graph.edges.len()).map(|edge| edge >= chain).collect();
        relax_robustly(&mut graph, &doubted, CUTOFF_SPATIAL, &options()).unwrap();
        let off = error(&graph.poses, &honest);
        assert!(off < 10.0, "{seed}: {off}");
        exact += usize::from(off < 0.1);
    }
    assert!(exact >= 9, "{exact} of 11");
}
