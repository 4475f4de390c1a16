#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

use proptest::prelude::*;

use super::*;

fn labels(rows: &[&str]) -> (u32, u32, Vec<u8>) {
    let value = |c: char| c.to_digit(10).map_or(VOID, |digit| digit as u8);
    let values = rows.iter().flat_map(|row| row.chars().map(value)).collect();
    (rows[0].len() as u32, rows.len() as u32, values)
}

fn graph(rows: &[&str], wraps: bool, min_px: u32) -> Graph {
    let (width, height, values) = labels(rows);
    let image = Labels {
        width,
        height,
        values: &values,
    };
    let options = GraphOptions {
        classes: 9,
        wraps,
        min_px,
    };
    Graph::from_labels(&image, &options).unwrap()
}

/// Each pixel's neighbours to the right and below.
fn neighbours(width: usize, height: usize, wraps: bool) -> Vec<[usize; 2]> {
    let mut pairs = Vec::new();
    for at in 0..width * height {
        let column = at % width;
        if column + 1 < width {
            pairs.push([at, at + 1]);
        } else if wraps && width >= 3 {
            pairs.push([at, at + 1 - width]);
        }
        if at + width < width * height {
            pairs.push([at, at + width]);
        }
    }
    pairs
}

/// The first pixel of each pixel's area, by spreading until nothing changes.
fn flood(values: &[u8], pairs: &[[usize; 2]]) -> Vec<Option<usize>> {
    let mut first: Vec<Option<usize>> = (0..values.len())
        .map(|at| (values[at] != VOID).then_some(at))
        .collect();
    loop {
        let mut changed = false;
        for [a, b] in pairs {
            if values[*a] == values[*b] && first[*a] != first[*b] {
                let least = first[*a].min(first[*b]);
                (first[*a], first[*b]) = (least, least);
                changed = true;
            }
        }
        if !changed {
            return first;
        }
    }
}

type Lengths = BTreeMap<(usize, usize), u32>;

fn lengths(first: &[Option<usize>], pairs: &[[usize; 2]]) -> Lengths {
    let mut lengths = Lengths::new();
    for [a, b] in pairs {
        if let (Some(a), Some(b)) = (first[*a], first[*b])
            && a != b
        {
            *lengths.entry((a.min(b), a.max(b))).or_default() += 1;
        }
    }
    lengths
}

fn sizes(first: &[Option<usize>]) -> BTreeMap<usize, u32> {
    let mut sizes = BTreeMap::new();
    for first in first.iter().flatten() {
        *sizes.entry(*first).or_default() += 1;
    }
    sizes
}

/// One small area after the other, everything computed afresh after each.
fn absorb(values: &mut [u8], pairs: &[[usize; 2]], min_px: u32) {
    loop {
        let first = flood(values, pairs);
        let sizes = sizes(&first);
        let small = sizes.iter().filter(|(_, size)| **size < min_px);
        let Some((region, _)) = small.min_by_key(|(region, size)| (**size, **region)) else {
            return;
        };
        let lengths = lengths(&first, pairs);
        let touching = lengths.iter().filter_map(|((a, b), length)| {
            let other = if a == region { b } else { a };
            (a == region || b == region).then_some((*length, sizes[other], Reverse(*other)))
        });
        let class = touching.max().map_or(VOID, |(_, _, heir)| values[heir.0]);
        for (at, of) in first.iter().enumerate() {
            if *of == Some(*region) {
                values[at] = class;
            }
        }
    }
}

/// Centre and second moments of pixels, unrolled at the first column without any, else opposite the mean direction.
fn moments(pixels: &[[usize; 2]], width: usize, wraps: bool) -> ([f64; 2], [f64; 3]) {
    let columns: BTreeSet<usize> = pixels.iter().map(|[u, _]| *u).collect();
    let rows_of = |column: usize| -> BTreeSet<usize> {
        let of = pixels.iter().filter(|[u, _]| *u == column);
        of.map(|[_, v]| *v).collect()
    };
    let crosses = wraps && width >= 3 && !rows_of(0).is_disjoint(&rows_of(width - 1));
    let cut = if !crosses {
        0
    } else if let Some(empty) = (0..width).find(|u| !columns.contains(u)) {
        empty
    } else {
        let angle = |u: &usize| *u as f64 * TAU / width as f64;
        let sum = |part: fn(f64) -> f64| -> f64 {
            let mut sum = 0.0;
            for column in 0..width {
                sum += rows_of(column).len() as f64 * part(angle(&column));
            }
            sum
        };
        let (x, y) = (sum(f64::cos), sum(f64::sin));
        let even = x.hypot(y) < 1e-9 * pixels.len() as f64;
        let mean = if even {
            0.0
        } else {
            y.atan2(x) / TAU * width as f64
        };
        (mean + width as f64 / 2.0 + 0.5 + 1e-6)
            .floor()
            .rem_euclid(width as f64) as usize
            % width
    };
    let points: Vec<[f64; 2]> = pixels
        .iter()
        .map(|[u, v]| [(if *u < cut { u + width } else { *u }) as f64, *v as f64])
        .collect();
    let n = points.len() as f64;
    let mean = [0, 1].map(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / n);
    let second = |a: usize, b: usize| {
        let products = points.iter().map(|p| (p[a] - mean[a]) * (p[b] - mean[b]));
        products.sum::<f64>() / n
    };
    let moments = [
        second(0, 0) + 1.0 / 12.0,
        second(1, 1) + 1.0 / 12.0,
        second(0, 1),
    ];
    (mean, moments)
}

/// The moments that an area's ellipse has.
fn moments_of(area: &Area) -> [f64; 3] {
    let [large, small] = [area.major_px, area.minor_px].map(|axis| f64::from(axis).powi(2) / 4.0);
    let (sin, cos) = f64::from(area.orientation_rad).sin_cos();
    [
        large * cos * cos + small * sin * sin,
        large * sin * sin + small * cos * cos,
        (large - small) * sin * cos,
    ]
}

fn check(width: usize, height: usize, values: &[u8], wraps: bool, min_px: u32) {
    let image = Labels {
        width: width as u32,
        height: height as u32,
        values,
    };
    let options = GraphOptions {
        classes: 4,
        wraps,
        min_px,
    };
    let graph = Graph::from_labels(&image, &options).unwrap();
    let mut plain: Vec<u8> = values
        .iter()
        .map(|v| if *v < 4 { *v } else { VOID })
        .collect();
    let pairs = neighbours(width, height, wraps);
    absorb(&mut plain, &pairs, min_px);
    let first = flood(&plain, &pairs);
    let mut regions: Vec<(usize, u32)> = sizes(&first).into_iter().collect();
    regions.sort_by_key(|(region, size)| (plain[*region], Reverse(*size), *region));
    assert_eq!(graph.areas.len(), regions.len());
    for (area, (region, size)) in graph.areas.iter().zip(&regions) {
        assert_eq!((area.class, area.pixels), (plain[*region], *size));
        let pixels: Vec<[usize; 2]> = (0..first.len())
            .filter(|at| first[*at] == Some(*region))
            .map(|at| [at % width, at / width])
            .collect();
        let ([u, v], expected) = moments(&pixels, width, wraps);
        let away = f64::from(area.u) - u;
        let turned = away.rem_euclid(width as f64);
        let off = if wraps {
            turned.min(width as f64 - turned)
        } else {
            away.abs()
        };
        assert!(off < 1e-3);
        assert!((f64::from(area.v) - v).abs() < 1e-3);
        for (found, expected) in moments_of(area).iter().zip(expected) {
            assert!(
                (found - expected).abs() < 1e-4 * (1.0 + expected.abs()),
                "{area:?}"
            );
        }
        assert!((0.0..=1.0).contains(&area.eccentricity));
        assert!(area.u >= -0.5 && area.u < width as f32);
    }
    let number = |region: usize| regions.iter().position(|(of, _)| *of == region).unwrap();
    let mut edges: Vec<(usize, usize, u32)> = lengths(&first, &pairs)
        .into_iter()
        .map(|((a, b), length)| (number(a).min(number(b)), number(a).max(number(b)), length))
        .collect();
    edges.sort_unstable();
    let found = graph.edges.iter();
    let found = found.map(|e| (usize::from(e.a), usize::from(e.b), e.boundary_px));
    assert_eq!(found.collect::<Vec<_>>(), edges);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn graphs_are_those_of_flood_fill(
        (width, values) in (1_usize..14).prop_flat_map(|width| {
            let row = prop::collection::vec(prop_oneof![8 => 0_u8..3, 1 => 3_u8..6, 1 => Just(VOID)], width);
            (Just(width), prop::collection::vec(row, 1..9))
        }),
        wraps: bool,
        min_px in 0_u32..12,
    ) {
        check(width, values.len(), &values.concat(), wraps, min_px);
    }

    #[test]
    fn blobs_are_those_of_flood_fill(
        blobs in prop::collection::vec((0_usize..24, 0_usize..10, 1_usize..14, 1_usize..8, 0_u8..4), 0..12),
        wraps: bool,
        min_px in 0_u32..40,
    ) {
        let mut values = vec![0; 24 * 10];
        for (u, v, width, height, class) in blobs {
            for row in v..(v + height).min(10) {
                for column in u..u + width {
                    values[row * 24 + column % 24] = class;
                }
            }
        }
        check(24, 10, &values, wraps, min_px);
    }
}

#[test]
fn an_area_across_the_seam_is_one_with_its_centre_at_the_seam() {
    let rows = ["2200000022", "2200000022", "1111111111"];
    let (whole, cut) = (graph(&rows, true, 0), graph(&rows, false, 0));
    let of_two = |graph: &Graph| graph.areas.iter().filter(|area| area.class == 2).count();
    assert_eq!((of_two(&whole), of_two(&cut)), (1, 2));
    let area = whole.areas.last().unwrap();
    assert_eq!((area.pixels, area.u, area.v), (8, -0.5, 0.5));
    assert_eq!(area.orientation_rad, 0.0);
}

#[test]
fn a_hole_is_filled_by_what_is_around_it() {
    let rows = ["0000000", "0111110", "0121110", "0111110", "0000000"];
    let graph = graph(&rows, true, 2);
    let sizes: Vec<(u8, u32)> = graph.areas.iter().map(|a| (a.class, a.pixels)).collect();
    assert_eq!(sizes, [(0, 20), (1, 15)]);
    assert_eq!(
        graph.edges,
        [Edge {
            a: 0,
            b: 1,
            boundary_px: 16
        }]
    );
}

#[test]
fn a_thin_line_given_away_joins_both_sides() {
    let graph = graph(&["0000", "0000", "1111", "0000", "0000"], false, 5);
    assert_eq!(graph.areas.len(), 1);
    assert_eq!((graph.areas[0].class, graph.areas[0].pixels), (0, 20));
}

#[test]
fn images_that_are_none_are_refused_and_empty_ones_have_empty_graphs() {
    let of = |width, height, values: &[u8]| {
        let options = GraphOptions {
            classes: 9,
            wraps: true,
            min_px: 3,
        };
        Graph::from_labels(
            &Labels {
                width,
                height,
                values,
            },
            &options,
        )
    };
    assert_eq!(
        of(3, 2, &[0; 5]),
        Err(GraphError::Size {
            expected: 6,
            found: 5
        })
    );
    assert_eq!(
        of(1 << 16, 1, &[0; 1 << 16]),
        Err(GraphError::TooLarge {
            width: 1 << 16,
            height: 1
        })
    );
    for (width, height) in [(0, 0), (5, 0), (0, 5)] {
        assert_eq!(of(width, height, &[]).unwrap().areas, []);
    }
    assert_eq!(of(2, 2, &[VOID, 77, VOID, 0]).unwrap().areas, []);
    let checks: Vec<u8> = (0..600 * 600)
        .map(|at| ((at % 600 + at / 600) % 2) as u8)
        .collect();
    let options = GraphOptions {
        classes: 9,
        wraps: false,
        min_px: 0,
    };
    let image = Labels {
        width: 600,
        height: 600,
        values: &checks,
    };
    assert_eq!(
        Graph::from_labels(&image, &options),
        Err(GraphError::TooManyAreas(360_000))
    );
    assert_eq!(image.unknown_px(1), 180_000);
    let filled = Graph::from_labels(
        &image,
        &GraphOptions {
            min_px: 2,
            ..options
        },
    )
    .unwrap();
    assert_eq!(filled.areas.len(), 1);
}

#[test]
fn relations_are_of_centres_and_contact() {
    // Sky above a road that goes all around, a car (7) on it left of a tree (0), both in front of the sky.
    let rows = ["1111111111", "1177110011", "2277220022", "2222222222"];
    let graph = graph(&rows, true, 0);
    let (tree, sky, road, car) = (0, 1, 2, 7);
    let holds = |a, word: &str, b| graph.holds(a, Relation::parse(word).unwrap(), b);
    assert!(holds(car, "on", road) && !holds(road, "on", car));
    assert!(
        holds(road, "touches", car) && holds(sky, "touches", road) && !holds(car, "touches", tree)
    );
    assert!(holds(tree, "right of", car) && holds(car, "left of", tree));
    assert!(!holds(tree, "left of", car) && !holds(car, "right of", car));
    assert!(
        graph.holds(sky, Relation::Above, road)
            || graph.holds(sky, Relation::AboveRightOf, road)
            || graph.holds(sky, Relation::AboveLeftOf, road)
    );
    assert_eq!(graph.count(tree), 1);
    assert_eq!(graph.count(5), 0);
}

#[test]
fn directions_are_the_papers_eight_in_its_order() {
    let offsets = [
        [-1., 0.],
        [-1., -1.],
        [0., -1.],
        [1., -1.],
        [1., 0.],
        [1., 1.],
        [0., 1.],
        [-1., 1.],
    ];
    for (offset, expected) in offsets.into_iter().zip(Relation::ALL) {
        assert_eq!(Relation::direction(offset), Some(expected));
        let nudged = [offset[0] + 0.3 * offset[1], offset[1] - 0.3 * offset[0]];
        assert_eq!(Relation::direction(nudged), Some(expected));
    }
    assert_eq!(Relation::direction([-1.0, -0.0]), Some(Relation::LeftOf));
    assert_eq!(Relation::direction([0.0, 0.0]), None);
    assert_eq!(Relation::direction([f32::NAN, 1.0]), None);
}

#[test]
fn words_are_read_and_unknown_ones_answered_with_all() {
    for relation in Relation::ALL {
        assert_eq!(Relation::parse(relation.word()), Ok(relation));
        assert_eq!(
            Relation::parse(&relation.to_string().to_uppercase().replace(' ', "_")),
            Ok(relation)
        );
    }
    assert_eq!(Relation::parse(" top  left "), Ok(Relation::AboveLeftOf));
    let error = Relation::parse("under").unwrap_err().to_string();
    assert!(
        error.contains("'under'") && error.contains("below right of") && error.contains("touches")
    );
}

#[test]
fn an_edge_to_an_area_that_is_not_there_is_passed_over() {
    let mut graph = graph(&["01"], false, 0);
    graph.edges.push(Edge {
        a: 1,
        b: 9,
        boundary_px: 1,
    });
    assert!(graph.holds(0, Relation::Touches, 1) && !graph.holds(1, Relation::On, 0));
}
