//! The maps of its first drive and of two, which the tests share, and what revisits make of them.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use evermap_algorithms::geometry::pose::Pose;
use evermap_engine::map::receipt::Receipt;
use evermap_engine::program::LIFT;
use evermap_messages::annotation::{Annotation, Geometry};
use evermap_recording::annotations::AnnotationLog;
use evermap_tests::park::{Localised, adjusted_error, copy, made_once, run, run_within};
use evermap_tests::trajectories::{Trajectories, rows, truth};
use evermap_tests::{evermap, text};

use super::floor::{self, Likeness};
use super::parking::spaces;
use super::{session, world};

/// A copy, in this folder, of the map that the plan `parking` makes of the first drive.
pub(crate) fn first_drive(world: &Path, folder: &Path) -> PathBuf {
    static MAP: OnceLock<PathBuf> = OnceLock::new();
    let map = MAP.get_or_init(|| {
        let map = made_once(env!("CARGO_TARGET_TMPDIR"), "strangers_car_park").join("map");
        run("parking", &map, &[&session(world, "initial")]);
        map
    });
    copy(map, folder, "map")
}

/// The map of the first drive once the plan `car_park` has added the second one, and what [`each_space_drawn`] says, within
/// 256 MiB.
pub(crate) fn two_drives(world: &Path) -> &'static Path {
    static MAP: OnceLock<PathBuf> = OnceLock::new();
    MAP.get_or_init(|| {
        let folder = made_once(env!("CARGO_TARGET_TMPDIR"), "strangers_two_drives");
        let map = first_drive(world, &folder);
        let said = each_space_drawn(world, &map, &folder);
        run_within(
            256,
            "car_park",
            &map,
            &[&session(world, "revisit_1"), &said],
        );
        map
    })
}

/// The steps of the metric map that take time.
const METRIC_MAP: [&str; 11] = [
    "keyframes",
    "body_masks",
    "features",
    "tracks",
    "localisations",
    "loop_closures",
    "graph_poses",
    "adjusted_poses",
    "landmarks",
    "map_frames",
    "frame_poses",
];

/// Puts the units of these steps that a map has done beside those of another one: a run of the latter finds there what it
/// would do in the same way, and does the rest.
pub(crate) fn lend_metric_map(from: &Path, to: &Path) {
    for entry in std::fs::read_dir(from.join("receipts")).unwrap() {
        let receipt = std::fs::read(entry.unwrap().path()).unwrap();
        let receipt: Receipt = serde_json::from_slice(&receipt).unwrap();
        let step = &receipt.recipe.stages.last().unwrap().name;
        if METRIC_MAP.contains(&step.strip_suffix(LIFT).unwrap_or(step)) {
            // The rows are there before the receipt that leads to them.
            for file in [receipt.artifact.name(), Receipt::name(&receipt.digest)] {
                if !to.join(&file).exists() {
                    std::fs::copy(from.join(&file), to.join(&file)).unwrap();
                }
            }
        }
    }
}

/// What somebody says who draws each space once on this map: its outline, which teaches nothing of where others are.
fn each_space_drawn(world: &Path, map: &Path, folder: &Path) -> PathBuf {
    let drawn = spaces(world, map).into_iter().enumerate();
    let drawn = drawn.map(|(number, space)| {
        let [x, y] = space.centre;
        let corners = space.corners();
        Annotation {
            stamp_ns: 1_800_000_000_000_000_000,
            author: "ada".into(),
            sequence: number as u64,
            id: format!("stall {number:02}"),
            kind: "stall".into(),
            act: "drawn".into(),
            map_version: Some(1),
            geometry: Some(Geometry {
                shape: "polygon".into(),
                points: corners.map(|at| [at[0] - x, at[1] - y, 0.0]).to_vec(),
                map_from_label: Pose::from_yaw(x, y, 0.0).to_array(),
            }),
            anchor: None,
            image: None,
        }
    });
    let said: Vec<Annotation> = drawn.collect();
    let mut log = AnnotationLog::begin(&folder.join("ada.mcap"), |_| false, "a test").unwrap();
    log.say_all(&said).unwrap();
    log.finish().unwrap()
}

/// Corners of the spaces that were drawn once, in the newest version, against the truth: the paper's bounds.
fn drawn_spaces_stay(world: &Path, map: &Path) {
    let query = "SELECT points FROM placed_labels WHERE kind = 'stall' ORDER BY label";
    let placed = rows(map, None, query);
    let truth = spaces(world, map);
    assert_eq!(placed.len(), truth.len());
    let mut off_m = Vec::new();
    for (row, space) in placed.iter().zip(&truth) {
        for (at, corner) in space.corners().iter().enumerate() {
            let [x, y] = [0, 1].map(|axis| row["points"][at][axis].as_f64().unwrap());
            off_m.push((x - corner[0]).hypot(y - corner[1]));
        }
    }
    off_m.sort_by(f64::total_cmp);
    let (median_m, worst_m) = (off_m[off_m.len() / 2], off_m[off_m.len() - 1]);
    eprintln!(
        "spaces drawn once: corners {median_m:.4} m off at the median, {worst_m:.4} m at worst"
    );
    assert!(median_m <= 0.03 && worst_m <= 0.13);
}

#[test]
fn it_gets_sharper_with_every_drive() {
    let Some(world) = world() else { return };
    let folder = tempfile::tempdir().unwrap();
    let map = first_drive(&world, folder.path());
    let true_path = |name: &str| {
        let path = world.join(name).join("trajectory.tum");
        (name.to_owned(), truth(&path))
    };
    let truths: Trajectories = ["initial", "revisit_1", "revisit_2"].map(true_path).into();
    let first = adjusted_error("initial", &map, None, &truths);
    assert!(first.position_m.rmse <= 0.05);
    let mut seen = vec![floor::likeness("initial", &world, &map, &truths)];

    let map = copy(two_drives(&world), folder.path(), "two_drives");
    is_localised(&map, 2, "revisit_1", &truths);
    drawn_spaces_stay(&world, &map);
    drawn(&map, folder.path());
    seen.push(floor::likeness("revisit_1", &world, &map, &truths));
    run("parking", &map, &[&session(&world, "revisit_2")]);
    is_localised(&map, 3, "revisit_2", &truths);
    drawn_spaces_stay(&world, &map);
    seen.push(floor::likeness("revisit_2", &world, &map, &truths));
    assert!(seen[0].aisles >= 0.88, "{seen:?}");
    let gains = |pair: &[Likeness]| pair[1].aisles > pair[0].aisles && pair[1].bays > pair[0].bays;
    assert!(seen.windows(2).all(gains), "{seen:?}");
    let last = adjusted_error("all three", &map, None, &truths);
    assert!(last.position_m.rmse <= 0.03);
}

/// The session that came with this version was found in the version before.
fn is_localised(map: &Path, version: u32, name: &str, truths: &Trajectories) {
    let localised = Localised::of(map, version, name, truths);
    let error = localised.error.unwrap();
    assert!(localised.is_never_silently_wrong() && localised.lost_share() < 0.02);
    assert!(error.position_m.median <= 0.03 && error.position_m.p99 <= 0.13);
    assert!(error.rotation_rad.median <= 0.3_f64.to_radians());
}

/// What the plan `car_park` has drawn of two drives, the second of which was added to a map of the first.
fn drawn(map: &Path, folder: &Path) {
    let query = "SELECT (SELECT count(*) FROM keyframes WHERE session = 'initial') AS keyframes, \
                 (SELECT count(*) FROM overhead_tiles WHERE zoom = 0) AS tiles, \
                 (SELECT sum(covered) FROM overhead_tiles WHERE zoom = 0) AS covered, \
                 (SELECT count(*) FROM lanes) AS lanes";
    let counted = rows(map, None, query);
    let number = |name: &str| counted[0][name].as_f64().unwrap();
    // 459 shots at most 0.48 m apart over 188 m: nearly every shot is a keyframe.
    assert!(
        (380.0..=459.0).contains(&number("keyframes")),
        "{counted:?}"
    );
    // The room is 39.6 by 24.8 m, of which the aisles and bays are seen.
    let covered_m2 = number("covered") * 0.05 * 0.05;
    assert!(covered_m2 > 500.0, "{covered_m2} m² of floor were seen");
    assert!(
        number("tiles") >= 6.0 && number("lanes") >= 3.0,
        "{counted:?}"
    );
    let picture = folder.join("map.png");
    evermap(&["render", "--map", text(map), "--out", text(&picture)]).expect(0);
    let report = folder.join("map.html");
    evermap(&["report", "--map", text(map), "--out", text(&report)]).expect(0);
    assert!(std::fs::metadata(&picture).unwrap().len() > 20_000);

    // The first drive's features stay; its floor is drawn anew, because the revisit makes its poses better.
    let query = "SELECT DISTINCT session FROM runs WHERE version = 2 AND NOT cached AND session <> 'ada' \
                 AND step IN ('keyframes', 'features', 'tracks')";
    let computed = rows(map, None, query);
    assert_eq!(computed, [serde_json::json!({ "session": "revisit_1" })]);
}
