#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::f32::consts::{PI, TAU};

use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::semantic_map::semantic_graph::{Area, Edge, Graph};

pub(in crate::semantic_map) mod graphs;
mod interpretation;
mod reference;
mod relations;

use graphs::{WIDTH, graph};

fn options() -> impl Strategy<Value = Options> {
    let pairs = (prop_oneof![Just(1.5_f64), Just(f64::INFINITY)], 0_u8..5);
    let turns = prop_oneof![Just(1_u32), Just(2), Just(21)];
    let unary = (
        0.5_f64..9.0,
        0.1_f64..4.0,
        prop_oneof![Just(0.0_f64), Just(0.5)],
    );
    let again = (1_u32..4, prop_oneof![Just(0_u32), Just(100)]);
    (pairs, turns, unary, any::<bool>(), again).prop_map(
        |((boundary_factor, direction_steps), headings, (limit, bearing, power), ignore, again)| {
            let (least, candidates) = again;
            Options {
                boundary_factor,
                direction_steps,
                headings,
                limit,
                max_bearing_rad: bearing,
                size_power: power,
                ignored: if ignore { vec![2] } else { Vec::new() },
                min_matched: least,
                candidates,
                ..Options::default()
            }
        },
    )
}

fn counts(graph: &Graph) -> Vec<u16> {
    (0..4).map(|class| graph.count(class) as u16).collect()
}

/// Turns a view: everything moves to the left by an angle.
fn turned(graph: &Graph, angle: f32) -> Graph {
    let mut graph = graph.clone();
    for area in &mut graph.areas {
        area.u = (area.u - angle / TAU * WIDTH as f32).rem_euclid(WIDTH as f32);
    }
    graph
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]
    #[test]
    fn searching_is_comparing_with_all(
        graphs in prop::collection::vec(graph(), 0..60),
        query in graph(),
        options in options(),
        top in 0_usize..8,
        without in 0_u32..3,
    ) {
        let map = ViewMap::new(graphs.iter(), options.clone());
        let asked = map.query(&query);
        let allowed = |view: u32| without == 0 || view % 3 != without;
        let found = map.search(&asked, top, allowed);
        let all = (0..graphs.len() as u32).filter(|view| allowed(*view));
        let mut all: Vec<Hit> = all.map(|view| map.compare(&asked, view).unwrap()).collect();
        all.retain(|hit| hit.matched >= options.min_matched);
        all.sort_by(|a, b| b.score.total_cmp(&a.score)
            .then(b.matched.cmp(&a.matched)).then(a.view.cmp(&b.view)));
        all.truncate(top);
        prop_assert_eq!(&found, &all);
        let views: Vec<u32> = (0..graphs.len() as u32 + 2).filter(|view| allowed(*view)).collect();
        prop_assert_eq!(map.among(&asked, &views, top), found);
    }

    #[test]
    fn a_view_is_found_again_wherever_it_looked(graphs in prop::collection::vec(graph(), 1..20), which: prop::sample::Index, half: bool) {
        let view = which.index(graphs.len());
        prop_assume!(!graphs[view].areas.is_empty());
        let options = Options { headings: 2, ..Options::default() };
        let map = ViewMap::new(graphs.iter(), options);
        let query = if half && graphs[view].wraps { turned(&graphs[view], PI) } else { graphs[view].clone() };
        let asked = map.query(&query);
        let hit = map.compare(&asked, view as u32).unwrap();
        prop_assert!(hit.score > 0.999 && hit.matched as usize == asked.areas(), "{:?}", hit);
        prop_assert!((hit.similarity - 1.0).abs() < 1e-12);
        prop_assert!(map.search(&asked, 1, |_| true)[0].score >= hit.score);
    }

    #[test]
    fn the_class_index_is_counting(graphs in prop::collection::vec(graph(), 0..50), query in graph(), wanted in 1_usize..9) {
        let index = ClassIndex::new(graphs.iter(), 4);
        let views = |fits: &dyn Fn(&Graph) -> bool| -> Vec<u32> {
            (0_u32..).zip(&graphs).filter(|(_, graph)| fits(graph)).map(|(view, _)| view).collect()
        };
        let sorted = |views: &[u32]| { let mut views = views.to_vec(); views.sort_unstable(); views };
        let asked = counts(&query);
        let leaves: Vec<Vec<u32>> = (0..index.len()).map(|leaf| index.leaf(leaf).1.to_vec()).collect();
        prop_assert_eq!(sorted(&leaves.concat()), views(&|_| true));
        // The nearest leaves, of all.
        let distance = |leaf: usize| -> u32 {
            let pairs = index.leaf(leaf).0.iter().zip(&asked);
            pairs.map(|(a, b)| u32::from(a.abs_diff(*b))).sum()
        };
        let mut order: Vec<usize> = (0..index.len()).collect();
        order.sort_by_key(|leaf| (distance(*leaf), *leaf));
        let mut expected: Vec<u32> = Vec::new();
        for leaf in order {
            if expected.len() < wanted {
                expected.extend(index.leaf(leaf).1.iter().filter(|view| **view % 3 > 0));
            }
        }
        prop_assert_eq!(index.near(&asked, wanted, |view| view % 3 > 0), expected);
    }
}

#[test]
fn similarity_is_the_formula() {
    assert_eq!(similarity(5, 0), 0.0);
    assert_eq!(similarity(7, 7), 1.0);
    assert!((similarity(14, 7) - (-1.0_f64).exp()).abs() < 1e-15);
    assert!((similarity(11, 8) - (1.0_f64 - 11.0 / 8.0).exp()).abs() < 1e-15);
}

#[test]
fn what_is_no_number_takes_no_part() {
    let bad = Area {
        class: 1,
        pixels: 5000,
        u: f32::NAN,
        v: 1.0,
        major_px: 1.0,
        minor_px: 1.0,
        orientation_rad: f32::INFINITY,
        eccentricity: 2.0,
    };
    let good = Area {
        u: 3.0,
        orientation_rad: 0.0,
        eccentricity: 0.5,
        ..bad
    };
    let of = |areas: &[Area]| Graph {
        width: 100,
        height: 50,
        wraps: true,
        field_of_view_rad: None,
        areas: areas.to_vec(),
        edges: vec![Edge {
            a: 0,
            b: 9,
            boundary_px: 4,
        }],
    };
    let graphs = [of(&[]), of(&[bad]), of(&[bad, good]), Graph::default()];
    let map = ViewMap::new(graphs.iter(), Options::default());
    let hits = map.search(&map.query(&graphs[2]), 9, |_| true);
    assert_eq!(hits.iter().map(|hit| hit.view).collect::<Vec<_>>(), [2]);
    assert_eq!(map.search(&map.query(&graphs[0]), 9, |_| true), []);
    assert_eq!(map.compare(&map.query(&graphs[2]), 4), None);
    let nowhere = ViewMap::new(std::iter::empty(), Options::default());
    assert_eq!(nowhere.search(&nowhere.query(&graphs[2]), 3, |_| true), []);
    let unturned = Options {
        headings: 0,
        ..Options::default()
    };
    let map = ViewMap::new(graphs.iter(), unturned);
    assert_eq!(map.search(&map.query(&graphs[2]), 3, |_| true), []);
    assert_eq!(map.compare(&map.query(&graphs[2]), 2), None);
}

/// More views than are bounded together: the one of its kind is found wherever it lies.
#[test]
fn a_view_is_found_among_thousands() {
    let view = |class: u8, u: f32| Graph {
        width: WIDTH,
        height: 333,
        wraps: true,
        areas: vec![Area {
            class,
            pixels: 5000,
            u,
            v: 160.0,
            major_px: 40.0,
            minor_px: 30.0,
            orientation_rad: 0.0,
            eccentricity: 0.5,
        }],
        ..Graph::default()
    };
    for (own, headings) in [(0, 24), (1000, 7), (2047, 24), (2048, 1), (2999, 24)] {
        let graphs: Vec<Graph> = (0..3000)
            .map(|at| view(u8::from(at == own), 300.0))
            .collect();
        let options = Options {
            headings,
            candidates: 1,
            ..Options::default()
        };
        let map = ViewMap::new(graphs.iter(), options);
        let hits = map.search(&map.query(&view(1, 290.0)), 1, |_| true);
        assert_eq!(hits.first().map(|hit| hit.view), Some(own), "{headings}");
        let passed = |view: u32| view != own;
        assert_eq!(map.search(&map.query(&view(1, 290.0)), 1, passed), []);
    }
}

/// Places of one kind each, two views of every one: found in their own drive, and sure of it; places that all look the same
/// are not told apart, and nothing is learnt from them.
#[test]
fn a_drive_says_what_finding_its_views_is_worth() {
    let view = |class: u8| Graph {
        width: WIDTH,
        height: 333,
        wraps: true,
        areas: vec![Area {
            class,
            pixels: 5000,
            u: 100.0,
            v: 160.0,
            major_px: 40.0,
            minor_px: 40.0,
            orientation_rad: 0.0,
            eccentricity: 0.0,
        }],
        ..Graph::default()
    };
    let positions: Vec<_> = (0..40)
        .map(|at| Vector3::new(f64::from(at / 2) * 40.0 + f64::from(at % 2) * 4.0, 0.0, 0.0))
        .collect();
    let learnt = |graphs: Vec<Graph>, positions: &[Vector3<f64>]| {
        let map = ViewMap::new(graphs.iter(), Options::default());
        self_search(&map, &graphs, positions, &CalibrationOptions::default())
    };
    // Two places that are alike are found for each other when the right one is not there, and no third is.
    let of_a_kind = |kinds: u8| (0..40).map(|at| view(at / 2 % kinds)).collect();
    let told_apart = learnt(of_a_kind(20), &positions).unwrap();
    assert_eq!((told_apart.queries, told_apart.recall), (40, 1.0));
    let all_alike = learnt(of_a_kind(1), &positions).unwrap();
    assert!(all_alike.recall < 0.2, "{all_alike:?}");
    assert_eq!(all_alike.calibration, None);
    // A drive of one place, and one whose views are all far apart.
    assert_eq!(learnt(of_a_kind(20), &positions[..2]), None);
    let far: Vec<_> = positions.iter().map(|at| at * 100.0).collect();
    assert_eq!(learnt(of_a_kind(20), &far), None);
    assert_eq!(learnt(Vec::new(), &[]), None);
}
