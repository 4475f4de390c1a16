//! Maps in the formats of other programs, read by these programs' own readers.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use evermap_tests::recording::is_read_as_the_map_says;
use evermap_tests::server::{Server, map, script};
use evermap_tests::{
    Finished, command, evermap, page, rows_of, rows_of_log, run_of_site, simulate, text,
};

/// Danger and speeds where the vehicle was, as cells of 2 m.
const CELLS: &str = r#"
plan: cells
extends: trajectory
steps:
  danger_map:
    sql: |
      SELECT site, CAST(floor(map_from_vehicle['x'] / 2) AS INT) AS "column",
             CAST(floor(map_from_vehicle['y'] / 2) AS INT) AS "row", CAST(2 AS DOUBLE) AS cell_m,
             least(0.003 * count(*), 1.0) AS danger
      FROM poses GROUP BY 1, 2, 3
  speed_map:
    sql: |
      SELECT site, "column", "row", cell_m, 2.8 * greatest(1.0 - 20.0 * danger, 0.001) AS speed_mps, 2.8 AS max_mps
      FROM danger_map
write: [danger_map, speed_map]
"#;

#[test]
fn a_recording_has_what_the_map_says() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let plan = folder.path().join("cells.yaml");
    std::fs::write(&plan, CELLS).unwrap();
    let monday = folder.path().join("monday.mcap");
    run_of_site(text(&plan), &map, "lot", &["--sessions", text(&monday)]).expect(0);
    let cells =
        "SELECT count(*) AS n FROM danger_map d JOIN speed_map s USING (\"column\", \"row\")";
    let cells = rows_of(&map, cells);
    assert!(cells[0]["n"].as_u64().unwrap() > 20, "{cells}");
    is_read_as_the_map_says(&map, folder.path());

    // A recording is a log again.
    let out = folder.path().join("recording.mcap");
    let count = "SELECT count(*) AS n FROM transforms WHERE parent = 'map'";
    let poses = rows_of(&map, "SELECT count(*) AS n FROM poses");
    assert_eq!(rows_of_log(&out, count), poses);

    // Of one session, only that.
    let monday = folder.path().join("monday_alone.mcap");
    let export = [
        "export",
        "--map",
        text(&map),
        "--format",
        "mcap",
        "--session",
        "monday",
        "--out",
        text(&monday),
    ];
    evermap(&export).expect(0);
    let topics = "SELECT DISTINCT topic FROM channels WHERE topic LIKE '/trajectory/%'";
    assert_eq!(
        rows_of_log(&monday, topics),
        serde_json::json!([{ "topic": "/trajectory/monday" }])
    );
}

#[test]
fn no_output_takes_the_place_of_a_drive_or_of_what_is_the_maps() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let drive = folder.path().join("monday.mcap");
    let link = folder.path().join("link.mcap");
    std::os::unix::fs::symlink(&drive, &link).unwrap();
    let version = map.join("receipts/../versions/1.json");
    let (map, query) = (text(&map), "SELECT 1 AS n");
    for out in [&drive, &link, &version] {
        let before = std::fs::read(out).unwrap();
        let says = match out == &version {
            true => "found one among the files of",
            false => "expected no log there",
        };
        for command in [
            &["export", "poses", "--format", "csv"][..],
            &["export", "--format", "mcap"],
            &["sql", "--format", "json", query],
            &["report"],
        ] {
            let whole = [command, &["--map", map, "--out", text(out)]].concat();
            let refused = evermap(&whole).expect(1).stderr;
            assert!(refused.contains(says), "{whole:?}: {refused}");
            assert!(std::fs::read(out).unwrap() == before, "{whole:?}");
        }
    }
    assert!(link.is_symlink());
    evermap(&["verify", "--map", map]).expect(0);
}

#[test]
fn a_recording_goes_into_pipes_and_devices_and_two_at_once_are_whole() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let within = |name: &str| folder.path().join(name);
    let [pipe, copy, recording] = ["pipe", "copy.mcap", "recording.mcap"].map(within);
    let beside = within("recording.mcap.part");
    std::fs::write(&beside, "mine").unwrap();
    let export = |out: &Path| {
        let head = ["export", "--map", text(&map), "--format", "mcap"];
        command(&[&head[..], &["--out", text(out)]].concat())
    };
    let mut quiet = export(&recording);
    let quiet = quiet.stdout(Stdio::null()).stderr(Stdio::piped());
    let twice = [quiet.spawn().unwrap(), quiet.spawn().unwrap()];
    for one in twice {
        Finished::from(one.wait_with_output().unwrap()).expect(0);
    }
    let topics = "SELECT DISTINCT topic FROM channels ORDER BY topic";
    let expected = rows_of_log(&recording, topics);
    assert!(!expected.as_array().unwrap().is_empty());
    assert_eq!(std::fs::read(&beside).unwrap(), b"mine");

    let made = Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || std::fs::read(pipe).unwrap()
    });
    Finished::from(export(&pipe).output().unwrap()).expect(0);
    std::fs::write(&copy, reader.join().unwrap()).unwrap();
    assert_eq!(rows_of_log(&copy, topics), expected);
    let null = within("null");
    std::os::unix::fs::symlink("/dev/null", &null).unwrap();
    Finished::from(export(&null).output().unwrap()).expect(0);
    let is_kept = |path: &Path| !path.metadata().unwrap().is_file();
    assert!(is_kept(&pipe) && is_kept(&null) && is_kept(Path::new("/dev/null")));

    let refused = Finished::from(export(folder.path()).output().unwrap()).expect(1);
    let told = "expected a file, found a folder";
    assert!(refused.stderr.contains(told), "{}", refused.stderr);
    let names = std::fs::read_dir(folder.path()).unwrap();
    let mut names = names.map(|entry| entry.unwrap().file_name());
    assert!(!names.any(|name| name.to_string_lossy().starts_with(".evermap-")));
}

#[test]
fn a_recording_is_of_the_whole_map_and_other_formats_of_a_layer() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    let out = folder.path().join("out");
    for (layer, format, says) in [
        (None, "csv", "expected the layer to export"),
        (
            Some("lanes"),
            "mcap",
            "expected no layer beside --format mcap",
        ),
    ] {
        let mut export = vec!["export"];
        export.extend(layer);
        export.extend(["--map", text(&map), "--format", format, "--out", text(&out)]);
        let ended = evermap(&export).expect(1);
        assert!(ended.stderr.contains(says), "{}", ended.stderr);
    }
}

/// What was driven, with the images of its keyframes.
const PICTURES: &str = "
plan: pictures
extends: trajectory
steps:
  keyframes: { in: { odometry: odometry, frames: frames } }
  mounts: { sql: SELECT * FROM transforms WHERE fixed }
  cameras: { sql: SELECT * FROM calibration }
write: [keyframes, mounts, cameras]
";

fn pictures_are_recorded(folder: &Path, session: &Path) {
    let plan = folder.join("pictures.yaml");
    std::fs::write(&plan, PICTURES).unwrap();
    let map = folder.join("pictures");
    run_of_site(text(&plan), &map, "lot", &["--sessions", text(session)]).expect(0);
    is_read_as_the_map_says(&map, folder);
    let recording = folder.join("recording.mcap");
    let images = "SELECT count(*) AS n FROM frames";
    let found = rows_of_log(&recording, images);
    assert!(found[0]["n"].as_u64().unwrap() > 100, "{found}");
}

/// What was driven, where poses are said to be of another frame.
const OF_A_FRAME: &str = "
plan: of_a_frame
extends: trajectory
defaults: { vehicle_frame: FRAME }
steps:
  mounts: { sql: SELECT * FROM transforms WHERE fixed }
write: [mounts]
";

/// Where poses are of a camera, what it is mounted on moves in the map such that the camera is there.
fn the_frame_of_poses_is_where_they_are(folder: &Path, session: &Path) {
    let mount = "SELECT parent, child, sqrt(power(parent_from_child['x'], 2) + power(parent_from_child['y'], 2)
                 + power(parent_from_child['z'], 2)) AS away_m FROM transforms WHERE fixed ORDER BY child LIMIT 1";
    let mount = rows_of_log(session, mount);
    let name = |column: &str| mount[0][column].as_str().unwrap();
    let plan = folder.join("of_a_frame.yaml");
    std::fs::write(&plan, OF_A_FRAME.replace("FRAME", name("child"))).unwrap();
    let map = folder.join("of_a_frame");
    run_of_site(text(&plan), &map, "lot", &["--sessions", text(session)]).expect(0);
    let out = folder.join("of_a_frame.mcap");
    exported(&map, &out, &["--format", "mcap"]);
    let at = |pose: &str, rest: &str| {
        format!("SELECT {pose}['x'] AS x, {pose}['y'] AS y, {pose}['z'] AS z {rest} ORDER BY stamp")
    };
    let poses = at("map_from_vehicle", "FROM poses");
    let poses = rows_of(&map, &poses);
    let moved = at(
        "parent_from_child",
        ", child FROM transforms WHERE parent = 'map'",
    );
    let moved = rows_of_log(&out, &moved);
    let (poses, moved) = (poses.as_array().unwrap(), moved.as_array().unwrap());
    assert!(poses.len() > 100 && poses.len() == moved.len());
    let away_m = mount[0]["away_m"].as_f64().unwrap();
    for (pose, moved) in poses.iter().zip(moved) {
        assert_eq!(moved["child"], format!("initial/{}", name("parent")));
        let along = |axis: &str| pose[axis].as_f64().unwrap() - moved[axis].as_f64().unwrap();
        let apart_m = ["x", "y", "z"]
            .map(along)
            .iter()
            .map(|d| d * d)
            .sum::<f64>()
            .sqrt();
        assert!(
            away_m > 0.1 && (apart_m - away_m).abs() < 1e-6,
            "{apart_m} {away_m}"
        );
    }
}

/// The roads of a simulated car with a receiver.
fn on_earth(folder: &Path) -> PathBuf {
    let world = folder.join("world");
    let small = [
        "gnss=true",
        "revisits=0",
        "width_px=32",
        "height_px=32",
        "rate_hz=1",
        "floor_texels_per_m=10",
    ];
    simulate("car_park", &world, &small);
    let roads = folder.join("roads");
    let session = world.join("initial.mcap");
    pictures_are_recorded(folder, &session);
    the_frame_of_poses_is_where_they_are(folder, &session);
    let more = ["--sessions", text(&session)];
    run_of_site("georeference", &roads, "lot", &more).expect(0);
    roads
}

/// The queries of docs/queries.md that lead from lanes to messages: they are about simulated drives.
fn what_lanes_were_made_from_is_answered_as_the_docs_ask(map: &Path) {
    let page = page("docs/queries.md");
    let part = page.split("## What rows were made from").nth(1).unwrap();
    let lines = part.split("```").nth(1).unwrap().lines();
    let queries = lines.filter_map(|line| {
        let query = line.strip_prefix("evermap sql --map map \"")?;
        Some(query.strip_suffix('"')?.replace("\\\"", "\""))
    });
    let queries: Vec<String> = queries.collect();
    assert_eq!(queries.len(), 3);
    for query in queries {
        let rows = rows_of(map, &query);
        assert!(!rows.as_array().unwrap().is_empty(), "{query}");
    }
}

fn exported(map: &Path, out: &Path, what: &[&str]) {
    let head = ["export", "--map", text(map), "--out", text(out)];
    evermap(&[&head, what].concat()).expect(0);
}

#[test]
fn a_map_of_a_car_with_a_receiver_opens_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let roads = on_earth(folder.path());
    what_lanes_were_made_from_is_answered_as_the_docs_ask(&roads);
    let file = |name: &str| folder.path().join(name);
    let [parquet, geojson, local] = ["lanes.parquet", "lanes.geojson", "local.geojson"].map(file);
    exported(&roads, &parquet, &["lanes", "--format", "parquet"]);
    exported(&roads, &geojson, &["lanes", "--format", "geojson"]);
    let as_it_is = ["lanes", "--format", "geojson", "--local"];
    exported(&roads, &local, &as_it_is);
    let server = Server::start(&roads, &[]);
    let files = [text(&parquet), text(&geojson), text(&local), &server.http];
    if let Some(mut reader) = script("exports/earth.py", &files) {
        let read = reader.output().expect("python starts");
        Finished::from(read).expect(0);
    }

    // What lies on earth would lie elsewhere in the map.
    let log = file("ada.mcap");
    let import = [
        "annotate",
        "--map",
        text(&roads),
        "--kind",
        "crossing",
        "--import",
        text(&geojson),
        "--out",
        text(&log),
    ];
    let ended = evermap(&import).expect(1);
    let says = "expected features in the map's metres, found longitude and latitude";
    assert!(ended.stderr.contains(says), "{}", ended.stderr);

    // A recording says it, too.
    let recording = file("roads.mcap");
    exported(&roads, &recording, &["--format", "mcap"]);
    let query = "SELECT count(*) AS n FROM gnss_fixes WHERE latitude_deg BETWEEN 52.2 AND 52.3";
    let found = rows_of_log(&recording, query);
    assert!(found[0]["n"].as_u64().unwrap() > 100, "{found}");
}
