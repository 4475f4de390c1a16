//! The truth beside the sessions: what a perfect map would hold.
//!
//! GeoJSON here is in local metres of the map frame (x east, y north), not longitude and
//! latitude; each file says so.

use super::Hall;
use super::canvas::Canvas;
use super::layout::{AISLES, NODES, Node, Rect};
use super::visit::Visit;
use crate::WorldError;
use crate::plane::Pose2;
use crate::record::{Folder, grey_png};
use crate::vehicle::PLACE;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Wanted scale of the overhead picture, pixels per metre.
const OVERHEAD: f64 = 40.0;

/// Writes the folder `truth` in `out`, replacing an older one, and gives its path.
pub(super) fn write(hall: &Hall<'_>, out: &Path) -> Result<PathBuf, WorldError> {
    let (picture, scale) = overhead(&hall.floor)?;
    let folder = Folder::create(out, "truth")?;
    for visit in &hall.visits {
        let session = &visit.session;
        let stamps = session.stamps.iter().copied();
        folder.save_poses(&format!("{}.tum", session.name), session, stamps)?;
        let walkers = format!("{}_walkers.csv", session.name);
        folder.save(&walkers, walkers_csv(visit).as_bytes())?;
    }
    folder.save("overhead.png", &picture)?;
    folder.save_json("bays.geojson", &hall.bays())?;
    folder.save_json("crossings.geojson", &hall.crossings())?;
    folder.save_json("lane_graph.json", &hall.lane_graph())?;
    folder.save_json("cars.json", &hall.cars())?;
    folder.save_json("world.json", &hall.description(scale))?;
    folder.finish()
}

impl Hall<'_> {
    /// A value for each session, by its name.
    fn by_session(&self, value: impl Fn(&Visit) -> Value) -> Map<String, Value> {
        let visits = self.visits.iter();
        visits
            .map(|visit| (visit.session.name.clone(), value(visit)))
            .collect()
    }

    fn bays(&self) -> Value {
        let features = self.layout.bays.iter().enumerate().map(|(index, bay)| {
            let taken = |visit: &Visit| visit.parked.iter().any(|car| car.bay == index).into();
            let properties = json!({
                "id": index,
                "label": bay.label,
                "entry_yaw": bay.entry_yaw,
                "occupied": self.by_session(taken),
            });
            feature(properties, &bay.rect)
        });
        collection(features.collect())
    }

    fn crossings(&self) -> Value {
        let crossings = self.layout.crossings.iter().enumerate();
        let id = |index| json!({ "id": index });
        let features = crossings.map(|(index, crossing)| feature(id(index), &crossing.rect));
        collection(features.collect())
    }

    fn lane_graph(&self) -> Value {
        let nodes = NODES.map(|node| {
            let [x, y] = self.layout.node(node);
            let touches = |(a, b): &&(Node, Node)| *a == node || *b == node;
            let degree = AISLES.iter().filter(touches).count();
            json!({
                "id": format!("{node:?}"), "x": x, "y": y,
                "degree": degree, "intersection": degree > 2,
            })
        });
        let segments = AISLES.map(|(a, b)| {
            let line = [a, b].map(|node| self.layout.node(node));
            json!({ "from": format!("{a:?}"), "to": format!("{b:?}"), "centre_line": line })
        });
        json!({ "frame": "map, metres", "nodes": nodes, "segments": segments })
    }

    fn cars(&self) -> Value {
        let sessions = self.by_session(|visit| json!(visit.parked));
        json!({ "frame": "map, metres, radians", "sessions": sessions })
    }

    fn description(&self, overhead_px_per_m: f64) -> Value {
        let sessions: Vec<Value> = self.visits.iter().map(Visit::description).collect();
        let cameras = self.rig.iter().map(|camera| {
            let (optics, topics) = (&camera.optics, &camera.topics);
            json!({
                "name": camera.name, "frame_id": topics.frame_id, "model": topics.model,
                "fx_fy": optics.focal(), "cx_cy": optics.centre(), "published_cx_cy": topics.centre,
                "k1_k4": optics.distortion(), "vehicle_from_camera": topics.vehicle_from_camera.to_array(),
            })
        });
        let rect = |r: &Rect| [r.x0, r.y0, r.x1, r.y1];
        json!({
            "world": "car_park",
            "parameters": self.params,
            "width_m": self.layout.width_m,
            "depth_m": self.layout.depth_m,
            "overhead_px_per_m": overhead_px_per_m,
            "overhead_pixels": "column c, row r: x = (c + 0.5) / scale, y = depth_m - (r + 0.5) / scale",
            "poses": "map_from_vehicle; TUM lines: stamp_s x y z qx qy qz qw",
            "pillars": self.layout.pillars.iter().map(rect).collect::<Vec<_>>(),
            "islands": self.layout.islands.iter().map(rect).collect::<Vec<_>>(),
            "cameras": cameras.collect::<Vec<_>>(),
            "origin": {
                "latitude_deg": PLACE.latitude_deg,
                "longitude_deg": PLACE.longitude_deg,
                "height_m": PLACE.height_m,
            },
            "sessions": sessions,
        })
    }
}

impl Visit {
    fn description(&self) -> Value {
        let (session, route) = (&self.session, &self.route);
        let nodes: Vec<String> = route.cycle.iter().map(|node| format!("{node:?}")).collect();
        json!({
            "name": session.name,
            "start_ns": session.start_ns,
            "duration_s": session.drive.duration_s(),
            "driven_m": session.drive.length_m(),
            "shots": session.stamps.len(),
            "round_trip": nodes,
            "lane_offset_m": route.offset_m,
            "wheel_errors": session.wheels.errors,
        })
    }
}

fn collection(features: Vec<Value>) -> Value {
    json!({
        "type": "FeatureCollection",
        "note": "local metres of the map frame (x east, y north), not longitude and latitude",
        "features": features,
    })
}

fn feature(properties: Value, rect: &Rect) -> Value {
    let Rect { x0, y0, x1, y1 } = *rect;
    let ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]];
    json!({
        "type": "Feature",
        "properties": properties,
        "geometry": { "type": "Polygon", "coordinates": [ring] },
    })
}

/// Where each walker is, ten times a second.
fn walkers_csv(visit: &Visit) -> String {
    let session = &visit.session;
    let mut text = String::from("stamp_ns,id,x,y,yaw,walking\n");
    for k in 0..(session.drive.duration_s() * 10.0) as u64 {
        let stamp = session.start_ns + k * 100_000_000;
        for (id, walker) in visit.walkers.iter().enumerate() {
            let at = walker.state(session.seconds(stamp));
            let (walking, Pose2 { x, y, yaw }) = (u8::from(at.walking), at.pose);
            let _ = writeln!(text, "{stamp},{id},{x:.4},{y:.4},{yaw:.4},{walking}");
        }
    }
    text
}

/// The floor from above, north up, as PNG; and its scale in pixels per metre.
fn overhead(floor: &Canvas) -> Result<(Vec<u8>, f64), WorldError> {
    let shrink = (floor.scale / OVERHEAD).round().max(1.0) as usize;
    let (width, height) = (floor.width / shrink, floor.height / shrink);
    let mut pixels = Vec::with_capacity(width * height);
    for row in (0..height).rev() {
        for column in 0..width {
            let sum: usize = (0..shrink * shrink)
                .map(|k| {
                    let (r, c) = (row * shrink + k / shrink, column * shrink + k % shrink);
                    usize::from(floor.grey[r * floor.width + c])
                })
                .sum();
            pixels.push((sum / (shrink * shrink)) as u8);
        }
    }
    let bytes = grey_png([width as u32, height as u32], &pixels)?;
    Ok((bytes, floor.scale / shrink as f64))
}
