//! The truth beside the sessions: what a perfect map would hold.
//!
//! GeoJSON here is in local metres of the map frame (x east, y north), not longitude and
//! latitude; each file says so.

use crate::WorldError;
use crate::canvas::Canvas;
use crate::folder::Folder;
use crate::layout::{AISLES, Layout, NODES, Node, Rect};
use crate::params::CarPark;
use crate::picture::grey_png;
use crate::rig::RigCamera;
use crate::session::Plan;
use evermap_algorithms::geometry::pose::Pose;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Wanted scale of the overhead picture, pixels per metre.
const OVERHEAD: f64 = 40.0;

/// All that is true about a world.
pub(crate) struct Truth<'a> {
    pub(crate) world: &'a CarPark,
    pub(crate) layout: &'a Layout,
    pub(crate) rig: &'a [RigCamera],
    pub(crate) floor: &'a Canvas,
    pub(crate) plans: &'a [Plan],
}

impl Truth<'_> {
    /// Writes the folder `truth` in `out`, replacing an older one, and gives its path.
    pub(crate) fn write(&self, out: &Path) -> Result<PathBuf, WorldError> {
        let folder = Folder::create(out, "truth")?;
        for plan in self.plans {
            let stamps = plan.stamps.iter();
            let poses =
                stamps.map(|stamp| (*stamp, plan.drive.map_from_vehicle(plan.seconds(*stamp))));
            folder.save(&format!("{}.tum", plan.name), tum(poses).as_bytes())?;
            let people = walkers_csv(plan);
            folder.save(&format!("{}_walkers.csv", plan.name), people.as_bytes())?;
        }
        let (picture, scale) = overhead(self.floor)?;
        folder.save("overhead.png", &picture)?;
        for (name, value) in [
            ("bays.geojson", self.bays()),
            ("crossings.geojson", self.crossings()),
            ("lane_graph.json", self.lane_graph()),
            ("cars.json", self.cars()),
            ("world.json", self.world(scale)),
        ] {
            folder.save(name, format!("{value:#}\n").as_bytes())?;
        }
        folder.finish()
    }

    fn bays(&self) -> Value {
        let features = self.layout.bays.iter().enumerate().map(|(index, bay)| {
            let mut occupied = serde_json::Map::new();
            for plan in self.plans {
                let taken = plan.parked.iter().any(|car| car.bay == index);
                occupied.insert(plan.name.clone(), Value::Bool(taken));
            }
            let properties = json!({
                "id": index,
                "label": bay.label,
                "entry_yaw": bay.entry_yaw,
                "occupied": occupied,
            });
            feature(properties, &bay.rect)
        });
        collection(features.collect())
    }

    fn crossings(&self) -> Value {
        let features = self.layout.crossings.iter().enumerate();
        collection(
            features
                .map(|(index, crossing)| feature(json!({ "id": index }), &crossing.rect))
                .collect(),
        )
    }

    fn lane_graph(&self) -> Value {
        let degree = |node: Node| {
            let touches = |(a, b): &&(Node, Node)| *a == node || *b == node;
            AISLES.iter().filter(touches).count()
        };
        let nodes: Vec<Value> = NODES
            .iter()
            .map(|node| {
                let [x, y] = self.layout.node(*node);
                let degree = degree(*node);
                json!({
                    "id": format!("{node:?}"), "x": x, "y": y,
                    "degree": degree, "intersection": degree > 2,
                })
            })
            .collect();
        let segments: Vec<Value> = AISLES
            .iter()
            .map(|(a, b)| {
                let line = [self.layout.node(*a), self.layout.node(*b)];
                json!({
                    "from": format!("{a:?}"), "to": format!("{b:?}"), "centre_line": line,
                })
            })
            .collect();
        json!({ "frame": "map, metres", "nodes": nodes, "segments": segments })
    }

    fn cars(&self) -> Value {
        let mut sessions = serde_json::Map::new();
        for plan in self.plans {
            sessions.insert(plan.name.clone(), json!(plan.parked));
        }
        json!({ "frame": "map, metres, radians", "sessions": sessions })
    }

    fn world(&self, overhead_px_per_m: f64) -> Value {
        let sessions: Vec<Value> = self.plans.iter().map(|plan| self.session(plan)).collect();
        let cameras: Vec<Value> = self
            .rig
            .iter()
            .map(|camera| {
                json!({
                    "name": camera.name, "frame_id": camera.frame_id, "model": "equidistant",
                    "fx_fy": camera.focal, "cx_cy": camera.centre, "published_cx_cy": camera.published_centre, "k1_k4": camera.k,
                    "vehicle_from_camera": camera.vehicle_from_camera.to_array(),
                })
            })
            .collect();
        let rect = |r: &Rect| [r.x0, r.y0, r.x1, r.y1];
        json!({
            "world": "car_park",
            "parameters": self.world,
            "width_m": self.layout.width_m,
            "depth_m": self.layout.depth_m,
            "overhead_px_per_m": overhead_px_per_m,
            "overhead_pixels": "column c, row r: x = (c + 0.5) / scale, y = depth_m - (r + 0.5) / scale",
            "poses": "map_from_vehicle; TUM lines: stamp_s x y z qx qy qz qw",
            "pillars": self.layout.pillars.iter().map(rect).collect::<Vec<_>>(),
            "islands": self.layout.islands.iter().map(rect).collect::<Vec<_>>(),
            "cameras": cameras,
            "sessions": sessions,
        })
    }

    fn session(&self, plan: &Plan) -> Value {
        let nodes: Vec<String> = plan.route.cycle.iter().map(|n| format!("{n:?}")).collect();
        json!({
            "name": plan.name,
            "start_ns": plan.start_ns,
            "duration_s": plan.drive.duration_s(),
            "driven_m": plan.drive.length_m(),
            "shots": plan.stamps.len(),
            "round_trip": nodes,
            "lane_offset_m": plan.route.offset_m,
            "wheel_errors": plan.wheels.errors,
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

/// One line per stamp (ns): `stamp_s x y z qx qy qz qw`.
pub(crate) fn tum(poses: impl Iterator<Item = (u64, Pose)>) -> String {
    let mut text = String::from("# stamp_s x y z qx qy qz qw (map_from_vehicle)\n");
    for (stamp, pose) in poses {
        let (s, ns) = (stamp / 1_000_000_000, stamp % 1_000_000_000);
        let _ = write!(text, "{s}.{ns:09}");
        for value in pose.to_array() {
            let _ = write!(text, " {value:.9}");
        }
        text.push('\n');
    }
    text
}

/// Where each walker is, ten times a second.
fn walkers_csv(plan: &Plan) -> String {
    let mut text = String::from("stamp_ns,id,x,y,yaw,walking\n");
    for k in 0..(plan.drive.duration_s() * 10.0) as u64 {
        let stamp = plan.start_ns + k * 100_000_000;
        for (id, person) in plan.people.iter().enumerate() {
            let at = person.state(plan.seconds(stamp));
            let walking = u8::from(at.walking);
            let _ = writeln!(
                text,
                "{stamp},{id},{:.4},{:.4},{:.4},{walking}",
                at.x, at.y, at.yaw
            );
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
