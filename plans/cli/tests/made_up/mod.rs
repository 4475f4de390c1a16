//! A map without any drive: rows made up, written as a run would leave them.

mod metric;

use std::collections::BTreeMap;
use std::path::Path;

use evermap_engine::digest::digest;
use evermap_engine::map::receipt::{Artifact, Extent, LogContent};
use evermap_engine::map::store::Store;
use evermap_engine::map::version::{MappedSession, Previous, StoredLayer, Version};
use evermap_schemas::layers::{Intersection, Lane, OverheadTile, VehiclePose};
use evermap_schemas::{Bytes, LayerRow, Pose, Stamp, Wkb, batch};

const SIDE: usize = 128;
const CELL_M: f64 = 0.2;

/// A floor with lines, which are yellow in colour.
fn floor(tile_x: i32, tile_y: i32, channels: png::ColorType) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, SIDE as u32, SIDE as u32);
    encoder.set_color(channels);
    let mut cells = Vec::new();
    for index in 0..SIDE * SIDE {
        let x = tile_x * SIDE as i32 + (index % SIDE) as i32;
        let y = tile_y * SIDE as i32 + (SIDE - 1 - index / SIDE) as i32;
        let line = x.rem_euclid(13) == 0 && (30..56).contains(&y.rem_euclid(90));
        let grain = (x.wrapping_mul(7919) ^ y.wrapping_mul(104_729)).rem_euclid(17) as u8;
        match (channels, line) {
            (png::ColorType::Rgba, true) => cells.extend([190, 160, 20]),
            (png::ColorType::Rgba, false) => cells.extend([90 + grain; 3]),
            (_, true) => cells.push(190),
            (_, false) => cells.push(90 + grain),
        }
        cells.push(255);
    }
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&cells).unwrap();
    writer.finish().unwrap();
    bytes
}

/// Four tiles, with the last one in these channels.
fn tiles(last: png::ColorType) -> Vec<OverheadTile> {
    let channels = |at: (i32, i32)| match at {
        (1, 1) => last,
        _ => png::ColorType::GrayscaleAlpha,
    };
    let tile = |(x, y): (i32, i32)| OverheadTile {
        site: "lot".into(),
        zoom: 0,
        tile_x: x,
        tile_y: y,
        cell_m: CELL_M,
        size_m: CELL_M * SIDE as f64,
        covered: (SIDE * SIDE) as u32,
        mean_weight: 1.0,
        png: Bytes(floor(x, y, channels((x, y)))),
        sources: vec![],
        geometry: Wkb::polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]),
    };
    [(0, 0), (0, 1), (1, 0), (1, 1)].map(tile).to_vec()
}

fn lane(lane: u32, points: Vec<[f64; 3]>, direction: &str) -> Lane {
    Lane {
        site: "lot".into(),
        lane,
        start_node: 0,
        end_node: 1,
        start_kind: "intersection".into(),
        end_kind: "intersection".into(),
        direction: direction.into(),
        forward_passes: 2,
        backward_passes: 0,
        length_m: 30.0,
        width_m: 2.4,
        next_lanes: vec![],
        next_lanes_backward: vec![],
        sources: vec![],
        geometry: Wkb::line_string(&points),
        points,
    }
}

fn lanes() -> Vec<Lane> {
    let arc = |from: f64| -> Vec<[f64; 3]> {
        (0..=40)
            .map(|k| from + std::f64::consts::PI * f64::from(k) / 40.0)
            .map(|turn| [25.0 + 18.0 * turn.cos(), 25.0 + 14.0 * turn.sin(), 0.0])
            .collect()
    };
    vec![
        lane(0, arc(0.0), "forward"),
        lane(1, arc(std::f64::consts::PI), "forward"),
        lane(2, vec![[7.0, 25.0, 0.0], [43.0, 25.0, 0.0]], "both"),
    ]
}

fn intersections() -> Vec<Intersection> {
    let place = |(node, x): (u32, f64)| Intersection {
        site: "lot".into(),
        node,
        degree: 3,
        x,
        y: 25.0,
        z: 0.0,
        sources: vec![],
        geometry: Wkb::point([x, 25.0, 0.0]),
    };
    [(0, 7.0), (1, 43.0)].map(place).to_vec()
}

fn poses(session: &str, radius: f64, count: i32) -> Vec<VehiclePose> {
    (0..count)
        .map(|k| {
            let turn = std::f64::consts::TAU * f64::from(k) / f64::from(count);
            let (x, y) = (
                25.0 + radius * turn.cos(),
                25.0 + radius * 14.0 / 18.0 * turn.sin(),
            );
            VehiclePose {
                site: "lot".into(),
                session: session.into(),
                stamp: Stamp(1_780_000_000_000_000_000 + i64::from(k) * 100_000_000),
                map_from_vehicle: Pose {
                    x,
                    y,
                    ..Pose::IDENTITY
                },
            }
        })
        .collect()
}

fn stored<T: LayerRow>(
    folder: &Path,
    op: Option<&str>,
    session: Option<&str>,
    rows: Vec<T>,
) -> StoredLayer {
    let table = batch(rows).unwrap();
    let mut bytes = Vec::new();
    let mut writer =
        parquet::arrow::ArrowWriter::try_new(&mut bytes, table.schema(), None).unwrap();
    writer.write(&table).unwrap();
    writer.close().unwrap();
    let artifact = Artifact {
        content: digest(&bytes),
        rows: table.num_rows() as u64,
        bytes: bytes.len() as u64,
        extent: Extent {
            session: session.map(str::to_owned),
            site: Some("lot".into()),
        },
    };
    let path = folder.join(artifact.name());
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, &bytes).unwrap();
    StoredLayer {
        published: true,
        op: op.map(str::to_owned),
        artifacts: vec![artifact],
        recipes: vec![],
    }
}

/// The first version of a map, of one session.
fn first_version(layers: BTreeMap<String, StoredLayer>) -> Version {
    Version {
        version: 1,
        parent: 0,
        program: String::new(),
        previous: Default::default(),
        plan: "car_park".into(),
        evermap: "0.1.0".into(),
        published: "2026-06-01T08:00:00+00:00".into(),
        sessions: vec![session("initial")],
        layers,
        losses: BTreeMap::new(),
    }
}

fn session(name: &str) -> MappedSession {
    let log = LogContent {
        session: name.into(),
        site: "lot".into(),
        content: digest(name.as_bytes()),
        roles: String::new(),
    };
    MappedSession {
        log,
        manifest: Default::default(),
        times: None,
    }
}

/// The layers of a metric map of one session, as the plan lifelong leaves them.
fn metric_layers(folder: &Path) -> BTreeMap<String, StoredLayer> {
    let (name, path) = ("initial", poses("initial", 18.3, 200));
    let session = Some(name);
    let keep = |op: &str, layer: StoredLayer| (op.to_owned(), layer);
    BTreeMap::from([
        keep(
            "keyframes",
            stored(folder, Some("keyframes"), session, metric::keyframes(&path)),
        ),
        keep(
            "graph_poses",
            stored(folder, Some("pose_graph"), None, metric::graph_poses(&path)),
        ),
        keep(
            "loop_closures",
            stored(
                folder,
                Some("loop_closures"),
                None,
                metric::loop_closures(&path),
            ),
        ),
        keep(
            "adjusted_poses",
            stored(
                folder,
                Some("bundle_adjustment"),
                None,
                metric::adjusted_poses(&path),
            ),
        ),
        keep(
            "frame_poses",
            stored(
                folder,
                Some("frame_poses"),
                None,
                // Some more keyframes than hold the map up.
                metric::frame_poses(&poses(name, 18.3, 230)),
            ),
        ),
        keep("poses", stored(folder, None, session, path.clone())),
        keep(
            "features",
            stored(folder, Some("features"), session, metric::features(&path)),
        ),
        keep(
            "landmarks",
            stored(folder, Some("landmarks"), None, metric::landmarks(&path)),
        ),
        keep(
            "localisations",
            stored(
                folder,
                Some("localisation"),
                session,
                metric::localisations(&path),
            ),
        ),
        keep(
            "cameras",
            stored(folder, None, session, metric::cameras(name)),
        ),
        keep(
            "mounts",
            stored(folder, None, session, metric::mounts(name)),
        ),
        keep(
            "placed_labels",
            stored(folder, Some("placed_labels"), None, metric::placed_labels()),
        ),
    ])
}

/// Writes a map whose second version, the only one that is left, has a metric map in it.
pub async fn metric_map(folder: &Path) {
    let store = Store::open(folder.to_str().unwrap(), true).unwrap();
    let version = Version {
        version: 2,
        parent: 1,
        program: String::new(),
        previous: Previous {
            version: 1,
            ..Previous::default()
        },
        plan: "lifelong".into(),
        evermap: "0.1.0".into(),
        published: "2026-06-01T08:00:00+00:00".into(),
        sessions: vec![session("initial")],
        layers: metric_layers(folder),
        losses: BTreeMap::new(),
    };
    version.publish(&store).await.unwrap();
}

/// Writes a map of a floor of which one tile of four is in colour.
pub async fn map_in_colour(folder: &Path) {
    let store = Store::open(folder.to_str().unwrap(), true).unwrap();
    let tiles = tiles(png::ColorType::Rgba);
    let version = first_version(BTreeMap::from([(
        "overhead_tiles".to_owned(),
        stored(folder, Some("overhead_tiles"), None, tiles),
    )]));
    version.publish(&store).await.unwrap();
}

/// Writes a map of two versions: the second has one more session, and something was lost on its way.
pub async fn map(folder: &Path) {
    let store = Store::open(folder.to_str().unwrap(), true).unwrap();
    let mut layers = BTreeMap::from([
        (
            "overhead_tiles".to_owned(),
            stored(
                folder,
                Some("overhead_tiles"),
                None,
                tiles(png::ColorType::GrayscaleAlpha),
            ),
        ),
        (
            "lanes".to_owned(),
            stored(folder, Some("road_network"), None, lanes()),
        ),
        (
            "intersections".to_owned(),
            stored(folder, Some("intersections"), None, intersections()),
        ),
        (
            "poses".to_owned(),
            stored(folder, None, Some("initial"), poses("initial", 18.3, 200)),
        ),
    ]);
    let first = first_version(layers.clone());
    first.publish(&store).await.unwrap();
    let more = stored(
        folder,
        None,
        Some("revisit_1"),
        poses("revisit_1", 17.5, 180),
    );
    layers
        .get_mut("poses")
        .unwrap()
        .artifacts
        .extend(more.artifacts);
    let second = Version {
        version: 2,
        parent: 1,
        program: String::new(),
        previous: Default::default(),
        sessions: vec![session("initial"), session("revisit_1")],
        layers,
        losses: BTreeMap::from([("images that do not decode".to_owned(), 4)]),
        ..first
    };
    second.publish(&store).await.unwrap();
}
