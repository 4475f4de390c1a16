//! What a planner needs of lanes, on made-up drives: every driven metre within 0.3 m of a lane of its direction, no lane
//! where nobody drove, junctions where drives part or cross and nowhere else.

use super::*;

/// Bound on how far a driven metre may be from a lane of its direction, and a lane from who drove it, metres.
const NEAR_M: f64 = 0.3;

/// Noise of a pose, metres, standard deviation.
const NOISE_M: f64 = 0.05;

/// Numbers from 0 to 1 that follow from the seed.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// The sum of twelve: normal enough.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

fn noisy(paths: &[Vec<[f64; 3]>], seed: u64) -> Vec<Vec<[f64; 3]>> {
    let mut numbers = Numbers(seed);
    let mut moved = |p: &[f64; 3]| {
        let [x, y] = [0, 1].map(|k| p[k] + NOISE_M * numbers.normal());
        [x, y, p[2]]
    };
    paths
        .iter()
        .map(|path| path.iter().map(&mut moved).collect())
        .collect()
}

/// A place with a direction, a unit vector from above.
pub(super) type Directed = ([f64; 3], [f64; 2]);

/// Points every decimetre, with the direction there.
pub(super) fn directed(line: &[[f64; 3]]) -> Vec<Directed> {
    let mut points = Vec::new();
    for pair in line.windows(2) {
        let (dx, dy) = (pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]);
        let length = dx.hypot(dy);
        let on = dense(&[pair[0], pair[1]], 0.1).into_iter();
        points.extend(on.map(|p| (p, [dx / length, dy / length])));
    }
    points
}

/// From each point to the nearest that goes its way, within 45°.
pub(super) fn nearest_ways(from: &[Directed], to: &[Directed]) -> Vec<f64> {
    let nearest = |(p, u): &Directed| {
        let alike = to.iter().filter(|(_, v)| u[0] * v[0] + u[1] * v[1] > 0.7);
        let away = alike.map(|(q, _)| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2));
        away.fold(f64::INFINITY, f64::min).sqrt()
    };
    from.iter().map(nearest).collect()
}

fn farthest(from: &[Directed], to: &[Directed]) -> f64 {
    nearest_ways(from, to).into_iter().fold(0.0, f64::max)
}

pub(super) fn lane_ways(found: &RoadNetwork) -> Vec<Directed> {
    let mut ways = Vec::new();
    for lane in &found.lanes {
        let ahead = directed(&lane.points);
        if matches!(lane.travel, Travel::Reverse | Travel::Both) {
            ways.extend(ahead.iter().map(|(p, [u, v])| (*p, [-u, -v])));
        }
        if matches!(lane.travel, Travel::Forward | Travel::Both) {
            ways.extend(ahead);
        }
        assert_ne!(lane.travel, Travel::Unknown, "{lane:#?}");
    }
    ways
}

/// The network of the paths with noise, once its laws hold.
fn lawful(paths: &[Vec<[f64; 3]>], seed: u64) -> RoadNetwork {
    let found = network(&noisy(paths, seed), &RoadNetworkParams::default());
    let driven: Vec<_> = paths.iter().flat_map(|path| directed(path)).collect();
    let lanes = lane_ways(&found);
    let (uncovered, invented) = (farthest(&driven, &lanes), farthest(&lanes, &driven));
    assert!(
        uncovered <= NEAR_M,
        "driven {uncovered} m from a lane of its direction"
    );
    assert!(
        invented <= NEAR_M,
        "a lane {invented} m from who drove its direction"
    );
    for lane in &found.lanes {
        assert!(
            sharpest(&lane.points) < 40.0,
            "a lane turns at once: {lane:#?}"
        );
    }
    found
}

/// The sharpest turn between pieces of at least half a metre, degrees.
fn sharpest(line: &[[f64; 3]]) -> f64 {
    let mut kept: Vec<[f64; 3]> = Vec::new();
    for p in line {
        if kept
            .last()
            .is_none_or(|last| cells::distance(last, p) >= 0.5)
        {
            kept.push(*p);
        }
    }
    let way = |a: &[f64; 3], b: &[f64; 3]| (b[1] - a[1]).atan2(b[0] - a[0]);
    let turn = |p: &[[f64; 3]]| {
        let turn = (way(&p[1], &p[2]) - way(&p[0], &p[1]))
            .to_degrees()
            .rem_euclid(360.0);
        turn.min(360.0 - turn)
    };
    kept.windows(3).map(turn).fold(0.0, f64::max)
}

/// Straight to (0, 0), then along a circle to the left by an angle, then straight on.
fn bend(radius: f64, degrees: f64, straight: f64) -> Vec<[f64; 3]> {
    let mut path = along(&[[-straight, 0.0], [0.0, 0.0]], 0.2, 0.0);
    let arc = radius * degrees.to_radians().abs();
    let side = degrees.signum();
    for k in 0..(arc / 0.2) as usize {
        let a = 0.2 * k as f64 / radius;
        path.push([radius * a.sin(), side * radius * (1.0 - a.cos()), 0.0]);
    }
    let a = degrees.to_radians().abs();
    let end = [radius * a.sin(), side * radius * (1.0 - a.cos())];
    let out = [
        end[0] + straight * a.cos(),
        end[1] + side * straight * a.sin(),
    ];
    path.extend(along(&[end, out], 0.2, 0.0));
    path
}

fn ring(radius: f64, turns: f64) -> Vec<[f64; 3]> {
    let steps = (turns * std::f64::consts::TAU * radius / 0.2) as usize;
    let at = |k: usize| {
        let a = 0.2 * k as f64 / radius;
        [radius * a.cos(), radius * a.sin(), 0.0]
    };
    (0..=steps).map(at).collect()
}

fn travels(found: &RoadNetwork) -> Vec<Travel> {
    found.lanes.iter().map(|lane| lane.travel).collect()
}

#[test]
fn opposite_lanes_side_by_side_stay_two() {
    for seed in 0..8 {
        for apart in [1.5, 2.0, 3.0] {
            let out = along(&[[0.0, 0.0], [60.0, 0.0]], 0.2, 0.0);
            let back = along(&[[60.0, apart], [0.0, apart]], 0.2, 0.0);
            let found = lawful(&[out.clone(), back.clone(), out, back], seed);
            let one_way = |travel: &Travel| matches!(travel, Travel::Forward | Travel::Reverse);
            assert_eq!(
                (found.lanes.len(), found.intersections.len()),
                (2, 0),
                "{found:#?}"
            );
            assert!(travels(&found).iter().all(one_way));
            assert!(
                found
                    .lanes
                    .iter()
                    .all(|lane| lane.forward_passes + lane.reverse_passes == 2)
            );
        }
    }
}

#[test]
fn one_line_driven_both_ways_is_one_lane() {
    for seed in 0..8 {
        let out = along(&[[0.0, 0.0], [60.0, 0.0]], 0.2, 0.0);
        let back: Vec<_> = out.iter().rev().copied().collect();
        let found = lawful(&[out, back], seed);
        assert_eq!(travels(&found), [Travel::Both], "{found:#?}");
        assert_eq!(
            (found.lanes[0].forward_passes, found.lanes[0].reverse_passes),
            (1, 1)
        );
    }
}

#[test]
fn a_lane_is_in_the_middle_of_its_passes_and_as_wide_as_they_are() {
    let line = [[0.0, 0.0], [60.0, 0.0]];
    let drives = [-0.2, 0.1, 0.1, 0.2].map(|aside| along(&line, 0.2, aside));
    let found = lawful(&drives, 1);
    assert_eq!(found.lanes.len(), 1, "{found:#?}");
    let lane = &found.lanes[0];
    let aside = lane.points.iter().map(|p| p[1].abs()).fold(0.0, f64::max);
    assert!(aside < 0.08, "{aside}");
    let vehicle_m = RoadNetworkParams::default().vehicle_width_m;
    assert!(
        (lane.width_m - vehicle_m - 0.4).abs() < 0.1,
        "{}",
        lane.width_m
    );
    // One that swerves by 1.2 m moves the lane by half of a driver's scatter at most.
    let mut drives = vec![along(&line, 0.2, 0.0); 3];
    let swerve = |x: f64| 0.6 * (1.0 - (std::f64::consts::TAU * (x - 20.0) / 20.0).cos());
    for p in drives[2]
        .iter_mut()
        .filter(|p| (20.0..40.0).contains(&p[0]))
    {
        p[1] += swerve(p[0]);
    }
    let found = network(&noisy(&drives, 2), &RoadNetworkParams::default());
    let lane = &found.lanes[0];
    let aside = lane.points.iter().map(|p| p[1].abs()).fold(0.0, f64::max);
    assert!(
        found.lanes.len() == 1 && aside < NEAR_M,
        "{aside} {found:#?}"
    );
}

#[test]
fn a_fork_bends_and_is_one_junction() {
    for seed in 0..8 {
        for (radius, degrees) in [(5.0, 90.0), (8.0, -60.0), (20.0, 30.0)] {
            let ahead = bend(1e6, 0.0, 40.0);
            let turn = bend(radius, degrees, 30.0);
            let drives = [ahead.clone(), turn.clone(), ahead, turn];
            let found = lawful(&drives, seed);
            assert_eq!(
                (found.lanes.len(), found.intersections.len()),
                (3, 1),
                "{found:#?}"
            );
            let at = found.intersections[0].position;
            assert!(
                (-1.0..4.5).contains(&at[0]) && at[1].abs() < NEAR_M,
                "{at:?}"
            );
            assert_eq!(found.intersections[0].degree, 3);
            // The other way round it is a merge.
            let back: Vec<Vec<[f64; 3]>> = drives
                .iter()
                .map(|path| path.iter().rev().copied().collect())
                .collect();
            let found = lawful(&back, seed);
            assert_eq!(
                (found.lanes.len(), found.intersections.len()),
                (3, 1),
                "{found:#?}"
            );
        }
    }
}

#[test]
fn where_a_drive_may_go_on_is_where_one_did() {
    let drives = [bend(1e6, 0.0, 40.0), bend(5.0, 90.0, 30.0)];
    let found = lawful(&drives, 3);
    let trunk = found
        .lanes
        .iter()
        .position(|lane| lane.passages.len() == 2)
        .unwrap();
    let others: Vec<u32> = (0..3).filter(|lane| *lane != trunk as u32).collect();
    let lane = &found.lanes[trunk];
    let [ahead, behind] = match lane.travel {
        Travel::Forward => [&lane.next, &lane.next_backward],
        _ => [&lane.next_backward, &lane.next],
    };
    assert_eq!((ahead, behind), (&others, &vec![]));
    let across = along(&[[0.0, 0.0], [50.0, 0.0]], 0.2, 0.0);
    let up = along(&[[25.0, -20.0], [25.0, 20.0]], 0.2, 0.0);
    let found = lawful(&[across, up], 4);
    assert_eq!(
        (found.lanes.len(), found.intersections.len()),
        (4, 1),
        "{found:#?}"
    );
    assert_eq!(found.intersections[0].degree, 4);
    for (number, lane) in found.lanes.iter().enumerate() {
        let on: Vec<u32> = lane
            .next
            .iter()
            .chain(&lane.next_backward)
            .copied()
            .collect();
        for next in on {
            // Straight on: the same drive, on the same line.
            assert_eq!(
                lane.passages[0].drive,
                found.lanes[next as usize].passages[0].drive
            );
            assert_ne!(next as usize, number);
        }
    }
}

#[test]
fn a_crossing_driven_straight_both_ways_is_one_junction() {
    for seed in 0..8 {
        for degrees in [90.0, 60.0, 30.0_f64] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let across = along(&[[-30.0, 0.0], [30.0, 0.0]], 0.2, 0.0);
            let up = along(
                &[[-30.0 * cos, -30.0 * sin], [30.0 * cos, 30.0 * sin]],
                0.2,
                0.0,
            );
            let back = |path: &Vec<[f64; 3]>| path.iter().rev().copied().collect();
            let drives = [across.clone(), up.clone(), back(&across), back(&up)];
            let found = lawful(&drives, seed);
            assert_eq!(
                (found.lanes.len(), found.intersections.len()),
                (4, 1),
                "{degrees}: {found:#?}"
            );
            assert_eq!(found.intersections[0].degree, 4);
            assert!(travels(&found).iter().all(|travel| *travel == Travel::Both));
        }
    }
}

#[test]
fn a_loop_is_a_ring_however_often_it_is_driven() {
    for seed in 0..8 {
        for turns in [1.1, 2.3, 6.4] {
            let found = lawful(&[ring(15.0, turns)], seed);
            assert_eq!(
                (found.lanes.len(), found.intersections.len()),
                (1, 0),
                "{turns}: {found:#?}"
            );
            assert_eq!(found.lanes[0].start.kind, EndKind::Ring);
            let around = std::f64::consts::TAU * 15.0;
            assert!(
                (found.lanes[0].length_m - around).abs() < 1.5,
                "{}",
                found.lanes[0].length_m
            );
        }
        let found = lawful(&[ring(15.0, 0.9)], seed);
        assert_eq!(found.lanes[0].start.kind, EndKind::DeadEnd);
        let eight: Vec<[f64; 3]> = (0..1000)
            .map(|k| {
                let a = std::f64::consts::TAU * f64::from(k) / 480.0;
                [20.0 * a.sin(), 10.0 * (2.0 * a).sin(), 0.0]
            })
            .collect();
        let found = lawful(&[eight], seed);
        assert_eq!(
            (found.lanes.len(), found.intersections.len()),
            (2, 1),
            "{found:#?}"
        );
    }
}

#[test]
fn ten_times_as_many_drives_give_the_same_network() {
    let kinds = [
        bend(1e6, 0.0, 40.0),
        bend(6.0, 90.0, 30.0),
        bend(6.0, -90.0, 30.0),
        along(&[[40.0, 2.0], [-40.0, 2.0]], 0.2, 0.0),
    ];
    let few = lawful(&kinds, 5);
    let many: Vec<Vec<[f64; 3]>> = (0..10).flat_map(|_| kinds.clone()).collect();
    let many = lawful(&many, 6);
    let shape = |found: &RoadNetwork| {
        let mut meetings: Vec<u32> = found.intersections.iter().map(|i| i.degree).collect();
        meetings.sort_unstable();
        (found.lanes.len(), meetings)
    };
    assert_eq!(shape(&few), shape(&many), "{few:#?}\n{many:#?}");
    let (few, many) = (lane_ways(&few), lane_ways(&many));
    assert!(farthest(&few, &many).max(farthest(&many, &few)) < NEAR_M);
}

#[test]
fn nothing_is_joined_across_floors() {
    let low = along(&[[0.0, 0.0], [40.0, 0.0]], 0.2, 0.0);
    let raise = |path: Vec<[f64; 3]>| path.iter().map(|p| [p[0], p[1], 3.0]).collect::<Vec<_>>();
    let same = raise(low.clone());
    let across = raise(along(&[[20.0, -20.0], [20.0, 20.0]], 0.2, 0.0));
    let found = network(&[low.clone(), same], &RoadNetworkParams::default());
    assert_eq!(
        (found.lanes.len(), found.intersections.len()),
        (2, 0),
        "{found:#?}"
    );
    let found = network(&[low, across], &RoadNetworkParams::default());
    assert_eq!(
        (found.lanes.len(), found.intersections.len()),
        (2, 0),
        "{found:#?}"
    );
}
