//! A map over time: sessions join, what is unchanged is kept, a killed run leaves nothing half done.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, SystemTime};

use evermap_tests::server::script;
use evermap_tests::{
    Finished, command, command_that_hangs_up, evermap, layers_of, program, rectangle, repository,
    rows_of, text, until_rested, write_drive, write_drive_with,
};
use serde_json::{Value, json};

const PLAN: &str = "trajectory";

/// The digests of a map's layers, by name.
fn digests(map: &Path) -> Vec<(String, String)> {
    let layers = layers_of(map);
    let digest = |layer: &Value| {
        (
            layer["layer"].as_str().unwrap().to_owned(),
            layer["digest"].as_str().unwrap().to_owned(),
        )
    };
    layers.as_array().unwrap().iter().map(digest).collect()
}

fn run(map: &Path, sessions: &[&Path]) -> Finished {
    evermap_tests::run(PLAN, map, sessions, &[])
}

/// Two drives of different lengths, `a` and `b`.
fn two_drives(folder: &Path) -> [PathBuf; 2] {
    let drives = ["a.mcap", "b.mcap"].map(|name| folder.join(name));
    write_drive(&drives[0], rectangle(20.0, 10.0, 1.0));
    write_drive(&drives[1], rectangle(30.0, 15.0, 1.5));
    drives
}

#[test]
fn a_second_session_recomputes_only_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let ([a, b], map) = (two_drives(folder.path()), folder.path().join("map"));
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
    let computed = rows_of(
        &map,
        "SELECT DISTINCT coalesce(session, site) AS of FROM runs WHERE version = 2 AND NOT cached",
    );
    assert_eq!(computed, serde_json::json!([{ "of": "b" }]));
    let sessions = rows_of(&map, "SELECT DISTINCT session FROM poses ORDER BY session");
    assert_eq!(
        sessions,
        serde_json::json!([{ "session": "a" }, { "session": "b" }])
    );
}

#[test]
fn what_a_run_was_at_work_on_can_be_seen() {
    let folder = tempfile::tempdir().unwrap();
    let (a, map) = (folder.path().join("a.mcap"), folder.path().join("map"));
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    run(&map, &[&a]).expect(0);
    let analyze = |plan| {
        let words = ["explain", plan, "--map", text(&map), "--analyze"];
        evermap(&[&words[..], &["--format", "json"]].concat())
    };
    let work = analyze(PLAN).expect(0).json();
    let work = work.as_array().unwrap();
    let of = |node: &str, of: Value| {
        let found = work
            .iter()
            .find(|row| row["node"] == node && row["of"] == of);
        found.unwrap_or_else(|| panic!("{node} of {of}: {work:?}"))
    };
    let scan = of("DataSourceExec", "odometry".into());
    assert!(scan["bytes"].as_u64().unwrap() > 0 && scan["rows"].as_u64().unwrap() > 0);
    assert!(
        of("OperatorExec", "keyframes".into())["seconds"]
            .as_f64()
            .unwrap()
            > 0.0
    );
    assert!(of("ParquetWriter", Value::Null)["bytes"].as_u64().unwrap() > 0);
    let seconds = work.iter().map(|row| row["seconds"].as_f64().unwrap());
    assert!(seconds.is_sorted_by(|before, after| before >= after));

    let other = analyze("speed").expect(1).stderr;
    assert!(
        other.contains("plan speed made no version of this map"),
        "{other}"
    );
}

#[test]
fn a_run_that_changes_nothing_publishes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (a, map) = (folder.path().join("a.mcap"), folder.path().join("map"));
    write_drive(&a, rectangle(20.0, 10.0, 1.0));
    run(&map, &[&a]).expect(0);
    let before = digests(&map);
    let records = || {
        let records = std::fs::read_dir(map.join("runs")).unwrap();
        records
            .map(|record| record.unwrap().path())
            .collect::<Vec<_>>()
    };
    let first = records();
    run(&map, &[&a]).expect(0);
    assert_eq!(digests(&map), before);
    let versions = rows_of(&map, "SELECT version FROM versions");
    assert_eq!(versions.as_array().unwrap().len(), 1);
    // What was done is told once; a version of which nobody tells is told of.
    assert_eq!((records(), first.len()), (first.clone(), 1));
    std::fs::remove_file(&first[0]).unwrap();
    run(&map, &[&a]).expect(0);
    assert_eq!(records().len(), 1);
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
    // Later each time, and not by the clock: how fast runs are does not matter.
    for done in [1, 4, 9, 15] {
        let mut child = command(&arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("evermap starts");
        while receipts(&killed) < done {
            assert!(
                child.try_wait().unwrap().is_none(),
                "it ended before its killer came"
            );
            std::thread::sleep(Duration::from_millis(5));
        }
        child.kill().expect("a process can be killed");
        child.wait().unwrap();
        whole_or_nothing(&killed, sessions.len());
    }
    let kept = receipts(&killed);
    let said = run(&killed, &sessions).expect(0).stderr;
    assert!(
        said.contains(&format!(", {kept} reused")),
        "{kept} were done: {said}"
    );
    assert_eq!(digests(&killed), digests(&undisturbed));
}

/// Logs that a map remembers, with when each was.
fn remembered(map: &Path) -> Vec<(PathBuf, SystemTime)> {
    let entries = std::fs::read_dir(map.join("logs"));
    let entries = entries.into_iter().flatten().map(Result::unwrap);
    let since = |path: &Path| path.metadata().unwrap().modified().unwrap();
    let mut found: Vec<_> = entries
        .map(|entry| (entry.path(), since(&entry.path())))
        .collect();
    found.sort();
    found
}

#[test]
fn a_run_that_is_killed_while_it_reads_logs_reads_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [small, large] = ["a", "b"].map(|name| folder.path().join(format!("{name}.mcap")));
    write_drive(&small, rectangle(40.0, 30.0, 1.0));
    // Long to read, so that the run is killed before it has.
    write_drive_with(&large, rectangle(50.0, 30.0, 1.0), &vec![0; 256 << 20]);
    let logs = [text(&small), text(&large)];
    let at = |map: &Path, command: &str, plan: &str| {
        let mut line = vec![command, plan, "--map", text(map), "--sessions"];
        line.extend(logs);
        self::command(&line)
    };
    for log in [&small, &large] {
        until_rested(log);
    }
    let map = folder.path().join("map");
    let ended = |mut command: Command| Finished::from(command.output().unwrap());
    ended(at(&map, "run", "lifelong")).expect(1);
    assert!(!map.exists(), "a run that is refused begins no map");
    ended(at(&map, "explain", PLAN)).expect(0);
    assert!(!map.exists(), "who only looks begins no map");

    let mut run = at(&map, "run", PLAN);
    let run = run.stdout(Stdio::null()).stderr(Stdio::null());
    let mut run = run.spawn().unwrap();
    while remembered(&map).is_empty() {
        assert!(run.try_wait().unwrap().is_none(), "it ended before");
        std::thread::sleep(Duration::from_millis(1));
    }
    run.kill().unwrap();
    run.wait().unwrap();
    let kept = remembered(&map);
    assert_eq!(kept.len(), 1, "it had read both");
    ended(at(&map, "run", PLAN)).expect(0);
    let all = remembered(&map);
    assert!(all.len() == 2 && all.contains(&kept[0]), "{kept:?} {all:?}");
}

/// A run on two logs, `a.mcap` and `b.mcap`, the first of which is disturbed between its digest and its rows.
fn disturbed(folder: &Path, disturb: impl FnOnce(&Path)) -> Finished {
    let [small, large, map] = ["a.mcap", "b.mcap", "map"].map(|name| folder.join(name));
    write_drive(&small, rectangle(40.0, 30.0, 1.0));
    // Long to read.
    write_drive_with(&large, rectangle(50.0, 30.0, 1.0), &vec![0; 256 << 20]);
    let line = ["run", PLAN, "--map", text(&map), "--progress", "none"];
    let logs = ["--sessions", text(&small), text(&large)];
    let mut run = command(&[&line[..], &logs].concat());
    let run = run.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut run = run.spawn().unwrap();
    while remembered(&map).is_empty() {
        assert!(run.try_wait().unwrap().is_none(), "it ended before");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(remembered(&map).len(), 1, "it had read both");
    disturb(&small);
    run.wait_with_output().unwrap().into()
}

/// What is mapped would be found done for the first log whenever that comes again.
#[test]
fn a_log_that_is_replaced_during_a_run_is_not_mapped_as_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let within = |name: &str| folder.path().join(name);
    let [small, large, map, other] = ["a.mcap", "b.mcap", "map", "other"].map(within);
    write_drive(&other, rectangle(30.0, 40.0, 1.0));
    let replace = |log: &Path| std::fs::rename(&other, log).unwrap();
    let said = disturbed(folder.path(), replace).expect(1).stderr;
    assert!(
        said.contains("session a") && said.contains("the file changed"),
        "{said}"
    );
    assert!(!map.join("versions/1.json").exists());

    run(&map, &[&small, &large]).expect(0);
    let anew = within("anew");
    run(&anew, &[&small, &large]).expect(0);
    assert_eq!(digests(&map), digests(&anew));
}

#[test]
fn of_a_log_that_grows_during_a_run_is_mapped_what_there_was() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    let within = |name: &str| folder.path().join(name);
    let was = within("was");
    std::fs::create_dir(&was).unwrap();
    let grow = |log: &Path| {
        std::fs::copy(log, was.join("a.mcap")).unwrap();
        let mut log = std::fs::File::options().append(true).open(log).unwrap();
        log.write_all(b"what comes next").unwrap();
    };
    disturbed(folder.path(), grow).expect(0);
    let undisturbed = within("undisturbed");
    run(&undisturbed, &[&was.join("a.mcap"), &within("b.mcap")]).expect(0);
    assert_eq!(digests(&within("map")), digests(&undisturbed));
}

/// A run on drives that take a while, by this program or what starts it, once a unit is done.
fn begun(command: &mut Command, folder: &Path, map: &Path) -> Child {
    let run = ["run", PLAN, "--progress", "none", "--map", text(map)];
    command.args(run).arg("--sessions");
    for index in 0..8 {
        let drive = folder.join(format!("drive_{index}.mcap"));
        write_drive(&drive, rectangle(40.0 + f64::from(index), 30.0, 20.0));
        command.arg(drive);
    }
    let command = command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut run = command.spawn().expect("evermap starts");
    while receipts(map) == 0 {
        assert!(run.try_wait().unwrap().is_none(), "it ended before");
        std::thread::sleep(Duration::from_millis(5));
    }
    run
}

fn hang_up(run: &Child) {
    let id = run.id().to_string();
    let sent = Command::new("kill").args(["-HUP", &id]).status();
    assert!(sent.unwrap().success());
}

#[test]
fn a_hangup_stops_a_run_as_a_person_does_unless_it_is_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("stopped");
    let run = begun(&mut command_that_hangs_up(&[]), folder.path(), &map);
    hang_up(&run);
    let ended = Finished::from(run.wait_with_output().unwrap()).expect(1);
    assert!(
        ended.stderr.contains("goes on where this one stopped"),
        "{}",
        ended.stderr
    );
    let leases = std::fs::read_dir(map.join("leases")).unwrap().count();
    assert_eq!(leases, 0);

    let map = folder.path().join("ignored");
    let mut ignoring = Command::new("env");
    ignoring.arg("--ignore-signal=HUP").arg(program());
    let ignoring = ignoring.current_dir(repository());
    let run = begun(ignoring, folder.path(), &map);
    hang_up(&run);
    Finished::from(run.wait_with_output().unwrap()).expect(0);
}

#[test]
fn a_prompt_that_is_hung_up_or_terminated_leaves_nothing() {
    let Some(mut prompt) = script("prompt.py", &[]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    write_drive(&log, rectangle(20.0, 10.0, 1.0));
    prompt.arg(program()).arg(log);
    Finished::from(prompt.output().unwrap()).expect(0);
}

/// Whatever it is at: the world is built, its truth is written, images are rendered.
#[test]
fn a_simulation_that_is_terminated_leaves_nothing_unfinished() {
    let folder = tempfile::tempdir().unwrap();
    for delay_ms in [300, 600, 900, 2000] {
        let out = folder.path().join(delay_ms.to_string());
        let mut simulate = command(&["simulate", "car_park", "--out", text(&out)]);
        let simulate = simulate.stderr(Stdio::piped()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(delay_ms));
        let id = simulate.id().to_string();
        let asked = Command::new("kill").args(["-TERM", &id]).status();
        assert!(asked.unwrap().success());
        let ended = Finished::from(simulate.wait_with_output().unwrap());
        ended.expect(1);
        let left = std::fs::read_dir(&out).into_iter().flatten();
        let left = left.map(|entry| entry.unwrap().file_name());
        let left: Vec<_> = left.filter(|name| name != "truth").collect();
        assert!(left.is_empty(), "{delay_ms} ms: {left:?}");
    }
}

/// What a shell has redirected is written to, as by other programs, and what is in front of it stays.
#[test]
fn what_standard_output_is_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    write_drive(&log, rectangle(20.0, 10.0, 1.0));
    let file = folder.path().join("rows.csv");
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(
        r#"set -e; { echo first; "$1" sql --sessions "$2" --query "SELECT 7 AS n" --format csv --out /dev/stdout; echo last; } > "$3""#,
    );
    shell.arg("sh").arg(program()).args([&log, &file]);
    Finished::from(shell.output().unwrap()).expect(0);
    assert!(Path::new("/dev/stdout").is_symlink());
    let written = std::fs::read_to_string(file).unwrap();
    assert_eq!(written, "first\nn\n7\nlast\n");
}

/// Units that are done.
fn receipts(map: &Path) -> usize {
    std::fs::read_dir(map.join("receipts")).map_or(0, Iterator::count)
}

/// A reader sees no version at all, or one with every session in every layer.
fn whole_or_nothing(map: &Path, sessions: usize) {
    if !map.join("versions/1.json").exists() {
        return;
    }
    let counted = rows_of(map, "SELECT count(DISTINCT session) AS n FROM poses");
    assert_eq!(counted[0]["n"], sessions);
    rows_of(map, "SELECT count(*) FROM lanes");
}

#[test]
fn a_recording_that_is_split_makes_the_map_of_one_that_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let drive = rectangle(40.0, 30.0, 2.0);
    let whole = folder.path().join("drive.mcap");
    write_drive(&whole, drive.clone());
    let undivided = folder.path().join("undivided");
    run(&undivided, &[&whole]).expect(0);

    // As rosbag2 leaves it: a folder of the recording's name, with numbered files and a list of them.
    let split = folder.path().join("drive");
    std::fs::create_dir(&split).unwrap();
    let mut names = Vec::new();
    for (number, poses) in drive.chunks(drive.len() / 11).enumerate() {
        let name = format!("drive_{number}.mcap");
        write_drive(&split.join(&name), poses.iter().copied());
        names.push(name);
    }
    assert!(names.len() > 10, "a tenth part comes behind a second");
    let listed =
        serde_json::json!({ "rosbag2_bagfile_information": { "relative_file_paths": names } });
    std::fs::write(split.join("metadata.yaml"), listed.to_string()).unwrap();
    let parted = folder.path().join("parted");
    run(&parted, &[&split]).expect(0);
    assert_eq!(digests(&parted), digests(&undivided));
}

#[test]
fn versions_stay_readable_differ_and_are_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let ([a, b], map) = (two_drives(folder.path()), folder.path().join("map"));
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
        rows_of(&map, "SELECT DISTINCT version FROM runs"),
        serde_json::json!([{ "version": 2 }])
    );
    assert_eq!(
        rows_of(&map, "SELECT count(DISTINCT session) AS n FROM poses"),
        serde_json::json!([{ "n": 2 }])
    );
}

/// Reading a pipe would wait for ever; a log that is gone may be one that somebody counts on.
#[test]
fn what_is_no_file_among_logs_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let logs = folder.path().join("logs");
    std::fs::create_dir(&logs).unwrap();
    write_drive(&logs.join("a.mcap"), rectangle(20.0, 10.0, 1.0));
    std::os::unix::fs::symlink("nowhere", logs.join("gone.mcap")).unwrap();
    let pipe = std::process::Command::new("mkfifo")
        .arg(logs.join("pipe.mcap"))
        .status();
    assert!(pipe.unwrap().success());
    // No line says these.
    let unsaid = [&b"b\xff.mcap"[..], b"t\t.mcap"].map(|name| logs.join(OsStr::from_bytes(name)));
    for name in &unsaid {
        std::fs::copy(logs.join("a.mcap"), name).unwrap();
    }
    for (name, given) in [("folder", logs.clone()), ("pattern", logs.join("*.mcap"))] {
        let map = folder.path().join(name);
        let told = run(&map, &[&given]).expect(3).stderr;
        for name in ["gone.mcap", "pipe.mcap", "b\\xFF.mcap", "t\\t.mcap"] {
            let said = format!("{name}: files that cannot be read");
            assert!(told.contains(&said), "{said}: {told}");
        }
        assert_eq!(
            rows_of(&map, "SELECT DISTINCT session FROM poses"),
            serde_json::json!([{ "session": "a" }])
        );
    }
    for name in unsaid
        .iter()
        .chain(&["a.mcap", "gone.mcap"].map(|name| logs.join(name)))
    {
        std::fs::remove_file(name).unwrap();
    }
    let refused = run(&folder.path().join("none"), &[&logs]).expect(1).stderr;
    assert!(refused.contains("found a named pipe"), "{refused}");
}

/// The system ends who writes beyond the limit, unless somebody listens.
#[test]
fn a_limit_of_file_sizes_is_told_and_leaves_nothing_half_written() {
    let folder = tempfile::tempdir().unwrap();
    let within = |name: &str| folder.path().join(name);
    let (map, log) = (within("map"), within("a.mcap"));
    write_drive(&log, rectangle(60.0, 40.0, 1.0));
    let refused = |arguments: &[&str]| {
        let mut shell = Command::new("sh");
        // Of 512 bytes each, or of 1024.
        shell.args(["-c", "ulimit -f 4; exec \"$0\" \"$@\""]);
        shell.arg(program()).args(arguments);
        let ended = Finished::from(shell.current_dir(repository()).output().unwrap());
        let told = ended.expect(1).stderr;
        assert!(told.contains("File too large"), "{arguments:?}: {told}");
    };
    let mapped = ["run", PLAN, "--map", text(&map), "--progress", "none"];
    refused(&[&mapped[..], &["--sessions", text(&log)]].concat());
    let left = std::fs::read_dir(map.join("tmp")).into_iter().flatten();
    assert_eq!(left.count(), 0);
    run(&map, &[&log]).expect(0);

    let (rows, recording) = (within("poses.csv"), within("recording.mcap"));
    let export = ["export", "--map", text(&map), "--out"];
    refused(&[&export[..], &[text(&rows), "poses", "--format", "csv"]].concat());
    refused(&[&export[..], &[text(&recording), "--format", "mcap"]].concat());
    let there = std::fs::read_dir(folder.path()).unwrap();
    let mut there: Vec<_> = there.map(|entry| entry.unwrap().file_name()).collect();
    there.sort();
    assert_eq!(there, ["a.mcap", "map"]);
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
    let poses = rows_of(&map, "SELECT count(*) AS n FROM poses");
    assert!(poses[0]["n"].as_u64().unwrap() > 100, "{poses}");
}

#[test]
fn a_plan_reads_the_version_before() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = two_drives(folder.path());
    let (plan, map) = (folder.path().join("growth.yaml"), folder.path().join("map"));
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
    let run = |session: &Path| evermap_tests::run(text(&plan), &map, &[session], &[]);
    run(&a).expect(0);
    let first = rows_of(&map, "SELECT now, before FROM growth");
    assert_eq!(first[0]["before"], 0);
    run(&b).expect(0);
    let second = rows_of(&map, "SELECT now, before FROM growth");
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

/// What a lane was made from is found step by step, back to the messages of the logs; of one session alone where one is asked for.
#[test]
fn rows_are_traced_back_to_the_messages_of_logs() {
    let folder = tempfile::tempdir().unwrap();
    let map = evermap_tests::server::map(folder.path());
    let rows = |query: &str| rows_of(&map, query);
    let all = rows("SELECT * FROM lineage('lanes')");
    let all = all.as_array().unwrap();
    let named = |name: &str| {
        all.iter()
            .filter(|one| one["name"] == name)
            .collect::<Vec<_>>()
    };
    let (lanes, logs) = (named("lanes"), named("odometry"));
    assert_eq!((lanes.len(), lanes[0]["entry"].as_u64()), (1, Some(0)));
    let computed = lanes[0]["computed"][0].as_str().unwrap();
    assert!(computed.starts_with("lanes: road_network "), "{computed}");
    assert_eq!(logs.len(), 2, "{all:?}");
    for (log, session) in logs.iter().zip(["monday", "tuesday"]) {
        assert_eq!(log["session"], session);
        assert_eq!(log["topics"], json!(["/odom"]));
        assert_eq!(log["files"], json!([format!("{session}.mcap")]));
    }
    // Each entry but those asked for is what another one was made from.
    let mut reached: Vec<u64> = vec![0];
    for one in all {
        let from = one["made_from"].as_array().unwrap();
        reached.extend(from.iter().filter_map(serde_json::Value::as_u64));
    }
    reached.sort_unstable();
    reached.dedup();
    assert_eq!(reached, (0..all.len() as u64).collect::<Vec<_>>());

    let monday = rows(
        "SELECT DISTINCT session, messages FROM lineage('lanes', 'monday') WHERE messages IS NOT NULL",
    );
    assert_eq!(monday.as_array().unwrap().len(), 1, "{monday}");
    let messages = monday[0]["messages"].as_str().unwrap();
    let count = |of: &str| rows(&format!("SELECT count(*) AS n FROM ({of})"))[0]["n"].as_u64();
    assert_eq!(count(messages), count("SELECT * FROM monday.\"/odom\""));

    for (query, told) in [
        ("FROM lineage('lane')", "did you mean `lanes`?"),
        ("FROM lineage('lanes', 'mondays')", "did you mean `monday`?"),
        (
            "FROM lineage(lanes)",
            "the name of a layer, such as 'lanes'",
        ),
    ] {
        let refused = evermap(&["sql", "--map", text(&map), query]).expect(1);
        assert!(refused.stderr.contains(told), "{}", refused.stderr);
    }
}

/// What two sites have none of is equal, and yet each site's own.
#[test]
fn sites_without_rows_are_traced_apart() {
    let folder = tempfile::tempdir().unwrap();
    let logs = ["north", "south"].map(|name| folder.path().join(format!("{name}.mcap")));
    for log in &logs {
        write_drive(log, rectangle(30.0, 20.0, 1.0));
    }
    let map = folder.path().join("map");
    run(&map, &[&logs[0], &logs[1]]).expect(0);
    let all = rows_of(&map, "SELECT * FROM lineage('intersections')");
    let named = |name: &'static str| {
        let all = all.as_array().unwrap().iter();
        all.filter(move |one| one["name"] == name)
    };
    assert_eq!(named("intersections").count(), 2, "{all}");
    for one in named("intersections") {
        assert_eq!(one["rows"], 0);
        let from = one["made_from"].as_array().unwrap();
        let lanes = named("lanes").filter(|lanes| from.contains(&lanes["entry"]));
        let sites: Vec<_> = lanes.map(|lanes| lanes["site"].clone()).collect();
        assert_eq!(sites, [one["site"].clone()], "{all}");
    }
}
