//! The mistakes that people make most, and what they are told: a golden file for each kind of person. A line that starts
//! with `$` is what they typed; the exit status and all that the program said stand below it.
//! `EVERMAP_BLESS=1 cargo test --test end_to_end mistakes` rewrites them.

use std::path::Path;

use evermap_tests::json_log::JsonLog;
use evermap_tests::{Finished, command, plan_command, program, rectangle, repository, write_drive};

/// What lies in the folder where they work: logs, a map, plans.
fn furnish(folder: &Path) {
    let file = |name: &str, content: &[u8]| std::fs::write(folder.join(name), content).unwrap();
    let drive = folder.join("monday.mcap");
    write_drive(&drive, rectangle(30.0, 20.0, 1.0));
    std::fs::create_dir(folder.join("elsewhere")).unwrap();
    write_drive(
        &folder.join("elsewhere/monday.mcap"),
        rectangle(20.0, 10.0, 1.0),
    );
    let whole = std::fs::read(&drive).unwrap();
    file("torn.mcap", &whole[..whole.len() * 2 / 3]);
    file("empty.mcap", b"");
    file("drive.bag", b"#ROSBAG V2.0\n");
    file("drive.db3", b"SQLite format 3\0");
    file(
        "wrong.yaml",
        b"sessions:\n  - { name: monday, file: monday.mcap }\n",
    );
    let mut blind = JsonLog::new(&folder.join("blind.mcap"));
    blind.topic("/front", "sensor_msgs/Image", b"{}");
    blind.finish();
    for (name, plan) in PLANS {
        file(name, plan.as_bytes());
    }
    let mut mapped = plan_command(
        "trajectory",
        &folder.join("lot"),
        "lot",
        &["--sessions", "monday.mcap"],
    );
    Finished::from(mapped.current_dir(folder).output().unwrap()).expect(0);
}

const PLANS: [(&str, &str); 12] = [
    (
        "tab.yaml",
        "plan: tab\nsteps:\n\tkeyframes: { op: keyframes }\nwrite: [keyframes]\n",
    ),
    (
        "operator.yaml",
        "plan: operator\nsteps:\n  keyframes: { op: keyframe }\nwrite: [keyframes]\n",
    ),
    (
        "port.yaml",
        "plan: port\nsteps:\n  keyframes: { op: keyframes, in: { odom: odometry } }\nwrite: [keyframes]\n",
    ),
    (
        "parameter.yaml",
        "plan: parameter\nsteps:\n  keyframes:\n    op: keyframes\n    with: { baseline_m: \"0.2\", baselin_m: 1 }\nwrite: [keyframes]\n",
    ),
    (
        "cycle.yaml",
        "plan: cycle\nsteps:\n  a: { sql: SELECT * FROM b }\n  b: { sql: SELECT * FROM a }\nwrite: [a]\n",
    ),
    (
        "write.yaml",
        "plan: write\nsteps:\n  keyframes: { op: keyframes }\nwrite: [keyframe]\n",
    ),
    (
        "query.yaml",
        "plan: query\nsteps:\n  keyframes: { op: keyframes }\n  far:\n    sql: >\n      SELECT stamp, distance\n      FROM keyframes\nwrite: [far]\n",
    ),
    (
        "random.yaml",
        "plan: random\nsteps:\n  some: { sql: SELECT stamp FROM odometry ORDER BY random() LIMIT 3 }\nwrite: [some]\n",
    ),
    (
        "source.yaml",
        "plan: source\nsteps:\n  odometry: { op: keyframes }\nwrite: [odometry]\n",
    ),
    (
        "columns.yaml",
        "plan: columns\nsteps:\n  poses: { sql: SELECT site, session FROM odometry }\n  map_frames: { op: map_frames }\nwrite: [map_frames]\n",
    ),
    (
        "wrong.test.yaml",
        "plan: wrong\nsteps:\n  speeds: { op: speeds }\n  fast: { sql: SELECT stamp FROM speeds WHERE speed_mps > 1 }\nwrite: [fast]\ntests:\n  - name: one is fast\n    given:\n      speeds:\n        - { stamp: 0, speed_mps: 0.5 }\n        - { stamp: 1, speed_mps: 1.5 }\n    expect:\n      fast:\n        - { stamp: 0 }\n",
    ),
    (
        "column.test.yaml",
        "plan: column\nsteps:\n  speeds: { op: speeds }\nwrite: [speeds]\ntests:\n  - name: nothing\n    expect:\n      speeds:\n        - { speed: 0.0 }\n",
    ),
];

/// The words of a line, as a shell has them.
fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (index, part) in line.split('"').enumerate() {
        match index % 2 {
            0 => words.extend(part.split_whitespace().map(str::to_owned)),
            _ => words.push(part.to_owned()),
        }
    }
    words
}

/// A line that says how long a run took, without that.
fn without_duration(line: &str) -> &str {
    match line.starts_with("version ") {
        true => line.split(", in ").next().unwrap_or(line),
        false => line,
    }
}

/// The golden text with what the program says now.
fn told(golden: &str, folder: &Path) -> String {
    let mut told = String::new();
    for line in golden.lines().filter(|line| line.starts_with(['#', '$'])) {
        let Some(typed) = line.strip_prefix("$ evermap ") else {
            told.push_str(&format!("{line}\n"));
            continue;
        };
        let words = words(typed);
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let mut typed = command(&words);
        let typed = typed.current_dir(folder).env("COLUMNS", "120");
        let Finished {
            code,
            stdout,
            stderr,
        } = typed.output().unwrap().into();
        // Rows that came out are no message.
        let stdout = if code == 0 || code == 3 {
            String::new()
        } else {
            stdout
        };
        let said = format!("{stdout}{stderr}").replace(&folder.display().to_string(), "FOLDER");
        let said = said.replace(&program().display().to_string(), "evermap");
        let lines = said.lines().map(without_duration);
        let said = lines.collect::<Vec<_>>().join("\n");
        told.push_str(&format!(
            "\n{line}\nexit status {code}\n{}\n",
            said.trim_end()
        ));
    }
    told
}

#[test]
fn people_are_told_what_is_wrong_and_what_helps() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().canonicalize().unwrap();
    furnish(&folder);
    for person in ["engineer", "analyst", "developer"] {
        let path = repository().join(format!("tests/mistakes/{person}.txt"));
        let golden = std::fs::read_to_string(&path).unwrap();
        let found = told(&golden, &folder);
        if std::env::var_os("EVERMAP_BLESS").is_some() {
            std::fs::write(&path, &found).unwrap();
        }
        let golden = std::fs::read_to_string(&path).unwrap();
        assert_eq!(found, golden, "{}", path.display());
    }
}
