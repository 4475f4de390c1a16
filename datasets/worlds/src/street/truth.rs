//! The truth beside the sessions.

use super::classes::{STREET_CLASSES, STREET_COLOURS};
use super::things::{Shape, Thing};
use super::views::StreetLabels;
use super::visit::Visit;
use crate::WorldError;
use crate::plane::Pose2;
use crate::record::Folder;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What is true of all visits: classes and the world.
pub fn write_world(street: &StreetLabels, out: &Path) -> Result<PathBuf, WorldError> {
    let folder = Folder::create(out, "truth")?;
    let classes = json!({
        "classes": STREET_CLASSES,
        "colors_rgb": STREET_COLOURS,
        "dynamic": ["car"],
    });
    folder.save_json("classes.json", &classes)?;
    folder.save_json("world.json", &description(street))?;
    folder.finish()
}

fn description(street: &StreetLabels) -> Value {
    let land = &street.scenery.land;
    let round = |value: f64| (value * 1e3).round() / 1e3;
    let line = land.course.stations.iter();
    let line: Vec<[f64; 2]> = line.map(|station| station.at.map(round)).collect();
    let stretches = land.plan.stretches.iter().map(|stretch| {
        let quarters = stretch.sides.map(|side| format!("{:?}", side.quarter));
        json!({ "from_m": round(stretch.from), "to_m": round(stretch.to), "left_right": quarters })
    });
    let junctions = land.plan.junctions.iter();
    let visits = street.visits.iter().map(|visit| {
        let session = &visit.session;
        json!({
            "name": session.name, "start_ns": session.start_ns, "lane_offset_m": visit.offset_m,
            "panoramas": session.stamps.len(), "driven_m": session.drive.length_m(),
            "wheel_errors": session.wheels.errors,
        })
    });
    json!({
        "world": "street",
        "parameters": street.params,
        "length_m": land.course.length_m,
        "poses": "map_from_vehicle; TUM lines: stamp_s x y z qx qy qz qw",
        "vehicle_from_panorama": street.camera.vehicle_from_camera.to_array(),
        "centre_line": line,
        "stretches": stretches.collect::<Vec<_>>(),
        "junctions_m": junctions.map(|junction| round(junction.s)).collect::<Vec<_>>(),
        "things": street.scenery.town.things.len(),
        "visits": visits.collect::<Vec<_>>(),
    })
}

/// What is true of one visit: where it was, and where cars stood.
pub fn write_visit(
    street: &StreetLabels,
    visit: &Visit,
    folder: &Folder,
) -> Result<(), WorldError> {
    let session = &visit.session;
    let samples = session.odometry();
    let fine = samples.iter().map(|sample| sample.times.stamp_ns);
    folder.save_poses("trajectory.tum", session, session.stamps.iter().copied())?;
    folder.save_poses("trajectory_50hz.tum", session, fine)?;
    let mut csv = String::from("index,stamp_ns,static_labels\n");
    for (index, stamp) in session.stamps.iter().enumerate() {
        let _ = writeln!(csv, "{index},{stamp},static_labels/{index:06}.png");
    }
    folder.save("panoramas.csv", csv.as_bytes())?;
    let car = |(car, speed): (Thing, f64)| {
        let Pose2 { x, y, yaw } = car.pose;
        let Shape::Car([length, width, height, _]) = car.shape else {
            return Value::Null;
        };
        json!({ "x": x, "y": y, "yaw": yaw, "speed": speed, "size": [length, width, height] })
    };
    let cars = visit.traffic.at_start(&street.scenery.land).map(car);
    let cars = json!({
        "frame": "map, metres, radians; driving cars (speed > 0) where the visit starts",
        "cars": cars.collect::<Vec<_>>(),
    });
    folder.save_json("cars.json", &cars)?;
    let description = json!({
        "session": session.name,
        "panoramas": session.stamps.len(),
        "wanted_label_noise": street.params.label_noise,
        "start_ns": session.start_ns,
    });
    folder.save_json("session.json", &description)
}
