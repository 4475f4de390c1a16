//! The truth beside the sessions.

use crate::WorldError;
use crate::folder::Folder;
use crate::odometry::OdometrySample;
use crate::street::classes::{STREET_CLASSES, STREET_COLOURS};
use crate::street::params::Street;
use crate::street::sight::Scenery;
use crate::street::views::StreetLabels;
use crate::street::visit::Visit;
use crate::truth::tum;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What is true of all visits: classes and the world.
pub fn write_world(
    world: &Street,
    labels: &StreetLabels,
    out: &Path,
) -> Result<PathBuf, WorldError> {
    let folder = Folder::create(out, "truth")?;
    let classes = json!({
        "classes": STREET_CLASSES,
        "colors_rgb": STREET_COLOURS,
        "dynamic": ["car"],
    });
    for (name, value) in [
        ("classes.json", classes),
        ("world.json", description(world, labels)),
    ] {
        folder.save(name, format!("{value:#}\n").as_bytes())?;
    }
    folder.finish()
}

fn description(world: &Street, labels: &StreetLabels) -> Value {
    let land = &labels.scenery.land;
    let round = |value: f64| (value * 1e3).round() / 1e3;
    let line: Vec<[f64; 2]> = land
        .course
        .stations
        .iter()
        .map(|station| station.at.map(round))
        .collect();
    let stretches: Vec<Value> = land
        .plan
        .stretches
        .iter()
        .map(|stretch| {
            let quarters = stretch.sides.map(|side| format!("{:?}", side.quarter));
            json!({ "from_m": round(stretch.from), "to_m": round(stretch.to), "left_right": quarters })
        })
        .collect();
    let junctions: Vec<f64> = land.plan.junctions.iter().map(|j| round(j.s)).collect();
    let visits: Vec<Value> = labels
        .visits
        .iter()
        .map(|visit| {
            json!({
                "name": visit.name, "start_ns": visit.start_ns, "lane_offset_m": visit.offset_m,
                "panoramas": visit.stamps.len(), "driven_m": visit.drive.length_m(),
                "wheel_errors": visit.wheels.errors,
            })
        })
        .collect();
    json!({
        "world": "street",
        "parameters": world,
        "length_m": land.course.length_m,
        "poses": "map_from_vehicle; TUM lines: stamp_s x y z qx qy qz qw",
        "vehicle_from_panorama": labels.camera.lens.vehicle_from_camera.to_array(),
        "centre_line": line,
        "stretches": stretches,
        "junctions_m": junctions,
        "things": labels.scenery.town.things.len(),
        "visits": visits,
    })
}

/// What is true of one visit: where it was, and where cars stood.
pub fn write_visit(
    world: &Street,
    scenery: &Scenery,
    visit: &Visit,
    samples: &[OdometrySample],
    folder: &Folder,
) -> Result<(), WorldError> {
    let shots = visit.stamps.iter().copied();
    let fine = samples.iter().map(|sample| sample.stamp_ns);
    let poses = |stamp: u64| (stamp, visit.drive.map_from_vehicle(visit.seconds(stamp)));
    folder.save("trajectory.tum", tum(shots.map(poses)).as_bytes())?;
    folder.save("trajectory_50hz.tum", tum(fine.map(poses)).as_bytes())?;
    let mut csv = String::from("index,stamp_ns,static_labels\n");
    for (index, stamp) in visit.stamps.iter().enumerate() {
        let _ = writeln!(csv, "{index},{stamp},static_labels/{index:06}.png");
    }
    folder.save("panoramas.csv", csv.as_bytes())?;
    let cars = json!({
        "frame": "map, metres, radians; driving cars (speed > 0) where the visit starts",
        "cars": visit.traffic.truth(&scenery.land),
    });
    folder.save("cars.json", format!("{cars:#}\n").as_bytes())?;
    let session = json!({
        "session": visit.name,
        "panoramas": visit.stamps.len(),
        "wanted_label_noise": world.label_noise,
        "start_ns": visit.start_ns,
    });
    folder.save("session.json", format!("{session:#}\n").as_bytes())
}
