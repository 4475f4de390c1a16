//! What `previous` means as a map lives: before the first version, when a session joins, when nothing is new, when a
//! session's log is replaced.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use evermap_datasets::log::index::LogIndex;
use evermap_engine::map::receipt::Receipt;
use evermap_tests::{Finished, evermap, rectangle, rows_of, text, until_rested, write_drive};
use serde_json::{Value, json};

/// A lifelong plan that needs no camera: sessions that are not in the version before are new.
const PLAN: &str = "
plan: growth
steps:
  keyframes: { op: keyframes, in: { odometry: odometry } }
  poses:
    sql: SELECT site, session, stamp, odom_from_vehicle AS map_from_vehicle FROM keyframes
  new_by_in:
    sql: >
      SELECT site, session, stamp, keyframe FROM keyframes
      WHERE session NOT IN (SELECT session FROM previous.keyframes)
  new_by_exists:
    sql: >
      SELECT k.site, k.session, k.stamp, k.keyframe FROM keyframes k
      WHERE NOT EXISTS (SELECT 1 FROM previous.keyframes p WHERE p.session = k.session)
  new_by_name:
    sql: SELECT site, session, stamp, keyframe FROM new.keyframes
  # A step of a site reads new sessions alone.
  new_lanes: { op: road_network, in: { poses: new_poses } }
  new_poses:
    sql: SELECT site, session, stamp, odom_from_vehicle AS map_from_vehicle FROM new.keyframes
  new_keyframes:
    sql: SELECT site, count(*) AS keyframes FROM new.keyframes GROUP BY site
  # Done in the run that brings the session, and kept.
  joined:
    once: true
    sql: >
      SELECT k.site, k.session, k.stamp, k.keyframe + 0 AS after
      FROM keyframes k WHERE k.session NOT IN (SELECT session FROM previous.keyframes)
  known:
    sql: SELECT site, count(*) AS keyframes FROM previous.keyframes GROUP BY site
  lanes: { op: road_network, in: { poses: poses } }
  # A layer of the version before drives an operator.
  old_crossings: { op: intersections, in: { lanes: previous.lanes } }
write:
  [keyframes, new_by_in, new_by_exists, new_by_name, new_lanes, new_keyframes, joined, known, lanes, old_crossings]
";

struct World {
    folder: tempfile::TempDir,
}

impl World {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("growth.yaml"), PLAN).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn drive(&self, name: &str, width_m: f64) -> PathBuf {
        let path = self.path(&format!("{name}.mcap"));
        write_drive(&path, rectangle(width_m, 10.0, 1.0));
        path
    }

    fn call(&self, command: &str, sessions: &[&Path], more: &[&str]) -> Finished {
        let (plan, map) = (self.path("growth.yaml"), self.path("map"));
        let mut arguments = vec![command, text(&plan), "--map", text(&map)];
        arguments.extend(more);
        arguments.push("--sessions");
        arguments.extend(sessions.iter().map(|path| text(path)));
        evermap(&arguments)
    }

    fn run(&self, sessions: &[&Path]) -> Finished {
        self.ended(sessions, 0)
    }

    fn ended(&self, sessions: &[&Path], code: i32) -> Finished {
        self.call("run", sessions, &["--site", "lot", "--progress", "none"])
            .expect(code)
    }

    fn explain(&self, sessions: &[&Path]) -> Vec<Value> {
        let told = self.call("explain", sessions, &["--site", "lot", "--format", "json"]);
        told.expect(0).json().as_array().unwrap().clone()
    }

    fn query(&self, sql: &str) -> Value {
        rows_of(&self.path("map"), sql)
    }

    /// Sessions that all ways of asking found to be new.
    fn new_sessions(&self) -> Value {
        let [a, b, c] = ["new_by_in", "new_by_exists", "new_by_name"].map(|layer| {
            self.query(&format!(
                "SELECT session, count(*) AS n FROM {layer} GROUP BY session ORDER BY session"
            ))
        });
        assert_eq!((&a, &a), (&b, &c));
        a
    }

    fn versions(&self) -> usize {
        let versions = self.query("SELECT version FROM versions");
        versions.as_array().unwrap().len()
    }

    /// The labels of the units that the runs of a version computed.
    fn computed(&self, version: usize, step: &str) -> Value {
        self.query(&format!(
            "SELECT coalesce(session, site) AS of FROM runs \
             WHERE version = {version} AND step = '{step}' AND NOT cached ORDER BY 1"
        ))
    }
}

#[test]
fn before_the_first_version_all_is_new_and_previous_is_empty() {
    let world = World::new();
    let a = world.drive("a", 20.0);
    world.run(&[&a]);
    assert_eq!(world.new_sessions(), json!([{ "session": "a", "n": 301 }]));
    assert_eq!(world.query("SELECT * FROM known"), json!([]));
    assert_eq!(world.query("SELECT * FROM old_crossings"), json!([]));
}

#[test]
fn a_session_that_joins_is_new_and_the_others_are_known() {
    let world = World::new();
    let (a, b) = (world.drive("a", 20.0), world.drive("b", 30.0));
    world.run(&[&a]);
    let forecast = world.explain(&[&b]);
    world.run(&[&b]);
    assert_eq!(world.new_sessions(), json!([{ "session": "b", "n": 401 }]));
    assert_eq!(
        world.query("SELECT * FROM known"),
        json!([{ "site": "lot", "keyframes": 301 }])
    );
    // What only the new session concerns is done for it alone.
    assert_eq!(world.computed(2, "keyframes"), json!([{ "of": "b" }]));
    assert_eq!(world.computed(2, "lanes"), json!([{ "of": "lot" }]));
    for unit in forecast {
        let (step, of, why) = (&unit["step"], unit["unit"].as_str().unwrap(), &unit["why"]);
        let expected = match step.as_str().unwrap() {
            "keyframes" | "poses" | "joined" => of.ends_with(" of b"),
            _ => true,
        };
        assert_eq!(unit["recompute"], expected, "{unit}");
        if of == "new_by_in of a" || of == "known of lot" {
            assert_eq!(why, "previous.keyframes has changed", "{unit}");
        }
    }
}

#[test]
fn what_is_done_once_is_kept_until_something_of_its_own_changes() {
    let world = World::new();
    let joined = || {
        world.query("SELECT session, count(*) AS n FROM joined GROUP BY session ORDER BY session")
    };
    let (a, b, c) = (
        world.drive("a", 20.0),
        world.drive("b", 30.0),
        world.drive("c", 40.0),
    );
    world.run(&[&a]);
    world.run(&[&b]);
    world.run(&[&c]);
    let [a_rows, b_rows, c_rows] = [("a", 301), ("b", 401), ("c", 501)]
        .map(|(session, n)| json!({ "session": session, "n": n }));
    assert_eq!(joined(), json!([a_rows, b_rows, c_rows]));
    for (version, session) in [(1, "a"), (2, "b"), (3, "c")] {
        assert_eq!(
            world.computed(version, "joined"),
            json!([{ "of": session }])
        );
    }
    // Its own log has changed: it joins anew, the others stay.
    let b = world.drive("b", 20.0);
    world.run(&[&b]);
    assert_eq!(world.computed(4, "joined"), json!([{ "of": "b" }]));
    assert_eq!(
        joined(),
        json!([a_rows, { "session": "b", "n": 301 }, c_rows])
    );
    // So has what it does: now all are known.
    let other = PLAN.replace("AS after", "AS before_it");
    std::fs::write(world.path("growth.yaml"), other).unwrap();
    world.run(&[&a]);
    assert_eq!(joined(), json!([]));
}

#[test]
fn a_step_of_a_site_reads_new_sessions_alone() {
    let world = World::new();
    let keyframes = || world.query("SELECT keyframes FROM new_keyframes");
    let (a, b, c) = (
        world.drive("a", 20.0),
        world.drive("b", 30.0),
        world.drive("c", 40.0),
    );
    world.run(&[&a]);
    assert_eq!(keyframes(), json!([{ "keyframes": 301 }]));
    world.run(&[&b, &c]);
    assert_eq!(keyframes(), json!([{ "keyframes": 902 }]));
    // A log that was replaced is that of a new session.
    let b = world.drive("b", 20.0);
    world.run(&[&b]);
    assert_eq!(keyframes(), json!([{ "keyframes": 301 }]));
    let other = PLAN.replace("AS after", "AS later");
    std::fs::write(world.path("growth.yaml"), other).unwrap();
    world.run(&[&a]);
    assert_eq!(keyframes(), json!([]));
    assert_eq!(world.query("SELECT * FROM new_lanes"), json!([]));
}

#[test]
fn new_sessions_alone_are_those_of_an_operator_of_one_session() {
    let world = World::new();
    let a = world.drive("a", 20.0);
    let told = |from: &str, to: &str| {
        std::fs::write(world.path("growth.yaml"), PLAN.replace(from, to)).unwrap();
        let told = world.call("run", &[&a], &["--site", "lot", "--progress", "none"]);
        told.expect(1).stderr
    };
    let of_query = told("in: { poses: new_poses }", "in: { poses: new.poses }");
    assert!(
        of_query.contains("`new.poses` is made by a query"),
        "{of_query}"
    );
    let of_site = told("in: { lanes: previous.lanes }", "in: { lanes: new.lanes }");
    assert!(
        of_site.contains("one unit of `lanes` covers more than a session"),
        "{of_site}"
    );
    let of_nothing = told("FROM new.keyframes", "FROM new.keyframe");
    assert!(
        of_nothing.contains("names `keyframe`, which is not a step"),
        "{of_nothing}"
    );
}

/// A log whose odometry said nothing: a session that brings no rows of any layer.
fn silent(world: &World, name: &str) -> PathBuf {
    let path = world.path(&format!("{name}.mcap"));
    write_drive(&path, []);
    path
}

#[test]
fn a_session_without_rows_computes_nothing_of_its_site() {
    let world = World::new();
    let (a, b) = (world.drive("a", 20.0), world.drive("b", 30.0));
    let once = "new_keyframes:\n    once: true";
    let plan = PLAN.replace("new_keyframes:", once);
    std::fs::write(world.path("growth.yaml"), plan).unwrap();
    let kept = || world.query("SELECT keyframes FROM new_keyframes");
    world.run(&[&a]);
    world.run(&[&b]);
    assert_eq!(kept(), json!([{ "keyframes": 401 }]));
    let ada = silent(&world, "ada");
    // Nothing comes out of it, which is counted.
    world.ended(&[&ada], 3);
    assert_eq!(world.computed(3, "keyframes"), json!([{ "of": "ada" }]));
    for step in ["lanes", "new_keyframes"] {
        assert_eq!(world.computed(3, step), json!([]), "{step}");
    }
    assert_eq!(kept(), json!([{ "keyframes": 401 }]));
    // What reads the version before without `once` reads the newest.
    assert_eq!(world.computed(3, "new_lanes"), json!([{ "of": "lot" }]));
    // A drive that is gone is not kept by what was done once.
    std::fs::remove_file(&b).unwrap();
    std::fs::rename(silent(&world, "b_said"), &b).unwrap();
    world.ended(&[&b], 3);
    assert_eq!(kept(), json!([]));
}

#[test]
fn once_is_for_steps_that_are_stored() {
    let world = World::new();
    let a = world.drive("a", 20.0);
    let copy = "  copy: { once: true, sql: SELECT * FROM keyframes }\n  new_by_exists:";
    let other = PLAN.replace("  new_by_exists:", copy);
    let other = other.replace(
        "FROM keyframes k\n      WHERE NOT",
        "FROM copy k\n      WHERE NOT",
    );
    std::fs::write(world.path("growth.yaml"), other).unwrap();
    let told = world.call("run", &[&a], &["--site", "lot", "--progress", "none"]);
    let told = told.expect(1);
    assert!(
        told.stderr
            .contains("step `copy`: `once` is for steps that are stored"),
        "{}",
        told.stderr
    );
}

#[test]
fn a_run_without_news_means_the_same_previous_and_changes_nothing() {
    let world = World::new();
    let (a, b) = (world.drive("a", 20.0), world.drive("b", 30.0));
    world.run(&[&a]);
    world.run(&[&b]);
    for sessions in [&[b.as_path()][..], &[&a, &b], &[&a]] {
        for unit in world.explain(sessions) {
            assert_eq!(
                (&unit["recompute"], &unit["why"]),
                (&json!(false), &json!("unchanged")),
                "{unit}"
            );
        }
        let told = world.run(sessions);
        assert!(
            told.stderr.contains("nothing has changed"),
            "{}",
            told.stderr
        );
        assert_eq!(world.versions(), 2);
        assert_eq!(world.new_sessions(), json!([{ "session": "b", "n": 401 }]));
    }
    // Not even when the version before has been forgotten.
    evermap(&["gc", "--map", text(&world.path("map")), "--keep", "1"]).expect(0);
    let told = world.run(&[&a]);
    assert!(
        told.stderr.contains("nothing has changed"),
        "{}",
        told.stderr
    );
    // A plan that does something else is something new: now both sessions are known.
    let other = PLAN.replace(
        "keyframe FROM keyframes\n",
        "keyframe + 0 AS keyframe FROM keyframes\n",
    );
    assert_ne!(other, PLAN);
    std::fs::write(world.path("growth.yaml"), other).unwrap();
    world.run(&[&a]);
    assert_eq!(world.new_sessions(), json!([]));
}

/// Leaves a map as an evermap did whose files have another format.
fn of_another_format(map: &Path) {
    let files = |folder: &str| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(map.join(folder)).unwrap();
        entries.map(|entry| entry.unwrap().path()).collect()
    };
    let mut digests = Vec::new();
    for path in files("receipts") {
        let mut receipt: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        receipt["recipe"]["format"] = json!(3);
        for stage in receipt["recipe"]["stages"].as_array_mut().unwrap() {
            let query = stage.pointer_mut("/task/sql");
            if let Some(query) = query.and_then(Value::as_object_mut) {
                query.remove("notes");
            }
        }
        let mut receipt: Receipt = serde_json::from_value(receipt).unwrap();
        let digest = receipt.recipe.digest().unwrap();
        digests.push((
            std::mem::replace(&mut receipt.digest, digest.clone()),
            digest.clone(),
        ));
        std::fs::remove_file(&path).unwrap();
        let path = map.join("receipts").join(format!("{digest}.json"));
        std::fs::write(path, serde_json::to_vec(&receipt).unwrap()).unwrap();
    }
    for path in files("versions") {
        let mut version: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        version.as_object_mut().unwrap().remove("seal").unwrap();
        let mut version = version.to_string();
        for (then, now) in &digests {
            version = version.replace(then, now);
        }
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, version).unwrap();
    }
}

#[test]
fn a_map_of_another_format_is_read_and_made_anew_with_the_same_previous() {
    let world = World::new();
    let (a, b) = (world.drive("a", 20.0), world.drive("b", 30.0));
    world.run(&[&a]);
    world.run(&[&b]);
    let lanes = world.query("SELECT lane, length_m FROM lanes ORDER BY lane");
    of_another_format(&world.path("map"));
    evermap(&["verify", "--map", text(&world.path("map"))]).expect(0);
    assert_eq!(world.new_sessions(), json!([{ "session": "b", "n": 401 }]));
    for unit in world.explain(&[&b]) {
        let why = "it was made by an evermap whose files have another format";
        assert_eq!(
            (&unit["recompute"], &unit["why"]),
            (&json!(true), &json!(why)),
            "{unit}"
        );
    }
    world.run(&[&b]);
    assert_eq!(world.versions(), 3);
    // It is the run of b still.
    assert_eq!(world.new_sessions(), json!([{ "session": "b", "n": 401 }]));
    assert_eq!(
        world.query("SELECT * FROM known"),
        json!([{ "site": "lot", "keyframes": 301 }])
    );
    assert_eq!(
        world.query("SELECT lane, length_m FROM lanes ORDER BY lane"),
        lanes
    );
    assert_eq!(
        world.query("SELECT count(*) AS n FROM v1.keyframes"),
        json!([{ "n": 301 }])
    );
    let told = world.run(&[&b]);
    assert!(
        told.stderr.contains("nothing has changed"),
        "{}",
        told.stderr
    );
    // A drive that comes builds on what there is.
    let c = world.drive("c", 40.0);
    world.run(&[&c]);
    assert_eq!(world.new_sessions(), json!([{ "session": "c", "n": 501 }]));
}

#[test]
fn a_log_that_lies_elsewhere_now_is_the_same_log() {
    let world = World::new();
    let (a, b) = (world.drive("a", 20.0), world.drive("b", 30.0));
    world.run(&[&a]);
    world.run(&[&b]);
    std::fs::create_dir(world.path("archive")).unwrap();
    let moved = world.path("archive/b.mcap");
    std::fs::rename(&b, &moved).unwrap();
    for _ in 0..2 {
        let told = world.run(&[&moved]);
        assert!(told.stderr.contains("0 units computed"), "{}", told.stderr);
        assert_eq!(world.new_sessions(), json!([{ "session": "b", "n": 401 }]));
    }
    assert_eq!(world.versions(), 3, "the place of the log is noted, once");
}

#[test]
fn a_replaced_log_is_a_new_session_and_its_old_rows_are_not_read() {
    let world = World::new();
    let (a, b) = (world.drive("a", 20.0), world.drive("b", 30.0));
    world.run(&[&a, &b]);
    let b = world.drive("b", 40.0);
    let forecast = world.explain(&[&b]);
    let of = |label: &str| {
        let found = forecast.iter().find(|unit| unit["unit"] == label);
        found.unwrap_or_else(|| panic!("no {label}")).clone()
    };
    assert_eq!(of("keyframes of a")["recompute"], false);
    assert_eq!(of("keyframes of b")["why"], "the log of b has changed");
    world.run(&[&b]);
    assert_eq!(world.new_sessions(), json!([{ "session": "b", "n": 501 }]));
    assert_eq!(
        world.query("SELECT * FROM known"),
        json!([{ "site": "lot", "keyframes": 301 }])
    );
    let told = world.run(&[&b]);
    assert!(
        told.stderr.contains("nothing has changed"),
        "{}",
        told.stderr
    );
}

#[test]
fn a_recording_that_is_overwritten_by_another_one_is_told() {
    let world = World::new();
    let b = world.drive("b", 30.0);
    world.run(&[&world.drive("a", 20.0), &b]);
    let told = |expected: bool| {
        let said = world.run(&[&b]).stderr;
        let another = "warning: session b has another recording now, of 2023-11-15T22:13:20+00:00";
        assert_eq!(said.contains(another), expected, "{said}");
        said
    };
    told(false);
    // Of the same time: the drive, written anew.
    world.drive("b", 40.0);
    told(false);
    let next_day = rectangle(40.0, 10.0, 1.0).into_iter();
    let next_day = next_day.map(|(seconds, x, y, yaw)| (seconds + 86_400.0, x, y, yaw));
    write_drive(&b, next_day);
    let said = told(true);
    assert!(said.contains("that of 2023-11-14T22:13:20"), "{said}");
    assert!(said.contains("b.mcap, and is no longer part of"), "{said}");
    told(false);
}

#[test]
fn a_session_given_again_stays_at_its_site() {
    let world = World::new();
    let a = world.drive("a", 20.0);
    world.run(&[&a]);
    let told = world.call("run", &[&a], &["--progress", "none"]).expect(0);
    assert!(
        told.stderr.contains("nothing has changed"),
        "{}",
        told.stderr
    );
}

/// A world whose map another plan made of its session.
fn after_another_plan() -> (World, PathBuf) {
    let world = World::new();
    let a = world.drive("a", 20.0);
    let (map, other) = (world.path("map"), world.path("other.yaml"));
    let lines = [
        "plan: other",
        "steps:",
        "  drive: { op: keyframes, in: { odometry: odometry } }",
        "write: [drive]",
    ];
    std::fs::write(&other, lines.join("\n")).unwrap();
    let (other, map) = (text(&other), text(&map));
    let given = ["--site", "lot", "--sessions", text(&a)];
    evermap(&[&["run", other, "--map", map], &given[..]].concat()).expect(0);
    (world, a)
}

#[test]
fn another_plan_between_is_told() {
    let (world, a) = after_another_plan();
    let told = world.call("run", &[&a], &["--progress", "none"]).expect(0);
    assert!(
        told.stderr.contains("version 1 has no layer keyframes"),
        "{}",
        told.stderr
    );
}

#[test]
fn after_another_plan_all_sessions_are_new_and_done_again_nothing_is_told() {
    let (world, a) = after_another_plan();
    let told = world.run(&[&a]).stderr;
    assert!(told.contains("all sessions are new to this one"), "{told}");
    assert_eq!(world.new_sessions()[0]["session"], "a");
    let new = "SELECT count(*) AS lanes FROM new_lanes";
    assert_ne!(world.query(new)[0]["lanes"], 0);
    let again = world.run(&[&a]).stderr;
    assert!(!again.contains("has no layer"), "{again}");
    assert!(again.contains("nothing has changed"), "{again}");
}

#[test]
fn what_another_plan_wrote_under_a_steps_name_is_told() {
    let world = World::new();
    let a = world.drive("a", 20.0);
    let other = "plan: growth\nsteps: { lanes: { op: keyframes, in: { odometry: odometry } } }\nwrite: [lanes]\n";
    std::fs::write(world.path("growth.yaml"), other).unwrap();
    world.run(&[&a]);
    std::fs::write(world.path("growth.yaml"), PLAN).unwrap();
    let told = world.call("run", &[&a], &["--progress", "none"]).expect(1);
    let sentence = "`previous.lanes` lacks the column lane (u32): another plan, or another version of evermap, wrote the layer lanes of this map; map its sessions into a new folder";
    assert!(told.stderr.contains(sentence), "{}", told.stderr);
}

/// What a map remembers of its only log, and where.
fn remembered(world: &World) -> (PathBuf, Value) {
    let entries: Vec<_> = std::fs::read_dir(world.path("map/logs")).unwrap().collect();
    assert_eq!(entries.len(), 1);
    let path = entries[0].as_ref().unwrap().path();
    let entry = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    (path, entry)
}

/// A world whose log was of just now when the run read it. Where that came too late, the times of the next one's log lie
/// ahead of the clock.
fn mapped_of_just_now() -> (World, PathBuf) {
    for ahead_s in [0, 4, 16, 64] {
        let world = World::new();
        let a = world.drive("a", 20.0);
        let log = std::fs::File::options().append(true).open(&a).unwrap();
        log.set_modified(SystemTime::now() + Duration::from_secs(ahead_s))
            .unwrap();
        world.run(&[&a]);
        if remembered(&world).1["rested"] == false {
            return (world, a);
        }
    }
    panic!("no run read its log within a minute");
}

#[test]
fn a_log_is_read_again_only_when_its_file_has_changed() {
    let (world, a) = mapped_of_just_now();
    let forge = || {
        let (path, mut forged) = remembered(&world);
        forged["content"] = json!("forged");
        let sealed = json!([LogIndex::VERSION, "forged", forged["indexes"]]);
        let sealed = serde_json::to_vec(&sealed).unwrap();
        forged["seal"] = json!(blake3::hash(&sealed).to_hex().as_str());
        std::fs::write(&path, forged.to_string()).unwrap();
    };
    // The file is of just now: what is remembered of it is for that run's units, and nobody believes it later.
    forge();
    until_rested(&a);
    let unit = &world.explain(&[&a])[0];
    assert_eq!(unit["why"], "unchanged", "{unit}");
    world.run(&[&a]);
    // Forge what is remembered: it is believed as long as the file is the same, and no longer.
    forge();
    let unit = &world.explain(&[&a])[0];
    assert_eq!(unit["why"], "the log of a has changed", "{unit}");
    let bytes = std::fs::read(&a).unwrap();
    std::fs::write(&a, bytes).unwrap();
    let unit = &world.explain(&[&a])[0];
    assert_eq!(unit["why"], "unchanged", "{unit}");
}
