//! The tree of paper 2 against Algorithm 1 as it is printed, on adjacency matrices.

use std::cmp::Reverse;
use std::f32::consts::{FRAC_PI_2, PI};
use std::f64::consts::TAU;

use proptest::prelude::*;

use super::graphs::graph;
use crate::semantic_map::relocation::{Options, ShapeLimits, TreeKind, ViewMap, matched_areas};
use crate::semantic_map::semantic_graph::{Area, Edge, Graph};

/// Matched areas of the query and of the view.
type InterpList = Vec<[usize; 2]>;

/// The adjacency matrix: angles (rad) that common boundaries take up, 0 where areas do not touch. A panorama has four times
/// as much of the world in each pixel as an image that does not wrap, which sees a quarter.
fn weights(graph: &Graph) -> Vec<Vec<f64>> {
    let number = graph.areas.len();
    let mut weights = vec![vec![0.0; number]; number];
    let range = if graph.wraps { TAU } else { TAU / 4.0 };
    for edge in &graph.edges {
        let (a, b) = (usize::from(edge.a), usize::from(edge.b));
        let length = f64::from(edge.boundary_px) * range / f64::from(graph.width);
        weights[a][b] = length;
        weights[b][a] = length;
    }
    weights
}

/// The areas that take part, the largest first.
fn largest_first(graph: &Graph, options: &Options) -> Vec<usize> {
    // Of a panorama, of which an image that does not wrap sees a quarter.
    let around = if graph.wraps { 1.0 } else { 4.0 };
    let panorama = around * f64::from(graph.height) * f64::from(graph.width);
    let least = options.min_area_share * panorama;
    let mut order: Vec<usize> = (0..graph.areas.len())
        .filter(|area| f64::from(graph.areas[*area].pixels) >= least)
        .filter(|area| !options.ignored.contains(&graph.areas[*area].class))
        .collect();
    order.sort_by_key(|area| Reverse(graph.areas[*area].pixels));
    order
}

/// Label, eccentricity and orientation of the elliptical envelope.
fn unary_constraint(a: &Area, b: &Area, limits: &ShapeLimits) -> Option<f32> {
    let mut tilt = (a.orientation_rad - b.orientation_rad).abs();
    if tilt > FRAC_PI_2 {
        tilt = PI - tilt;
    }
    let ratio = |area: &Area| area.log_elongation().exp();
    let differences = [
        (
            (a.eccentricity - b.eccentricity).abs(),
            limits.max_eccentricity,
        ),
        ((ratio(a) - ratio(b)).abs(), limits.max_length_over_width),
        (tilt, limits.max_orientation_rad),
    ];
    let fits = differences.iter().all(|(by, most)| *by <= *most as f32);
    let score = differences.iter().map(|(by, most)| by / *most as f32);
    (a.class == b.class && fits).then(|| score.sum())
}

fn pairwise_constraint(
    list: &InterpList,
    here: &[Vec<f64>],
    there: &[Vec<f64>],
    most: f64,
) -> bool {
    list.iter().all(|[a, b]| {
        list.iter().all(|[c, d]| {
            let (mine, theirs) = (here[*a][*c], there[*b][*d]);
            let one = a == c || b == d;
            let neither = mine == 0.0 && theirs == 0.0;
            let both = mine > 0.0 && theirs > 0.0;
            one || neither || both && (mine / theirs).ln().abs() <= most.ln() + 1e-6
        })
    })
}

/// Algorithm 1.
fn interpretation_tree(g1: &Graph, g2: &Graph, options: &Options) -> InterpList {
    let (here, there) = (weights(g1), weights(g2));
    let mut list = InterpList::new();
    for i in largest_first(g1, options) {
        let mut matched: Vec<(f32, usize, usize)> = Vec::new();
        // Of equal ones that of the first class in the map's order, which is one here.
        for (rank, j) in largest_first(g2, options).into_iter().enumerate() {
            let score = unary_constraint(&g1.areas[i], &g2.areas[j], &options.shapes);
            matched.extend(score.map(|score| (score, rank, j)));
        }
        matched.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, _, j) in matched {
            list.push([i, j]);
            if !pairwise_constraint(&list, &here, &there, options.boundary_factor) {
                list.pop();
            }
        }
    }
    list
}

fn count(list: &InterpList) -> u32 {
    let mut areas: Vec<usize> = list.iter().map(|[area, _]| *area).collect();
    areas.sort_unstable();
    areas.dedup();
    areas.len() as u32
}

fn options() -> impl Strategy<Value = Options> {
    let ratio = prop_oneof![Just(1e6_f64), 0.1_f64..4.0];
    let shapes = (0.05_f64..1.0, ratio, 0.05_f64..1.6);
    let others = (1.0_f64..9.0, any::<bool>());
    (shapes, others).prop_map(
        |((eccentricity, ratio, orientation), (boundary, ignores))| Options {
            tree: TreeKind::Interpretation,
            shapes: ShapeLimits {
                max_eccentricity: eccentricity,
                max_length_over_width: ratio,
                max_orientation_rad: orientation,
            },
            boundary_factor: boundary,
            ignored: if ignores { vec![1] } else { Vec::new() },
            ..Options::default()
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn the_tree_is_the_papers(
        graphs in prop::collection::vec(graph(), 1..12),
        query in graph(),
        options in options(),
        top in 0_usize..5,
    ) {
        let map = ViewMap::new(graphs.iter(), options.clone());
        let asked = map.query(&query);
        let defined: Vec<u32> = graphs.iter()
            .map(|view| count(&interpretation_tree(&query, view, &options)))
            .collect();
        let areas = largest_first(&query, &options).len().max(1);
        for (view, defined) in (0..).zip(&defined) {
            let hit = map.compare(&asked, view).unwrap();
            prop_assert_eq!(hit.matched, *defined);
            prop_assert_eq!(hit.score, f64::from(*defined) / areas as f64);
        }
        let mut best: Vec<u32> = (0..graphs.len() as u32).filter(|view| defined[*view as usize] > 0).collect();
        best.sort_by_key(|view| (Reverse(defined[*view as usize]), *view));
        best.truncate(top);
        let found = map.search(&asked, top, |_| true);
        prop_assert_eq!(found.iter().map(|hit| hit.view).collect::<Vec<_>>(), best);
        let views: Vec<u32> = (0..graphs.len() as u32).collect();
        prop_assert_eq!(map.among(&asked, &views, top), found);
    }

    /// Neither where areas are nor how large they look counts, but for their order.
    #[test]
    fn place_and_size_do_not_count(graph in graph(), other in graph(), options in options(), right in 0.0_f32..1024.0) {
        let options = Options { min_area_share: 0.0, ..options };
        let mut moved = other.clone();
        for area in &mut moved.areas {
            area.u = (area.u + right).rem_euclid(1024.0);
            area.v += 9.0;
            area.pixels *= 3;
        }
        let matched = |view: &Graph| matched_areas(&graph, view, &options);
        prop_assert_eq!(matched(&other), matched(&moved));
    }
}

/// An ellipse of so much length and width (px), turned by an angle.
fn ellipse(class: u8, [length, width]: [f32; 2], orientation_rad: f32) -> Area {
    Area {
        class,
        pixels: 4000,
        u: 100.0,
        v: 100.0,
        major_px: length,
        minor_px: width,
        orientation_rad,
        eccentricity: (1.0 - (width / length).powi(2)).sqrt(),
    }
}

fn of(areas: &[Area], edges: &[(u16, u16, u32)]) -> Graph {
    let edge = |(a, b, boundary_px): &(u16, u16, u32)| Edge {
        a: *a,
        b: *b,
        boundary_px: *boundary_px,
    };
    Graph {
        width: 1024,
        height: 333,
        wraps: true,
        field_of_view_rad: None,
        areas: areas.to_vec(),
        edges: edges.iter().map(edge).collect(),
    }
}

fn matched(query: &Graph, view: &Graph, shapes: ShapeLimits) -> u32 {
    let options = Options {
        tree: TreeKind::Interpretation,
        shapes,
        boundary_factor: 2.0,
        ..Options::default()
    };
    let map = ViewMap::new(std::iter::once(view), options);
    map.compare(&map.query(query), 0).unwrap().matched
}

/// Lengths of 2 and 4 widths have eccentricities of √(3/4) = 0.866 and √(15/16) = 0.968, 0.102 apart.
#[test]
fn label_eccentricity_and_orientation_decide() {
    let one = of(&[ellipse(0, [20.0, 10.0], 0.0)], &[]);
    let limits = |eccentricity, ratio, orientation| ShapeLimits {
        max_eccentricity: eccentricity,
        max_length_over_width: ratio,
        max_orientation_rad: orientation,
    };
    let longer = of(&[ellipse(0, [40.0, 10.0], 0.0)], &[]);
    assert_eq!(matched(&one, &longer, limits(0.103, 1e6, 0.1)), 1);
    assert_eq!(matched(&one, &longer, limits(0.101, 1e6, 0.1)), 0);
    assert_eq!(matched(&one, &longer, limits(1.0, 2.01, 0.1)), 1);
    assert_eq!(matched(&one, &longer, limits(1.0, 1.99, 0.1)), 0);
    // The axis has no sign: 1.5 and -1.5 rad are 0.142 apart.
    let [up, down] = [1.5, -1.5].map(|angle| of(&[ellipse(0, [20.0, 10.0], angle)], &[]));
    assert_eq!(matched(&up, &down, limits(0.1, 1e6, 0.15)), 1);
    assert_eq!(matched(&up, &down, limits(0.1, 1e6, 0.14)), 0);
    assert_eq!(matched(&up, &one, limits(0.1, 1e6, FRAC_PI_2.into())), 1);
    let other = of(&[ellipse(1, [20.0, 10.0], 0.0)], &[]);
    assert_eq!(matched(&one, &other, limits(1.0, 1e6, 2.0)), 0);
}

/// A car on a road, beside one that is not on it, one that hardly touches it, and a road without a car.
#[test]
fn what_touches_what_decides_both_ways() {
    let (road, car) = (ellipse(0, [80.0, 10.0], 0.0), ellipse(1, [20.0, 10.0], 0.0));
    let on = |boundary: u32| of(&[road, car], &[(0, 1, boundary)]);
    let beside = of(&[road, car], &[]);
    let same = |a: &Graph, b: &Graph| matched(a, b, ShapeLimits::default());
    assert_eq!(same(&on(40), &on(40)), 2);
    assert_eq!(same(&on(40), &on(21)), 2);
    assert_eq!(same(&on(40), &on(19)), 1);
    assert_eq!(same(&on(40), &beside), 1);
    assert_eq!(same(&beside, &on(40)), 1);
    assert_eq!(same(&beside, &beside), 2);
}

/// Two cars, one of which hides the other in the other view.
#[test]
fn an_area_stands_for_several() {
    let (road, car) = (ellipse(0, [80.0, 10.0], 0.0), ellipse(1, [20.0, 10.0], 0.0));
    let two = of(&[road, car, car], &[(0, 1, 40), (0, 2, 40)]);
    let one = of(&[road, car], &[(0, 1, 60)]);
    let same = |a: &Graph, b: &Graph| matched(a, b, ShapeLimits::default());
    assert_eq!(same(&two, &one), 3);
    assert_eq!(same(&one, &two), 2);
}
