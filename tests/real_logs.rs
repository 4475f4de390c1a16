//! Recordings that others made: every one decodes or says why not, and values equal those of the official readers.

use std::path::{Path, PathBuf};
use std::process::Command;

use evermap_tests::{evermap, repository, rows_of, rows_of_log, run, run_of_site, shared, text};
use serde_json::Value;

/// Every file below a folder, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path))
        } else {
            found.push(path)
        }
    }
    found.sort();
    found
}

#[test]
fn every_recording_is_read_or_refused_with_what_to_do() {
    let Some(folder) = shared("data/mcap_real") else {
        return;
    };
    for file in files(&folder) {
        let told = evermap(&["inspect", text(&file), "--json"]);
        match file.extension().and_then(|extension| extension.to_str()) {
            Some("mcap") => {
                assert!(
                    told.code == 0 || told.code == 3,
                    "{}: {}",
                    file.display(),
                    told.stderr
                );
            }
            Some("bag" | "db3") => {
                assert_eq!(told.code, 1, "{}", file.display());
                let empty = std::fs::metadata(&file).unwrap().len() == 0;
                let next = if empty { "empty file" } else { "convert" };
                assert!(
                    told.stderr.contains(next),
                    "{}: {}",
                    file.display(),
                    told.stderr
                );
            }
            _ => {}
        }
    }
}

/// The messages of topics as the official Python readers decode them; `None`, loudly, without those readers.
fn python(file: &Path, topics: &[&str]) -> Option<Vec<Value>> {
    let interpreter = evermap_tests::python()?;
    let script = repository().join("tests/peers/check_values.py");
    let output = Command::new(interpreter)
        .arg(script)
        .arg(file)
        .args(topics)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let lines = String::from_utf8(output.stdout).unwrap();
    Some(
        lines
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect(),
    )
}

/// Whether ours says the same as theirs; numbers as close as a float32's text allows.
fn same(ours: &Value, theirs: &Value) -> bool {
    match (ours, theirs) {
        (Value::Object(ours), Value::Object(theirs)) => theirs
            .iter()
            .all(|(name, theirs)| ours.get(name).is_some_and(|ours| same(ours, theirs))),
        (Value::Array(ours), Value::Array(theirs)) => {
            ours.len() == theirs.len() && ours.iter().zip(theirs).all(|(a, b)| same(a, b))
        }
        (Value::Number(ours), Value::Number(theirs)) => match (ours.as_f64(), theirs.as_f64()) {
            (Some(a), Some(b)) => a == b || (a as f32) == (b as f32),
            _ => false,
        },
        // JSON has no NaN: Arrow writes null.
        (Value::Null, Value::String(theirs)) => {
            ["NaN", "Infinity", "-Infinity"].contains(&theirs.as_str())
        }
        _ => ours == theirs,
    }
}

fn compare(file: &str, topics: &[&str]) {
    let Some(file) = shared(file) else { return };
    for topic in topics {
        let Some(theirs) = python(&file, &[topic]) else {
            return;
        };
        let query = format!("SELECT * FROM \"{topic}\" ORDER BY log_time, sequence");
        let ours = rows_of_log(&file, &query);
        let ours = ours.as_array().unwrap();
        assert_eq!(ours.len(), theirs.len(), "{topic}");
        assert!(!ours.is_empty(), "{topic} is empty");
        for (row, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
            assert!(
                same(ours, &theirs["message"]),
                "{topic} message {row}: {ours} is not {theirs}"
            );
        }
    }
}

#[test]
fn turtlebot_values_equal_the_official_readers() {
    compare("data/mcap_real/evo/nav2_turtlebot.mcap", &["/odom", "/tf"]);
}

#[test]
fn soccer_values_equal_the_official_readers() {
    let Some(file) = shared("data/mcap_real/amber/soccer_goal_12.mcap") else {
        return;
    };
    let query = "SELECT DISTINCT topic FROM messages";
    let topics = rows_of_log(&file, query);
    let topics: Vec<&str> = topics
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["topic"].as_str().unwrap())
        .collect();
    assert!(!topics.is_empty());
    compare("data/mcap_real/amber/soccer_goal_12.mcap", &topics);
}

/// What an engineer learns first of a log of a machine that we never saw.
struct Machine {
    /// Its recording, below the recordings of others.
    log: &'static str,
    /// What `inspect` says that its topics are for.
    roles: &'static [&'static str],
    /// How `run trajectory` ends.
    code: i32,
    /// What it says, by which one knows what to do next.
    says: &'static str,
}

const MACHINES: [Machine; 8] = [
    // A TurtleBot 4 in a house.
    Machine {
        log: "evo/nav2_turtlebot",
        roles: &["odometry", "transforms"],
        code: 0,
        says: "version 1 published",
    },
    // A vehicle whose odometry and IMU are JSON of which nobody says what fields it has.
    Machine {
        log: "mcap_explorer/demo",
        roles: &["frames"],
        code: 1,
        says: "/odom (nav_msgs/Odometry, JSON whose schema names no fields)",
    },
    // A robot that plays soccer: one camera.
    Machine {
        log: "amber/soccer_goal_12",
        roles: &["frames"],
        code: 1,
        says: "found topics /camera/image_raw (sensor_msgs/Image)",
    },
    // A calibrated camera on a bench.
    Machine {
        log: "lichtblick/custom-camera-model",
        roles: &["calibration", "frames"],
        code: 1,
        says: "/image/compressed (foxglove.CompressedImage)",
    },
    // A tracker with GNSS and a battery.
    Machine {
        log: "foxglove_tutorials/tutorial",
        roles: &["gnss_fixes"],
        code: 1,
        says: "location (foxglove.LocationFix)",
    },
    // A plant: pumps and tanks.
    Machine {
        log: "foxglove_tutorials/foxglove_eip_bridge_2025-07-04_17-53-27",
        roles: &[],
        code: 1,
        says: "expected odometry",
    },
    // An arm with joints and an IMU.
    Machine {
        log: "rosbag2parquet/array_msgs_0",
        roles: &["imu"],
        code: 1,
        says: "/one_shot/joint_state (sensor_msgs/msg/JointState)",
    },
    // A node that talks, and moves nothing.
    Machine {
        log: "ros2_rosbag2/rosbag2_py/test/resources/mcap/talker/talker",
        roles: &[],
        code: 1,
        says: "say in a manifest which topic plays the role",
    },
];

#[test]
fn logs_of_eight_machines_are_understood_checked_and_mapped_or_refused_with_the_reason() {
    let Some(recordings) = shared("data/mcap_real") else {
        return;
    };
    for machine in MACHINES {
        let log = recordings.join(machine.log).with_added_extension("mcap");
        let told = evermap(&["inspect", text(&log), "--json"]).expect(0).json();
        let roles = told["roles"].as_array().unwrap();
        let roles: Vec<&str> = roles
            .iter()
            .map(|role| role["role"].as_str().unwrap())
            .collect();
        assert_eq!(roles, machine.roles, "{}", machine.log);

        // The manifest that is printed ready to edit is one that is read.
        let folder = tempfile::tempdir().unwrap();
        let manifest = folder.path().join("logs.yaml");
        let printed = evermap(&["inspect", text(&log), "--manifest"]).expect(0);
        std::fs::write(&manifest, printed.stdout).unwrap();
        let checks = [("--sessions", &log), ("--manifest", &manifest)]
            .map(|(option, file)| evermap(&["check", "trajectory", option, text(file)]).code);
        let map = folder.path().join("map");
        let ran = run_of_site("trajectory", &map, "lot", &["--sessions", text(&log)]);
        let ran = ran.expect(machine.code);
        // What a message's values are is known when they are read: a check reads none.
        let refused = i32::from(machine.code == 1);
        assert_eq!(checks, [refused; 2], "{}", machine.log);
        let said = ran.stdout + &ran.stderr;
        assert!(said.contains(machine.says), "{}: {said}", machine.log);
        assert_eq!(map.exists(), machine.code != 1, "{}", machine.log);
    }
}

#[test]
fn turtlebot_gives_its_road_network() {
    let Some(file) = shared("data/mcap_real/evo/nav2_turtlebot.mcap") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    let plan = repository().join("plans/library/trajectory.yaml");
    run(text(&plan), &map, &[&file], &[]).expect(0);
    let query = "SELECT count(*) AS lanes, sum(length_m) AS length_m FROM lanes";
    let lanes = rows_of(&map, query);
    assert!(lanes[0]["lanes"].as_u64().unwrap() >= 1, "{lanes}");
    let poses = rows_of(&map, "SELECT count(*) AS n FROM poses");
    let path_m = poses[0]["n"].as_f64().unwrap() * 0.2;
    let length_m = lanes[0]["length_m"].as_f64().unwrap();
    assert!(
        length_m > 0.2 * path_m && length_m < 1.2 * path_m,
        "{length_m} m of lanes for {path_m} m driven"
    );
}

#[test]
fn a_recording_cut_anywhere_gives_what_is_before_the_cut_and_says_so() {
    let Some(file) = shared("data/mcap_real/evo/nav2_turtlebot.mcap") else {
        return;
    };
    let bytes = std::fs::read(&file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut before = 0;
    for part in 1..8 {
        let cut = folder.path().join(format!("cut_{part}.mcap"));
        std::fs::write(&cut, &bytes[..bytes.len() * part / 8 + 7]).unwrap();
        let told = evermap(&[
            "sql",
            "--sessions",
            text(&cut),
            "--format",
            "json",
            "SELECT count(*) AS n FROM messages",
        ]);
        let rows = told.expect(3).json()[0]["n"].as_u64().unwrap();
        assert!(rows >= before, "a longer file gave fewer messages");
        before = rows;
    }
    assert!(before > 0);
}

#[test]
fn four_real_fisheyes_become_a_view_from_above() {
    let Some(samples) = shared("data/avm_fisheye/pjlab") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (log, map) = (folder.path().join("pjlab.mcap"), folder.path().join("map"));
    let description = repository().join("datasets/imports/pjlab.yaml");
    let import = [
        "import",
        "images",
        text(&description),
        "--folder",
        text(&samples),
        "--out",
        text(&log),
    ];
    evermap(&import).expect(0);
    run("car_park", &map, &[&log], &[]).expect(0);
    let query = "SELECT sum(covered) AS cells FROM overhead_tiles WHERE zoom = 0";
    let seen = rows_of(&map, query);
    let seen_m2 = seen[0]["cells"].as_f64().unwrap() * 0.05 * 0.05;
    // Four half discs of 8 m, overlapping.
    assert!(
        seen_m2 > 200.0 && seen_m2 < 403.0,
        "{seen_m2} m² of floor were seen"
    );
}

#[test]
fn kitti_drives_give_lanes_on_the_driven_path() {
    for sequence in ["00", "07"] {
        let Some(poses) = shared(&format!("data/kitti_poses/{sequence}.txt")) else {
            return;
        };
        let folder = tempfile::tempdir().unwrap();
        let (log, map) = (folder.path().join("kitti.mcap"), folder.path().join("map"));
        evermap(&[
            "import",
            "kitti",
            "--poses",
            text(&poses),
            "--out",
            text(&log),
        ])
        .expect(0);
        run("trajectory", &map, &[&log], &[]).expect(0);
        let points = "SELECT unnest(points) AS point FROM lanes";
        let driven = "SELECT map_from_vehicle['x'] AS x, map_from_vehicle['y'] AS y FROM poses";
        let rows = |sql: &str| rows_of(&map, sql);
        let driven: Vec<[f64; 2]> = rows(driven)
            .as_array()
            .unwrap()
            .iter()
            .map(|row| [row["x"].as_f64().unwrap(), row["y"].as_f64().unwrap()])
            .collect();
        assert!(driven.len() > 3000, "{} poses", driven.len());
        for row in rows(points).as_array().unwrap() {
            let [x, y] = [0, 1].map(|axis| row["point"][axis].as_f64().unwrap());
            let near = driven.iter().any(|[a, b]| (a - x).hypot(b - y) < 2.0);
            assert!(
                near,
                "lane point {x}, {y} of {sequence} is more than 2 m from the driven path"
            );
        }
        let crossings = rows("SELECT count(*) AS n FROM intersections");
        assert!(
            crossings[0]["n"].as_u64().unwrap() >= 1,
            "{sequence}: {crossings}"
        );
    }
}
