//! What people say about a map: logs like any other, and labels that stay where they belong in every version.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};

use evermap_messages::annotation::{Annotation, Geometry};
use evermap_recording::annotations::AnnotationLog;
use evermap_tests::{DrivePose, Finished, evermap, text, write_drive};
use serde_json::Value;

/// A straight drive at 2 m/s whose odometry measures a metre as so many.
fn straight(scale: f64) -> Vec<DrivePose> {
    let pose = |step: u32| {
        let seconds = f64::from(step) * 0.1;
        (seconds, 2.0 * seconds * scale, 0.0, 0.0)
    };
    (0..=150).map(pose).collect()
}

/// A folder with a map in it of one drive, `a`.
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

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, sessions: &[&str]) -> Finished {
        let map = self.path("map");
        let mut arguments = vec!["run", "labels", "--map", text(&map), "--site", "lot"];
        arguments.extend(["--progress", "none", "--sessions"]);
        let sessions: Vec<PathBuf> = sessions.iter().map(|name| self.path(name)).collect();
        arguments.extend(sessions.iter().map(|path| text(path)));
        evermap(&arguments)
    }

    fn ask(&self, query: &str) -> Value {
        let map = self.path("map");
        let asked = ["sql", "--map", text(&map), "--format", "json", query];
        evermap(&asked).expect(0).json()
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
    }
}

fn say(path: &Path, acts: &[Annotation]) {
    let mut log = AnnotationLog::begin(path, "a test").unwrap();
    acts.iter().for_each(|act| log.say(act).unwrap());
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
    // Nothing is done twice.
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
}
