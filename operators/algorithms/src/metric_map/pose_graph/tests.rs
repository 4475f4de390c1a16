//! Jacobians against numeric ones, drives with known truth, false loops, files.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Matrix6, SMatrix, SVector, Vector3, Vector6};
use proptest::prelude::*;

use super::consensus::{Rules, Sighting, agree};
use super::robust::{CUTOFF_PLANAR, CUTOFF_SPATIAL, relax_robustly};
use super::*;
use crate::solving::least_squares::Loss;
use crate::geometry::lie::se3;
use crate::shared_data;

fn spatial() -> impl Strategy<Value = Pose> {
    (
        prop::array::uniform3(-5.0..5.0f64),
        prop::array::uniform3(-1.7..1.7f64),
    )
        .prop_map(|(t, r)| Pose::new(Vector3::from(t), crate::geometry::lie::so3::exp(&Vector3::from(r))))
}

fn planar() -> impl Strategy<Value = PlanarPose> {
    prop::array::uniform3(-3.0..3.0f64).prop_map(|[x, y, yaw]| PlanarPose::new(x, y, yaw))
}

fn jacobians_are_derivatives<M: Motion<D>, const D: usize>(measured: M, from: M, to: M) {
    let (r, by_from, by_to) = M::linearise(&measured, &from, &to);
    assert!((r - M::residual(&measured, &from, &to)).norm() < 1e-12);
    // At half a turn the residual jumps.
    if r.amax() > 3.0 {
        return;
    }
    for column in 0..D {
        let mut xi = SVector::<f64, D>::zeros();
        xi[column] = 1e-6;
        let by = |plus: [M; 2], minus: [M; 2]| {
            (M::residual(&measured, &plus[0], &plus[1])
                - M::residual(&measured, &minus[0], &minus[1]))
                / 2e-6
        };
        let from_numeric = by([from.moved(&xi), to], [from.moved(&-xi), to]);
        let to_numeric = by([from, to.moved(&xi)], [from, to.moved(&-xi)]);
        let size = 1.0 + by_from.norm() + by_to.norm();
        assert!((from_numeric - by_from.column(column)).norm() < 1e-6 * size);
        assert!((to_numeric - by_to.column(column)).norm() < 1e-6 * size);
    }
}

/// Reproducible noise.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().max(1e-300).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn twist<const D: usize>(&mut self, sigma: f64) -> SVector<f64, D> {
        SVector::from_fn(|_, _| sigma * self.normal())
    }
}

/// A drive round and round a block, with odometry, and loops where a round meets the one before.
/// A part of the loops is false.
fn rounds<M: Motion<D>, const D: usize>(
    truth: impl Fn(f64) -> M,
    false_part: f64,
    seed: u64,
) -> (Graph<M, D>, Vec<M>, Vec<bool>) {
    let mut noise = Noise(seed);
    const ROUND: usize = 60;
    let truth: Vec<M> = (0..3 * ROUND)
        .map(|step| truth(step as f64 / ROUND as f64))
        .collect();
    let edge = |from: usize, to: usize, measured: M, sigma: f64| Edge {
        from,
        to,
        measured,
        information: SMatrix::identity() / (sigma * sigma),
        loss: Loss::Quadratic,
    };
    let between = |from: usize, to: usize| truth[from].inverted().then(&truth[to]);
    let mut edges = Vec::new();
    for step in 1..truth.len() {
        let measured = between(step - 1, step).moved(&noise.twist(0.02));
        edges.push(edge(step - 1, step, measured, 0.02));
    }
    let mut is_false = vec![false; edges.len()];
    for step in (ROUND..truth.len()).step_by(2) {
        let lie = noise.uniform() < false_part;
        let other = if lie {
            (noise.uniform() * step as f64) as usize
        } else {
            step - ROUND
        };
        let mut measured = between(other, step).moved(&noise.twist(0.01));
        if lie {
            // Farther off than odometry can be after a round: nobody can tell smaller lies.
            let mut off = SVector::<f64, D>::zeros();
            off[0] =
                (10.0 + 10.0 * noise.uniform()) * if noise.uniform() < 0.5 { -1.0 } else { 1.0 };
            measured = measured.moved(&off).moved(&noise.twist(0.3));
        }
        edges.push(edge(other, step, measured, 0.01));
        is_false.push(lie);
    }
    let mut poses = vec![truth[0]];
    for step in 1..truth.len() {
        poses.push(poses[step - 1].then(&edges[step - 1].measured));
    }
    let mut fixed = vec![false; poses.len()];
    fixed[0] = true;
    (
        Graph {
            poses,
            fixed,
            edges,
        },
        truth,
        is_false,
    )
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

fn flat_block(turns: f64) -> PlanarPose {
    let angle = turns * std::f64::consts::TAU;
    PlanarPose::new(10.0 * angle.cos(), 10.0 * angle.sin(), angle)
}

/// The relaxed poses that somebody finds who knows which edges are false.
fn honest<M: Motion<D>, const D: usize>(graph: &Graph<M, D>, is_false: &[bool]) -> Vec<M> {
    let mut honest = graph.clone();
    let mut lies = is_false.iter();
    honest.edges.retain(|_| lies.next() == Some(&false));
    relax(&mut honest, &options()).unwrap();
    honest.poses
}

/// Largest distance of a pose from the truth.
fn error<M: Motion<D>, const D: usize>(poses: &[M], truth: &[M]) -> f64 {
    let errors = poses.iter().zip(truth);
    let errors = errors.map(|(pose, truth)| M::residual(&M::identity(), truth, pose).norm());
    errors.fold(0.0, f64::max)
}

proptest! {
    #[test]
    fn spatial_jacobians(measured in spatial(), from in spatial(), to in spatial()) {
        jacobians_are_derivatives(measured, from, to);
    }

    #[test]
    fn planar_jacobians(measured in planar(), from in planar(), to in planar()) {
        jacobians_are_derivatives(measured, from, to);
    }

    #[test]
    fn written_graphs_are_read_again(poses in prop::collection::vec(spatial(), 2..9), seed in any::<u64>()) {
        let mut noise = Noise(seed);
        let n = poses.len();
        let edges = (1..n).map(|to| {
            let root = Matrix6::from_fn(|_, _| noise.normal());
            let information = root.transpose() * root;
            Edge { from: to - 1, to, measured: poses[n - to], information, loss: Loss::Quadratic }
        });
        let edges: Vec<_> = edges.collect();
        let fixed: Vec<_> = (0..n).map(|pose| pose % 3 == 1).collect();
        let graph = SpatialGraph { poses, fixed, edges };
        let ids: Vec<u64> = (0..n as u64).map(|id| id * 7 + 3).collect();
        let g2o::File::Spatial(read) = g2o::read(&g2o::write_spatial(&graph, &ids)).unwrap() else {
            panic!("not spatial");
        };
        prop_assert_eq!(&read.ids, &ids);
        prop_assert!(read.given.iter().all(|given| *given));
        prop_assert_eq!(&read.graph.fixed, &graph.fixed);
        for (a, b) in read.graph.poses.iter().zip(&graph.poses) {
            prop_assert!(se3::minus(a, b).norm() < 1e-12);
        }
        for (a, b) in read.graph.edges.iter().zip(&graph.edges) {
            prop_assert_eq!(a.information.upper_triangle(), b.information.upper_triangle());
            prop_assert_eq!((a.from, a.to), (b.from, b.to));
        }
    }

    #[test]
    fn no_text_panics(text in "(VERTEX_SE2|EDGE_SE2|EDGE_SE3:QUAT|FIX|x)( (0|1|-2|1e999|nan|3.5|w)){0,32}\n{0,2}") {
        drop(g2o::read(&text));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_fifth_of_false_loops_is_found_in_space(seed in any::<u64>()) {
        let (mut graph, truth, is_false) = rounds(block, 0.2, seed);
        let honest = honest(&graph, &is_false);
        let doubted: Vec<bool> = (0..graph.edges.len()).map(|edge| edge >= truth.len() - 1).collect();
        let weights = relax_robustly(&mut graph, &doubted, CUTOFF_SPATIAL, &options()).unwrap();
        let off = error(&graph.poses, &honest);
        let lost = weights.iter().zip(&is_false).filter(|(weight, lie)| !**lie && **weight < 0.5).count();
        let wrongly = weights.iter().zip(&is_false).filter(|(weight, lie)| **lie && **weight > 0.5).count();
        prop_assert!(off < 0.15, "{off}: {wrongly} wrongly, {lost} lost; honest {}", error(&honest, &truth));
        let wrongly = weights.iter().zip(&is_false).filter(|(weight, lie)| **lie && **weight > 0.5).count();
        prop_assert_eq!(wrongly, 0);
        let lost = weights.iter().zip(&is_false).filter(|(weight, lie)| !**lie && **weight < 0.5).count();
        prop_assert!(lost <= 3, "{lost}");
    }

    #[test]
    fn a_fifth_of_false_loops_is_found_on_the_plane(seed in any::<u64>()) {
        let (mut graph, truth, is_false) = rounds(flat_block, 0.2, seed);
        let honest = honest(&graph, &is_false);
        let doubted: Vec<bool> = (0..graph.edges.len()).map(|edge| edge >= truth.len() - 1).collect();
        let weights = relax_robustly(&mut graph, &doubted, CUTOFF_PLANAR, &options()).unwrap();
        let off = error(&graph.poses, &honest);
        let lost = weights.iter().zip(&is_false).filter(|(weight, lie)| !**lie && **weight < 0.5).count();
        let wrongly = weights.iter().zip(&is_false).filter(|(weight, lie)| **lie && **weight > 0.5).count();
        prop_assert!(off < 0.15, "{off}: {wrongly} wrongly, {lost} lost; honest {}", error(&honest, &truth));
        let wrongly = weights.iter().zip(&is_false).filter(|(weight, lie)| **lie && **weight > 0.5).count();
        prop_assert_eq!(wrongly, 0);
    }

    #[test]
    fn first_guesses_need_no_poses(seed in any::<u64>()) {
        let (mut graph, _, _) = rounds(block, 0.0, seed);
        relax(&mut graph, &options()).unwrap();
        let relaxed = graph.cost();
        for pose in &mut graph.poses[1..] {
            *pose = Pose::identity();
        }
        let poses = initial::spanning_tree(&graph);
        let exact = SpatialGraph { poses, ..graph.clone() };
        let fits = exact.edges.iter().filter(|edge| exact.squared_residual(edge) < 1e-12).count();
        prop_assert!(fits >= graph.poses.len() - 1, "{fits}");
        graph.poses = chordal::chordal(&graph).unwrap();
        prop_assert!(graph.cost() < exact.cost(), "{} {}", graph.cost(), exact.cost());
        relax(&mut graph, &options()).unwrap();
        prop_assert!((graph.cost() - relaxed).abs() < 1e-3 * relaxed);
    }

    #[test]
    fn relaxed_costs_are_minima(seed in any::<u64>()) {
        let (mut graph, _, _) = rounds(flat_block, 0.0, seed);
        let summary = relax(&mut graph, &options()).unwrap();
        prop_assert!(summary.converged());
        prop_assert!((graph.cost() - summary.final_cost).abs() < 1e-9 * summary.final_cost);
        let mut noise = Noise(seed);
        let best = graph.cost();
        for pose in &mut graph.poses[1..] {
            *pose = pose.plus(&noise.twist(1e-3));
        }
        prop_assert!(graph.cost() > best);
    }

    #[test]
    fn a_drive_is_found_among_false_sightings(seed in any::<u64>(), lies in 0..12usize) {
        let mut noise = Noise(seed);
        let map_from_drive = Pose::from_yaw(7.0, -3.0, 2.0);
        let sighting = |path: f64, at: Pose| Sighting {
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

/// The plane is space without height, roll and pitch: costs and minima are the same.
#[test]
fn the_plane_lifted_into_space_costs_the_same() {
    let (mut flat, _, _) = rounds(flat_block, 0.0, 3);
    let space =
        |pose: &PlanarPose| Pose::from_yaw(pose.translation.x, pose.translation.y, pose.yaw);
    const PLACE: [usize; 3] = [0, 1, 5];
    let edges = flat.edges.iter().map(|edge| Edge {
        from: edge.from,
        to: edge.to,
        measured: space(&edge.measured),
        information: Matrix6::from_fn(|row, column| {
            let place = |at| PLACE.iter().position(|found| *found == at);
            match (place(row), place(column)) {
                (Some(row), Some(column)) => edge.information[(row, column)],
                _ => f64::from(u8::from(row == column)),
            }
        }),
        loss: edge.loss,
    });
    let mut lifted = SpatialGraph {
        edges: edges.collect(),
        poses: flat.poses.iter().map(space).collect(),
        fixed: flat.fixed.clone(),
    };
    assert!((flat.cost() - lifted.cost()).abs() < 1e-9 * flat.cost());
    relax(&mut flat, &options()).unwrap();
    relax(&mut lifted, &options()).unwrap();
    assert!((flat.cost() - lifted.cost()).abs() < 1e-6 * flat.cost());
    for (a, b) in flat.poses.iter().zip(&lifted.poses) {
        assert!(se3::minus(&space(a), b).norm() < 1e-4);
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

#[test]
fn faults_have_lines() {
    for (text, line, words) in [
        ("", 0, "neither"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 1 1 1", 2, "again"),
        (
            "VERTEX_SE2 0 0 0",
            1,
            "expected 4 numbers after VERTEX_SE2, found 3",
        ),
        ("# c\nVERTEX_SE2 0 0 nan 0", 2, "`nan`"),
        ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0 0", 1, "quaternion"),
        ("EDGE_SE2 1 2 0 0 0 -1 0 0 1 0 1", 1, "negative"),
        ("EDGE_SE2 1 1 0 0 0 1 0 0 1 0 1", 1, "itself"),
        ("VERTEX_SE2 0 0 0 0\nFIX 9", 2, "FIX 9"),
        (
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1",
            2,
            "both",
        ),
        ("VERTEX_XY 0 0 0", 1, "`VERTEX_XY`"),
        ("VERTEX_SE2 -1 0 0 0", 1, "`-1`"),
    ] {
        let error = g2o::read(text).unwrap_err();
        assert_eq!(error.line, line, "{text}");
        assert!(error.to_string().contains(words), "{error}");
    }
}

/// Costs that GTSAM 4.3 reports for these files, at the file's poses and at its minimum.
#[test]
fn the_fields_graphs_relax_to_known_minima() {
    let Some(folder) = shared_data::find("data/pose_graph/g2o") else {
        return;
    };
    for (name, before, after) in [
        ("tinyGrid3D", 143.317_874, 9.313_909_5),
        ("smallGrid3D", 83_894.333_4, 517.925_33),
        ("intel", 276.997_898, 22.502_116_5),
        ("MIT", 3_548_660_355.52, 385.119_66),
    ] {
        let text = std::fs::read_to_string(folder.join(format!("{name}.g2o"))).unwrap();
        let costs = match g2o::read(&text).unwrap() {
            g2o::File::Planar(mut file) => relax(&mut file.graph, &options()).unwrap(),
            g2o::File::Spatial(mut file) => relax(&mut file.graph, &options()).unwrap(),
        };
        assert!(
            (costs.initial_cost / before - 1.0).abs() < 1e-6,
            "{name}: {costs:?}"
        );
        assert!(
            (costs.final_cost / after - 1.0).abs() < 1e-5,
            "{name}: {costs:?}"
        );
    }
}

/// Drives round the block, each in a frame of its own, with loops to the first and to themselves.
fn neighbours(
    seed: u64,
    lies: f64,
) -> (
    Vec<Vec<drives::DrivePose>>,
    Vec<drives::Loop>,
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
            loops.push(drives::Loop {
                later: drives::Place {
                    drive: later,
                    keyframe: step,
                },
                earlier: drives::Place {
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
            let at = |place: drives::Place| truths[place.drive][place.keyframe];
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
            drives::Fix {
                at: drives::Place { drive: 1, keyframe },
                map_from_vehicle: se3::plus(&truths[1][keyframe], &noise.twist(size)),
                covariance: Matrix6::identity() * 1e-4,
            }
        }).collect();
        let joined = drives::join(&drives[..2], &[], &fixes, None, &Default::default()).unwrap();
        prop_assert!(joined.poses[0].is_none());
        prop_assert!(error(joined.poses[1].as_ref().unwrap(), &truths[1]) < 0.6);
    }
}
