//! What the tree `weighted` may be asked of pairs of matches.

use crate::semantic_map::relocation::{Hit, Options, ViewMap, matched_areas};
use crate::semantic_map::semantic_graph::{Area, Edge, Graph};

fn area(class: u8, u: f32, pixels: u32) -> Area {
    Area {
        class,
        pixels,
        u,
        v: 160.0,
        major_px: (pixels as f32).sqrt(),
        minor_px: (pixels as f32).sqrt() / 2.0,
        orientation_rad: 0.0,
        eccentricity: 0.75_f32.sqrt(),
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

/// Three areas that lie alike in both views; boundaries differ. 163 px are a radian.
#[test]
fn contacts_hold_both_ways_from_a_length_on() {
    let areas = [
        area(0, 100.0, 8000),
        area(1, 200.0, 5000),
        area(2, 300.0, 3000),
    ];
    let touching = of(&areas, &[(0, 1, 50)]);
    let apart = of(&areas, &[]);
    let matched = |a: &Graph, b: &Graph, contact_rad| {
        let options = Options {
            contact_rad,
            ..Options::default()
        };
        matched_areas(a, b, &options)
    };
    let all = vec![[0, 0], [1, 1], [2, 2]];
    let without = vec![[0, 0], [2, 2]];
    for [a, b] in [[&touching, &apart], [&apart, &touching]] {
        assert_eq!(matched(a, b, None), all);
        assert_eq!(matched(a, b, Some(0.4)), all);
        assert_eq!(matched(a, b, Some(0.0)), without);
        assert_eq!(matched(a, b, Some(0.2)), without);
    }
    for view in [&touching, &apart] {
        assert_eq!(matched(view, view, Some(0.0)), all);
    }
}

/// Two cars, 60 px apart, which are one from elsewhere.
#[test]
fn two_areas_of_the_map_are_one_of_the_query() {
    let mut one = area(0, 130.0, 6000);
    // Two deviations along the row of two cars of the same size, 30 px to either side.
    let own = (3000.0_f32.sqrt() / 2.0).powi(2);
    one.major_px = 2.0 * (own + 900.0).sqrt();
    one.minor_px = 3000.0_f32.sqrt() / 2.0;
    one.eccentricity = (1.0 - (one.minor_px / one.major_px).powi(2)).sqrt();
    let query = of(&[one], &[]);
    let two = of(&[area(0, 100.0, 3000), area(0, 160.0, 3000)], &[]);
    let compared = |query: &Graph, view: &Graph, fused: bool| -> Hit {
        let options = Options {
            fused,
            headings: 1,
            candidates: 0,
            ..Options::default()
        };
        let map = ViewMap::new(std::iter::once(view), options);
        map.compare(&map.query(query), 0).unwrap()
    };
    let [alone, both] = [false, true].map(|fused| compared(&query, &two, fused));
    assert!(alone.score < 0.5 && both.score > 0.98, "{alone:?} {both:?}");
    assert_eq!((alone.matched, both.matched), (1, 1));
    // What is like one alone stays with it, and leaves the other to the next.
    for fused in [false, true] {
        let hit = compared(&two, &two, fused);
        assert_eq!((hit.matched, hit.score), (2, 1.0));
    }
}
