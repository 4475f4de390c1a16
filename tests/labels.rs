//! What people say about a map: logs like any other, and labels that stay where they belong in every version.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::OnceLock;

use evermap_messages::annotation::{Anchor, Annotation, Geometry};
use evermap_recording::annotations::AnnotationLog;
use evermap_tests::asked::AskedStreet;
use evermap_tests::park::{copy, made_once};
use evermap_tests::{
    DrivePose, Finished, command, evermap, rows_of, run_of_site, text, write_drive,
};
use serde_json::{Value, json};

/// A straight drive at 2 m/s whose odometry measures a metre as so many.
fn straight(scale: f64) -> Vec<DrivePose> {
    let pose = |step: u32| {
        let seconds = f64::from(step) * 0.1;
        (seconds, 2.0 * seconds * scale, 0.0, 0.0)
    };
    (0..=150).map(pose).collect()
}

/// A folder for a map of one drive, `a`.
struct Lot {
    folder: tempfile::TempDir,
}

impl Lot {
    fn new() -> Self {
        let lot = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        write_drive(&lot.path("a.mcap"), straight(1.0));
        lot
    }

    /// With a copy of the first version of such a map, which the tests share, as they do the log of its drive: it is not to be
    /// changed.
    fn mapped() -> Self {
        static MAP: OnceLock<PathBuf> = OnceLock::new();
        let map = MAP.get_or_init(|| {
            let folder = made_once(env!("CARGO_TARGET_TMPDIR"), "labels");
            let (drive, map) = (folder.join("a.mcap"), folder.join("map"));
            write_drive(&drive, straight(1.0));
            run_of_site("labels", &map, "lot", &["--sessions", text(&drive)]).expect(0);
            map
        });
        let folder = tempfile::tempdir().unwrap();
        copy(map, folder.path(), "map");
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, sessions: &[&str]) -> Finished {
        self.run_plan("labels", sessions)
    }

    fn run_plan(&self, plan: &str, sessions: &[&str]) -> Finished {
        let map = self.path("map");
        let mut arguments = vec!["run", plan, "--map", text(&map), "--site", "lot"];
        arguments.extend(["--progress", "none", "--sessions"]);
        let sessions: Vec<PathBuf> = sessions.iter().map(|name| self.path(name)).collect();
        arguments.extend(sessions.iter().map(|path| text(path)));
        evermap(&arguments)
    }

    /// What a person imports into the log `NAME.mcap`.
    fn import(&self, author: &str, labels: &Value, more: &[&str]) -> Finished {
        let file = self.path("labels.json");
        std::fs::write(&file, labels.to_string()).unwrap();
        self.import_file(author, &file, more)
    }

    fn import_file(&self, author: &str, file: &Path, more: &[&str]) -> Finished {
        let log = self.path(&format!("{author}.mcap"));
        let map = self.path("map");
        let mut arguments = vec!["annotate", "--map", text(&map), "--author", author];
        arguments.extend(["--import", text(file), "--out", text(&log)]);
        arguments.extend(more);
        evermap(&arguments)
    }

    fn export(&self) -> Value {
        let (map, file) = (self.path("map"), self.path("export.json"));
        evermap(&["annotate", "--map", text(&map), "--export", text(&file)]).expect(0);
        serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
    }

    fn ask(&self, query: &str) -> Value {
        rows_of(&self.path("map"), query)
    }

    /// Label, x and y in centimetres, what placed it.
    fn labels(&self) -> Vec<(String, i64, i64, String)> {
        let rows = self.ask(
            "SELECT label, round(map_from_label['x'] * 100) AS x, round(map_from_label['y'] * 100) AS y, placed_by
             FROM placed_labels ORDER BY label",
        );
        let number = |row: &Value, name: &str| row[name].as_f64().unwrap() as i64;
        let row = |row: &Value| {
            let text = |name: &str| row[name].as_str().unwrap().to_owned();
            (
                text("label"),
                number(row, "x"),
                number(row, "y"),
                text("placed_by"),
            )
        };
        rows.as_array().unwrap().iter().map(row).collect()
    }
}

/// A space that is drawn with its middle there.
fn drawn(label: &str, x: f64, y: f64) -> Annotation {
    Annotation {
        stamp_ns: 1_800_000_000_000_000_000,
        author: "ada".into(),
        sequence: 0,
        id: label.into(),
        kind: "parking_space".into(),
        act: "drawn".into(),
        map_version: Some(1),
        geometry: Some(Geometry {
            shape: "box".into(),
            points: vec![
                [2.5, 1.2, 0.0],
                [-2.5, 1.2, 0.0],
                [-2.5, -1.2, 0.0],
                [2.5, -1.2, 0.0],
            ],
            map_from_label: [x, y, 0.0, 0.0, 0.0, 0.0, 1.0],
        }),
        anchor: None,
        image: None,
    }
}

fn say(path: &Path, acts: &[Annotation]) {
    let mut log = AnnotationLog::begin(path, |_| false, "a test").unwrap();
    log.say_all(acts).unwrap();
    log.finish().unwrap();
}

#[test]
fn labels_are_drawn_once_and_move_with_the_poses_of_every_version() {
    let lot = Lot::new();
    let first = lot.run(&["a.mcap"]).expect(0);
    let said = first.stderr.contains("annotations");
    assert!(
        said && first.stderr.contains("note: no session has"),
        "{}",
        first.stderr
    );
    assert!(lot.labels().is_empty());

    say(
        &lot.path("ada.mcap"),
        &[drawn("one", 10.0, 3.0), drawn("two", 20.0, -3.0)],
    );
    let second = lot.run(&["ada.mcap"]).expect(0);
    assert!(!second.stderr.contains("annotations"), "{}", second.stderr);
    let pose = |label: &str, x, y| (label.to_owned(), x, y, "pose".to_owned());
    assert_eq!(
        lot.labels(),
        [pose("one", 1000, 300), pose("two", 2000, -300)]
    );
    // What is said makes nothing of the drive anew, and nothing is done twice.
    let of_drive = lot
        .ask("SELECT DISTINCT step FROM runs WHERE version = 2 AND session = 'a' AND NOT cached");
    assert_eq!(of_drive, json!([]));
    let again = lot.run(&["ada.mcap"]).expect(0);
    assert!(
        again.stderr.contains("nothing has changed"),
        "{}",
        again.stderr
    );

    // The same drive with better odometry: the poses move, and the labels with them.
    write_drive(&lot.path("a.mcap"), straight(1.1));
    lot.run(&["a.mcap"]).expect(0);
    assert_eq!(
        lot.labels(),
        [pose("one", 1100, 300), pose("two", 2200, -300)]
    );
    let kept = lot.ask("SELECT count(*) AS n FROM label_anchors WHERE anchor['session'] = 'a'");
    assert_eq!(kept[0]["n"], 2);

    // Two labels in the two versions that have them are four outlines, where each version has them.
    let (map, picture) = (lot.path("map"), lot.path("labels.svg"));
    let drawn = ["render", "--map", text(&map), "--view", "labels"];
    let drawn = [&drawn[..], &["--out", text(&picture)]].concat();
    evermap(&drawn).expect(0);
    let svg = std::fs::read_to_string(&picture).unwrap();
    for told in [
        "parking_space one in version 2: 1000 mm off the newest",
        "parking_space two in version 2: 2000 mm off the newest",
        "parking_space two in version 3: 0 mm off the newest",
    ] {
        assert!(svg.contains(told), "{told}");
    }
    assert_eq!(svg.matches(" off the newest").count(), 4);
    let newest = [&drawn[..], &["--since", "3"]].concat();
    evermap(&newest).expect(0);
    let svg = std::fs::read_to_string(&picture).unwrap();
    assert_eq!(svg.matches(" off the newest").count(), 2);
    let none = evermap(&[&drawn[..], &["--since", "9"]].concat()).expect(1);
    assert!(none.stderr.contains("no version 9"), "{}", none.stderr);
    let (other, render) = (lot.path("other.svg"), ["render", "--map", text(&map)]);
    for view in ["map", "metric", "views", "similarities", "stable"] {
        let shown = ["--view", view, "--since", "1", "--out", text(&other)];
        let told = evermap(&[&render[..], &shown].concat()).expect(1).stderr;
        let expected = format!("--since is for the views changes and labels, found {view}");
        assert!(told.contains(&expected) && !other.exists(), "{told}");
    }
    let before = evermap(&[&drawn[..], &["--version", "1"]].concat()).expect(1);
    assert!(
        before.stderr.contains("no labels of lot"),
        "{}",
        before.stderr
    );
}

const SPACE: [&str; 2] = ["--kind", "parking_space"];

/// Features with these outlines and names.
fn collection(features: &[(&str, Value)]) -> Value {
    let feature = |(label, geometry): &(&str, Value)| json!({ "type": "Feature", "id": label, "properties": {}, "geometry": geometry });
    let features: Vec<Value> = features.iter().map(feature).collect();
    json!({ "type": "FeatureCollection", "features": features })
}

/// A space 5 m by 2.4 m that begins there.
fn space(x: f64, y: f64) -> Value {
    let (far_x, far_y) = (x + 5.0, y + 2.4);
    let ring = [[x, y], [far_x, y], [far_x, far_y], [x, far_y], [x, y]];
    json!({ "type": "Polygon", "coordinates": [ring] })
}

fn line(points: &[[f64; 2]]) -> Value {
    json!({ "type": "LineString", "coordinates": points })
}

#[test]
fn what_is_drawn_moved_and_removed_with_other_programs_comes_back() {
    let lot = Lot::mapped();
    let arrow = line(&[[8.0, 0.0], [10.0, 0.0]]);
    let drawn = collection(&[
        ("one", space(5.0, 2.0)),
        ("two", space(10.0, 2.0)),
        ("arrow", arrow),
    ]);
    let said = lot.import("ada", &drawn, &SPACE).expect(0);
    assert!(said.stderr.contains("ada.mcap: 3 drawn"), "{}", said.stderr);
    // What a log says counts before a run has it, and nothing is said twice.
    let again = lot.import("ada", &drawn, &SPACE).expect(0);
    assert!(
        again.stderr.contains("nothing new to say, 3 as they were"),
        "{}",
        again.stderr
    );
    assert!(!lot.path("ada_2.mcap").exists());

    lot.run(&["ada.mcap"]).expect(0);
    let pose = |label: &str, x, y| (label.to_owned(), x, y, "pose".to_owned());
    let expected = [
        pose("arrow", 900, 0),
        pose("one", 750, 320),
        pose("two", 1250, 320),
    ];
    assert_eq!(lot.labels(), expected);
    let sizes = lot.ask("SELECT round(length_m, 6) AS length_m, round(width_m, 6) AS width_m, shape FROM placed_labels WHERE label = 'one'");
    assert_eq!(
        sizes[0],
        json!({ "length_m": 5.0, "width_m": 2.4, "shape": "box" })
    );
    let tied =
        lot.ask("SELECT anchor['session'] AS session, log FROM label_anchors WHERE label = 'one'");
    assert_eq!(tied[0], json!({ "session": "a", "log": "ada" }));

    // Exported, as it is, it says nothing new; edited, it says just what was edited.
    let mut exported = lot.export();
    assert_eq!(exported["features"].as_array().unwrap().len(), 3);
    let same = lot.import("ada", &exported, &[]).expect(0);
    assert!(same.stderr.contains("3 as they were"), "{}", same.stderr);
    for feature in exported["features"].as_array_mut().unwrap() {
        match feature["properties"]["label"].as_str().unwrap() {
            "arrow" => feature["properties"]["standing"] = "removed".into(),
            "one" => feature["geometry"] = space(4.0, 2.0),
            _ => feature["properties"]["standing"] = "accepted".into(),
        }
    }
    let edited = lot.import("ada", &exported, &[]).expect(0);
    let told = "ada_2.mcap: 1 accepted, 1 moved, 1 removed";
    assert!(edited.stderr.contains(told), "{}", edited.stderr);
    lot.run(&["ada_2.mcap"]).expect(0);
    assert_eq!(
        lot.labels(),
        [pose("one", 650, 320), pose("two", 1250, 320)]
    );
    let standing = lot.ask("SELECT standing FROM placed_labels ORDER BY label");
    assert_eq!(
        standing,
        json!([{ "standing": "drawn" }, { "standing": "accepted" }])
    );
    // At another machine, where the logs are not: the map knows what they said, and has their names.
    std::fs::remove_file(lot.path("ada.mcap")).unwrap();
    std::fs::remove_file(lot.path("ada_2.mcap")).unwrap();
    let more = collection(&[("one", space(4.0, 2.0)), ("three", space(15.0, 2.0))]);
    let elsewhere = lot.import("ada", &more, &SPACE).expect(0);
    let told = "ada_3.mcap: 1 drawn, 1 as they were";
    assert!(elsewhere.stderr.contains(told), "{}", elsewhere.stderr);
    lot.run(&["ada_3.mcap"]).expect(0);
    assert_eq!(lot.labels().len(), 3);
    // The versions before are as they were.
    let map = lot.path("map");
    let before = [
        "sql",
        "--map",
        text(&map),
        "--version",
        "2",
        "--format",
        "json",
    ];
    let before = [&before[..], &["SELECT count(*) AS n FROM placed_labels"]].concat();
    assert_eq!(evermap(&before).expect(0).json()[0]["n"], 3);
}

/// As `to_json` of GeoPandas writes features: the number of the row is the id of each.
#[test]
fn numbers_of_rows_are_no_names_of_labels() {
    let lot = Lot::mapped();
    let drawn = collection(&[("one", space(5.0, 2.0)), ("two", space(10.0, 2.0))]);
    lot.import("ada", &drawn, &SPACE).expect(0);
    lot.run(&["ada.mcap"]).expect(0);
    let mut rows = lot.export();
    for (row, feature) in (0..).zip(rows["features"].as_array_mut().unwrap()) {
        feature["id"] = format!("{row}").into();
        feature["properties"]["standing"] = "accepted".into();
    }
    let said = lot.import("bob", &rows, &[]).expect(0);
    assert!(
        said.stderr.contains("bob.mcap: 2 accepted"),
        "{}",
        said.stderr
    );
    lot.run(&["bob.mcap"]).expect(0);
    let found = lot.ask("SELECT label, standing FROM placed_labels ORDER BY label");
    let accepted = |label: &str| json!({ "label": label, "standing": "accepted" });
    assert_eq!(found, json!([accepted("one"), accepted("two")]));
}

#[test]
fn two_people_who_disagree_are_counted_and_the_later_holds() {
    let lot = Lot::mapped();
    let mut labels = collection(&[("one", space(5.0, 2.0)), ("two", space(10.0, 2.0))]);
    lot.import("ada", &labels, &SPACE).expect(0);
    lot.run(&["ada.mcap"]).expect(0);
    labels["features"][0]["properties"]["standing"] = "accepted".into();
    lot.import("ada", &labels, &[]).expect(0);
    labels["features"][0]["properties"]["standing"] = "rejected".into();
    let bob = lot.import("bob", &labels, &[]).expect(0);
    assert!(
        bob.stderr.contains("bob.mcap: 1 rejected, 1 as they were"),
        "{}",
        bob.stderr
    );
    // The order in which logs are given says nothing.
    let run = lot.run(&["bob.mcap", "ada_2.mcap"]).expect(3);
    let told = "1  annotation that contradicts another person's; the later holds";
    assert!(run.stderr.contains(told), "{}", run.stderr);
    let standing = lot.ask("SELECT label, standing, author FROM placed_labels ORDER BY label");
    let expected = json!([
        { "label": "one", "standing": "rejected", "author": "bob" },
        { "label": "two", "standing": "drawn", "author": "ada" },
    ]);
    assert_eq!(standing, expected);
}

/// What a feature says of the image that shows it goes before the pose that is nearest.
#[test]
fn a_feature_that_names_an_image_is_tied_to_it() {
    let lot = Lot::mapped();
    let first = "SELECT CAST(stamp AS BIGINT) AS stamp, map_from_vehicle['x'] AS x FROM poses ORDER BY stamp LIMIT 1";
    let first = lot.ask(first)[0].clone();
    let mut people = collection(&[("one", space(20.0, 2.0)), ("two", space(20.0, 2.0))]);
    let image = |stamp: &Value| json!({ "session": "a", "stamp": stamp, "camera": "front" });
    for feature in people["features"].as_array_mut().unwrap() {
        feature["properties"] = json!({ "kind": "person", "standing": "rejected" });
    }
    people["features"][0]["properties"]["image"] = image(&first["stamp"]);
    lot.import("ada", &people, &[]).expect(0);
    // The same again is nothing new, and another image is another pose.
    let again = lot.import("ada", &people, &[]).expect(0);
    let told = "nothing new to say, 2 as they were";
    assert!(again.stderr.contains(told), "{}", again.stderr);
    lot.run(&["ada.mcap"]).expect(0);
    let tied = lot.ask(
        "SELECT anchor['camera'] AS camera, CAST(anchor['stamp'] AS BIGINT) AS stamp, map_from_label['x'] AS x,
           anchor['vehicle_from_label']['x'] AS from_vehicle
         FROM placed_labels ORDER BY label",
    );
    assert_eq!(tied[0]["camera"], "front");
    assert_eq!(tied[0]["stamp"], first["stamp"]);
    let number = |row: &Value, name: &str| row[name].as_f64().unwrap();
    let ahead = 22.5 - number(&first, "x");
    assert!(
        (number(&tied[0], "from_vehicle") - ahead).abs() < 1e-3,
        "{tied}"
    );
    assert!((number(&tied[0], "x") - 22.5).abs() < 1e-3, "{tied}");
    assert!(
        tied[1]["camera"].is_null() && tied[1]["stamp"] != first["stamp"],
        "{tied}"
    );

    people["features"][0]["properties"]["image"] = image(&7.into());
    people["features"][1]["properties"]["image"] = json!({ "session": "a" });
    let lost = lot.import("bob", &people, &[]).expect(3);
    for told in [
        "that the map has no vehicle pose of",
        "without session, stamp (ns) and camera",
    ] {
        assert!(lost.stderr.contains(told), "{told}: {}", lost.stderr);
    }
    assert!(!lot.path("bob.mcap").exists());
}

/// In UTM, or 5 km from the image that is to show it: what covers the labels would cover all in between.
#[test]
fn what_lies_kilometres_away_is_refused_left_out_and_can_be_removed() {
    let lot = Lot::mapped();
    let mut drawn_far = collection(&[
        ("utm", space(500_000.0, 5_540_000.0)),
        ("seen", space(300.0, 2.0)),
    ]);
    let first = lot.ask("SELECT CAST(stamp AS BIGINT) AS stamp FROM poses ORDER BY stamp LIMIT 1");
    drawn_far["features"][1]["properties"]["image"] =
        json!({ "session": "a", "stamp": first[0]["stamp"], "camera": "front" });
    let said = lot.import("ada", &drawn_far, &SPACE).expect(3);
    for told in [
        "label utm: feature kilometres from every vehicle pose: expected metres in the map's frame",
        "label seen: feature of an image that was taken hundreds of metres away from it",
    ] {
        assert!(said.stderr.contains(told), "{told}: {}", said.stderr);
    }
    assert!(!lot.path("ada.mcap").exists());

    // As an older evermap said it, or another program.
    let early = |label: &str, x, y| Annotation {
        stamp_ns: 1_700_000_000_000_000_000,
        ..drawn(label, x, y)
    };
    let acts = [early("near", 5.0, 3.0), early("utm", 5e5, 5.54e6)];
    say(&lot.path("old.mcap"), &acts);
    let run = lot.run(&["old.mcap"]).expect(3);
    let told = "1  label kilometres from every vehicle pose, in no layer that labels make";
    assert!(run.stderr.contains(told), "{}", run.stderr);
    let near = ("near".to_owned(), 500, 300, "pose".to_owned());
    assert_eq!(lot.labels(), std::slice::from_ref(&near));
    let mut gone = collection(&[("utm", Value::Null)]);
    gone["features"][0]["properties"]["standing"] = "removed".into();
    let said = lot.import("ada", &gone, &[]).expect(3);
    assert!(
        said.stderr.contains("ada.mcap: 1 removed"),
        "{}",
        said.stderr
    );
    lot.run(&["ada.mcap"]).expect(0);
    assert_eq!(lot.labels(), [near]);
}

/// Somebody with two windows open, who says two things in each; of one label something else.
#[test]
fn an_author_twice_at_once_loses_nothing() {
    let lot = Lot::mapped();
    let said = [
        collection(&[("one", space(5.0, 2.0)), ("two", space(10.0, 2.0))]),
        collection(&[("one", space(5.5, 2.0)), ("three", space(15.0, 2.0))]),
    ];
    let (map, log) = (lot.path("map"), lot.path("ada.mcap"));
    let windows = [0, 1].map(|window| {
        let file = lot.path(&format!("window_{window}.json"));
        std::fs::write(&file, said[window].to_string()).unwrap();
        let mut import = command(&["annotate", "--map", text(&map), "--author", "ada"]);
        import.args(["--import", text(&file), "--out", text(&log)]);
        import.args(SPACE).stdout(Stdio::piped());
        import.stderr(Stdio::piped()).spawn().unwrap()
    });
    for window in windows.map(|window| window.wait_with_output().unwrap()) {
        let ended = Finished::from(window);
        // One may read what the other is about to write, which is a log without an end.
        assert!([0, 3].contains(&ended.code), "{}", ended.stderr);
    }
    lot.run(&["ada.mcap", "ada_2.mcap"]).expect(0);
    assert_eq!(lot.ask("SELECT count(*) AS n FROM said")[0]["n"], 4);
    let labels = lot.labels();
    let names: Vec<&str> = labels.iter().map(|(name, ..)| name.as_str()).collect();
    assert_eq!(names, ["one", "three", "two"]);
    assert!([750, 800].contains(&labels[0].1), "{labels:?}");
}

#[test]
fn what_makes_no_sense_is_counted_and_said_and_the_rest_is_kept() {
    let lot = Lot::mapped();
    let tie =
        json!({ "type": "Polygon", "coordinates": [[[0, 2], [2, 4], [2, 2], [0, 4], [0, 2]]] });
    let hole = json!({ "type": "Polygon", "coordinates": [space(0.0, 2.0)["coordinates"][0], [[1, 3], [2, 3], [2, 4]]] });
    let bad = collection(&[
        ("good", space(5.0, 2.0)),
        ("point", json!({ "type": "Point", "coordinates": [1, 2] })),
        ("tie", tie),
        ("hole", hole),
        (
            "text",
            json!({ "type": "LineString", "coordinates": ["a", "b"] }),
        ),
        ("short", line(&[[1.0, 1.0]])),
        ("far", space(900.0, 2.0)),
        ("empty", Value::Null),
        ("two\nlines", space(10.0, 2.0)),
    ]);
    let said = lot.import("ada", &bad, &SPACE).expect(3);
    for told in [
        "feature 1, label point: geometry that is neither polygon nor line",
        "feature 2, label tie: polygon that crosses itself",
        "feature 3, label hole: polygon with holes",
        "feature 4, label text: feature with a position that is not a list of numbers",
        "feature 5, label short: line of less than two points",
        "feature 6, label far: label too far from every vehicle pose",
        "feature 7, label empty: label that is not there",
        "1  feature of a kind, or a label, whose name has a control character",
        "ada.mcap: 2 drawn",
    ] {
        assert!(said.stderr.contains(told), "{told}: {}", said.stderr);
    }
    // A label out of reach is kept, on its map frame.
    let run = lot.run(&["ada.mcap"]).expect(3);
    assert!(
        run.stderr
            .contains("1  label too far from every vehicle pose"),
        "{}",
        run.stderr
    );
    let placed = |label: &str, x, by: &str| (label.to_owned(), x, 320, by.to_owned());
    assert_eq!(
        lot.labels(),
        [placed("far", 90250, "frame"), placed("good", 750, "pose")]
    );
    let no_kind = lot
        .import("ada", &collection(&[("new", space(6.0, -4.0))]), &[])
        .expect(3);
    assert!(
        no_kind.stderr.contains("feature without a kind"),
        "{}",
        no_kind.stderr
    );
    let pixels = lot
        .import("ada", &json!({ "images": [] }), &SPACE)
        .expect(1);
    assert!(pixels.stderr.contains("--mosaic"), "{}", pixels.stderr);
    lot.import("ada", &json!({ "some": "thing" }), &SPACE)
        .expect(1);
    let mosaic = mosaic(&lot);
    let on_mosaic = [&SPACE[..], &["--mosaic", text(&mosaic)]].concat();
    let least = json!([{ "image": "mosaic.png", "id": 1, "label": [{ "x": 10 }] }]);
    for (labels, next) in [
        (json!({ "type": "FeatureCollection" }), "as GeoJSON"),
        (least, "as `JSON`, not as `JSON-MIN`"),
    ] {
        let said = lot.import("ada", &labels, &on_mosaic).expect(1);
        assert!(said.stderr.contains(next), "{}", said.stderr);
    }
}

#[test]
fn a_kind_of_its_own_goes_first_and_one_that_contradicts_is_left_out() {
    let lot = Lot::mapped();
    let mut labels = collection(&[("one", space(5.0, 2.0)), ("two", space(10.0, 2.0))]);
    labels["features"][1]["properties"]["kind"] = "crossing".into();
    let said = lot.import("ada", &labels, &SPACE).expect(3);
    for told in [
        "feature 1, label two: feature of another kind than --kind",
        "ada.mcap: 1 drawn",
    ] {
        assert!(said.stderr.contains(told), "{told}: {}", said.stderr);
    }
    let said = lot.import("ada", &labels, &[]).expect(0);
    let told = "ada_2.mcap: 1 drawn, 1 as they were";
    assert!(said.stderr.contains(told), "{}", said.stderr);
    lot.run(&["ada.mcap", "ada_2.mcap"]).expect(0);

    // Any word is a kind; one that looks like a kind of the map may be a slip.
    let more = collection(&[("three", space(15.0, 2.0))]);
    let said = lot
        .import("bob", &more, &["--kind", "parkingspace"])
        .expect(0);
    for told in ["did you mean `parking_space`?", "bob.mcap: 1 drawn"] {
        assert!(said.stderr.contains(told), "{told}: {}", said.stderr);
    }
    let said = lot.import("bob", &more, &["--kind", "arrow"]).expect(0);
    assert!(!said.stderr.contains("did you mean"), "{}", said.stderr);

    // Categories are other programs' words, but for kinds of the map.
    let mosaic = mosaic(&lot);
    let coco = json!({
        "images": [{ "id": 7, "file_name": "mosaic.png", "width": 400, "height": 200 }],
        "categories": [{ "id": 1, "name": "Stellplatz" }, { "id": 2, "name": "crossing" }],
        "annotations": [
            { "image_id": 7, "category_id": 1, "bbox": [100, 100, 100, 48], "segmentation": [] },
            { "image_id": 7, "category_id": 2, "bbox": [200, 76, 100, 48], "segmentation": [] },
        ],
    });
    let named = [&SPACE[..], &["--mosaic", text(&mosaic)]].concat();
    let said = lot.import("coco", &coco, &named).expect(3);
    for told in [
        "1  feature of another kind than --kind",
        "coco.mcap: 1 drawn",
    ] {
        assert!(said.stderr.contains(told), "{told}: {}", said.stderr);
    }
    lot.run(&["coco.mcap"]).expect(0);
    let kinds = lot.ask("SELECT kind, author FROM placed_labels ORDER BY author, kind");
    let of = |kind: &str, author: &str| json!({ "kind": kind, "author": author });
    let expected = [
        of("crossing", "ada"),
        of("parking_space", "ada"),
        of("parking_space", "coco"),
    ];
    assert_eq!(kinds, json!(expected));
}

#[test]
fn a_torn_log_is_read_as_far_as_it_goes_and_gone_on_from() {
    let lot = Lot::mapped();
    let labels = collection(&[("one", space(5.0, 2.0)), ("two", space(10.0, 2.0))]);
    lot.import("ada", &labels, &SPACE).expect(0);
    let whole = std::fs::read(lot.path("ada.mcap")).unwrap();
    let second = whole
        .windows(5)
        .rposition(|bytes| bytes == b"\"two\"")
        .unwrap();
    std::fs::write(lot.path("ada.mcap"), &whole[..second]).unwrap();
    // The second label is said again, in a part of its own.
    let again = lot.import("ada", &labels, &SPACE).expect(3);
    assert!(
        again.stderr.contains("ada_2.mcap: 1 drawn, 1 as they were"),
        "{}",
        again.stderr
    );
    let one_torn = |line: &str| {
        line.trim_start().starts_with("1  ") && line.contains("ada.mcap: logs without an end")
    };
    assert!(again.stderr.lines().any(one_torn), "{}", again.stderr);
    assert_eq!(std::fs::read(lot.path("ada.mcap")).unwrap().len(), second);
    lot.run(&["ada.mcap", "ada_2.mcap"]).expect(3);
    let placed = |label: &str, x| (label.to_owned(), x, 320, "pose".to_owned());
    assert_eq!(lot.labels(), [placed("one", 750), placed("two", 1250)]);
}

#[test]
fn labels_of_a_session_that_the_map_does_not_have_are_counted_and_kept() {
    let lot = Lot::mapped();
    let labels = collection(&[("one", space(5.0, 2.0))]);
    lot.import("ada", &labels, &SPACE).expect(0);
    // Another map of the same place, without the session that the label is tied to.
    std::fs::rename(lot.path("map"), lot.path("older")).unwrap();
    write_drive(&lot.path("b.mcap"), straight(1.0));
    let run = lot.run(&["b.mcap", "ada.mcap"]).expect(3);
    let told = "1  label whose session is gone, placed by its frame";
    assert!(run.stderr.contains(told), "{}", run.stderr);
    assert_eq!(
        lot.labels(),
        [("one".to_owned(), 750, 320, "frame".to_owned())]
    );
}

#[test]
fn a_label_whose_session_was_replaced_is_held_by_no_frame_that_has_the_number_of_its_own() {
    let lot = Lot::new();
    lot.run(&["a.mcap"]).expect(0);
    let labels = collection(&[("one", space(20.0, 2.0))]);
    lot.import("ada", &labels, &SPACE).expect(0);
    lot.run(&["ada.mcap"]).expect(0);
    // Under the same name the same way back, an hour later.
    let back = straight(1.0).into_iter();
    let back = back.map(|(seconds, x, y, yaw)| {
        let turned = yaw + std::f64::consts::PI;
        (seconds + 3600.0, 30.0 - x, y, turned)
    });
    write_drive(&lot.path("a.mcap"), back);
    let run = lot.run(&["a.mcap"]).expect(3);
    let told = "1  label of an instant that its session has no pose at, placed where it was before";
    assert!(run.stderr.contains(told), "{}", run.stderr);
    let numbered = "SELECT count(*) AS n FROM map_frames JOIN label_anchors USING (site, frame)";
    assert_eq!(lot.ask(numbered)[0]["n"], 1, "the number is there again");
    assert_eq!(
        lot.labels(),
        [("one".to_owned(), 2250, 320, "before".to_owned())]
    );
}

/// Labels tied in a plan of one's own; what it reads and writes besides.
fn tied(label_anchors: &str, more: &str) -> String {
    format!(
        "plan: tied
steps:
  keyframes: {{ op: keyframes, in: {{ odometry: odometry }} }}
  poses: {{ sql: 'SELECT site, session, stamp, odom_from_vehicle AS map_from_vehicle FROM keyframes' }}
  map_frames: {{ op: map_frames, in: {{ poses: poses }} }}
  said: {{ sql: 'SELECT * FROM annotations' }}
  {label_anchors}:
    op: label_anchors
    in: {{ annotations: said, poses: poses, frames: map_frames{more}
write: [said, label_anchors]
"
    )
}

#[test]
fn labels_of_a_map_that_did_not_note_what_their_frames_are_are_held_anew() {
    let lot = Lot::new();
    say(&lot.path("ada.mcap"), &[drawn("one", 10.0, 3.0)]);
    let plan = lot.path("tied.yaml");
    let older = " }
  label_anchors:
    sql: >
      SELECT site, label, kind, standing, author, said, log, shape, points, map_from_label, anchor, frame,
             frame_from_label FROM held";
    std::fs::write(&plan, tied("held", older)).unwrap();
    lot.run_plan(text(&plan), &["a.mcap", "ada.mcap"]).expect(0);
    let frame = lot.ask("SELECT frame FROM label_anchors");
    assert!(frame[0]["frame"].is_number(), "{frame}");

    let today = ", previous: previous.label_anchors }";
    std::fs::write(&plan, tied("label_anchors", today)).unwrap();
    lot.run_plan(text(&plan), &["a.mcap"]).expect(0);
    let noted = "SELECT frame, frame_session, frame_stamp IS NOT NULL AS noted FROM label_anchors";
    let expected = json!([{ "frame": frame[0]["frame"], "frame_session": "a", "noted": true }]);
    assert_eq!(lot.ask(noted), expected);
}

/// A picture of 400 by 200 pixels of 5 cm whose upper left corner is at x = 0, y = 10.
fn mosaic(lot: &Lot) -> PathBuf {
    let world = "0.05\n0\n0\n-0.05\n0.025\n9.975\n";
    std::fs::write(lot.path("mosaic.pgw"), world).unwrap();
    let picture = lot.path("mosaic.png");
    let mut encoder = png::Encoder::new(std::fs::File::create(&picture).unwrap(), 400, 200);
    encoder.set_color(png::ColorType::Grayscale);
    let mut pixels = encoder.write_header().unwrap();
    pixels.write_image_data(&[0; 400 * 200]).unwrap();
    picture
}

#[test]
fn boxes_drawn_on_a_mosaic_are_where_they_were_drawn() {
    let lot = Lot::mapped();
    let mosaic = mosaic(&lot);
    let coco = json!({
        "images": [{ "id": 7, "file_name": "mosaic.png", "width": 400, "height": 200 }],
        "categories": [{ "id": 1, "name": "parking_space" }],
        "annotations": [
            { "image_id": 7, "category_id": 1, "bbox": [100, 100, 100, 48], "segmentation": [] },
            { "image_id": 7, "category_id": 1, "bbox": [200, 76, 100, 48], "attributes": { "rotation": 90.0 } },
            { "image_id": 7, "category_id": 1, "bbox": [0, 0, 1, 1], "segmentation": [[20, 60, 60, 60, 40, 100]] },
            { "image_id": 8, "category_id": 1, "bbox": [0, 0, 9, 9] },
            { "image_id": 7, "category_id": 1, "segmentation": { "counts": "abc" } },
        ],
    });
    let said = lot
        .import("coco", &coco, &["--mosaic", text(&mosaic)])
        .expect(3);
    assert!(
        said.stderr.contains("coco.mcap: 3 drawn"),
        "{}",
        said.stderr
    );
    assert!(
        said.stderr.contains("1  annotation of another picture"),
        "{}",
        said.stderr
    );
    assert!(
        said.stderr
            .contains("1  annotation that is neither box, outline nor line"),
        "{}",
        said.stderr
    );
    // 10 % of 400 px is 2 m. Turned by 90 degrees, clockwise, about its upper left corner.
    let result = |value: Value, kind: &str| {
        json!({
            "type": kind, "original_width": 400, "original_height": 200, "value": value,
        })
    };
    let turned = json!({ "x": 50, "y": 40, "width": 25, "height": 24, "rotation": 90.0, "rectanglelabels": ["arrow"] });
    let brush = json!({ "rle": [], "brushlabels": ["arrow"] });
    let results = [
        result(turned, "rectanglelabels"),
        result(brush, "brushlabels"),
    ];
    let studio = json!([{ "id": 1, "annotations": [{ "result": results }] }]);
    let said = lot
        .import("studio", &studio, &["--mosaic", text(&mosaic)])
        .expect(3);
    assert!(
        said.stderr.contains("studio.mcap: 1 drawn"),
        "{}",
        said.stderr
    );
    lot.run(&["coco.mcap", "studio.mcap"]).expect(0);
    let rows = lot.ask(
        "SELECT kind, shape, round(map_from_label['x'], 3) AS x, round(map_from_label['y'], 3) AS y,
                round(length_m, 3) AS length_m, round(abs(sin(2 * atan2(map_from_label['qz'], map_from_label['qw']))), 3) AS north
         FROM placed_labels ORDER BY kind, x",
    );
    let found = |kind, shape, x: f64, y: f64, length_m: Value, north: f64| json!({ "kind": kind, "shape": shape, "x": x, "y": y, "length_m": length_m, "north": north });
    let expected = json!([
        found("arrow", "box", 8.8, 3.5, 5.0.into(), 1.0),
        found("parking_space", "polygon", 2.0, 6.333, Value::Null, 0.0),
        found("parking_space", "box", 7.5, 3.8, 5.0.into(), 0.0),
        found("parking_space", "box", 12.5, 5.0, 5.0.into(), 1.0),
    ]);
    assert_eq!(rows, expected);
}

#[test]
fn annotations_of_another_picture_are_refused_and_nothing_is_said() {
    let lot = Lot::mapped();
    let mosaic = mosaic(&lot);
    let coco = |name: &str, width: u32| {
        json!({
            "images": [{ "id": 1, "file_name": name, "width": width, "height": 200 }],
            "categories": [{ "id": 1, "name": "parking_space" }],
            "annotations": [{ "image_id": 1, "category_id": 1, "bbox": [100, 100, 100, 48] }],
        })
    };
    let on_mosaic = ["--mosaic", text(&mosaic)];
    let said = lot
        .import("ada", &coco("mosaic.png", 800), &on_mosaic)
        .expect(1);
    let told =
        "expected annotations of a picture of 400 × 200 px, found those of one of 800 × 200 px";
    assert!(said.stderr.contains(told), "{}", said.stderr);
    assert!(!lot.path("ada.mcap").exists());
    let said = lot
        .import("ada", &coco("old.png", 400), &on_mosaic)
        .expect(0);
    for told in [
        "note: annotations of old.png are taken for those of mosaic.png",
        "ada.mcap: 1 drawn",
    ] {
        assert!(said.stderr.contains(told), "{told}: {}", said.stderr);
    }
}

/// A text whose numbers have no more digits than so many behind their points.
fn rounded(text: &str, digits: usize) -> String {
    let is_number = |character: char| character.is_ascii_digit() || character == '.';
    let mut rest = text;
    let mut written = String::new();
    while let Some(start) = rest.find(is_number) {
        let (before, from) = rest.split_at(start);
        let end = from.find(|character: char| !is_number(character));
        let (number, after) = from.split_at(end.unwrap_or(from.len()));
        written.push_str(before);
        match number.split_once('.') {
            Some((_, behind)) if behind.len() > digits => {
                let number: f64 = number.parse().unwrap();
                written.push_str(&format!("{number:.digits$}"));
            }
            _ => written.push_str(number),
        }
        rest = after;
    }
    written + rest
}

/// Labels go to other programs, which round what they keep and may forget names, and come back: nothing new is said.
#[test]
fn what_goes_to_other_programs_comes_back_as_it_was() {
    let lot = Lot::mapped();
    let mosaic = mosaic(&lot);
    let (sin, cos) = 0.4_f64.sin_cos();
    let corner = |[along, across]: [f64; 2]| {
        [
            13.0 + along * cos - across * sin,
            6.0 + along * sin + across * cos,
        ]
    };
    let ring = [
        [2.5, 1.2],
        [-2.5, 1.2],
        [-2.5, -1.2],
        [2.5, -1.2],
        [2.5, 1.2],
    ]
    .map(corner);
    let turned = json!({ "type": "Polygon", "coordinates": [ring] });
    let outline = [
        [1.0, 1.0],
        [4.0, 1.0],
        [5.0, 3.0],
        [3.0, 4.5],
        [1.0, 3.0],
        [1.0, 1.0],
    ];
    let outline = json!({ "type": "Polygon", "coordinates": [outline] });
    let mut drawn = collection(&[
        ("space", space(5.0, 5.0)),
        ("turned", turned),
        ("area", outline),
        ("stop", line(&[[8.0, 1.0], [10.0, 1.5], [12.0, 1.0]])),
    ]);
    let kinds = ["parking_space", "parking_space", "hatched", "stop_line"];
    for (feature, kind) in drawn["features"]
        .as_array_mut()
        .unwrap()
        .iter_mut()
        .zip(kinds)
    {
        feature["properties"]["kind"] = kind.into();
    }
    lot.import("ada", &drawn, &[]).expect(0);
    lot.run(&["ada.mcap"]).expect(0);

    let map = lot.path("map");
    for (program, name, digits, lost, count) in [
        ("coco", "labels.json", 2, 1, 3),
        ("cvat", "labels.xml", 2, 0, 4),
        ("label-studio", "labels.json", 6, 1, 3),
        ("yolo-obb", "spaces.labels", 6, 2, 2),
    ] {
        let file = lot.path(name);
        let mut export = vec!["annotate", "--map", text(&map), "--export", text(&file)];
        export.extend(["--program", program, "--mosaic", text(&mosaic)]);
        let ended = evermap(&export).expect(if lost > 0 { 3 } else { 0 });
        let lines = ended
            .stderr
            .lines()
            .filter(|line| line.starts_with("label "));
        assert_eq!(lines.count(), lost, "{program}: {}", ended.stderr);
        let written = std::fs::read_to_string(&file).unwrap();
        let nameless = rounded(&written, digits).replace("evermap_label", "other");
        for content in [&written, &nameless] {
            std::fs::write(&file, content).unwrap();
            let said = lot
                .import_file("bob", &file, &["--mosaic", text(&mosaic)])
                .expect(0);
            let told = format!("nothing new to say, {count} as they were");
            assert!(said.stderr.contains(&told), "{program}: {}", said.stderr);
        }
    }
    assert!(!lot.path("bob.mcap").exists());

    // By its name a label is moved there, and not drawn a second time.
    let file = lot.path("labels.json");
    let mut export = vec!["annotate", "--map", text(&map), "--export", text(&file)];
    export.extend(["--program", "label-studio", "--mosaic", text(&mosaic)]);
    evermap(&export).expect(3);
    let mut tasks: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let results = tasks[0]["annotations"][0]["result"].as_array_mut().unwrap();
    let space = results
        .iter_mut()
        .find(|one| one["id"] == "evermap_label:space");
    space.unwrap()["value"]["x"] = 30.0.into();
    let said = lot
        .import("ada", &tasks, &["--mosaic", text(&mosaic)])
        .expect(0);
    let told = "ada_2.mcap: 1 moved, 2 as they were";
    assert!(said.stderr.contains(told), "{}", said.stderr);
    lot.run(&["ada_2.mcap"]).expect(0);
    let moved = lot
        .ask("SELECT round(map_from_label['x'], 3) AS x FROM placed_labels WHERE label = 'space'");
    assert_eq!(moved, json!([{ "x": 8.5 }]));
}

/// Boxes around those whom a map asks about go to other programs; what is left there is a person, what is removed none, and who
/// is added was missed.
#[test]
fn boxes_on_camera_images_answer_for_who_is_seen_in_them() {
    let street = AskedStreet::new();
    let (map, folder, file) = (
        street.map(),
        street.path("people"),
        street.path("said.json"),
    );
    let export = [
        "export",
        "person_questions",
        "--map",
        text(&map),
        "--format",
        "coco",
    ];
    let export = [&export[..], &["--questions", "3", "--out", text(&folder)]].concat();
    evermap(&export).expect(0);
    let read = |name: &str| -> Value {
        serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap()
    };
    let coco = read("coco.json");
    let names: Vec<&str> = coco["images"]
        .as_array()
        .unwrap()
        .iter()
        .map(|image| {
            assert_eq!(
                (&image["session"], &image["site"]),
                (&json!("visit_a"), &json!("street"))
            );
            assert_eq!(
                [&image["width"], &image["height"]],
                [&json!(256), &json!(83)]
            );
            image["file_name"].as_str().unwrap()
        })
        .collect();
    assert_eq!(names.len(), 3);
    for name in &names {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        assert_eq!(
            evermap_vision::image_size(&bytes).unwrap(),
            [256, 83],
            "{name}"
        );
    }
    let asked: Vec<&Value> = coco["annotations"].as_array().unwrap().iter().collect();
    assert_eq!(asked[0]["bbox"], json!([100.5, 30.5, 10.0, 30.0]));
    let predicted = &read("label_studio.json")[2]["predictions"][0]["result"];
    assert_eq!(predicted.as_array().unwrap().len(), 1);

    // As a program writes it that knows nothing of ours: the first box is drawn tighter, one is removed, and on the first image
    // somebody is added, 5 m ahead. Nobody looked at the third image.
    let image = |id: usize| json!({ "id": id + 10, "file_name": format!("upload/3f2a1b4c-{}", names[id]), "width": 256, "height": 83 });
    let drawn = |bbox: [f64; 4]| json!({ "image_id": 10, "category_id": 4, "bbox": bbox });
    let said = json!({
        "images": [image(0), image(1)],
        "categories": [{ "id": 4, "name": "Person" }],
        "annotations": [drawn([101.0, 32.0, 9.0, 27.0]), drawn([125.0, 42.0, 6.0, 14.0])],
    });
    std::fs::write(&file, said.to_string()).unwrap();
    let import = |folder: &Path, author: &str| {
        let log = street.path(&format!("{author}.mcap"));
        let import = [
            "annotate",
            "--map",
            text(&map),
            "--author",
            author,
            "--out",
            text(&log),
        ];
        evermap(
            &[
                &import[..],
                &["--import", text(&file), "--images", text(folder)],
            ]
            .concat(),
        )
    };
    // Boxes of something else say nothing, not even that there is no person: the one that is gone says so.
    let other = said.to_string().replace("Person", "pedestrian");
    std::fs::write(&file, other).unwrap();
    let ended = import(&folder, "eve").expect(3);
    for told in [
        "eve.mcap: 1 rejected",
        "box of something else than a person",
    ] {
        assert!(ended.stderr.contains(told), "{told}: {}", ended.stderr);
    }
    std::fs::write(&file, said.to_string()).unwrap();
    let ended = import(&folder, "ada").expect(0);
    let told = "ada.mcap: 1 accepted, 1 drawn, 1 rejected";
    assert!(ended.stderr.contains(told), "{}", ended.stderr);
    let again = import(&folder, "ada").expect(0);
    let told = "nothing new to say, 3 as they were";
    assert!(again.stderr.contains(told), "{}", again.stderr);

    let ended = street.run(&["--sessions", text(&street.path("ada.mcap"))]);
    assert!([0, 3].contains(&ended.code), "{}", ended.stderr);
    let tied = "SELECT l.standing, p.nth, l.anchor['vehicle_from_label']['x'] AS x, l.anchor['vehicle_from_label']['y'] AS y
                FROM placed_labels l
                JOIN (SELECT *, row_number() OVER (ORDER BY stamp) AS nth FROM pictures) p
                  ON p.session = l.anchor['session'] AND p.stamp = l.anchor['stamp'] AND p.camera = l.anchor['camera']
                WHERE l.kind = 'person' ORDER BY l.standing";
    let tied = rows_of(&map, tied);
    let found: Vec<(&str, i64)> = tied
        .as_array()
        .unwrap()
        .iter()
        .map(|row| {
            (
                row["standing"].as_str().unwrap(),
                row["nth"].as_i64().unwrap(),
            )
        })
        .collect();
    assert_eq!(found, [("accepted", 1), ("drawn", 1), ("rejected", 2)]);
    for (row, [x, y], within_m) in [
        (0_usize, [3.0, 0.5], 1e-3),
        (1, [5.0, 0.0], 1.5),
        (2, [3.0, 0.5], 1e-3),
    ] {
        let off_m =
            |name: &str, expected: f64| (tied[row][name].as_f64().unwrap() - expected).abs();
        assert!(
            off_m("x", x) <= within_m && off_m("y", y) <= within_m,
            "{tied}"
        );
    }
    // In the version that has them they are the same labels, also who was rejected.
    let again = import(&folder, "bob").expect(0);
    assert!(again.stderr.contains(told), "{}", again.stderr);

    let refused = import(&map, "bob").expect(1);
    let told = "expected a folder of camera images, found";
    assert!(refused.stderr.contains(told), "{}", refused.stderr);
    std::fs::write(
        &file,
        said.to_string()
            .replace(names[0], "a.png")
            .replace(names[1], "b.png"),
    )
    .unwrap();
    let refused = import(&folder, "bob").expect(1);
    let told =
        "expected annotations of the images of the folder, found those of `upload/3f2a1b4c-a.png`";
    assert!(refused.stderr.contains(told), "{}", refused.stderr);

    // Without the log there are no images, and that is counted.
    std::fs::remove_file(street.log()).unwrap();
    let lost = evermap(&export).expect(3);
    assert!(
        lost.stderr.contains("image that cannot be read"),
        "{}",
        lost.stderr
    );
}

/// What is said of an image that there is not is refused, and where a log has it all the same, a run counts it.
#[test]
fn answers_about_an_image_that_is_not_there_are_refused_or_counted() {
    let street = AskedStreet::new();
    let map = street.map();
    let first =
        "SELECT CAST(stamp AS BIGINT) AS stamp, camera FROM pictures ORDER BY stamp LIMIT 1";
    let first = rows_of(&map, first)[0].clone();
    let (file, log) = (street.path("person.json"), street.path("ada.mcap"));
    let import_with = |name: &str, image: Value| {
        let mut person = collection(&[(name, space(5.0, 0.0))]);
        person["features"][0]["properties"] = json!({ "kind": "person", "image": image });
        std::fs::write(&file, person.to_string()).unwrap();
        let (map, file, log) = (text(&map), text(&file), text(&log));
        let import = ["annotate", "--map", map, "--author", "ada"];
        evermap(&[&import[..], &["--import", file, "--out", log]].concat())
    };
    let image =
        |camera: &Value| json!({ "session": "visit_a", "stamp": first["stamp"], "camera": camera });
    let import = |camera: &Value| import_with("nobody", image(camera));
    let refused = import(&"no_camera".into()).expect(3);
    let told = "feature of an image that the map does not have";
    assert!(refused.stderr.contains(told), "{}", refused.stderr);
    assert!(!log.exists());
    let taken = import(&first["camera"]).expect(0);
    assert!(taken.stderr.contains("1 drawn"), "{}", taken.stderr);

    let other = street.path("bob.mcap");
    let mut act = drawn("nobody", 3.0, 0.0);
    act.kind = "person".into();
    act.anchor = Some(Anchor {
        session: "visit_a".into(),
        stamp_ns: 7,
        camera: Some("no_camera".into()),
        vehicle_from_label: [3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    });
    say(&other, &[act]);
    let (plan, answered) = (street.path("answered.yaml"), street.path("answered"));
    std::fs::write(&plan, ANSWERED).unwrap();
    let mut run = vec!["run", text(&plan), "--map", text(&answered)];
    run.extend(["--site", "street", "--progress", "none", "--sessions"]);
    let drive = street.log();
    run.extend([text(&drive), text(&other)]);
    let run = evermap(&run).expect(3);
    let told = "1  label of an image that the map does not have";
    assert!(run.stderr.contains(told), "{}", run.stderr);

    // Which images there are is read for who names one.
    let version = std::fs::read(map.join("versions/1.json")).unwrap();
    let version: Value = serde_json::from_slice(&version).unwrap();
    let content = &version["layers"]["pictures"]["artifacts"][0]["content"];
    let content = content.as_str().unwrap();
    std::fs::remove_file(map.join(format!("artifacts/{content}.parquet"))).unwrap();
    let taken = import_with("somebody", Value::Null).expect(0);
    assert!(taken.stderr.contains("1 drawn"), "{}", taken.stderr);
    let refused = import_with("a third one", image(&first["camera"])).expect(1);
    assert!(refused.stderr.contains(content), "{}", refused.stderr);
}

/// Examples of people as the plan `people` has them, of all images of a log.
const ANSWERED: &str = "\
plan: answered
steps:
  cameras: { sql: SELECT * FROM calibration }
  mounts: { sql: SELECT * FROM transforms WHERE fixed }
  labels:
    sql: SELECT site, id AS label, kind, act AS standing, stamp AS said, anchor FROM annotations
  answered_images:
    sql: >
      SELECT said.site, said.session, said.stamp, said.camera, f.image
      FROM (SELECT DISTINCT site, anchor['session'] AS session, anchor['stamp'] AS stamp, anchor['camera'] AS camera
            FROM labels WHERE kind = 'person' AND anchor['camera'] IS NOT NULL) said
      LEFT JOIN frames f
        ON f.site = said.site AND f.session = said.session AND f.stamp = said.stamp AND f.camera = said.camera
  person_examples:
    op: person_examples
    in: { images: answered_images, labels: labels, calibration: cameras, transforms: mounts }
write: [person_examples]
";
