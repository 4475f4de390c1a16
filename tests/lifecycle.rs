//! A map over time: sessions join, what is unchanged is kept, a killed run leaves nothing half done.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use evermap_tests::{command, evermap, rectangle, text, write_drive};
use serde_json::Value;

const PLAN: &str = "trajectory";

/// The digests of a map's layers, by name.
fn digests(map: &Path) -> Vec<(String, String)> {
    let layers = evermap(&["layers", "--map", text(map), "--format", "json"])
        .expect(0)
        .json();
    let digest = |layer: &Value| {
        (
            layer["layer"].as_str().unwrap().to_owned(),
            layer["digest"].as_str().unwrap().to_owned(),
        )
    };
    layers.as_array().unwrap().iter().map(digest).collect()
}

fn run(map: &Path, sessions: &[&Path]) -> evermap_tests::Finished {
    let mut arguments = vec![
        "run",
        PLAN,
        "--map",
        text(map),
        "--progress",
        "none",
        "--sessions",
    ];
    arguments.extend(sessions.iter().map(|path| text(path)));
    evermap(&arguments)
}

fn query(map: &Path, sql: &str) -> Value {
    evermap(&["sql", "--map", text(map), "--format", "json", sql])
        .expect(0)
        .json()
}

#[test]
fn a_second_session_recomputes_only_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b, map) = (
        folder.path().join("a.mcap"),
        folder.path().join("b.mcap"),
        folder.path().join("map"),
    );
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    write_drive(&b, rectangle(30.0, 15.0, 1.5));
    run(&map, &[&a]).expect(0);

    let explained = evermap(&[
        "explain",
        PLAN,
        "--map",
        text(&map),
        "--sessions",
        text(&b),
        "--format",
        "json",
    ]);
    for unit in explained.expect(0).json().as_array().unwrap() {
        let of_b = unit["unit"].as_str().unwrap().ends_with(" of b");
        assert_eq!(unit["recompute"], Value::Bool(of_b), "{unit}");
    }

    run(&map, &[&b]).expect(0);
    let computed = query(
        &map,
        "SELECT DISTINCT coalesce(session, site) AS of FROM runs WHERE version = 2 AND NOT cached",
    );
    assert_eq!(computed, serde_json::json!([{ "of": "b" }]));
    let sessions = query(&map, "SELECT DISTINCT session FROM poses ORDER BY session");
    assert_eq!(
        sessions,
        serde_json::json!([{ "session": "a" }, { "session": "b" }])
    );
}

#[test]
fn a_run_that_changes_nothing_publishes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (a, map) = (folder.path().join("a.mcap"), folder.path().join("map"));
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    run(&map, &[&a]).expect(0);
    let before = digests(&map);
    run(&map, &[&a]).expect(0);
    assert_eq!(digests(&map), before);
    let versions = query(&map, "SELECT version FROM versions");
    assert_eq!(versions.as_array().unwrap().len(), 1);
}

#[test]
fn a_parameter_recomputes_what_depends_on_it_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let (a, map) = (folder.path().join("a.mcap"), folder.path().join("map"));
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    run(&map, &[&a]).expect(0);
    let setting = ["--set", "lanes.connect_m=1.5"];
    let mut explain = vec![
        "explain",
        PLAN,
        "--map",
        text(&map),
        "--sessions",
        text(&a),
        "--format",
        "json",
    ];
    explain.extend(setting);
    let units = evermap(&explain).expect(0).json();
    let recomputed: Vec<_> = units
        .as_array()
        .unwrap()
        .iter()
        .filter(|unit| unit["recompute"] == true)
        .collect();
    assert!(
        recomputed
            .iter()
            .all(|unit| unit["step"] == "lanes" || unit["step"] == "intersections"),
        "{units}"
    );
    assert!(
        recomputed.iter().any(|unit| unit["why"]
            .as_str()
            .unwrap()
            .contains("connect_m was 2.0, is 1.5")),
        "{units}"
    );
}

#[test]
fn a_killed_run_resumes_to_the_same_map() {
    let folder = tempfile::tempdir().unwrap();
    let sessions: Vec<_> = (0..12)
        .map(|index| folder.path().join(format!("drive_{index:02}.mcap")))
        .collect();
    for (index, session) in sessions.iter().enumerate() {
        write_drive(session, rectangle(40.0 + index as f64, 30.0, 3.0));
    }
    let sessions: Vec<&Path> = sessions.iter().map(|path| path.as_path()).collect();
    let undisturbed = folder.path().join("undisturbed");
    run(&undisturbed, &sessions).expect(0);

    let killed = folder.path().join("killed");
    let mut arguments = vec![
        "run",
        PLAN,
        "--map",
        text(&killed),
        "--progress",
        "none",
        "--sessions",
    ];
    arguments.extend(sessions.iter().map(|path| text(path)));
    let mut deaths = 0;
    for milliseconds in [60, 110, 170, 240, 320, 410] {
        let mut child = command(&arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("evermap starts");
        std::thread::sleep(Duration::from_millis(milliseconds));
        child.kill().expect("a process can be killed");
        deaths += i32::from(!child.wait().unwrap().success());
        whole_or_nothing(&killed, sessions.len());
    }
    assert!(deaths > 0, "every run was faster than its killer");
    run(&killed, &sessions).expect(0);
    assert_eq!(digests(&killed), digests(&undisturbed));
}

/// A reader sees no version at all, or one with every session in every layer.
fn whole_or_nothing(map: &Path, sessions: usize) {
    if !map.join("versions/1.json").exists() {
        return;
    }
    let counted = query(map, "SELECT count(DISTINCT session) AS n FROM poses");
    assert_eq!(counted[0]["n"], sessions);
    query(map, "SELECT count(*) FROM lanes");
}

#[test]
fn versions_stay_readable_differ_and_are_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b, map) = (
        folder.path().join("a.mcap"),
        folder.path().join("b.mcap"),
        folder.path().join("map"),
    );
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    write_drive(&b, rectangle(30.0, 15.0, 1.0));
    run(&map, &[&a]).expect(0);
    run(&map, &[&b]).expect(0);
    let first = evermap(&[
        "sql",
        "--map",
        text(&map),
        "--version",
        "1",
        "--format",
        "json",
        "SELECT DISTINCT session FROM poses",
    ]);
    assert_eq!(
        first.expect(0).json(),
        serde_json::json!([{ "session": "a" }])
    );

    let diff = evermap(&["diff", "1", "2", "--map", text(&map), "--format", "json"])
        .expect(0)
        .json();
    let poses = diff
        .as_array()
        .unwrap()
        .iter()
        .find(|layer| layer["layer"] == "poses")
        .unwrap();
    assert_eq!(
        (&poses["removed"], &poses["changed"]),
        (&Value::from(0), &Value::from(0)),
        "{diff}"
    );
    assert!(
        poses["added"].as_u64().unwrap() > 100 && poses["same"].as_u64().unwrap() > 100,
        "{diff}"
    );

    evermap(&["gc", "--map", text(&map), "--keep", "1"]).expect(0);
    evermap(&["sql", "--map", text(&map), "--version", "1", "SELECT 1"]).expect(1);
    assert_eq!(
        query(&map, "SELECT count(DISTINCT session) AS n FROM poses"),
        serde_json::json!([{ "n": 2 }])
    );
}

#[test]
fn a_torn_log_is_mapped_as_far_as_it_is_sound_and_the_loss_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (a, map) = (folder.path().join("a.mcap"), folder.path().join("map"));
    write_drive(&a, rectangle(200.0, 100.0, 10.0));
    let bytes = std::fs::read(&a).unwrap();
    std::fs::write(&a, &bytes[..bytes.len() / 2]).unwrap();
    let told = run(&map, &[&a]).expect(3);
    assert!(
        told.stderr.contains("lost") || told.stderr.contains("loss"),
        "{}",
        told.stderr
    );
    let poses = query(&map, "SELECT count(*) AS n FROM poses");
    assert!(poses[0]["n"].as_u64().unwrap() > 100, "{poses}");
}

#[test]
fn a_plan_reads_the_version_before() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let (plan, map) = (folder.path().join("growth.yaml"), folder.path().join("map"));
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    write_drive(&b, rectangle(30.0, 15.0, 1.0));
    let lines = [
        "plan: growth",
        "steps:",
        "  keyframes: { op: keyframes, in: { odometry: odometry } }",
        "  growth:",
        "    sql: >",
        "      SELECT (SELECT count(*) FROM keyframes) AS now, (SELECT count(*) FROM previous.keyframes) AS before",
        "write: [keyframes, growth]",
    ];
    std::fs::write(&plan, lines.join("\n")).unwrap();
    let run = |session: &Path| {
        evermap(&[
            "run",
            text(&plan),
            "--map",
            text(&map),
            "--progress",
            "none",
            "--sessions",
            text(session),
        ])
    };
    run(&a).expect(0);
    let first = query(&map, "SELECT now, before FROM growth");
    assert_eq!(first[0]["before"], 0);
    run(&b).expect(0);
    let second = query(&map, "SELECT now, before FROM growth");
    assert_eq!(second[0]["before"], first[0]["now"]);
    assert!(
        second[0]["now"].as_u64() > second[0]["before"].as_u64(),
        "{second}"
    );
}

#[test]
fn a_query_that_is_none_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("write.yaml");
    let lines = [
        "plan: write",
        "steps:",
        "  t: { sql: CREATE TABLE x AS SELECT 1 }",
        "write: [t]",
    ];
    std::fs::write(&plan, lines.join("\n")).unwrap();
    evermap(&["check", text(&plan)]).expect(1);
}
