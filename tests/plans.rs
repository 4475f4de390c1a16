//! The plans that ship: they check, their tests pass, and a bad plan is refused with all its faults.

use evermap_tests::{evermap, page, rectangle, repository, rows_of, text, write_drive};

#[test]
fn every_shipped_plan_checks_and_its_tests_pass() {
    let mut plans: Vec<_> = std::fs::read_dir(repository().join("plans/library"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "yaml")
        })
        .collect();
    plans.sort();
    assert!(plans.len() >= 2);
    for plan in plans {
        evermap(&["check", text(&plan)]).expect(0);
        evermap(&["test", text(&plan)]).expect(0);
    }
}

#[test]
fn a_quick_look_is_a_preset_of_the_plans_that_map() {
    for plan in ["metric_map", "lifelong", "car_park"] {
        evermap(&["check", plan, "--set", "preview"]).expect(0);
    }
    evermap(&["check", "speed", "--set", "previw"]).expect(1);
}

/// The steps of a shipped plan as composed, as text, by name.
fn steps(plan: &str) -> std::collections::BTreeMap<String, String> {
    let text = evermap(&["explain", plan]).expect(0).stdout;
    let text = text.split("\nsteps:\n").nth(1).unwrap();
    let text = text.split("\nwrite:").next().unwrap();
    let mut steps = std::collections::BTreeMap::<String, String>::new();
    let mut name = String::new();
    for line in text.lines() {
        if line.starts_with("  ") && !line.starts_with("   ") {
            name = line.trim().trim_end_matches(':').to_owned();
        } else {
            let step = steps.entry(name.clone()).or_default();
            step.push_str(line.trim());
            step.push('\n');
        }
    }
    steps
}

/// A map that one of them made can be gone on with by the other.
#[test]
fn plans_share_the_steps_of_the_metric_map() {
    let (lifelong, car_park) = (steps("lifelong"), steps("car_park"));
    assert!(lifelong.len() > 10);
    for (name, step) in &lifelong {
        assert_eq!(car_park.get(name), Some(step), "{name}");
    }
    // The first drive is a lifelong map without a version before.
    for (name, step) in steps("metric_map") {
        let mut other = lifelong[&name].replace("new.", "");
        for more in [
            "once: true",
            "localisations: localisations",
            "previous: previous.adjusted_poses",
            "previous: previous.frame_poses",
            "previous: previous.loop_closures",
            "previous: previous.map_frames",
            "previous_frames: previous.map_frames",
        ] {
            other = other.replace(more, "");
        }
        let flat = |text: &str| text.replace(['\n', ' ', ',', '{', '}'], "");
        assert_eq!(flat(&other), flat(&step), "{name}");
    }
}

/// Two plans in a folder, the second beside the first; the path of the first.
fn plans(folder: &tempfile::TempDir, texts: [&str; 2]) -> std::path::PathBuf {
    let path = folder.path().join("plan.yaml");
    std::fs::write(&path, texts[0]).unwrap();
    std::fs::write(folder.path().join("base.yaml"), texts[1]).unwrap();
    path
}

#[test]
fn a_plan_extends_a_file_beside_it_which_extends_one_that_ships() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plans(
        &folder,
        [
            "plan: denser\nextends: base.yaml\ndefaults: { baseline_m: 0.5 }\ndrop: [intersections]\n",
            "plan: base\nextends: trajectory\nsteps:\n  keyframes: { with: { baseline_m: 0.1 } }\n  \
             drives: { sql: SELECT DISTINCT session FROM poses }\nwrite: [drives]\n",
        ],
    );
    evermap(&["check", text(&plan)]).expect(0);
    evermap(&["test", text(&plan)]).expect(0);
    let composed = evermap(&["explain", text(&plan), "--set", "lanes.connect_m=3"]).expect(0);
    let expected = "plan: denser\n\
         doc: >\n  The road network of any log with odometry: where the vehicle drove, which lanes that makes, and\n  \
         where they meet. Needs no camera.\n\
         steps:\n  \
         inertial_odometry:\n    op: inertial_odometry\n    in: { imu: imu, odometry: odometry, transforms: transforms }\n  \
         keyframes:\n    op: keyframes\n    in: { odometry: inertial_odometry }\n    with: { baseline_m: 0.1 }\n  \
         poses:\n    sql: |\n      SELECT site, session, stamp, odom_from_vehicle AS map_from_vehicle FROM keyframes\n  \
         lanes:\n    op: road_network\n    in: { keyframes: keyframes, poses: poses }\n    with: { connect_m: 3 }\n  \
         drives:\n    sql: |-\n      SELECT DISTINCT session FROM poses\n\
         write: [poses, lanes, drives]\n";
    assert_eq!(composed.stdout, expected);
    let again = folder.path().join("composed.yaml");
    std::fs::write(&again, &composed.stdout).unwrap();
    let again = evermap(&["explain", text(&again)]).expect(0);
    assert_eq!(again.stdout, expected);
}

#[test]
fn a_function_that_an_extended_plan_names_is_found_from_the_plan_as_composed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(path("ours")).unwrap();
    std::fs::create_dir_all(path("library/python")).unwrap();
    std::fs::write(path("library/python/steps.py"), "def made(speeds): ...\n").unwrap();
    let base = "plan: base\nsteps:\n  speeds: { op: speeds }\n  made:\n    once: true\n    \
         python: python/steps.py:made\n    in: { speeds: speeds }\n    grain: rows\n    output: speeds\nwrite: [made]\n";
    std::fs::write(path("library/base.yaml"), base).unwrap();
    let (plan, again) = (path("ours/plan.yaml"), path("ours/composed.yaml"));
    std::fs::write(&plan, "plan: ours\nextends: ../library/base.yaml\n").unwrap();
    let composed = evermap(&["explain", text(&plan)]).expect(0).stdout;
    let made = "  made:\n    once: true\n    python: \"../library/python/steps.py:made\"\n";
    assert!(composed.contains(made), "{composed}");
    std::fs::write(&again, &composed).unwrap();
    assert_eq!(
        evermap(&["explain", text(&again)]).expect(0).stdout,
        composed
    );
}

#[test]
fn a_manifest_that_an_extended_plan_names_is_found_from_the_plan_as_composed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for name in ["ours", "library/logs"] {
        std::fs::create_dir_all(path(name)).unwrap();
    }
    let (log, manifest) = (path("library/logs/drive.mcap"), "logs/lot.yaml");
    write_drive(&log, rectangle(30.0, 20.0, 1.0));
    let sessions = "site: lot\nsessions: [{ name: monday, files: [drive.mcap] }]\n";
    std::fs::write(path("library").join(manifest), sessions).unwrap();
    let base = format!("plan: base\nextends: trajectory\nsessions: {manifest}\n");
    std::fs::write(path("library/base.yaml"), base).unwrap();
    let (plan, again) = (path("ours/plan.yaml"), path("ours/composed.yaml"));
    std::fs::write(&plan, "plan: ours\nextends: ../library/base.yaml\n").unwrap();
    let composed = evermap(&["explain", text(&plan)]).expect(0).stdout;
    let named = "\nsessions: ../library/logs/lot.yaml\n";
    assert!(composed.contains(named), "{composed}");
    std::fs::write(&again, &composed).unwrap();
    assert_eq!(
        evermap(&["explain", text(&again)]).expect(0).stdout,
        composed
    );
    // Both find the log.
    let map = path("map");
    for plan in [&plan, &again] {
        let run = ["run", text(plan), "--map", text(&map), "--progress", "none"];
        evermap(&run).expect(0);
    }
    // Where there is none, it is as written.
    std::fs::remove_file(path("library").join(manifest)).unwrap();
    let composed = evermap(&["explain", text(&plan)]).expect(0).stdout;
    assert!(
        composed.contains("\nsessions: logs/lot.yaml\n"),
        "{composed}"
    );
}

#[test]
fn faults_of_what_a_plan_extends_are_told_where_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plans(
        &folder,
        [
            "plan: plan\nextends: base.yaml\nsteps:\n  lanes:\n    with: { connect_m: -1 }\n",
            "plan: base\nextends: trajectory\nsteps:\n  more:\n    sql: SELECT nothing FROM lanes\nwrite: [more]\n",
        ],
    );
    let told = evermap(&["check", text(&plan)]).expect(1);
    assert!(told.stderr.contains("plan.yaml:5:24"), "{}", told.stderr);
    // What only compiling shows, too.
    std::fs::write(&plan, "plan: plan\nextends: base.yaml\n").unwrap();
    let told = evermap(&["check", text(&plan)]).expect(1);
    assert!(told.stderr.contains("base.yaml:5:17"), "{}", told.stderr);
    std::fs::write(&plan, "plan: plan\nextends: bases.yaml\n").unwrap();
    let told = evermap(&["check", text(&plan)]).expect(1);
    for needle in ["plan.yaml:2:10", "bases.yaml", "lifelong"] {
        assert!(told.stderr.contains(needle), "{}", told.stderr);
    }
}

#[test]
fn a_place_that_is_none_is_told_in_the_manifest_that_gives_it() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = folder.path().join("lot.yaml");
    for (origins, place, said) in [
        (
            "{ yard: [52.25, 10.5, 80.0, 0.0], lot: [152.25, 10.5, 80.0, 0.0] }",
            "[152",
            "`origins` of lot: expected latitude, longitude, height and heading, the latitude between -90 and 90°, found 152.25",
        ),
        (
            "{ yard: [52.25, 10.5, 80.0, 0.0], lot: [52.25, 10.5] }",
            "[52.25, 10.5] }",
            "expected `origins` to be of type object",
        ),
        (
            "[52.25]",
            "[52.25]",
            "expected `origins` to be of type object",
        ),
    ] {
        let line = format!("  origins: {origins}");
        std::fs::write(&manifest, format!("defaults:\n{line}\n")).unwrap();
        let told = evermap(&["check", "georeference", "--manifest", text(&manifest)]).expect(1);
        let place = format!("lot.yaml:2:{}", line.find(place).unwrap() + 1);
        for needle in [place.as_str(), said] {
            assert!(told.stderr.contains(needle), "{needle}: {}", told.stderr);
        }
    }
}

#[test]
fn files_and_names_that_are_wrong_in_a_manifest_are_told_there() {
    let folder = tempfile::tempdir().unwrap();
    let (manifest, map) = (folder.path().join("lot.yaml"), folder.path().join("map"));
    std::fs::write(folder.path().join("a.mcap"), "").unwrap();
    let absent = folder.path().join("absent.mcap");
    let absent = format!("lot.yaml:3:21: {}", text(&absent));
    for (files, name, place, said) in [
        (
            "absent.mcap",
            "b",
            absent.as_str(),
            "expected a file, found nothing",
        ),
        (
            "n*.mcap",
            "b",
            "lot.yaml:3:21",
            "expected MCAP files, found none at",
        ),
        (
            "a.mcap",
            "a",
            "lot.yaml:4:13",
            "give one of them another name",
        ),
    ] {
        let sessions = format!(
            "sessions:\n  - name: a\n    files: [a.mcap, {files}]\n  - {{ name: {name}, files: [a.mcap] }}\n"
        );
        std::fs::write(&manifest, sessions).unwrap();
        let given = ["--manifest", text(&manifest)];
        for command in [
            &["check", "trajectory"][..],
            &["run", "trajectory", "--map", text(&map)],
        ] {
            let told = evermap(&[command, &given].concat()).expect(1).stderr;
            for needle in [place, said] {
                assert!(told.contains(needle), "{needle}: {told}");
            }
        }
    }
}

#[test]
fn a_bad_plan_is_refused_with_all_its_faults_before_anything_runs() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, map) = (folder.path().join("bad.yaml"), folder.path().join("map"));
    let lines = [
        "plan: bad",
        "steps:",
        "  keyframes:",
        "    op: keyframe",
        "    in: { odometry: odometry }",
        "  poses:",
        "    sql: SELECT site, session, stamp FROM odometry",
        "  lanes:",
        "    op: road_network",
        "    in: { poses: poses }",
        "    with: { conect_m: 2.0 }",
        "write: [lanes, keyframes]",
    ];
    std::fs::write(&plan, lines.join("\n")).unwrap();
    let told = evermap(&[
        "run",
        text(&plan),
        "--map",
        text(&map),
        "--sessions",
        "no_such.mcap",
    ])
    .expect(1);
    for needle in ["keyframes", "connect_m", ":4:", ":11:"] {
        assert!(
            told.stderr.contains(needle),
            "{needle} is not in {}",
            told.stderr
        );
    }
    assert!(!map.exists(), "a map was begun");
}

#[test]
fn a_query_that_every_run_would_refuse_is_refused_by_the_check() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("never.yaml");
    let open = "SELECT session, stamp FROM odometry WHERE session > $1";
    let interval = "SELECT session, INTERVAL '1 month' AS x FROM odometry";
    let around = "SELECT o.session, u.b FROM odometry o, LATERAL (SELECT o.stamp AS b LIMIT 1) u";
    for (query, at, said) in [
        (open, "$1", "has $1, which nobody gives a value"),
        (
            interval,
            "x FROM",
            "gives x as an interval, which Parquet cannot hold",
        ),
        (
            around,
            "SELECT o.session",
            "without columns of the query around it",
        ),
    ] {
        let steps = format!("plan: never\nsteps:\n  made:\n    sql: {query}\nwrite: [made]\n");
        std::fs::write(&plan, steps).unwrap();
        let told = evermap(&["check", text(&plan)]).expect(1).stderr;
        let column = "    sql: ".len() + query.find(at).unwrap() + 1;
        for needle in [said, &format!("never.yaml:4:{column}")] {
            assert!(told.contains(needle), "{needle}: {told}");
        }
    }
    // What is not kept need not be such that a file holds it.
    let steps = format!(
        "plan: never\nsteps:\n  made:\n    sql: {interval}\n  long:\n    \
         sql: SELECT session, extract(epoch FROM x) AS s FROM made\nwrite: [long]\n"
    );
    std::fs::write(&plan, steps).unwrap();
    evermap(&["check", text(&plan)]).expect(0);
}

#[test]
fn faults_of_queries_are_told_beside_those_of_the_text() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("both.yaml");
    let lines = [
        "plan: both",
        "steps:",
        "  lanes:",
        "    op: road_network",
        "    in: { poses: poses }",
        "    with: { conect_m: 2.0 }",
        "  poses:",
        "    sql: SELECT site, session, stamp, nothing AS map_from_vehicle FROM odometry",
        "  long: { sql: SELECT absent FROM lanes }",
        "  seen: { sql: 'SELECT missing FROM \"/cam\"' }",
        "write: [lanes, pose]",
    ];
    std::fs::write(&plan, lines.join("\n")).unwrap();
    let told = evermap(&["check", text(&plan)]).expect(1);
    for needle in ["conect_m", ":6:", "nothing", ":8:", "`pose`", ":11:"] {
        assert!(told.stderr.contains(needle), "{needle}: {}", told.stderr);
    }
    // What reads a step at fault, or a topic of logs that are not at hand, may be sound.
    for needle in ["absent", "missing"] {
        assert!(!told.stderr.contains(needle), "{needle}: {}", told.stderr);
    }
}

#[test]
fn rows_that_do_not_fit_a_test_are_told_and_end_no_other_test() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("fixtures.yaml");
    let lines = [
        "plan: fixtures",
        "steps:",
        "  poses: { sql: 'SELECT site, session, stamp, odom_from_vehicle AS map_from_vehicle FROM odometry' }",
        "  lanes: { op: road_network, in: { poses: poses } }",
        "write: [lanes]",
        "tests:",
        "  - name: lacking",
        "    given: { poses: [ { site: s, session: a, stamp: 0 } ] }",
        "    expect: { lanes: [] }",
        "  - name: wrong",
        "    given: { odometry: [ { site: s, session: a, stamp: soon } ] }",
        "    expect: { poses: [] }",
        "  - name: sound",
        "    given: { odometry: [] }",
        "    expect: { poses: [] }",
    ];
    std::fs::write(&plan, lines.join("\n")).unwrap();
    let lacking = "row 0 of `poses` has no `map_from_vehicle`, which step `lanes` needs; give `map_from_vehicle` a value";
    let wrong = "row 0 of `odometry` has \"soon\" in `stamp`, expected time";
    let told = evermap(&["check", text(&plan)]).expect(1).stderr;
    for needle in [
        format!("test `lacking`: {lacking}"),
        format!("test `wrong`: {wrong}"),
    ] {
        assert!(told.contains(&needle), "{needle}: {told}");
    }
    let tested = evermap(&["test", text(&plan)]).expect(1);
    for needle in [
        format!("FAILED  lacking: {lacking}"),
        format!("FAILED  wrong: {wrong}"),
        "ok      sound".to_owned(),
    ] {
        assert!(
            tested.stdout.contains(&needle),
            "{needle}: {}",
            tested.stdout
        );
    }
}

#[test]
fn a_table_that_does_not_fit_its_port_is_a_fault_of_the_plan() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("misfit.yaml");
    let lines = [
        "plan: misfit",
        "steps:",
        "  poses:",
        "    sql: SELECT site, session, stamp, 1.0 AS map_from_vehicle FROM odometry",
        "  lanes:",
        "    op: road_network",
        "    in: { poses: poses }",
        "write: [lanes]",
    ];
    std::fs::write(&plan, lines.join("\n")).unwrap();
    let told = evermap(&["check", text(&plan)]).expect(1);
    assert!(
        told.stderr.contains("map_from_vehicle") && told.stderr.contains(":5:"),
        "{}",
        told.stderr
    );
}

#[test]
fn a_query_of_the_version_before_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("query.yaml");
    let lines = [
        "plan: query",
        "steps:",
        "  poses:",
        "    sql: SELECT site, session, stamp, odom_from_vehicle AS map_from_vehicle FROM odometry",
        "  lanes: { op: road_network, in: { poses: previous.poses } }",
        "  more: { sql: SELECT * FROM previous.poses }",
        "write: [poses, lanes, more]",
    ];
    std::fs::write(&plan, lines.join("\n")).unwrap();
    let told = evermap(&["check", text(&plan)]).expect(1);
    let count = told.stderr.matches("is made by a query").count();
    assert_eq!(count, 2, "{}", told.stderr);
}

/// Each step reads the one before it twice: made anew for each, the first join of sixteen steps would be made 16,384 times.
const JOINED: &str = "SELECT a.site, a.session, a.stamp FROM {} a JOIN {} b ON a.stamp = b.stamp";

/// Each step is planned with all those beneath it that are not kept: of seventy, two are, and the last one.
const NUMBERED: &str = "SELECT site, session, stamp, row_number() OVER (PARTITION BY session ORDER BY stamp) AS n FROM {}";

#[test]
fn a_plan_of_many_steps_takes_time_by_their_number() {
    let folder = tempfile::tempdir().unwrap();
    let drive = folder.path().join("drive.mcap");
    let poses = rectangle(4.0, 2.0, 1.0);
    let messages = poses.len();
    write_drive(&drive, poses);
    for (name, query, steps, kept) in [("joined", JOINED, 16, 16), ("numbered", NUMBERED, 70, 3)] {
        let plan = folder.path().join(format!("{name}.yaml"));
        let map = folder.path().join(name);
        let first = "  s0: { sql: 'SELECT site, session, stamp FROM odometry' }";
        let mut lines = vec![format!("plan: {name}\nsteps:\n{first}")];
        for step in 1..steps {
            let query = query.replace("{}", &format!("s{}", step - 1));
            lines.push(format!("  s{step}: {{ sql: '{query}' }}"));
        }
        let last = format!("s{}", steps - 1);
        lines.push(format!("write: [{last}]\n"));
        std::fs::write(&plan, lines.join("\n")).unwrap();

        let given = ["--map", text(&map), "--sessions", text(&drive)];
        let explain = ["explain", text(&plan), "--format", "json"];
        let units = evermap(&[explain, given].concat()).expect(0).json();
        assert_eq!(units.as_array().unwrap().len(), kept, "{units}");
        let run = ["run", text(&plan), "--progress", "none"];
        evermap(&[run, given].concat()).expect(0);
        let count = format!("SELECT count(*) AS rows, count(DISTINCT stamp) AS stamps FROM {last}");
        let count = rows_of(&map, &count);
        let expected = serde_json::json!([{ "rows": messages, "stamps": messages }]);
        assert_eq!(count, expected, "{name}");
    }
}

#[test]
fn the_page_of_plans_names_every_table_of_a_session() {
    let page = page("docs/plans.md");
    let said = page.split("Sessions give the tables").nth(1).unwrap();
    let said = said.lines().next().unwrap();
    for role in evermap_schemas::roles::ALL {
        let name = format!("`{}`", role.name);
        assert!(said.contains(&name), "{name} is not in docs/plans.md");
    }
}

#[test]
fn the_page_of_plans_names_every_key() {
    let page = page("docs/plans.md");
    let schema = evermap(&["schema"]).expect(0).json();
    let mut keys = Vec::new();
    for at in [
        "/properties",
        "/$defs/step/properties",
        "/$defs/test/properties",
    ] {
        keys.extend(schema.pointer(at).unwrap().as_object().unwrap().keys());
    }
    assert!(keys.len() > 20, "{keys:?}");
    for key in keys {
        assert!(
            page.contains(&format!("`{key}`")),
            "{key} is not in docs/plans.md"
        );
    }
}

#[test]
fn the_plans_in_the_docs_check() {
    let docs = ["README.md", "docs/plans.md"].map(page).concat();
    let folder = tempfile::tempdir().unwrap();
    let plans: Vec<_> = docs.split("```yaml\n").skip(1).collect();
    assert_eq!(plans.len(), 2);
    for (number, plan) in plans.iter().enumerate() {
        let path = folder.path().join(format!("plan_{number}.yaml"));
        std::fs::write(&path, plan.split("```").next().unwrap()).unwrap();
        evermap(&["check", text(&path)]).expect(0);
    }
}
