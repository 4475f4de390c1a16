//! Indexes against asking each graph, and scales found again.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::f32::consts::TAU;

use evermap_algorithms::semantic_map::relocation::{ClassIndex, Options};
use evermap_algorithms::semantic_map::semantic_graph::{Area, Edge, Graph};
use proptest::prelude::*;

use super::*;

#[path = "../../../../operators/algorithms/src/semantic_map/relocation/tests/graphs.rs"]
mod graphs;

use graphs::graph;

fn counts(graph: &Graph) -> Vec<u16> {
    (0..4).map(|class| graph.count(class) as u16).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn counting_is_asking_each_graph(
        graphs in prop::collection::vec(graph(), 0..50), query in graph(), class in 0_u8..6, areas in 0_usize..4
    ) {
        let index = CountIndex::new(&graphs, 4);
        let views = |fits: &dyn Fn(&Graph) -> bool| -> Vec<u32> {
            (0_u32..).zip(&graphs).filter(|(_, graph)| fits(graph)).map(|(view, _)| view).collect()
        };
        let count = |graph: &Graph| if class < 4 { graph.count(class) } else { 0 };
        let sorted = |views: &[u32]| { let mut views = views.to_vec(); views.sort_unstable(); views };
        prop_assert_eq!(sorted(index.exactly(class, areas)), views(&|graph| count(graph) == areas));
        prop_assert_eq!(sorted(index.at_least(class, areas)), views(&|graph| count(graph) >= areas));
        prop_assert_eq!(sorted(index.without(class)), views(&|graph| count(graph) == 0));
        let asked = counts(&query);
        let classes = ClassIndex::new(graphs.iter(), 4);
        prop_assert_eq!(like(&classes, &asked), views(&|graph| counts(graph) == asked));
    }
}

#[test]
fn scales_are_those_that_views_were_disturbed_with() {
    let mut state = 1_u32;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let mut graphs = Vec::new();
    for _ in 0..40 {
        let areas: Vec<Area> = (0..12)
            .map(|at| Area {
                class: at % 6,
                pixels: 2000,
                u: random() * 1024.0,
                v: 166.0 + 60.0 * (random() - 0.5),
                major_px: 40.0,
                minor_px: 20.0,
                orientation_rad: 0.2,
                eccentricity: 0.6 + 0.3 * random(),
            })
            .collect();
        let disturbed = areas.iter().map(|area| Area {
            // Even noise in (-a, a) has a mean absolute value of a / 2.
            u: (area.u + 0.2 * 1024.0 / TAU * (2.0 * random() - 1.0)).rem_euclid(1024.0),
            v: area.v + 0.06 * 1024.0 / TAU * (2.0 * random() - 1.0),
            ..*area
        });
        let of = |areas: Vec<Area>| Graph {
            width: 1024,
            height: 333,
            wraps: true,
            field_of_view_rad: None,
            areas,
            edges: Vec::new(),
        };
        graphs.push([of(areas.clone()), of(disturbed.collect())]);
    }
    let pairs: Vec<[&Graph; 2]> = graphs.iter().map(|[a, b]| [a, b]).collect();
    let scales = estimate_scales(&pairs, &Options::default()).unwrap();
    assert!((scales.bearing_rad - 0.1).abs() < 0.02, "{scales:?}");
    assert!((scales.elevation_rad - 0.03).abs() < 0.006, "{scales:?}");
    assert!(
        scales.log_size < 0.01 && scales.log_elongation < 0.01,
        "{scales:?}"
    );
    assert_eq!(estimate_scales(&pairs[..1], &Options::default()), None);
}
