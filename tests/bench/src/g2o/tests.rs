#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use evermap_algorithms::geometry::lie::se3;
use evermap_algorithms::metric_map::pose_graph::g2o::write_spatial;
use evermap_algorithms::metric_map::pose_graph::{SpatialGraph, options, relax};
use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::*;

fn poses() -> impl Strategy<Value = Pose> {
    let three = |size: f64| prop::array::uniform3(-size..size).prop_map(Vector3::from);
    (three(5.0), three(1.7)).prop_map(|(t, r)| Pose::new(t, UnitQuaternion::from_scaled_axis(r)))
}

proptest! {
    #[test]
    fn written_graphs_are_read_again(
        poses in prop::collection::vec(poses(), 2..9), roots in prop::collection::vec(-2.0..2.0f64, 8 * 36)
    ) {
        let n = poses.len();
        let edges = (1..n).map(|to| {
            let root = Matrix6::from_row_slice(&roots[36 * (to - 1)..][..36]);
            let information = root.transpose() * root;
            Edge { from: to - 1, to, measured: poses[n - to], information, loss: Loss::Quadratic }
        });
        let edges: Vec<_> = edges.collect();
        let fixed: Vec<_> = (0..n).map(|pose| pose % 3 == 1).collect();
        let graph = SpatialGraph { poses, fixed, edges };
        let ids: Vec<u64> = (0..n as u64).map(|id| id * 7 + 3).collect();
        let File::Spatial(read) = read(&write_spatial(&graph, &ids)).unwrap() else {
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
        drop(read(&text));
    }
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
        let error = read(text).unwrap_err();
        assert_eq!(error.line, line, "{text}");
        assert!(error.to_string().contains(words), "{error}");
    }
}

/// Costs that GTSAM 4.3 reports for these files, at the file's poses and at its minimum.
#[test]
fn the_fields_graphs_relax_to_known_minima() {
    let Some(folder) = crate::shared("data/pose_graph/g2o") else {
        return;
    };
    for (name, before, after) in [
        ("tinyGrid3D", 143.317_874, 9.313_909_5),
        ("smallGrid3D", 83_894.333_4, 517.925_33),
        ("intel", 276.997_898, 22.502_116_5),
        ("MIT", 3_548_660_355.52, 385.119_66),
    ] {
        let text = std::fs::read_to_string(folder.join(format!("{name}.g2o"))).unwrap();
        let costs = match read(&text).unwrap() {
            File::Planar(mut file) => relax(&mut file.graph, &options()).unwrap(),
            File::Spatial(mut file) => relax(&mut file.graph, &options()).unwrap(),
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
