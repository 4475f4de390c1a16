//! When messages were sent, however their stamps are spelled, and where a clock begins at zero.

use std::path::Path;

use evermap_tests::json_log::JsonLog;
use evermap_tests::{Finished, evermap, text};
use serde_json::{Value, json};

/// The log time of the first message, ns; the others follow a second apart.
const LOGGED: u64 = 1_700_000_000_000_000_000;

fn object(members: Value) -> Value {
    json!({"type": "object", "properties": members})
}

/// The type of a header whose stamp has members that are called so.
fn header([seconds, nanoseconds]: [&str; 2]) -> Value {
    let stamp = object(json!({seconds: {"type": "integer"}, nanoseconds: {"type": "integer"}}));
    object(json!({"stamp": stamp, "frame_id": {"type": "string"}}))
}

/// Writes a log of odometry whose messages have these stamps, of members that are called so.
fn write(path: &Path, parts: [&str; 2], stamps: &[Value]) {
    let mut log = JsonLog::new(path);
    write_odometry(&mut log, parts, stamps);
    log.finish();
}

fn write_odometry(log: &mut JsonLog, parts: [&str; 2], stamps: &[Value]) {
    let number = json!({"type": "number"});
    let position = object(json!({"x": number, "y": number, "z": number}));
    let orientation = object(json!({"x": number, "y": number, "z": number, "w": number}));
    let pose = object(json!({"position": position, "orientation": orientation}));
    let members = json!({
        "header": header(parts),
        "pose": object(json!({"pose": pose})),
    });
    let odometry = log.topic_of("/odom", "nav_msgs/Odometry", &members);
    for (second, stamp) in (0_u64..).zip(stamps) {
        let position = json!({"x": second as f64, "y": 0.0, "z": 0.0});
        let orientation = json!({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0});
        let message = json!({
            "header": {"stamp": stamp, "frame_id": "odom"},
            "pose": {"pose": {"position": position, "orientation": orientation}},
        });
        log.send(odometry, 0, LOGGED + second * 1_000_000_000, &message);
    }
}

/// GPS time is 18 s ahead of the clock that odometry has.
#[test]
fn a_clock_that_differs_from_that_of_odometry_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    let parts = ["sec", "nanosec"];
    let said = |ahead: u64| {
        let stamp = |sec: u64| json!({"sec": LOGGED / 1_000_000_000 + sec, "nanosec": 0});
        let stamps: Vec<Value> = (0..20).map(stamp).collect();
        let mut written = JsonLog::new(&log);
        write_odometry(&mut written, parts, &stamps);
        let number = json!({"type": "number"});
        let members = json!({
            "header": header(parts), "status": object(json!({"status": number})),
            "latitude": number, "longitude": number, "altitude": number,
        });
        let fixes = written.topic_of("/fix", "sensor_msgs/NavSatFix", &members);
        for sec in 0..20 {
            let header = json!({"stamp": stamp(sec + ahead), "frame_id": "gps"});
            let message = json!({"header": header, "status": {"status": 0}, "latitude": 48.0, "longitude": 9.0, "altitude": 0.0});
            written.send(
                fixes,
                0,
                LOGGED + sec * 1_000_000_000 + 200_000_000,
                &message,
            );
        }
        written.finish();
        evermap(&["inspect", text(&log)]).expect(0).stdout
    };
    let told = "expected stamps of one clock, found those of /fix ";
    let inspected = said(18);
    let whole = format!("{told}17.8 s ahead of those of /odom by when messages were logged");
    assert!(inspected.contains(&whole), "{inspected}");
    assert!(!said(0).contains(told));
}

/// The stamps of odometry, ns, in the order of its path.
fn stamps(log: &Path) -> Finished {
    let sql = "SELECT CAST(stamp AS BIGINT) AS stamp FROM odometry ORDER BY odom_from_vehicle['x']";
    evermap(&[
        "sql",
        "--sessions",
        text(log),
        "--format",
        "json",
        "--query",
        sql,
    ])
}

fn rows(stamps: &[u64]) -> Value {
    stamps.iter().map(|stamp| json!({"stamp": stamp})).collect()
}

#[test]
fn json_stamps_are_read_however_they_are_spelled_or_counted() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    for [seconds, nanoseconds] in [["sec", "nanosec"], ["secs", "nsecs"], ["sec", "nsec"]] {
        let stamp = |sec: u64| json!({seconds: sec, nanoseconds: 7});
        write(&log, [seconds, nanoseconds], &[stamp(5), stamp(6)]);
        let found = stamps(&log).expect(0).json();
        assert_eq!(
            found,
            rows(&[5_000_000_007, 6_000_000_007]),
            "{seconds} {nanoseconds}"
        );
    }
    write(&log, ["secs", "ns"], &[json!({"secs": 5, "ns": 7})]);
    let found = stamps(&log).expect(3);
    assert_eq!(found.json(), json!([]));
    let said = "at header.stamp, found secs, ns";
    assert!(found.stderr.contains(said), "{}", found.stderr);
}

#[test]
fn zero_is_the_first_instant_of_a_clock_that_begins_there() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    let seconds = |seconds: &[u64]| {
        let stamps = seconds.iter().map(|sec| json!({"sec": sec, "nanosec": 0}));
        write(&log, ["sec", "nanosec"], &stamps.collect::<Vec<_>>());
        stamps_of(&log)
    };
    let second = 1_000_000_000;
    assert_eq!(seconds(&[0, 1, 2]), (0, rows(&[0, second, 2 * second])));
    // Senders without a clock.
    assert_eq!(seconds(&[0, 0]), (0, rows(&[LOGGED, LOGGED + second])));
    // One that did not know the time at first.
    let later = [1_700_000_001, 1_700_000_002];
    let expected = rows(&later.map(|later| later * second));
    assert_eq!(seconds(&[0, later[0], later[1]]), (3, expected));
}

/// The exit code, and what is found.
fn stamps_of(log: &Path) -> (i32, Value) {
    let found = stamps(log);
    (found.code, found.json())
}
