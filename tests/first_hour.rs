//! The first hour: of an engineer with logs of one's own, where nothing would come out; of an analyst, who has other
//! programs and compares versions; of a developer, whose query is not the same twice.

use std::path::Path;

use evermap_tests::json_log::JsonLog;
use evermap_tests::{evermap, rectangle, rows_of, run, text, write_drive, write_nothing};
use serde_json::json;

/// A log with some topics and message types, without messages.
fn write_topics(path: &Path, topics: &[(&str, &str)]) {
    write_log(path, topics, 0);
}

/// A log with some topics and message types, with so many messages each that say nothing.
fn write_log(path: &Path, topics: &[(&str, &str)], messages: u32) {
    let mut log = JsonLog::new(path);
    for (topic, schema) in topics {
        let topic = log.topic_of(topic, schema, &json!({"header": {"type": "object"}}));
        for sequence in 0..messages {
            log.send(topic, sequence, 1, &json!({}));
        }
    }
    log.finish();
}

const PICTURES: (&str, &str) = ("/front/image", "sensor_msgs/Image");
const LABELS: (&str, &str) = ("/front/labels", "sensor_msgs/Image");
const DEPTH: (&str, &str) = ("/front/depth", "sensor_msgs/Image");
const CALIBRATION: (&str, &str) = ("/front/camera_info", "sensor_msgs/CameraInfo");
const FIXES: (&str, &str) = ("/fix", "sensor_msgs/NavSatFix");

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
        "cannot use session blind",
        "odometry (step inertial_odometry)",
        "/front (sensor_msgs/Image)",
        "nav_msgs/Odometry",
    ] {
        assert!(refused.contains(said), "{said}: {refused}");
    }
    assert!(!map.join("versions").exists());
    let checked = evermap(&["check", "trajectory", "--sessions", text(&blind)])
        .expect(1)
        .stderr;
    assert!(
        checked.contains("odometry (step inertial_odometry)"),
        "{checked}"
    );

    let counted = run("trajectory", &map, &[&drive, &blind], &[])
        .expect(3)
        .stderr;
    assert!(
        counted.contains("session without odometry (step inertial_odometry): blind"),
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
    assert!(warned.contains("cannot use session blind"), "{warned}");
}

#[test]
fn a_drive_without_cameras_is_no_part_of_a_metric_map() {
    let folder = tempfile::tempdir().unwrap();
    let (drive, map) = (folder.path().join("drive.mcap"), folder.path().join("map"));
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    let lacks = "calibration (step cameras), frames (step keyframes), transforms (step mounts)";
    let refused = run("lifelong", &map, &[&drive], &[]).expect(1).stderr;
    let said = format!("cannot use session drive: expected {lacks}, found topics /odom");
    assert!(refused.contains(&said), "{refused}");
    assert!(!map.join("versions").exists());
    let inspected = evermap(&["inspect", text(&drive)]).expect(0).stdout;
    assert!(
        inspected.contains(&format!("lifelong     lacks {lacks}")),
        "{inspected}"
    );
    // The floor, who walks on it and how fast to drive there are seen, too.
    for plan in ["parking", "people", "speed", "car_park"] {
        let refused = run(plan, &map, &[&drive], &[]).expect(1).stderr;
        assert!(refused.contains(&said), "{plan}: {refused}");
    }
    assert!(!map.join("versions").exists());
    // Labels need no camera. What is empty without is said.
    let labels = run("labels", &folder.path().join("labels"), &[&drive], &[]).expect(0);
    for said in [
        "annotations (step said), calibration (step cameras), transforms (step mounts): what the plan makes of it is empty",
        "no session has frames (step keyframes)",
        "\nnote: layers without rows: ",
        "placed_labels, said\n",
    ] {
        assert!(labels.stderr.contains(said), "{said}: {}", labels.stderr);
    }
    // Where it is on earth is asked of no session, and of the run.
    let refused = run("georeference", &map, &[&drive], &[]).expect(1).stderr;
    let said = "expected gnss_fixes (step antenna_positions)";
    assert!(refused.contains(said), "{refused}");
    // One's own plan may be content with less.
    let plan = folder.path().join("roads.yaml");
    std::fs::write(&plan, "plan: roads\nextends: georeference\nneeds: []\n").unwrap();
    run(text(&plan), &map, &[&drive], &[]).expect(0);
}

#[test]
fn a_plan_that_reads_nothing_of_a_session_says_so_and_what_any_log_has_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let drive = at("drive.mcap");
    write_topics(&drive, &[CALIBRATION]);
    let said_of = |name: &str, query: &str| {
        let plan = at(&format!("{name}.yaml"));
        let text_of =
            format!("plan: {name}\nsteps: {{ {name}: {{ sql: \"{query}\" }} }}\nwrite: [{name}]\n");
        std::fs::write(&plan, text_of).unwrap();
        run(text(&plan), &at(name), &[&drive], &[])
    };
    let refused = said_of("one", "SELECT 1 AS n").expect(1).stderr;
    let said = "the plan cannot use any session: expected a step that reads a role or a topic of sessions, found none";
    assert!(refused.contains(said), "{refused}");
    said_of("topics", "SELECT session, topic FROM channels").expect(0);
    // What each refusal says next does not lead to the other one.
    let alone = |map: &str| {
        let (plan, map) = (at("one.yaml"), at(map));
        evermap(&["run", text(&plan), "--map", text(&map)])
    };
    let next = "without --sessions the plan runs on a map that has sessions";
    assert!(refused.contains(next), "{refused}");
    alone("topics").expect(0);
    let refused = alone("new").expect(1).stderr;
    let next = "of which a step of the plan reads a role or a topic";
    assert!(refused.contains(next), "{refused}");
    // It has none, which is said and no refusal.
    let empty = said_of("classes", "SELECT * FROM label_classes").expect(3);
    assert!(
        empty.stderr.contains("no layer has rows"),
        "{}",
        empty.stderr
    );
}

#[test]
fn a_session_without_the_one_role_that_a_plan_needs_is_counted_among_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let whole = at("monday.mcap");
    write_log(&whole, &[PICTURES, LABELS, DEPTH], 1);
    let cases = [
        (
            "stable_map",
            [PICTURES, DEPTH],
            "label_frames (step label_images)",
        ),
        ("scene_labels", [LABELS, DEPTH], "frames (step pictures)"),
    ];
    for (plan, topics, lacks) in cases {
        let (part, map) = (at("tuesday.mcap"), at(plan));
        write_log(&part, &topics, 1);
        let one_site = ["--site", "street"];
        let counted = run(plan, &map, &[&whole, &part], &one_site).expect(3);
        let said = format!("session without {lacks}: tuesday");
        assert!(counted.stderr.contains(&said), "{said}: {}", counted.stderr);
        let check = ["check", plan, "--sessions", text(&whole), text(&part)];
        // Its pictures have no bytes, which is counted as their frames are looked at.
        let warned = evermap(&check).expect(3).stderr;
        let said = format!("cannot use session tuesday: it lacks {lacks}");
        assert!(warned.contains(&said), "{said}: {warned}");
        // Beside the map that there is, it is alone.
        let refused = run(plan, &map, &[&part], &one_site).expect(1).stderr;
        let said = format!("cannot use session tuesday: expected {lacks}, found topics");
        assert!(refused.contains(&said), "{said}: {refused}");
    }
}

#[test]
fn a_session_without_calibration_is_told_beside_calibrated_ones_and_the_map_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let [monday, tuesday, map] =
        ["monday.mcap", "tuesday.mcap", "map"].map(|name| folder.path().join(name));
    write_log(&monday, &[LABELS, CALIBRATION], 1);
    write_log(&tuesday, &[LABELS], 1);
    let said = "note: session tuesday has no calibration, which other sessions have: step views does without it\n";
    let check = [
        "check",
        "relocate",
        "--sessions",
        text(&monday),
        text(&tuesday),
    ];
    let checked = evermap(&check).expect(0).stderr;
    assert_eq!(checked.matches("no calibration").count(), 1, "{checked}");
    assert!(checked.contains(said), "{checked}");
    // Nothing is said of the calibrated one, nor again when others come.
    let first = run("relocate", &map, &[&monday], &["--site", "street"]).stderr;
    assert!(!first.contains("no calibration"), "{first}");
    let second = run("relocate", &map, &[&tuesday], &["--site", "street"]).stderr;
    assert!(second.contains(said), "{second}");
    let again = run("relocate", &map, &[&monday], &["--site", "street"]).stderr;
    assert!(!again.contains("no calibration"), "{again}");
    // Where nobody has one, that is told.
    let alone = evermap(&["check", "relocate", "--sessions", text(&tuesday)]);
    let alone = alone.expect(0).stderr;
    assert!(
        alone.contains("no session has calibration (step views)"),
        "{alone}"
    );
    assert!(!alone.contains("session tuesday has no"), "{alone}");
}

#[test]
fn fixes_of_one_session_are_enough_for_its_site_and_for_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (drive, fixed) = (at("drive.mcap"), at("fixed.mcap"));
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    write_log(&fixed, &[("/odom", "foxglove.PoseInFrame"), FIXES], 1);
    let sessions = ["--sessions", text(&drive), text(&fixed)];
    let check = |more: &[&str]| {
        let arguments = [&["check", "georeference"], &sessions[..], more].concat();
        evermap(&arguments).expect(0).stderr
    };
    let said = "cannot use session drive: it lacks gnss_fixes (step antenna_positions)";
    let apart = check(&[]);
    assert!(apart.contains(said), "{apart}");
    let together = check(&["--site", "lot"]);
    assert!(!together.contains("cannot use"), "{together}");
}

#[test]
fn a_session_of_which_nothing_came_out_is_counted_among_others() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["drive", "still"].map(|name| folder.path().join(format!("{name}.mcap")));
    write_drive(&paths[0], rectangle(30.0, 20.0, 1.0));
    write_drive(&paths[1], [(0.0, f64::NAN, 0.0, 0.0)]);
    let map = folder.path().join("map");
    let counted = run("trajectory", &map, &[&paths[0], &paths[1]], &[]).expect(3);
    let said = "session of which nothing came out: still";
    assert!(counted.stderr.contains(said), "{}", counted.stderr);
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
        "  stable_map   lacks label_frames (step label_images)",
        "  georeference lacks gnss_fixes (step antenna_positions)",
        "  scene_labels lacks frames (step pictures)",
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
fn where_no_map_is_and_where_none_can_be_is_told_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("photos")).unwrap();
    std::fs::write(at("photos/a.txt"), "a").unwrap();
    let told = evermap(&["layers", "--map", text(&at("photos"))])
        .expect(1)
        .stderr;
    let said = format!("no map at {}", text(&at("photos")));
    assert!(
        told.contains(&said) && told.contains("evermap run"),
        "{told}"
    );
    let drive = at("drive.mcap");
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    // Nobody makes a folder there.
    if cfg!(target_os = "linux") {
        let proc = Path::new("/proc/map");
        let told = run("trajectory", proc, &[&drive], &[]).expect(1).stderr;
        assert!(
            told.contains("cannot create a map at /proc/map: "),
            "{told}"
        );
    }
}

#[test]
fn a_run_without_any_row_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let silent = folder.path().join("silent.mcap");
    write_topics(&silent, &[("/odom", "nav_msgs/Odometry")]);
    let map = folder.path().join("map");
    let said = run("trajectory", &map, &[&silent], &[]).expect(3).stderr;
    assert!(said.contains("no layer has rows"), "{said}");
    let picture = folder.path().join("map.svg");
    let drawn = evermap(&["render", "--map", text(&map), "--out", text(&picture)]);
    let said = drawn.expect(1).stderr;
    assert!(
        said.contains("no row to draw in `lanes`, `poses`"),
        "{said}"
    );
    let page = folder.path().join("report.html");
    evermap(&["report", "--map", text(&map), "--out", text(&page)]).expect(0);
    let page = std::fs::read_to_string(&page).unwrap();
    assert!(page.contains("There is no picture: no row to draw in `lanes`, `poses`."));
}

#[test]
fn a_topic_whose_schema_names_no_fields_is_refused_when_a_manifest_is_checked() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let odometry = ("nav_msgs/Odometry", &br#"{"type":"object"}"#[..]);
    write_nothing(&at("drive.mcap"), "/odom", odometry);
    let why = "JSON whose schema names no fields";
    let inspected = evermap(&["inspect", text(&at("drive.mcap"))]).stdout;
    assert!(
        inspected.contains(&format!("  plays no role: {why}\n")),
        "{inspected}"
    );
    std::fs::write(at("drive.yaml"), "roles:\n  odometry: /odom\n").unwrap();
    let (manifest, drive) = (at("drive.yaml"), at("drive.mcap"));
    let given = ["--manifest", text(&manifest), "--sessions", text(&drive)];
    let map = at("map");
    for asked in [
        &["check", "trajectory"][..],
        &["run", "trajectory", "--map", text(&map)],
    ] {
        let refused = evermap(&[asked, &given].concat()).expect(1).stderr;
        for said in ["drive.yaml:2:13", "for the role odometry", "/odom", why] {
            assert!(refused.contains(said), "{said}: {refused}");
        }
    }
}

#[test]
fn a_query_of_what_a_topic_without_fields_might_play_says_why_it_has_no_rows() {
    let folder = tempfile::tempdir().unwrap();
    let log = |name: &str, topic: &str, schema: &str| {
        let path = folder.path().join(name);
        write_nothing(&path, topic, (schema, &br#"{"type":"object"}"#[..]));
        path
    };
    let asked = |log: &Path, table: &str, code: i32| {
        let query = format!("SELECT count(*) FROM {table}");
        evermap(&["sql", "--sessions", text(log), &query])
            .expect(code)
            .stderr
    };
    let drive = log("drive.mcap", "/odom", "nav_msgs/Odometry");
    let said = asked(&drive, "odometry", 0);
    let why = "note: session drive has no odometry, which these topics do not play: /odom (nav_msgs/Odometry, JSON whose \
               schema names no fields)";
    assert!(said.contains(why), "{said}");
    assert!(!asked(&drive, "imu", 0).contains("note:"));
    let images = log("images.mcap", "/front/image", "foxglove.CompressedImage");
    let said = asked(&images, "frames", 3);
    for told in ["1 skipped or lost", "cannot be decoded", "contentEncoding"] {
        assert!(said.contains(told), "{told}: {said}");
    }
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

    // The logs behind it are there by the names of their sessions; what reading them loses is counted.
    let beside =
        "SELECT count(*) > 0, count(o.stamp) = count(*) FROM poses p LEFT JOIN monday.odometry o
        ON o.stamp BETWEEN p.stamp - INTERVAL '1 second' AND p.stamp WHERE p.session = 'monday'";
    let beside = ask(beside).expect(0).stdout;
    assert_eq!(beside.lines().nth(1), Some("true,true"));
    let odom = ask("SELECT count(*) FROM monday.\"/odom\"")
        .expect(0)
        .stdout;
    let other = ask("SELECT count(*) FROM monday.odometry").expect(0).stdout;
    assert_eq!(odom, other);
    let none = ask("SELECT * FROM monday.\"/nothing\"").expect(1).stderr;
    assert!(none.contains("/nothing"), "{none}");
    let whole = std::fs::read(&logs[0]).unwrap();
    std::fs::write(&logs[0], &whole[..whole.len() / 2]).unwrap();
    let torn = ask("SELECT count(*) FROM monday.odometry").expect(3).stderr;
    assert!(torn.contains("logs without an end"), "{torn}");
    std::fs::write(&logs[0], &whole).unwrap();

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
            "error: user: there is no table `pose` (at line 1, column 15 of the query); did you mean `poses`?",
        ),
        (
            "SELECT stmp FROM poses",
            "error: user: No field named stmp. Did you mean 'poses.stamp'?",
        ),
        ("SELECT 1 / 0", "error: user: Divide by zero"),
        (
            "SELECT * FROM v1.pose",
            "there is no table `v1.pose` (at line 1, column 15 of the query); did you mean `v1.poses`?",
        ),
        (
            "SELECT * FROM drive.\"/odm\"",
            "there is no table `drive.\"/odm\"` (at line 1, column 15 of the query); did you mean `drive.\"/odom\"`?",
        ),
        (
            "SELECT * FROM driv.\"/odom\"",
            "did you mean `drive.\"/odom\"`?",
        ),
        (
            "SELECT * FROM \"/odom\"",
            "(at line 1, column 15 of the query); did you mean `drive.\"/odom\"`?",
        ),
        (
            "SELECT map_from_vehicle_x FROM poses",
            "write map_from_vehicle['x'], or FROM poses_flat: it has map_from_vehicle_x",
        ),
        (
            "SELECT * FROM lanes WHERE length_m > 'x'",
            "error: user: expected a number, found 'x'",
        ),
        (
            "SELECT sources['session'] FROM lanes",
            "`lanes.sources` is a list, which has no member `session`; \
             take it of one item, lanes.sources[1]['session'], or of each: unnest(lanes.sources)",
        ),
        (
            "SELECT * FROM poses WHERE stamp > 5",
            "error: user: expected two values that go together, found time > i64",
        ),
        (
            "SELECT avg(map_from_vehicle) FROM poses",
            "error: user: avg expects (decimal) or (duration) or (f64), found (a pose)",
        ),
        (
            "SELECT * FROM odometry",
            "(at line 1, column 15 of the query); did you mean `drive.odometry`?",
        ),
        (
            "DESCRIBE pose",
            "there is no table `pose`; did you mean `poses`?",
        ),
    ] {
        let told = evermap(&["sql", "--map", text(&map), query])
            .expect(1)
            .stderr;
        assert!(told.contains(said), "{query}: {told}");
    }
}

#[test]
fn versions_are_compared_in_metres() {
    let folder = tempfile::tempdir().unwrap();
    let (drive, map) = (folder.path().join("drive.mcap"), folder.path().join("map"));
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    run("trajectory", &map, &[&drive], &[]).expect(0);
    write_drive(&drive, rectangle(32.0, 20.0, 1.0));
    run("trajectory", &map, &[&drive], &[]).expect(0);

    let ask = |query: &str| rows_of(&map, query);
    // The far side of the lap is two metres farther.
    let lanes = ask("SELECT site, lane, change, moved_m, moved_rad FROM diff('lanes', 1, 2)");
    assert_eq!(lanes.as_array().unwrap().len(), 1, "{lanes}");
    assert_eq!(lanes[0]["change"], "changed");
    let moved_m = lanes[0]["moved_m"].as_f64().unwrap();
    assert!((moved_m - 2.0).abs() < 0.2, "{lanes}");
    assert!(lanes[0]["moved_rad"].is_null());
    // The same drive until the first corner, which comes two metres later; longer by twenty keyframes.
    let poses = ask("SELECT count(*) FILTER (WHERE change = 'added') AS added,
                            count(*) FILTER (WHERE change <> 'added') AS rows,
                            count(*) FILTER (WHERE change = 'same') AS same,
                            max(moved_m) AS moved_m, max(moved_rad) AS moved_rad FROM diff('poses', 1, 2)");
    let old = ask("SELECT count(*) AS rows FROM v1.poses");
    assert_eq!(poses[0]["rows"], old[0]["rows"], "{poses}");
    assert!(poses[0]["same"].as_u64().unwrap() > 100, "{poses}");
    assert!(poses[0]["moved_m"].as_f64().unwrap() > 1.0, "{poses}");
    let turned = poses[0]["moved_rad"].as_f64().unwrap();
    assert!((1.0..=3.2).contains(&turned), "{poses}");
    // Backwards, what came goes.
    let back = ask("SELECT count(*) AS rows FROM diff('poses', 2, 1) WHERE change = 'removed'");
    assert_eq!(back[0]["rows"], poses[0]["added"]);
    let none = ask("SELECT count(*) AS rows FROM diff('lanes', 2, 2) WHERE moved_m > 0");
    assert_eq!(none[0]["rows"], 0);

    // Where rows were, beside where they are.
    let places = ask("SELECT count(*) AS rows, max(abs(st_distance(geometry, geometry_before) - moved_m)) AS apart_m
                      FROM diff('poses', 1, 2) WHERE change = 'changed'");
    assert!(places[0]["rows"].as_u64().unwrap() > 10, "{places}");
    assert!(places[0]["apart_m"].as_f64().unwrap() < 1e-6, "{places}");
    let picture = folder.path().join("changes.svg");
    let drawn = [
        "render",
        "--map",
        text(&map),
        "--view",
        "changes",
        "--out",
        text(&picture),
    ];
    evermap(&drawn).expect(0);
    let svg = std::fs::read_to_string(&picture).unwrap();
    let points = svg
        .split(" points moved")
        .next()
        .unwrap()
        .rsplit('>')
        .next();
    let points: u64 = points.unwrap().parse().unwrap();
    assert!(
        points >= places[0]["rows"].as_u64().unwrap(),
        "{points} {places}"
    );
    let of_first = [&drawn[..], &["--version", "1"]].concat();
    let told = evermap(&of_first).expect(1).stderr;
    assert!(
        told.contains("version 1 is the oldest of the map"),
        "{told}"
    );

    // Other programs find the newest files without evermap.
    let newest = std::fs::read_dir(map.join("newest/poses")).unwrap();
    assert_eq!(newest.count(), 1);
    let linked = std::fs::read(map.join("newest/poses/00000.parquet")).unwrap();
    let files = evermap(&["layers", "--map", text(&map), "--files", "--format", "json"]);
    let files = files.expect(0).json();
    let file = files
        .as_array()
        .unwrap()
        .iter()
        .find(|file| file["layer"] == "poses");
    assert_eq!(
        std::fs::read(file.unwrap()["file"].as_str().unwrap()).unwrap(),
        linked
    );

    let summary = [
        "diff",
        "--map",
        text(&map),
        "--layer",
        "lanes",
        "1",
        "2",
        "--format",
        "json",
    ];
    let summary = evermap(&summary).expect(0).json();
    assert_eq!(summary[0]["changed"], 1, "{summary}");
    assert_eq!(summary[0]["max_moved_m"], lanes[0]["moved_m"], "{summary}");
    let all = ["diff", "--map", text(&map), "1", "2", "--format", "json"];
    let all = evermap(&all).expect(0).json();
    assert_eq!(all.as_array().unwrap().len(), 3, "{all}");

    for (query, said) in [
        ("diff('lane', 1, 2)", "no layer lane in either version"),
        (
            "diff('lanes', 1, 7)",
            "no version 7 in this map; there are: 1, 2",
        ),
        ("diff('lanes', 1)", "diff expects (layer, before, after)"),
        (
            "diff('lanes', 1, 'two')",
            "diff expects the number of a version",
        ),
    ] {
        let refused = [
            "sql",
            "--map",
            text(&map),
            &format!("SELECT * FROM {query}"),
        ];
        let told = evermap(&refused).expect(1).stderr;
        assert!(told.contains(said), "{query}: {told}");
    }
}

/// Rows that no key tells apart are the same, new or gone, whatever their columns are called.
#[test]
fn layers_that_queries_made_are_compared_with_their_own_geometry_and_pose() {
    let folder = tempfile::tempdir().unwrap();
    let (drive, map) = (folder.path().join("drive.mcap"), folder.path().join("map"));
    let plan = folder.path().join("beside.yaml");
    let steps = "plan: beside
extends: trajectory
steps:
  places:
    sql: >
      SELECT session, map_from_vehicle, 'kept' AS change, 1.5 AS moved_m,
             st_point(map_from_vehicle['x'], map_from_vehicle['y']) AS geometry
      FROM poses
  points: { sql: \"SELECT st_point(map_from_vehicle['x'], map_from_vehicle['y']) AS geometry FROM poses\" }
  named: { sql: \"SELECT map_from_vehicle, 'a word' AS geometry, 'another' AS geometry_before FROM poses\" }
  words: { sql: \"SELECT stamp, 'a word' AS geometry FROM poses\" }
write: [places, points, named, words]
";
    std::fs::write(&plan, steps).unwrap();
    for length_m in [30.0, 32.0] {
        write_drive(&drive, rectangle(length_m, 20.0, 1.0));
        run(text(&plan), &map, &[&drive], &[]).expect(0);
    }
    let ask = |query: &str| rows_of(&map, query);
    for layer in ["places", "points", "named"] {
        let rows = ask(&format!(
            "SELECT count(*) FILTER (WHERE change <> 'added') AS before,
                    count(*) FILTER (WHERE change = 'same') AS same,
                    count(*) FILTER (WHERE change = 'removed') AS removed,
                    count(*) FILTER (WHERE change = 'changed') AS changed,
                    count(*) FILTER (WHERE geometry IS NULL) AS nowhere,
                    count(*) FILTER (WHERE (geometry_before IS NULL) <> (change = 'added')) AS wrong,
                    max(st_x(geometry)) AS east_m, max(moved_m) AS moved_m
             FROM diff('{layer}', 1, 2)"
        ));
        let old = ask(&format!("SELECT count(*) AS rows FROM v1.{layer}"));
        assert_eq!(rows[0]["before"], old[0]["rows"], "{layer}: {rows}");
        for some in ["same", "removed"] {
            assert!(rows[0][some].as_u64().unwrap() > 10, "{layer}: {rows}");
        }
        for none in ["changed", "nowhere", "wrong"] {
            assert_eq!(rows[0][none], 0, "{layer}: {rows}");
        }
        assert!(
            rows[0]["east_m"].as_f64().unwrap() > 31.0,
            "{layer}: {rows}"
        );
        assert_eq!(rows[0]["moved_m"], 0.0, "{layer}: {rows}");
    }
    let words = ask("SELECT DISTINCT geometry FROM diff('words', 1, 2)");
    assert_eq!(words, json!([{ "geometry": "a word" }]));
    let all = ["diff", "--map", text(&map), "1", "2", "--format", "json"];
    let all = evermap(&all).expect(0).json();
    assert_eq!(all.as_array().unwrap().len(), 7, "{all}");
}

#[test]
fn functions_are_listed_and_work_on_layers_and_logs() {
    let folder = tempfile::tempdir().unwrap();
    let drive = folder.path().join("drive.mcap");
    let map = folder.path().join("map");
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    run("trajectory", &map, &[&drive], &[]).expect(0);

    let listed = evermap(&["functions", "--format", "json"]).expect(0).json();
    let listed = listed.as_array().unwrap();
    for name in [
        "diff(",
        "yaw(",
        "st_distance(",
        "related(",
        "distance_along(",
    ] {
        let line = listed
            .iter()
            .find(|line| line["function"].as_str().unwrap().starts_with(name))
            .unwrap();
        assert!(!line["example"].as_str().unwrap().is_empty(), "{name}");
    }
    for (query, on_map, expected) in [
        (
            "SELECT count(*) > 0 AS yes FROM poses WHERE abs(abs(yaw(map_from_vehicle)) - pi() / 2) < 0.01",
            true,
            "true",
        ),
        (
            "SELECT abs(st_length(geometry) - length_m) < 0.01 AS yes FROM lanes",
            true,
            "true",
        ),
        (
            "SELECT count(*) = 0 AS yes FROM poses, lanes WHERE st_distance(geometry,
                st_point(map_from_vehicle['x'], map_from_vehicle['y'])) > 1.5",
            true,
            "true",
        ),
        (
            "SELECT bool_and(distance_along(geometry, map_from_vehicle['x'], map_from_vehicle['y'])
                BETWEEN 0 AND length_m + 0.001) AS yes FROM poses, lanes",
            true,
            "true",
        ),
        (
            "SELECT max(yaw(pose)) > 1.5 AS yes FROM \"/odom\"",
            false,
            "true",
        ),
    ] {
        let source = match on_map {
            true => ["--map", text(&map)],
            false => ["--sessions", text(&drive)],
        };
        let asked = ["sql", source[0], source[1], "--format", "csv", "-q", query];
        let answer = evermap(&asked).expect(0).stdout;
        assert_eq!(answer, format!("yes\n{expected}\n"), "{query}");
    }
}

#[test]
fn every_column_of_a_map_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let drive = folder.path().join("drive.mcap");
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    let map = folder.path().join("map");
    run("trajectory", &map, &[&drive], &[]).expect(0);
    let sql = |query: &str| rows_of(&map, query).as_array().unwrap().clone();
    let lanes = sql(
        "SELECT \"column\", kind, unit, frame, meaning FROM columns WHERE layer = 'lanes' AND \"column\" = 'length_m'",
    );
    assert_eq!(
        (&lanes[0]["kind"], &lanes[0]["unit"]),
        (&"f64".into(), &"m".into())
    );
    assert!(!lanes[0]["meaning"].as_str().unwrap().is_empty());
    // Every table has its columns there, under the names that queries use, and itself too.
    let unexplained = sql("SELECT layer FROM layers EXCEPT SELECT layer FROM columns");
    assert!(unexplained.is_empty(), "{unexplained:?}");
    let own = sql("SELECT count(*) AS n FROM columns WHERE layer = 'columns' AND meaning <> ''");
    assert_eq!(own[0]["n"], 8);
    let within =
        sql("SELECT unit FROM columns WHERE layer = 'poses' AND \"column\" = 'map_from_vehicle.x'");
    assert_eq!(within[0]["unit"], "m");
    let nulls = sql(
        "SELECT \"column\" FROM columns WHERE nullable AND null_meaning IS NULL AND layer <> 'poses'",
    );
    assert!(nulls.is_empty(), "{nulls:?}");

    let listed = evermap(&["layers", "--map", text(&map), "lanes"])
        .expect(0)
        .stdout;
    assert!(
        listed.contains("length_m") && listed.contains("| m "),
        "{listed}"
    );
    let refused = evermap(&["layers", "--map", text(&map), "lane"])
        .expect(1)
        .stderr;
    assert!(refused.contains("did you mean `lanes`?"), "{refused}");
}
