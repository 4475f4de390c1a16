//! The lanes of perfect poses.

use std::path::{Path, PathBuf};

use evermap_tests::{rows_of, run, write_drive};
use serde_json::Value;

use super::world;

type Point = [f64; 2];

/// The lines of a TUM trajectory: stamp (s), x, y, z, qx, qy, qz, qw.
fn trajectory(path: &Path) -> Vec<[f64; 8]> {
    let text = std::fs::read_to_string(path).unwrap();
    let line = |line: &str| {
        let numbers: Vec<f64> = line
            .split_whitespace()
            .map(|number| number.parse().unwrap())
            .collect();
        <[f64; 8]>::try_from(numbers).unwrap()
    };
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .map(line)
        .collect()
}

/// The centre lines of the true lane graph.
fn aisles(world: &Path) -> Vec<Vec<Point>> {
    let graph: Value =
        serde_json::from_slice(&std::fs::read(world.join("truth/lane_graph.json")).unwrap())
            .unwrap();
    let point = |point: &Value| [point[0].as_f64().unwrap(), point[1].as_f64().unwrap()];
    let segments = graph["segments"].as_array().unwrap();
    let line = |segment: &Value| {
        let points = segment.get("polyline");
        points
            .unwrap()
            .as_array()
            .unwrap()
            .iter()
            .map(point)
            .collect()
    };
    segments.iter().map(line).collect()
}

fn distance_to(line: &[Point], [x, y]: Point) -> f64 {
    line.windows(2)
        .map(|pair| {
            let ([ax, ay], [bx, by]) = (pair[0], pair[1]);
            let (dx, dy) = (bx - ax, by - ay);
            let along =
                (((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy).max(1e-12)).clamp(0.0, 1.0);
            (ax + along * dx - x).hypot(ay + along * dy - y)
        })
        .fold(f64::INFINITY, f64::min)
}

/// A session whose odometry is the truth: the tiles and lanes that perfect poses give.
fn true_session(world: &Path, folder: &Path) -> PathBuf {
    let poses = trajectory(&world.join("initial/trajectory_50hz.tum"));
    let start = poses[0][0];
    let drive = folder.join("truth.mcap");
    write_drive(
        &drive,
        poses
            .iter()
            .map(|[stamp, x, y, _, _, _, qz, qw]| (stamp - start, *x, *y, 2.0 * qz.atan2(*qw))),
    );
    drive
}

#[test]
fn lanes_of_true_poses_follow_the_aisles() {
    let Some(world) = world() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (session, map) = (
        true_session(&world, folder.path()),
        folder.path().join("map"),
    );
    run("trajectory", &map, &[&session], &[]).expect(0);
    let lanes = rows_of(&map, "SELECT points FROM lanes");
    let aisles = aisles(&world);
    let mut points = Vec::new();
    for lane in lanes.as_array().unwrap() {
        let line = lane["points"].as_array().unwrap();
        points.extend(
            line.iter()
                .map(|point| [point[0].as_f64().unwrap(), point[1].as_f64().unwrap()]),
        );
    }
    assert!(points.len() > 50, "{} points", points.len());
    for point in &points {
        let nearest = aisles
            .iter()
            .map(|aisle| distance_to(aisle, *point))
            .fold(f64::INFINITY, f64::min);
        assert!(nearest < 2.5, "{point:?} is {nearest:.2} m from any aisle");
    }
}
