//! Real and simulated drives, judged by geometry that shares nothing with the algorithm.

use super::*;
use evermap_test_data::shared;

/// KITTI odometry ground truth: rows of 3×4 camera poses; the ground plane is x and z.
fn kitti(name: &str) -> Option<Vec<[f64; 3]>> {
    let path = shared(&format!("data/kitti_poses/{name}.txt"))?;
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let n: Vec<f64> = line
            .split_whitespace()
            .map(|word| word.parse().unwrap())
            .collect();
        [n[3], n[11], 0.0]
    };
    Some(text.lines().map(row).collect())
}

/// Where a path comes to run along or across an earlier or later part of itself, or stops doing
/// so: samples every 0.5 m, "alongside" meaning within 2 m of a part more than 30 m of path away.
/// Ends that are also an end of the path (of either part) are no junctions: it merely goes on.
struct Meetings {
    /// Ends of stretches driven more than once.
    ends: Vec<[f64; 3]>,
    /// Everything within the stretches and a little around.
    shared: Vec<[f64; 3]>,
}

const STEP: f64 = 0.5;

fn meetings(path: &[[f64; 3]]) -> Meetings {
    let samples = dense(&resampled(path), STEP);
    let partner: Vec<Option<usize>> = (0..samples.len())
        .map(|i| {
            let far = |j: &usize| (j.abs_diff(i) as f64) * STEP > 30.0;
            let away = |&j: &usize| cells::distance(&samples[i], &samples[j]);
            (0..samples.len())
                .filter(far)
                .filter(|j| away(j) <= 2.0)
                .min_by(|a, b| away(a).total_cmp(&away(b)))
        })
        .collect();
    let mut found = Meetings {
        ends: Vec::new(),
        shared: Vec::new(),
    };
    let margin = (4.0 / STEP) as usize;
    let inside = |i: usize| i > margin && i + margin < samples.len();
    for i in 0..samples.len() {
        let Some(j) = partner[i] else { continue };
        found.shared.push(samples[i]);
        let borders = [i.checked_sub(1), Some(i + 1)].into_iter().flatten();
        let ends = borders
            .filter(|&k| partner.get(k).is_some_and(Option::is_none))
            .count()
            > 0;
        if ends && inside(i) && inside(j) {
            found.ends.push(samples[i]);
        }
    }
    found
}

/// The corners of a path at equal distances, so that sample numbers measure path.
fn resampled(path: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let (mut points, mut due, mut length) = (vec![path[0]], STEP, 0.0);
    for pair in path.windows(2) {
        let step = cells::distance(&pair[0], &pair[1]);
        while due <= length + step {
            let t = (due - length) / step;
            points.push([0, 1, 2].map(|k| pair[0][k] + t * (pair[1][k] - pair[0][k])));
            due += STEP;
        }
        length += step;
    }
    points
}

fn nearest(to: &[f64; 3], among: impl Iterator<Item = [f64; 3]>) -> f64 {
    among
        .map(|p| (p[0] - to[0]).hypot(p[1] - to[1]))
        .fold(f64::INFINITY, f64::min)
}

/// Poses that are clearly on one lane, by geometry alone, lie in its passage.
fn check_passages(path: &[[f64; 3]], found: &RoadNetwork) {
    let mut clear = 0;
    for (at, p) in path.iter().enumerate() {
        let mut lanes: Vec<(f64, &Lane)> = found
            .lanes
            .iter()
            .map(|lane| (off_line(p, &lane.points), lane))
            .collect();
        lanes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let next = lanes.get(1).map_or(f64::INFINITY, |next| next.0);
        if lanes[0].0 > 1.0 || next < 10.0 {
            continue;
        }
        let passage = &lanes[0].1.passages[0];
        assert!(
            (passage.first..=passage.last).contains(&at),
            "pose {at} at {p:?}: {passage:?}"
        );
        clear += 1;
    }
    assert!(2 * clear > path.len(), "{clear} of {}", path.len());
    for lane in &found.lanes {
        for at in [lane.passages[0].first, lane.passages[0].last] {
            let off = off_line(&path[at], &lane.points);
            assert!(off < 6.0, "pose {at} is {off} m from its lane");
        }
    }
}

fn check_kitti(name: &str, intersections: usize) {
    let Some(path) = kitti(name) else { return };
    let positions_alone = RoadNetworkParams {
        headings: false,
        ..RoadNetworkParams::default()
    };
    let found = network(std::slice::from_ref(&path), &positions_alone);
    for lane in &found.lanes {
        let worst = dense(&lane.points, 0.5)
            .iter()
            .map(|p| off_line(p, &path))
            .fold(0.0, f64::max);
        assert!(
            worst < 2.0,
            "{name}: a lane leaves the driven path by {worst} m"
        );
        assert_ne!(lane.travel, Travel::Unknown);
    }
    let lanes: Vec<Vec<[f64; 3]>> = found.lanes.iter().map(|lane| lane.points.clone()).collect();
    for p in dense(&path, 1.0) {
        let off = lanes
            .iter()
            .map(|lane| off_line(&p, lane))
            .fold(f64::INFINITY, f64::min);
        assert!(off < 4.0, "{name}: driven at {p:?}, {off} m from any lane");
    }
    attribution::check(&found, &[("drive_00000", &path)]);
    check_passages(&path, &found);
    let truth = meetings(&path);
    assert!(!truth.ends.is_empty());
    for end in &truth.ends {
        let off = nearest(end, found.intersections.iter().map(|i| i.position));
        assert!(
            off < 6.0,
            "{name}: the path meets itself at {end:?}, {off} m from an intersection"
        );
    }
    for intersection in &found.intersections {
        let off = nearest(&intersection.position, truth.shared.iter().copied());
        assert!(
            off < 4.0,
            "{name}: {intersection:?} is {off} m from where the path meets itself"
        );
    }
    assert_eq!(
        found.intersections.len(),
        intersections,
        "{name}: {:#?}",
        found.intersections
    );
}

#[test]
fn kitti_07_comes_home_once() {
    check_kitti("07", 1);
}

#[test]
fn kitti_00_meets_itself_where_it_should() {
    check_kitti("00", 8);
}

/// KITTI drives some streets again half a lane aside; nowhere is it farther than a lane's width off, and hardly anywhere
/// farther than 0.3 m.
#[test]
fn driven_metres_are_near_lanes_of_their_direction() {
    for (name, share) in [("00", 0.95), ("07", 0.99)] {
        let Some(path) = kitti(name) else { return };
        let path = resampled(&path);
        let found = network(std::slice::from_ref(&path), &RoadNetworkParams::default());
        let (driven, lanes) = (laws::directed(&path), laws::lane_ways(&found));
        let some: Vec<laws::Directed> = driven.iter().step_by(10).copied().collect();
        let off = laws::nearest_ways(&some, &lanes);
        let near = off.iter().filter(|off| **off <= 0.3).count() as f64 / off.len() as f64;
        let worst = off.into_iter().fold(0.0, f64::max);
        assert!(
            near >= share && worst < 2.0,
            "{name}: {near} within 0.3 m, worst {worst} m"
        );
        let some: Vec<laws::Directed> = lanes.iter().step_by(10).copied().collect();
        let invented = laws::nearest_ways(&some, &driven)
            .into_iter()
            .fold(0.0, f64::max);
        assert!(invented < 1.0, "{name}: a lane {invented} m from any drive");
    }
}

/// A trajectory as TUM lines: stamp, then position.
fn tum(path: &std::path::Path) -> Vec<[f64; 3]> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let n: Vec<f64> = line
            .split_whitespace()
            .skip(1)
            .map(|word| word.parse().unwrap())
            .collect();
        [n[0], n[1], n[2]]
    };
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .map(row)
        .collect()
}

#[test]
fn car_park_lanes_follow_the_aisles() {
    let Some(world) = shared("worlds/carpark_small") else {
        return;
    };
    let sessions = ["initial", "revisit_1", "revisit_2"];
    let drives = sessions.map(|name| tum(&world.join(name).join("trajectory.tum")));
    let found = network(&drives, &RoadNetworkParams::default());
    let text = std::fs::read_to_string(world.join("truth/lane_graph.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&text).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let aisles: Vec<Vec<[f64; 3]>> = truth["segments"]
        .as_array()
        .unwrap()
        .iter()
        .map(|segment| {
            let corners = segment["polyline"].as_array().unwrap();
            corners
                .iter()
                .map(|p| [number(&p[0]), number(&p[1]), 0.0])
                .collect()
        })
        .collect();
    let crossings: Vec<[f64; 3]> = truth["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|node| number(&node["degree"]) > 2.0)
        .map(|node| [number(&node["x"]), number(&node["y"]), 0.0])
        .collect();
    assert_eq!(
        (found.lanes.len(), found.intersections.len()),
        (3, 2),
        "{found:#?}"
    );
    let named = ["drive_00000", "drive_00001", "drive_00002"];
    let named: Vec<(&str, &[[f64; 3]])> = named
        .into_iter()
        .zip(drives.iter().map(Vec::as_slice))
        .collect();
    attribution::check(&found, &named);
    let mut points: Vec<[f64; 3]> = found
        .lanes
        .iter()
        .flat_map(|lane| dense(&lane.points, 0.5))
        .collect();
    for p in &mut points {
        p[2] = 0.0;
    }
    // Bends are driven round, the truth has corners: 2.6 m is half an aisle.
    for p in &points {
        let off = aisles
            .iter()
            .map(|aisle| off_line(p, aisle))
            .fold(f64::INFINITY, f64::min);
        assert!(
            off < 2.6,
            "lane point {p:?} is {off} m from an aisle's middle"
        );
    }
    for p in aisles.iter().flat_map(|aisle| dense(aisle, 0.5)) {
        let off = nearest(&p, points.iter().copied());
        let driven = nearest(&p, drives.iter().flatten().copied());
        assert!(
            off < driven + 2.0,
            "aisle at {p:?} is {off} m from a lane, {driven} m from a drive"
        );
    }
    // Nobody made it up: each lane lies where somebody drove its way. Sessions drive 0.8 m beside each other, where no line
    // is within 0.3 m of all; the lane is as wide instead, and no vehicle is farther out of it.
    let driven = drives
        .iter()
        .flat_map(|path| laws::directed(&resampled(path)));
    let driven: Vec<laws::Directed> = driven.collect();
    let some: Vec<laws::Directed> = laws::lane_ways(&found).into_iter().step_by(5).collect();
    let invented = laws::nearest_ways(&some, &driven)
        .into_iter()
        .fold(0.0, f64::max);
    assert!(
        invented <= 0.3,
        "a lane {invented} m from who drove its way"
    );
    let vehicle_m = RoadNetworkParams::default().vehicle_width_m;
    let outside = |p: &[f64; 3]| {
        let lanes = found.lanes.iter();
        let outside =
            lanes.map(|lane| off_line(p, &lane.points) - 0.5 * (lane.width_m - vehicle_m));
        outside.fold(f64::INFINITY, f64::min)
    };
    let outside = driven.iter().step_by(10).map(|(p, _)| outside(p));
    let outside = outside.fold(f64::NEG_INFINITY, f64::max);
    assert!(outside <= 0.3, "a vehicle {outside} m out of every lane");
    for intersection in &found.intersections {
        let off = nearest(&intersection.position, crossings.iter().copied());
        assert!(
            off < 6.0,
            "{intersection:?} is {off} m from any crossing of aisles"
        );
    }
    for crossing in &crossings {
        let off = nearest(crossing, found.intersections.iter().map(|i| i.position));
        assert!(off < 6.0, "no intersection near {crossing:?}");
    }
}
