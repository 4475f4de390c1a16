//! Maps in the formats of other programs, read by these programs' own readers.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use evermap_tests::recording::is_read_as_the_map_says;
use evermap_tests::server::map;
use evermap_tests::{evermap, text};

#[test]
fn a_recording_has_what_the_map_says() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(folder.path());
    is_read_as_the_map_says(&map, folder.path());

    // A recording is a log again.
    let out = folder.path().join("recording.mcap");
    let count = "SELECT count(*) AS n FROM transforms WHERE parent = 'map'";
    let sessions = ["sql", "--sessions", text(&out), "--format", "json", count];
    let found = evermap(&sessions).expect(0).json();
    let poses = [
        "sql",
        "--map",
        text(&map),
        "--format",
        "json",
        "SELECT count(*) AS n FROM poses",
    ];
    assert_eq!(found, evermap(&poses).expect(0).json());

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
    let topics = [
        "sql",
        "--sessions",
        text(&monday),
        "--format",
        "json",
        topics,
    ];
    let found = evermap(&topics).expect(0).json();
    assert_eq!(
        found,
        serde_json::json!([{ "topic": "/trajectory/monday" }])
    );
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
