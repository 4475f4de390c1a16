//! Lanes and intersections, by hand and on a real drive.

use evermap_contract::Losses;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{Intersection, Lane, Source, VehiclePose};
use evermap_schemas::{Pose, Stamp};
use serde_json::json;

use crate::yields;

fn pose(session: &str, stamp: i64, x: f64, y: f64) -> VehiclePose {
    VehiclePose {
        site: "s".into(),
        session: session.into(),
        stamp: Stamp(stamp),
        map_from_vehicle: Pose {
            x,
            y,
            ..Pose::IDENTITY
        },
    }
}

fn source(session: &str, first: i64, last: i64) -> Source {
    Source {
        session: session.into(),
        first_stamp: Stamp(first),
        last_stamp: Stamp(last),
    }
}

fn lanes(poses: Vec<VehiclePose>) -> (Vec<Lane>, Losses) {
    yields(
        "road_network",
        json!({}),
        [inputs_of("poses", poses).unwrap()],
    )
}

fn intersections(lanes: Vec<Lane>) -> Vec<Intersection> {
    yields(
        "intersections",
        json!({}),
        [inputs_of("lanes", lanes).unwrap()],
    )
    .0
}

/// East along y = 0, and north along x = 0.
fn crossing() -> Vec<VehiclePose> {
    let along = |step: i64| step as f64 * 0.5 - 20.0;
    let east = (0..=80).map(|step| pose("east", step, along(step), 0.0));
    let north = (0..=80).map(|step| pose("north", step, 0.0, along(step)));
    east.chain(north).collect()
}

#[test]
fn two_streets_that_cross_have_four_lanes_and_one_intersection() {
    let (found, losses) = lanes(crossing());
    assert!(losses.is_empty());
    assert_eq!(found.len(), 4, "{found:?}");
    for lane in &found {
        let along_x = lane.points[0][0] != lane.points[lane.points.len() - 1][0];
        let session = if along_x { "east" } else { "north" };
        let [only] = lane.sources.as_slice() else {
            panic!("{lane:?}");
        };
        // Either arm is half of the drive: stamps 0 to 40, or 40 to 80, but for the junction's width.
        assert_eq!(only.session, session);
        let (first, last) = (only.first_stamp.0, only.last_stamp.0);
        assert!(
            (first == 0 && (35..46).contains(&last)) || (last == 80 && (35..46).contains(&first)),
            "{lane:?}"
        );
    }
    let places = intersections(found);
    assert_eq!(places.len(), 1, "{places:?}");
    assert_eq!(places[0].degree, 4);
    assert!(places[0].x.hypot(places[0].y) < 1.0);
    let whole = |session: &str| source(session, 0, 80);
    assert_eq!(places[0].sources, [whole("east"), whole("north")]);
}

#[test]
fn the_order_of_sessions_and_nonsense_do_not_matter() {
    let (expected, _) = lanes(crossing());
    let mut poses = crossing();
    poses.reverse();
    poses.push(pose("east", 1_000, f64::NAN, 0.0));
    let (found, losses) = lanes(poses);
    assert_eq!(found, expected);
    assert_eq!(losses.0["position is not finite"], 1);
    let mut straight: Vec<_> = (0..9)
        .map(|at| pose("a", at * 10, at as f64, 0.0))
        .collect();
    straight.insert(0, pose("a", -5, f64::NAN, 0.0));
    straight.insert(4, pose("a", 25, 0.0, f64::INFINITY));
    let (found, losses) = lanes(straight);
    assert_eq!(losses.total(), 2);
    assert_eq!(found[0].sources, [source("a", 0, 80)]);
    let (found, _) = lanes(vec![pose("a", 0, 1.0, 1.0)]);
    assert!(found.is_empty(), "{found:?}");
    let standing = (0..50).map(|stamp| pose("a", stamp, 1.0, 1.0)).collect();
    assert!(lanes(standing).0.is_empty());
}

#[test]
fn a_lane_without_points_is_counted() {
    let (mut found, _) = lanes(crossing());
    found[0].points.clear();
    let inputs = [inputs_of("lanes", found).unwrap()];
    let (places, losses) = yields::<Intersection>("intersections", json!({}), inputs);
    assert_eq!((places[0].degree, losses.total()), (3, 1));
}

/// The first poses file of KITTI 07 below a folder: 3 × 4 matrices, camera axes, so that x and z are horizontal.
fn kitti(folder: &std::path::Path) -> Option<Vec<VehiclePose>> {
    let mut entries: Vec<_> = std::fs::read_dir(folder)
        .ok()?
        .flatten()
        .map(|e| e.path())
        .collect();
    entries.sort();
    if let Some(file) = entries
        .iter()
        .find(|path| path.file_name().is_some_and(|name| name == "07.txt"))
    {
        let text = std::fs::read_to_string(file).ok()?;
        let poses = text.lines().zip(0..).map(|(line, stamp)| {
            let numbers: Vec<f64> = line
                .split_whitespace()
                .filter_map(|n| n.parse().ok())
                .collect();
            pose("07", stamp, numbers[11], -numbers[3])
        });
        return Some(poses.collect());
    }
    entries
        .iter()
        .filter(|path| path.is_dir())
        .find_map(|path| kitti(path))
}

#[test]
fn a_real_drive_stays_on_its_lanes() {
    let Some(folder) = evermap_test_data::shared("data/kitti_poses") else {
        return;
    };
    let poses = kitti(&folder).unwrap();
    let (found, losses) = lanes(poses.clone());
    assert!(losses.is_empty() && !found.is_empty());
    for lane in &found {
        let [part] = lane.sources.as_slice() else {
            panic!("{lane:?}");
        };
        assert!(part.session == "07" && part.first_stamp < part.last_stamp);
        for stamp in [part.first_stamp, part.last_stamp] {
            let at = &poses[stamp.0 as usize].map_from_vehicle;
            let away = lane.points.iter().map(|p| (p[0] - at.x).hypot(p[1] - at.y));
            assert!(
                away.fold(f64::INFINITY, f64::min) < 6.0,
                "{stamp:?} {lane:?}"
            );
        }
    }
    for point in found.iter().flat_map(|lane| &lane.points) {
        let nearest = poses.iter().map(|pose| {
            (pose.map_from_vehicle.x - point[0]).hypot(pose.map_from_vehicle.y - point[1])
        });
        assert!(nearest.fold(f64::INFINITY, f64::min) < 2.0, "{point:?}");
    }
    for place in intersections(found) {
        assert!(place.degree > 2, "{place:?}");
        assert_eq!(place.sources.len(), 1);
    }
}
