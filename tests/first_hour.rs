//! The first hour: of an engineer with logs of one's own, where nothing would come out; of an analyst, who has other
//! programs and compares versions; of a developer, whose query is not the same twice.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use evermap_tests::{Finished, evermap, rectangle, text, write_drive};

/// A log with some topics and message types, without messages.
fn write_topics(path: &Path, topics: &[(&str, &str)]) {
    let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
    for (topic, schema) in topics {
        let schema = writer.add_schema(schema, "jsonschema", b"{}").unwrap();
        writer
            .add_channel(schema, topic, "json", &Default::default())
            .unwrap();
    }
    writer.finish().unwrap();
}

fn run(plan: &str, map: &Path, sessions: &[&Path], more: &[&str]) -> Finished {
    let mut arguments = vec![
        "run",
        plan,
        "--map",
        text(map),
        "--progress",
        "none",
        "--sessions",
    ];
    arguments.extend(sessions.iter().map(|path| text(path)));
    arguments.extend(more);
    evermap(&arguments)
}

#[test]
fn a_log_of_which_a_plan_makes_nothing_is_refused_alone_and_counted_among_others() {
    let folder = tempfile::tempdir().unwrap();
    let (blind, drive) = (
        folder.path().join("blind.mcap"),
        folder.path().join("drive.mcap"),
    );
    write_topics(
        &blind,
        &[
            ("/front", "sensor_msgs/Image"),
            ("/goal", "geometry_msgs/PoseStamped"),
        ],
    );
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    let map = folder.path().join("map");

    let refused = run("trajectory", &map, &[&blind], &[]).expect(1).stderr;
    for said in [
        "makes nothing of session blind",
        "odometry (step keyframes)",
        "/front (sensor_msgs/Image)",
        "nav_msgs/Odometry",
    ] {
        assert!(refused.contains(said), "{said}: {refused}");
    }
    assert!(!map.join("versions").exists());
    let checked = evermap(&["check", "trajectory", "--sessions", text(&blind)])
        .expect(1)
        .stderr;
    assert!(checked.contains("odometry (step keyframes)"), "{checked}");

    let counted = run("trajectory", &map, &[&drive, &blind], &[])
        .expect(3)
        .stderr;
    assert!(
        counted.contains("session without odometry (step keyframes): blind"),
        "{counted}"
    );
    let warned = [
        "check",
        "trajectory",
        "--sessions",
        text(&drive),
        text(&blind),
    ];
    let warned = evermap(&warned).expect(0).stderr;
    assert!(warned.contains("nothing of session blind"), "{warned}");
}

#[test]
fn inspect_says_which_topic_plays_which_role_and_which_plans_can_run() {
    let folder = tempfile::tempdir().unwrap();
    let drive = folder.path().join("drive.mcap");
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    let said = evermap(&["inspect", text(&drive)]).expect(0).stdout;
    for line in [
        "  odometry     /odom",
        "  trajectory   can run on this file",
        "  relocate     lacks label_frames (step label_images)",
    ] {
        assert!(said.contains(line), "{line}: {said}");
    }
    let json = evermap(&["inspect", "--json", text(&drive)])
        .expect(0)
        .json();
    let plans = json["plans"].as_array().unwrap().iter();
    let lacks =
        |name: &str| plans.clone().find(|plan| plan["plan"] == name).unwrap()["lacks"].clone();
    assert!(lacks("trajectory").is_null());
    assert_eq!(lacks("relocate")["label_frames"], "label_images");
}

#[test]
fn a_log_of_the_same_name_takes_no_place_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let logs = ["monday", "tuesday"].map(|day| {
        std::fs::create_dir(folder.path().join(day)).unwrap();
        folder.path().join(day).join("drive.mcap")
    });
    write_drive(&logs[0], rectangle(30.0, 20.0, 1.0));
    write_drive(&logs[1], rectangle(40.0, 20.0, 1.0));
    let map = folder.path().join("map");
    run("trajectory", &map, &[&logs[0]], &[]).expect(0);
    let refused = run("trajectory", &map, &[&logs[1]], &[]).expect(1).stderr;
    for said in [
        "session drive of another log",
        "monday",
        "tuesday",
        "--replace",
    ] {
        assert!(refused.contains(said), "{said}: {refused}");
    }
    run("trajectory", &map, &[&logs[1]], &["--replace"]).expect(0);
    // The same drive, elsewhere, is the same session; a log that has changed where it lies is taken anew.
    let moved = folder.path().join("drive.mcap");
    std::fs::copy(&logs[1], &moved).unwrap();
    let same = run("trajectory", &map, &[&moved], &[]).expect(0).stderr;
    assert!(same.contains("0 units computed"), "{same}");
    write_drive(&moved, rectangle(50.0, 20.0, 1.0));
    run("trajectory", &map, &[&moved], &[]).expect(0);
}

#[test]
fn a_run_without_any_row_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let silent = folder.path().join("silent.mcap");
    write_topics(&silent, &[("/odom", "nav_msgs/Odometry")]);
    let map = folder.path().join("map");
    let said = run("trajectory", &map, &[&silent], &[]).expect(3).stderr;
    assert!(said.contains("no layer has rows"), "{said}");
}

#[test]
fn versions_are_read_side_by_side_and_files_by_other_programs() {
    let folder = tempfile::tempdir().unwrap();
    let logs = ["monday", "tuesday"].map(|day| folder.path().join(format!("{day}.mcap")));
    let map = folder.path().join("map");
    for log in &logs {
        write_drive(log, rectangle(30.0, 20.0, 1.0));
        run("trajectory", &map, &[log], &[]).expect(0);
    }
    let ask = |query: &str| evermap(&["sql", "--map", text(&map), "--format", "csv", query]);
    let query = "SELECT count(*) FROM v2.poses n LEFT ANTI JOIN v1.poses o ON n.session = o.session AND n.stamp = o.stamp";
    let added = ask(query).expect(0).stdout;
    let tuesday = ask("SELECT count(*) FROM poses WHERE session = 'tuesday'")
        .expect(0)
        .stdout;
    assert_eq!(added.lines().nth(1), tuesday.lines().nth(1));
    let unknown = ask("SELECT * FROM v9.poses").expect(1).stderr;
    assert!(unknown.contains("version 9"), "{unknown}");

    let files = ["layers", "--map", text(&map), "--files", "--format", "json"];
    let files = evermap(&files).expect(0).json();
    let files = files.as_array().unwrap();
    assert!(files.len() >= 6);
    for file in files {
        let bytes = std::fs::metadata(file["file"].as_str().unwrap())
            .unwrap()
            .len();
        assert_eq!(bytes, file["bytes"].as_u64().unwrap());
    }
    let views = evermap(&["layers", "--map", text(&map), "--duckdb"])
        .expect(0)
        .stdout;
    assert_eq!(
        views.matches("CREATE OR REPLACE VIEW").count(),
        3,
        "{views}"
    );
    assert!(
        files
            .iter()
            .all(|file| views.contains(file["file"].as_str().unwrap()))
    );
}

#[test]
fn a_plan_whose_query_is_not_the_same_twice_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.yaml");
    let written = "plan: dice\nsteps:\n  some: { sql: SELECT * FROM odometry ORDER BY random() LIMIT 3 }\nwrite: [some]\n";
    std::fs::write(&plan, written).unwrap();
    let refused = evermap(&["check", text(&plan)]).expect(1).stderr;
    assert!(refused.contains("calls random"), "{refused}");
    assert!(refused.contains("plan.yaml:3"), "{refused}");
}

#[test]
fn queries_that_cannot_be_answered_say_what_was_meant() {
    let folder = tempfile::tempdir().unwrap();
    let drive = folder.path().join("drive.mcap");
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    let map = folder.path().join("map");
    run("trajectory", &map, &[&drive], &[]).expect(0);
    for (query, said) in [
        (
            "SELECT * FROM pose",
            "error: user: there is no table `pose`; did you mean `poses`?; there are `intersections`, `lanes`",
        ),
        (
            "SELECT stmp FROM poses",
            "error: user: No field named stmp. Did you mean 'poses.stamp'?",
        ),
        ("SELECT 1 / 0", "error: user: Divide by zero"),
        (
            "SELECT * FROM v1.pose",
            "there is no table `datafusion.v1.pose`",
        ),
    ] {
        let told = evermap(&["sql", "--map", text(&map), query])
            .expect(1)
            .stderr;
        assert!(told.contains(said), "{query}: {told}");
    }
}
