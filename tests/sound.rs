//! A map whose files were damaged, torn or lost: it is noticed, said, and made anew.

use std::path::{Path, PathBuf};

use evermap_tests::{
    Finished, command, evermap, program, rectangle, rows_of, run, text, write_drive,
};
use serde_json::{Value, json};
use tempfile::TempDir;

/// A map of two versions, the second with a drive more than the first.
struct Mapped {
    folder: TempDir,
    map: PathBuf,
}

impl Mapped {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let map = folder.path().join("map");
        let mapped = Self { folder, map };
        for (name, width_m) in [("a", 20.0), ("b", 30.0)] {
            write_drive(&mapped.log(name), rectangle(width_m, 15.0, 1.0));
            mapped.run(name).expect(0);
        }
        mapped
    }

    fn log(&self, name: &str) -> PathBuf {
        self.folder.path().join(format!("{name}.mcap"))
    }

    fn run(&self, session: &str) -> Finished {
        run("trajectory", &self.map, &[&self.log(session)], &[])
    }

    fn evermap(&self, command: &str, more: &[&str]) -> Finished {
        let mut arguments = vec![command, "--map", text(&self.map)];
        arguments.extend(more);
        evermap(&arguments)
    }

    fn query(&self, sql: &str) -> Value {
        rows_of(&self.map, sql)
    }

    /// The artifacts of a layer of version 2.
    fn artifacts(&self, layer: &str) -> Vec<PathBuf> {
        let version = std::fs::read(self.map.join("versions/2.json")).unwrap();
        let version: Value = serde_json::from_slice(&version).unwrap();
        let artifacts = version["layers"][layer]["artifacts"].as_array().unwrap();
        let path = |artifact: &Value| {
            let content = artifact["content"].as_str().unwrap();
            self.map.join(format!("artifacts/{content}.parquet"))
        };
        artifacts.iter().map(path).collect()
    }
}

fn name(path: &Path) -> &str {
    path.file_name().unwrap().to_str().unwrap()
}

/// Turns 200 bytes over in the middle of a file; its size stays.
fn flip(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    let many = 200.min(middle);
    for byte in &mut bytes[middle - many / 2..middle + many / 2] {
        *byte ^= 0xff;
    }
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn an_artifact_that_was_emptied_is_said_and_made_anew() {
    let mapped = Mapped::new();
    let poses = mapped.query("SELECT count(*) AS n FROM poses");
    let emptied = &mapped.artifacts("poses")[0];
    let bytes = std::fs::metadata(emptied).unwrap().len();
    std::fs::write(emptied, "").unwrap();
    let said = format!("{}: expected {bytes} bytes, found 0 bytes", name(emptied));

    let asked = mapped
        .evermap("sql", &["SELECT count(*) FROM poses"])
        .expect(1);
    assert!(asked.stderr.contains(&said), "{}", asked.stderr);
    let exported = [
        "export",
        "poses",
        "--map",
        text(&mapped.map),
        "--format",
        "csv",
        "--out",
    ];
    let out = mapped.folder.path().join("poses.csv");
    let exported: Finished = command(&exported).arg(&out).output().unwrap().into();
    assert!(exported.expect(1).stderr.contains(&said) && !out.exists());
    let listed = mapped.evermap("layers", &[]).expect(3);
    assert!(listed.stderr.contains(&said), "{}", listed.stderr);
    // What does not read it is as before.
    mapped.query("SELECT count(*) FROM lanes");
    mapped.query("SELECT layer FROM layers");

    let ran = mapped.run("b").expect(0);
    assert!(ran.stderr.contains(&said), "{}", ran.stderr);
    assert!(ran.stderr.contains("1 unit computed"), "{}", ran.stderr);
    assert_eq!(mapped.query("SELECT count(*) AS n FROM poses"), poses);
    mapped.evermap("verify", &[]).expect(0);
}

#[test]
fn flipped_bytes_are_not_built_upon() {
    let mapped = Mapped::new();
    let layers = mapped.evermap("layers", &[]).expect(0).stdout;
    // What was found right once is not read again, so it is turned over afterwards.
    mapped.run("b").expect(0);
    let flipped = mapped.artifacts("keyframes");
    flipped.iter().for_each(|path| flip(path));

    let log = mapped.log("b");
    let more = [
        "--format",
        "json",
        "--sessions",
        text(&log),
        "--map",
        text(&mapped.map),
    ];
    let explain = evermap(&[&["explain", "trajectory"][..], &more].concat());
    let explain = explain.expect(0).json();
    let units = explain.as_array().unwrap().iter();
    let anew: Vec<&Value> = units.filter(|unit| unit["recompute"] == true).collect();
    assert!(
        anew.iter()
            .any(|unit| unit["why"].as_str().unwrap().contains(name(&flipped[0]))),
        "{explain}"
    );

    let found = mapped
        .evermap("verify", &["--format", "json"])
        .expect(1)
        .json();
    let findings = found.as_array().unwrap();
    assert_eq!(findings.len(), flipped.len(), "{found}");
    for finding in findings {
        assert_eq!(finding["state"], "damaged", "{finding}");
        let by = finding["needed_by"].as_str().unwrap();
        assert!(by.contains("keyframes"), "{finding}");
    }

    let ran = mapped.run("b").expect(0);
    for path in &flipped {
        let said = format!("{}: expected the digest", name(path));
        assert!(ran.stderr.contains(&said), "{}", ran.stderr);
    }
    mapped.evermap("verify", &[]).expect(0);
    assert_eq!(mapped.evermap("layers", &[]).expect(0).stdout, layers);
}

/// What reads Parquet believes much of what a file says of itself: an artifact that was changed since it was published is not
/// given to it, whichever byte it was.
#[test]
fn a_query_reads_nothing_that_was_changed_since() {
    let mapped = Mapped::new();
    let path = &mapped.artifacts("lanes")[0];
    let whole = std::fs::read(path).unwrap();
    let written = std::fs::metadata(path).unwrap().modified().unwrap();
    let query = "SELECT site, lane, length_m FROM lanes ORDER BY site, lane";
    let lanes = mapped.query(query);
    for at in (0..whole.len())
        .step_by(whole.len() / 25)
        .chain(whole.len() - 8..whole.len())
    {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x7f;
        std::fs::write(path, &bytes).unwrap();
        let asked = mapped.evermap("sql", &["SELECT * FROM lanes"]);
        let refused = asked.expect(1).stderr;
        assert!(refused.contains("expected the digest"), "{at}: {refused}");
    }
    mapped.evermap("verify", &[]).expect(1);
    // As a disk flips a bit, of the length that a reader believes: nothing else tells.
    let mut bytes = whole.clone();
    bytes[whole.len() - 5] ^= 0x80;
    std::fs::write(path, &bytes).unwrap();
    let file = std::fs::File::options().write(true).open(path).unwrap();
    file.set_modified(written).unwrap();
    let refused = mapped.evermap("sql", &["SELECT * FROM lanes"]).expect(1);
    let told = "expected the end of a Parquet file";
    assert!(refused.stderr.contains(told), "{}", refused.stderr);
    // Written elsewhere, and set back: that it was written tells.
    let mut bytes = whole.clone();
    bytes[whole.len() / 2] ^= 0x7f;
    std::fs::write(path, &bytes).unwrap();
    let file = std::fs::File::options().write(true).open(path).unwrap();
    file.set_modified(written).unwrap();
    let refused = mapped.evermap("sql", &["SELECT * FROM lanes"]).expect(1);
    let told = "expected the digest";
    assert!(refused.stderr.contains(told), "{}", refused.stderr);
    // As a copy of a map looks, whose times are of now.
    std::fs::write(path, &whole).unwrap();
    assert_eq!(mapped.query(query), lanes);
    mapped.run("b").expect(0);
    mapped.evermap("verify", &[]).expect(0);
}

/// Versions of an older evermap, which have no seal, that say other than their receipts how many rows there are. What the second
/// says is of rows that the first has too.
#[test]
fn what_a_version_says_of_its_rows_is_held_against_receipts() {
    for (version, layer) in [
        ("versions/1.json", "lanes"),
        ("versions/2.json", "keyframes"),
    ] {
        let mapped = Mapped::new();
        let path = mapped.map.join(version);
        let mut forged = unsealed(&path);
        forged["layers"][layer]["artifacts"][0]["rows"] = json!(7);
        std::fs::write(&path, forged.to_string()).unwrap();
        let found = mapped
            .evermap("verify", &["--format", "json"])
            .expect(1)
            .json();
        let expected = found[0]["expected"].as_str().unwrap();
        assert!(expected.starts_with("7 rows in "), "{found}");
        assert_eq!(found.as_array().unwrap().len(), 1, "{found}");
    }
}

/// A version or a receipt as an older evermap wrote it, which had no seals.
fn unsealed(path: &Path) -> Value {
    let mut read: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let seal = read.as_object_mut().unwrap().remove("seal");
    assert!(seal.is_some(), "{read}");
    read
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().path()).collect()
}

/// What is JSON still, and reads: nothing but its seal tells.
#[test]
fn a_version_or_receipt_that_says_something_else_is_as_a_torn_one() {
    let mapped = Mapped::new();
    let version = mapped.map.join("versions/2.json");
    let change = |path: &Path, from: &str, to: &str| {
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.contains(from), "{text}");
        std::fs::write(path, text.replacen(from, to, 1)).unwrap();
        text
    };
    let found = || {
        let found = mapped.evermap("verify", &["--format", "json"]).expect(1);
        let files = found.json();
        let lost = files.as_array().unwrap().iter();
        let lost = lost.filter(|finding| finding["state"] == "unreadable");
        let names = lost.map(|finding| finding["file"].as_str().unwrap().to_owned());
        names.collect::<Vec<_>>()
    };
    for (from, to) in [
        ("\"lanes\"", "\"lames\""),
        ("\"site\"", "\"sitf\""),
        ("\"content\":\"", "\"content\": \""),
        ("\"plan\":\"t", "\"plan\":\"T"),
        ("\"roles\"", "\"rolex\""),
        ("{\"seal\"", "{\"real\""),
    ] {
        let text = change(&version, from, to);
        assert_eq!(found(), ["versions/2.json"], "{from}");
        std::fs::write(&version, text).unwrap();
    }
    let receipt = &files_in(&mapped.map.join("receipts"))[0];
    let file = format!("receipts/{}", name(receipt));
    for (from, to) in [
        ("\"seconds\":", "\"seconds\":1"),
        ("\"nodes\"", "\"modes\""),
        ("\"session\"", "\"sessiom\""),
    ] {
        let text = change(receipt, from, to);
        assert_eq!(found(), [file.as_str()], "{from}");
        std::fs::write(receipt, text).unwrap();
    }
    mapped.evermap("verify", &[]).expect(0);

    change(receipt, "\"nodes\"", "\"modes\"");
    change(&version, "\"lanes\"", "\"lames\"");
    let asked = mapped.evermap("sql", &["SELECT DISTINCT session FROM poses"]);
    let asked = asked.expect(0);
    let said = "version 2 is ignored";
    assert!(asked.stderr.contains(said), "{}", asked.stderr);
    mapped.run("b").expect(0);
    mapped.run("a").expect(0);
    mapped.evermap("gc", &["--keep", "1"]).expect(0);
    assert!(!version.exists());
    mapped.evermap("verify", &[]).expect(0);
}

#[test]
fn a_map_of_an_older_evermap_without_seals_is_read_as_it_is() {
    let mapped = Mapped::new();
    let layers = mapped.evermap("layers", &[]).expect(0).stdout;
    for folder in ["versions", "receipts"] {
        for path in files_in(&mapped.map.join(folder)) {
            std::fs::write(&path, unsealed(&path).to_string()).unwrap();
        }
    }
    mapped.evermap("verify", &[]).expect(0);
    let ran = mapped.run("b").expect(0);
    assert!(ran.stderr.contains(" 0 units computed"), "{}", ran.stderr);
    assert!(ran.stderr.contains("nothing has changed"), "{}", ran.stderr);
    assert_eq!(mapped.evermap("layers", &[]).expect(0).stdout, layers);
}

/// A plan that reads a layer of the version before.
const GROWN: &str = "plan: grown
extends: trajectory
steps:
  met: { sql: 'SELECT count(*) AS lanes, sum(length_m) AS length_m FROM previous.lanes' }
write: [met]
";

#[test]
fn what_is_damaged_of_the_version_before_is_made_anew_by_its_own_recipe() {
    let mapped = Mapped::new();
    let plan = mapped.folder.path().join("grown.yaml");
    std::fs::write(&plan, GROWN).unwrap();
    // Other parameters, so that this run itself makes nothing that the version before has.
    let set = ["--set", "keyframes.baseline_m=0.7"];
    let run = || run(text(&plan), &mapped.map, &[&mapped.log("b")], &set);
    let lanes = mapped.query("SELECT count(*) AS lanes, sum(length_m) AS length_m FROM lanes");
    let damaged: Vec<PathBuf> = ["keyframes", "poses", "lanes"]
        .iter()
        .flat_map(|layer| mapped.artifacts(layer))
        .collect();
    let before: Vec<Vec<u8>> = damaged
        .iter()
        .map(|path| std::fs::read(path).unwrap())
        .collect();
    damaged.iter().for_each(|path| flip(path));
    std::fs::remove_file(&damaged[0]).unwrap();

    let receipts = mapped.map.join("receipts");
    let kept = mapped.folder.path().join("receipts");
    std::fs::rename(&receipts, &kept).unwrap();
    let refused = run().expect(1).stderr;
    assert!(refused.contains("cannot be made anew"), "{refused}");
    assert!(
        damaged.iter().any(|path| refused.contains(name(path))),
        "{refused}"
    );
    let _ = std::fs::remove_dir_all(&receipts);
    std::fs::rename(&kept, &receipts).unwrap();

    let told = run().expect(0).stderr;
    assert_eq!(mapped.query("SELECT lanes, length_m FROM met"), lanes);
    for (path, before) in damaged.iter().zip(before) {
        assert!(told.contains(name(path)), "{told}");
        assert!(
            std::fs::read(path).unwrap() == before,
            "{} differs",
            path.display()
        );
    }
    mapped.evermap("verify", &[]).expect(0);
}

#[test]
fn torn_receipts_versions_and_records_of_runs_are_ignored_and_said() {
    let mapped = Mapped::new();
    for (index, receipt) in std::fs::read_dir(mapped.map.join("receipts"))
        .unwrap()
        .enumerate()
    {
        let path = receipt.unwrap().path();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..[0, bytes.len() / 2][index % 2]]).unwrap();
    }
    std::fs::write(mapped.map.join("versions/2.json"), "").unwrap();
    let runs = std::fs::read_dir(mapped.map.join("runs")).unwrap();
    let run = runs.map(|run| run.unwrap().path()).max().unwrap();
    std::fs::write(&run, "PAR1 and no more").unwrap();

    let sessions = mapped.evermap(
        "sql",
        &["--format", "json", "SELECT DISTINCT session FROM poses"],
    );
    let sessions = sessions.expect(0);
    assert_eq!(sessions.json(), json!([{ "session": "a" }]));
    assert!(
        sessions.stderr.contains("version 2 is ignored"),
        "{}",
        sessions.stderr
    );
    let runs = mapped.evermap(
        "sql",
        &["--format", "json", "SELECT DISTINCT version FROM runs"],
    );
    assert!(runs.stderr.contains(name(&run)), "{}", runs.stderr);
    assert_eq!(runs.expect(0).json(), json!([{ "version": 1 }]));
    let found = mapped
        .evermap("verify", &["--format", "json"])
        .expect(1)
        .json();
    let unreadable = found.as_array().unwrap().iter();
    let unreadable = unreadable.filter(|finding| finding["state"] == "unreadable");
    let receipts = std::fs::read_dir(mapped.map.join("receipts"))
        .unwrap()
        .count();
    assert_eq!(unreadable.count(), receipts + 2, "{found}");

    // A number that a torn version has is not used again.
    mapped.run("b").expect(0);
    assert_eq!(
        mapped.query("SELECT version FROM versions"),
        json!([{ "version": 1 }, { "version": 3 }])
    );
    let sessions = mapped.query("SELECT DISTINCT session FROM poses ORDER BY session");
    assert_eq!(sessions, json!([{ "session": "a" }, { "session": "b" }]));
    mapped.evermap("gc", &["--keep", "1"]).expect(0);
    assert!(!run.exists());
    mapped.evermap("verify", &[]).expect(0);
    assert!(!mapped.map.join("versions/2.json").exists());
}

/// A pipe in the place of a file: whoever opened it would wait for ever.
#[test]
fn what_is_no_file_holds_nobody_up_and_is_said_and_made_anew() {
    let mapped = Mapped::new();
    let lanes = mapped.query("SELECT * FROM lanes ORDER BY lane");
    let receipts = std::fs::read_dir(mapped.map.join("receipts")).unwrap();
    let receipts = receipts.map(|receipt| receipt.unwrap().path());
    let mut pipes: Vec<PathBuf> = receipts.chain(mapped.artifacts("lanes")).collect();
    for path in &pipes {
        std::fs::remove_file(path).unwrap();
    }
    let (version, record) = ("versions/3.json", "runs/000003-pipe.parquet");
    pipes.extend([version, record].map(|name| mapped.map.join(name)));
    let made = std::process::Command::new("mkfifo").args(&pipes).status();
    assert!(made.unwrap().success());
    let in_time = |command: &str, more: &[&str]| -> Finished {
        let mut limited = std::process::Command::new("timeout");
        limited.arg("120").arg(program());
        limited.args([command, "--map", text(&mapped.map)]);
        limited.args(more).output().unwrap().into()
    };

    let asked = in_time("sql", &["SELECT count(*) FROM poses"]).expect(0);
    let said = "version 3 is ignored";
    assert!(asked.stderr.contains(said), "{}", asked.stderr);
    let asked = in_time("sql", &["SELECT count(*) FROM lanes"]).expect(1);
    assert!(asked.stderr.contains("found no file"), "{}", asked.stderr);
    let asked = in_time("sql", &["SELECT count(*) FROM runs"]).expect(0);
    assert!(asked.stderr.contains(record), "{}", asked.stderr);
    let found = in_time("verify", &["--format", "json"]).expect(1).json();
    let found = found.as_array().unwrap().iter();
    let found = found.filter_map(|finding| finding["found"].as_str());
    let found = found.filter(|found| found.ends_with("a named pipe"));
    assert_eq!(found.count(), pipes.len());

    let log = mapped.log("b");
    let plan = ["--progress", "none", "--sessions", text(&log)];
    let mut run = std::process::Command::new("timeout");
    run.arg("300").arg(program());
    run.args(["run", "trajectory", "--map", text(&mapped.map)]);
    let ran: Finished = run.args(plan).output().unwrap().into();
    assert!(ran.expect(0).stderr.contains("a named pipe"));
    assert_eq!(mapped.query("SELECT * FROM lanes ORDER BY lane"), lanes);
    mapped.evermap("gc", &["--keep", "1"]).expect(0);
    std::fs::remove_file(mapped.map.join(record)).unwrap();
    mapped.evermap("verify", &[]).expect(0);
}

/// An empty folder gives way; what is in another is not the map's to remove.
#[test]
fn a_folder_in_the_place_of_rows_or_receipts_gives_way_unless_something_is_in_it() {
    let mapped = Mapped::new();
    let lanes = mapped.query("SELECT * FROM lanes ORDER BY lane");
    let artifacts = mapped.artifacts("lanes");
    let receipts = std::fs::read_dir(mapped.map.join("receipts")).unwrap();
    let receipts = receipts.map(|receipt| receipt.unwrap().path());
    for path in receipts.chain(artifacts.clone()) {
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
    }
    let mine = artifacts[0].join("mine");
    std::fs::write(&mine, "mine").unwrap();
    let found = mapped.evermap("verify", &["--format", "json"]).expect(1);
    let found = found.json();
    let of = |path: &Path| {
        let file = |finding: &&Value| finding["file"].as_str().unwrap().ends_with(name(path));
        let mut found = found.as_array().unwrap().iter();
        found.find(file).map(|finding| finding["found"].clone())
    };
    for artifact in &artifacts {
        assert_eq!(of(artifact), Some(json!("a folder")), "{found}");
    }

    let refused = mapped.run("b").expect(1);
    let said = "expected a file, found a folder with something in it";
    for said in [name(&artifacts[0]), said, "move it away"] {
        assert!(refused.stderr.contains(said), "{}", refused.stderr);
    }
    assert_eq!(std::fs::read(&mine).unwrap(), b"mine");

    std::fs::rename(&artifacts[0], mapped.folder.path().join("away")).unwrap();
    mapped.run("b").expect(0);
    assert_eq!(mapped.query("SELECT * FROM lanes ORDER BY lane"), lanes);
    mapped.evermap("gc", &["--keep", "1"]).expect(0);
    mapped.evermap("verify", &[]).expect(0);
}

/// It has a number, which is nobody's, as that of a torn one is.
#[test]
fn a_folder_in_the_place_of_a_version_is_ignored_and_said() {
    let mapped = Mapped::new();
    let poses = mapped.query("SELECT count(*) AS n FROM poses");
    std::fs::create_dir(mapped.map.join("versions/3.json")).unwrap();
    let asked = mapped.evermap(
        "sql",
        &["--format", "json", "SELECT count(*) AS n FROM poses"],
    );
    let said = "version 3 is ignored";
    assert!(asked.stderr.contains(said), "{}", asked.stderr);
    assert_eq!(asked.expect(0).json(), poses);
    let found = mapped
        .evermap("verify", &["--format", "json"])
        .expect(1)
        .json();
    assert_eq!(found.as_array().unwrap().len(), 1, "{found}");
    assert_eq!(found[0]["file"], "versions/3.json");
    assert_eq!(found[0]["state"], "unreadable");
    assert!(found[0]["found"].as_str().unwrap().ends_with("a folder"));

    write_drive(&mapped.log("c"), rectangle(25.0, 15.0, 1.0));
    mapped.run("c").expect(0);
    let versions = mapped.query("SELECT version FROM versions ORDER BY version");
    assert_eq!(
        versions,
        json!([{ "version": 1 }, { "version": 2 }, { "version": 4 }])
    );
    mapped.evermap("gc", &["--keep", "1"]).expect(0);
    mapped.evermap("verify", &[]).expect(0);
}

/// As a person keeps a copy of it: it was counted as a version more, and what `gc` kept was the copy.
#[test]
fn another_spelling_of_a_versions_number_is_no_version() {
    let mapped = Mapped::new();
    let within = |name: &str| mapped.map.join("versions").join(name);
    for copy in ["02.json", "+2.json"] {
        std::fs::copy(within("2.json"), within(copy)).unwrap();
    }
    let poses = mapped.query("SELECT count(*) AS n FROM poses");
    let collected = mapped.evermap("gc", &["--keep", "1"]).expect(0).stdout;
    assert!(collected.starts_with("removed 1 version,"), "{collected}");
    assert!(within("2.json").exists() && within("02.json").exists());
    assert_eq!(mapped.query("SELECT count(*) AS n FROM poses"), poses);
    mapped.evermap("verify", &[]).expect(0);
    // Without the version they stand for nothing, and hold up nobody.
    std::fs::remove_file(within("2.json")).unwrap();
    let asked = std::process::Command::new("timeout")
        .arg("120")
        .arg(program())
        .args(["layers", "--map", text(&mapped.map)])
        .output();
    let asked = Finished::from(asked.unwrap()).expect(1);
    let said = "has no version yet";
    assert!(asked.stderr.contains(said), "{}", asked.stderr);
}

/// A run makes anew what it needs; the rest is for `gc`, or for a person.
#[test]
fn verify_advises_what_helps() {
    let mapped = Mapped::new();
    let (run, collect, remove) = ("run the same plan again", "`evermap gc`", "records of runs");
    let advises = |path: &Path, advice: &str| {
        let whole = std::fs::read(path).unwrap();
        flip(path);
        let told = mapped.evermap("verify", &[]).expect(1).stderr;
        for other in [run, collect, remove] {
            assert_eq!(told.contains(other), other == advice, "{told}");
        }
        std::fs::write(path, whole).unwrap();
    };
    advises(&mapped.artifacts("poses")[0], run);
    advises(&mapped.map.join("versions/1.json"), collect);
    advises(&mapped.map.join("versions/2.json"), collect);
    advises(&files_in(&mapped.map.join("runs"))[0], remove);
    // Rows that the older version alone has.
    write_drive(&mapped.log("a"), rectangle(22.0, 15.0, 1.0));
    let old = mapped.artifacts("poses");
    let log = mapped.log("a");
    let anew = ["run", "trajectory", "--map", text(&mapped.map)];
    let mut anew = command(&anew);
    anew.args(["--progress", "none", "--replace", "--sessions"]);
    let ran: Finished = anew.arg(&log).output().unwrap().into();
    ran.expect(0);
    let version = std::fs::read_to_string(mapped.map.join("versions/3.json")).unwrap();
    let mut old = old.iter();
    let old = old.find(|path| !version.contains(name(path).trim_end_matches(".parquet")));
    advises(old.unwrap(), collect);
}

/// The number of a version that somebody has removed is given to another one.
#[test]
fn newest_leads_to_the_version_that_there_is() {
    let mapped = Mapped::new();
    let linked = || {
        let mut links = files_in(&mapped.map.join("newest/poses"));
        links.sort();
        let files = links.iter().map(|link| link.canonicalize().unwrap());
        files.collect::<Vec<_>>()
    };
    let poses = || {
        let files = mapped.artifacts("poses").into_iter();
        let files = files.map(|file| file.canonicalize().unwrap());
        files.collect::<Vec<_>>()
    };
    let before = poses();
    assert_eq!(linked(), before);
    std::fs::remove_file(mapped.map.join("versions/2.json")).unwrap();
    write_drive(&mapped.log("c"), rectangle(25.0, 15.0, 1.0));
    mapped.run("c").expect(0);
    assert_ne!(poses(), before);
    assert_eq!(linked(), poses());
}

/// Rows that are whole, and those of another session or layer.
#[test]
fn a_receipt_that_leads_to_rows_of_another_unit_is_said_and_the_work_done_again() {
    let mapped = Mapped::new();
    let count = "SELECT count(*) AS n FROM poses WHERE session = 'b'";
    let poses = mapped.query(count);
    let receipts = std::fs::read_dir(mapped.map.join("receipts")).unwrap();
    let receipts = receipts.map(|receipt| {
        let path = receipt.unwrap().path();
        let receipt = unsealed(&path);
        (path, receipt)
    });
    let receipts: Vec<(PathBuf, Value)> = receipts.collect();
    let of = |stage: &str, session: &str| {
        let mut found = receipts.iter().filter(|(_, receipt)| {
            let stages = receipt["recipe"]["stages"].as_array().unwrap();
            stages.last().unwrap()["name"] == stage && receipt["recipe"]["session"] == session
        });
        found.next().unwrap()
    };
    for (told, rows) in [
        (of("keyframes", "b"), of("keyframes", "a")),
        (of("poses", "b"), of("keyframes", "b")),
    ] {
        let ((path, told), (_, rows)) = (told, rows);
        let mut told = told.clone();
        told["artifact"] = rows["artifact"].clone();
        std::fs::write(path, told.to_string()).unwrap();
    }
    let found = mapped.evermap("verify", &["--format", "json"]).expect(1);
    assert_eq!(found.json().as_array().unwrap().len(), 2);
    // Nothing else says what the rows are of.
    std::fs::remove_dir_all(mapped.map.join("versions")).unwrap();
    let found = mapped.evermap("verify", &["--format", "json"]).expect(1);
    let is_damaged = |finding: &&Value| finding["state"] == "damaged";
    let found = found.json();
    assert_eq!(
        found.as_array().unwrap().iter().filter(is_damaged).count(),
        1
    );

    let ran = mapped.run("b").expect(0);
    for said in [
        "expected rows of b, found rows of a",
        "expected rows of a query, found rows of layer keyframes",
    ] {
        assert!(ran.stderr.contains(said), "{}", ran.stderr);
    }
    assert_eq!(mapped.query(count), poses);
    mapped.evermap("verify", &[]).expect(0);
}

/// One bit within its rows is enough: a record is named by its digest, as an artifact is.
#[test]
fn a_record_of_a_run_that_was_changed_is_ignored_and_said() {
    let mapped = Mapped::new();
    let runs = std::fs::read_dir(mapped.map.join("runs")).unwrap();
    let run = runs.map(|run| run.unwrap().path()).max().unwrap();
    let mut bytes = std::fs::read(&run).unwrap();
    let middle = bytes.len() / 3;
    bytes[middle] ^= 1;
    std::fs::write(&run, bytes).unwrap();
    let found = mapped
        .evermap("verify", &["--format", "json"])
        .expect(1)
        .json();
    assert_eq!(found.as_array().unwrap().len(), 1, "{found}");
    assert_eq!(found[0]["state"], "damaged");
    assert!(found[0]["file"].as_str().unwrap().contains(name(&run)));
    let asked = mapped.evermap(
        "sql",
        &["--format", "json", "SELECT DISTINCT version FROM runs"],
    );
    let said = format!("{} is ignored: expected the digest", name(&run));
    assert!(asked.stderr.contains(&said), "{}", asked.stderr);
    assert_eq!(asked.expect(0).json(), json!([{ "version": 1 }]));
}

/// What is on the disk before what, as the trace of a run tells it.
#[test]
fn an_artifact_is_on_the_disk_before_its_receipt_and_receipts_before_the_version() {
    let folder = tempfile::tempdir().unwrap();
    let (log, map) = (folder.path().join("a.mcap"), folder.path().join("map"));
    write_drive(&log, rectangle(20.0, 10.0, 1.0));
    let run = [
        "run",
        "trajectory",
        "--progress",
        "none",
        "--map",
        text(&map),
        "--jobs",
        "1",
    ];
    let mut run = command(&run);
    run.args(["--sessions", text(&log)])
        .env("EVERMAP_LOG", "evermap_engine::map=trace");
    let traced: Finished = run.output().unwrap().into();
    let traced = traced.expect(0).stderr;
    let lines: Vec<&str> = traced.lines().collect();
    let named = |what: &str| {
        let ends = |line: &&str| line.contains("named") && line.contains(what);
        lines
            .iter()
            .position(ends)
            .unwrap_or_else(|| panic!("{what}: {traced}"))
    };
    let version = named("versions/1.json");
    // Whatever has a name was synced under its temporary one, and its folder after; several may be on their way at once.
    let synced = |lines: &[&str], place: &str| {
        let synced = lines.iter().filter(|line| line.contains("synced"));
        synced.filter(|line| line.contains(place)).count()
    };
    let mut names = 0;
    for (place, line) in lines.iter().enumerate().filter(|(_, line)| {
        line.contains("named") && (line.contains(".json") || line.contains(".parquet"))
    }) {
        names += 1;
        let temporary = synced(&lines[..place], "/map/tmp/");
        let folders = synced(&lines[..place], "/map") - temporary;
        assert!(temporary >= names && folders >= names, "{line}");
    }
    let receipts = std::fs::read_dir(map.join("receipts")).unwrap();
    let receipts: Vec<_> = receipts.map(|receipt| receipt.unwrap().path()).collect();
    assert!(receipts.len() > 3);
    for path in receipts {
        let receipt: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let artifact = receipt["artifact"]["content"].as_str().unwrap();
        let receipt = named(name(&path));
        assert!(named(artifact) < receipt && receipt < version, "{traced}");
    }
}
