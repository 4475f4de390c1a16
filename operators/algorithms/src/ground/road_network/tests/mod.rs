#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod attribution;
mod laws;
mod real;
mod reference;

use super::*;
use proptest::prelude::*;
use reference::Reference;

fn network(drives: &[Vec<[f64; 3]>], params: &RoadNetworkParams) -> RoadNetwork {
    let keys: Vec<String> = (0..drives.len()).map(|i| format!("drive_{i:05}")).collect();
    let drives: Vec<Trace<'_>> = keys
        .iter()
        .zip(drives)
        .map(|(key, positions)| Trace {
            key,
            positions,
            breaks: &[],
        })
        .collect();
    road_network(&drives, params).unwrap()
}

/// A drive along corners, a pose every `step` metres, pushed sideways by `offset`.
fn along(corners: &[[f64; 2]], step: f64, offset: f64) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for pair in corners.windows(2) {
        let (dx, dy) = (pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]);
        let length = dx.hypot(dy);
        let (ux, uy) = (dx / length, dy / length);
        for k in 0..(length / step) as usize {
            let s = k as f64 * step;
            points.push([
                pair[0][0] + s * ux - offset * uy,
                pair[0][1] + s * uy + offset * ux,
                0.0,
            ]);
        }
    }
    points
}

/// Distance in the plane from `p` to the polyline `line`.
fn off_line(p: &[f64; 3], line: &[[f64; 3]]) -> f64 {
    let to_segment = |a: &[f64; 3], b: &[f64; 3]| {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let squared = dx * dx + dy * dy;
        let along = (p[0] - a[0]) * dx + (p[1] - a[1]) * dy;
        let t = if squared > 0.0 {
            (along / squared).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
    };
    line.windows(2)
        .map(|pair| to_segment(&pair[0], &pair[1]))
        .fold(f64::INFINITY, f64::min)
}

/// Points every `step` metres along a polyline.
fn dense(line: &[[f64; 3]], step: f64) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for pair in line.windows(2) {
        let parts = (cells::distance(&pair[0], &pair[1]) / step).ceil().max(1.0) as u32;
        for part in 0..parts {
            let t = f64::from(part) / f64::from(parts);
            points.push([0, 1, 2].map(|k| pair[0][k] + t * (pair[1][k] - pair[0][k])));
        }
    }
    points.extend(line.last());
    points
}

#[test]
fn two_passes_side_by_side_are_one_lane() {
    let line = [[0.0, 0.0], [60.0, 0.0]];
    for offset in [0.3, 0.7, 0.9, 1.1, 1.4, 1.6, 1.8] {
        for steps in [[0.2, 0.2], [1.0, 0.7], [0.2, 1.5]] {
            let drives = [along(&line, steps[0], 0.0), along(&line, steps[1], offset)];
            let found = network(&drives, &RoadNetworkParams::default());
            assert_eq!(
                found.lanes.len(),
                1,
                "offset {offset}, steps {steps:?}: {found:#?}"
            );
            let lane = &found.lanes[0];
            assert!((58.0..60.5).contains(&lane.length_m), "{}", lane.length_m);
            assert_eq!((lane.travel, lane.forward_passes), (Travel::Forward, 2));
        }
    }
}

#[test]
fn a_crossing_is_one_intersection_of_four() {
    let across = along(&[[0.0, 0.0], [50.0, 0.0]], 0.2, 0.0);
    let up = along(&[[25.3, -20.0], [25.3, 20.0]], 0.2, 0.0);
    let found = network(&[across, up], &RoadNetworkParams::default());
    assert_eq!(
        (found.lanes.len(), found.intersections.len()),
        (4, 1),
        "{found:#?}"
    );
    let meeting = &found.intersections[0];
    assert_eq!(meeting.degree, 4);
    assert!(cells::distance(&meeting.position, &[25.3, 0.0, 0.0]) < 2.0);
    assert!(
        found
            .lanes
            .iter()
            .all(|lane| lane.forward_passes + lane.reverse_passes == 1)
    );
}

#[test]
fn out_and_back_is_both_ways_and_trembling_is_not() {
    let mut drive = along(&[[0.0, 0.0], [30.0, 0.0]], 0.2, 0.0);
    let tremble = (0..100_000).map(|i| {
        [
            30.0 + 0.3 * f64::from(i % 7 - 3),
            0.2 * f64::from(i % 5 - 2),
            0.0,
        ]
    });
    drive.extend(tremble);
    let one_way = network(&[drive.clone()], &RoadNetworkParams::default());
    assert_eq!(one_way.lanes.len(), 1);
    assert_eq!(
        (
            one_way.lanes[0].forward_passes,
            one_way.lanes[0].reverse_passes
        ),
        (1, 0)
    );
    drive.extend(along(&[[30.0, 0.3], [0.0, 0.3]], 0.2, 0.0));
    let both = network(&[drive], &RoadNetworkParams::default());
    assert_eq!(both.lanes.len(), 1);
    let lane = &both.lanes[0];
    assert_eq!(
        (lane.travel, lane.forward_passes, lane.reverse_passes),
        (Travel::Both, 1, 1)
    );
}

#[test]
fn a_closed_loop_is_a_ring() {
    let corners = [
        [0.0, 0.0],
        [30.0, 0.0],
        [30.0, 20.0],
        [0.0, 20.0],
        [0.0, 0.0],
        [12.0, 0.0],
    ];
    let found = network(&[along(&corners, 0.3, 0.0)], &RoadNetworkParams::default());
    assert_eq!(
        (found.lanes.len(), found.intersections.len()),
        (1, 0),
        "{found:#?}"
    );
    let lane = &found.lanes[0];
    assert_eq!(
        (lane.start.kind, lane.end.kind),
        (EndKind::Ring, EndKind::Ring)
    );
    assert_eq!(lane.points.first(), lane.points.last());
    assert!((lane.length_m - 100.0).abs() < 6.0, "{}", lane.length_m);
    assert_eq!(lane.forward_passes + lane.reverse_passes, 1);
}

#[test]
fn nothing_and_nonsense() {
    let params = RoadNetworkParams::default();
    assert_eq!(network(&[], &params), RoadNetwork::default());
    assert_eq!(
        network(&[vec![[f64::NAN; 3], [1.0; 3]]], &params),
        RoadNetwork::default()
    );
    let far = vec![[0.0; 3], [1e300, 0.0, 0.0], [f64::MAX, -f64::MAX, 0.0]];
    assert!(network(&[far], &params).lanes.len() <= 1);
    for connect_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let params = RoadNetworkParams {
            connect_m,
            ..RoadNetworkParams::default()
        };
        assert!(road_network(&[], &params).is_err());
    }
}

fn wandering(most: usize) -> impl Strategy<Value = Vec<[f64; 3]>> {
    prop::collection::vec((-1.3..1.3f64, -1.3..1.3f64), 0..most).prop_map(|steps| {
        let mut at = [0.0; 3];
        let walk = |(dx, dy)| {
            at = [at[0] + dx, at[1] + dy, 0.0];
            at
        };
        steps.into_iter().map(walk).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn without_thinning_it_is_the_paper_to_the_letter(
        a in wandering(7), b in wandering(6), loops in 0..4u32
    ) {
        let drives = [a, b];
        let mut reference = Reference::new(&drives, 2.0);
        reference.prune(loops, 2.0);
        let borrowed: Vec<Trace<'_>> =
            drives.iter().map(|positions| Trace { key: "", positions, breaks: &[] }).collect();
        let (mut graph, _) = graph::connect(thinning::literal(&borrowed), 2.0, usize::MAX);
        let rule = Rule { connect_m: 2.0, drops_dead_ends: true };
        prune::prune_cliques(&mut graph, loops, rule);
        for i in 0..reference.x.len() {
            prop_assert_eq!(graph.exists(i as u32), reference.exists[i]);
            for j in 0..reference.x.len() {
                prop_assert_eq!(graph.adjacent(i as u32, j as u32), reference.a[i][j]);
            }
        }
        // Algorithm 2: every edge is in exactly one lane, and lanes end where it branches or stops.
        let mut edges: Vec<(u32, u32)> = Vec::new();
        for chain in explore::chains(&graph) {
            edges.extend(chain.nodes.windows(2).map(|e| (e[0].min(e[1]), e[0].max(e[1]))));
            let inner = &chain.nodes[1..chain.nodes.len() - 1];
            prop_assert!(inner.iter().all(|&node| graph.degree(node) == 2));
            prop_assert_eq!(chain.ring, graph.degree(chain.nodes[0]) == 2);
        }
        edges.sort_unstable();
        let m = reference.x.len();
        let expected: Vec<(u32, u32)> = (0..m)
            .flat_map(|i| (i + 1..m).map(move |j| (i, j)))
            .filter(|&(i, j)| reference.a[i][j])
            .map(|(i, j)| (i as u32, j as u32))
            .collect();
        prop_assert_eq!(edges, expected);
    }

    #[test]
    fn lanes_stay_near_and_the_order_of_drives_does_not_matter(
        a in wandering(60), b in wandering(60), c in wandering(60), headings in any::<bool>(),
    ) {
        let params = RoadNetworkParams { headings, ..RoadNetworkParams::default() };
        let drives =
            [("a", &a), ("b", &b), ("c", &c)].map(|(key, positions)| Trace { key, positions, breaks: &[] });
        let found = road_network(&drives, &params).unwrap();
        let [first, second, third] = drives;
        prop_assert_eq!(&road_network(&[third, first, second], &params).unwrap(), &found);
        let driven: Vec<[f64; 3]> = [&a, &b, &c].into_iter().flat_map(|d| dense(d, 0.1)).collect();
        attribution::check(&found, &[("a", &a), ("b", &b), ("c", &c)]);
        for point in found.lanes.iter().flat_map(|lane| &lane.points) {
            let off = driven.iter().map(|p| cells::distance(p, point)).fold(f64::INFINITY, f64::min);
            let most = if headings { params.connect_m } else { 0.1 };
            prop_assert!(off < most);
        }
        for lane in &found.lanes {
            prop_assert!(lane.points.len() >= 2 && lane.start.node <= lane.end.node);
        }
    }
}
