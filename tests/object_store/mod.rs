//! Maps and logs on an object store: made, asked, raced for, killed, and all that with a network that fails.

mod server;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Barrier, Mutex};
use std::time::Duration;

use evermap_tests::{Finished, command, layers_of, rectangle, run, text, write_drive};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use server::{Bucket, Fate, Request, put};

/// `evermap` with the bucket within its reach, not yet started.
fn on(bucket: &Bucket, arguments: &[&str]) -> Command {
    let mut command = command(arguments);
    command.envs(bucket.environment());
    command
}

fn run_on(bucket: &Bucket, sessions: &[PathBuf]) -> Command {
    let map = bucket.url("maps/lot");
    let mut run = on(
        bucket,
        &["run", "trajectory", "--map", &map, "--progress", "none"],
    );
    run.arg("--sessions").args(sessions);
    run
}

fn ended(mut command: Command) -> Finished {
    command.output().expect("evermap starts").into()
}

fn asked(bucket: &Bucket, command: &str, more: &[&str]) -> Value {
    let map = bucket.url("maps/lot");
    let mut asked = on(bucket, &[command, "--map", &map, "--format", "json"]);
    asked.args(more);
    ended(asked).expect(0).json()
}

fn drives(folder: &Path, count: usize) -> Vec<PathBuf> {
    let write = |index: usize| {
        let path = folder.join(format!("drive_{index}.mcap"));
        write_drive(&path, rectangle(20.0 + index as f64, 15.0, 1.0));
        path
    };
    (0..count).map(write).collect()
}

/// The layers of a map of these sessions in a local folder.
fn local_layers(folder: &Path, sessions: &[PathBuf]) -> Value {
    let map = folder.join("local");
    let sessions: Vec<&Path> = sessions.iter().map(PathBuf::as_path).collect();
    run("trajectory", &map, &sessions, &[]).expect(0);
    layers_of(&map)
}

#[test]
fn a_map_on_an_object_store_is_made_of_logs_there_asked_and_found_done_again() {
    let late = |_: &Request| Fate::Late(Duration::from_millis(20));
    let Some(bucket) = Bucket::new("made", late) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let sessions = drives(folder.path(), 2);
    let there: Vec<PathBuf> = sessions
        .iter()
        .map(|session| {
            let name = format!("logs/{}", text(Path::new(session.file_name().unwrap())));
            bucket.put(&name, std::fs::read(session).unwrap());
            bucket.url(&name).into()
        })
        .collect();
    ended(run_on(&bucket, &there[..1])).expect(0);
    ended(run_on(&bucket, &there[1..])).expect(0);
    assert_eq!(
        asked(&bucket, "layers", &[]),
        local_layers(folder.path(), &sessions)
    );
    let poses = "SELECT count(DISTINCT session) AS n FROM poses";
    assert_eq!(asked(&bucket, "sql", &[poses]), json!([{ "n": 2 }]));

    let again = ended(run_on(&bucket, &[bucket.url("logs/*.mcap").into()])).expect(0);
    assert!(again.stderr.contains("version 2 stays"), "{}", again.stderr);
    assert!(
        again.stderr.contains(" 0 units computed"),
        "{}",
        again.stderr
    );
    let map = bucket.url("maps/lot");
    ended(on(&bucket, &["verify", "--map", &map])).expect(0);
    ended(on(&bucket, &["gc", "--map", &map, "--keep", "1"])).expect(0);
    ended(on(&bucket, &["verify", "--map", &map])).expect(0);
    assert_eq!(asked(&bucket, "sql", &[poses]), json!([{ "n": 2 }]));
}

#[test]
fn of_two_runs_that_publish_at_once_on_an_object_store_one_goes_on_from_the_other() {
    let both = Barrier::new(2);
    let meet = move |request: &Request| {
        if request.puts("versions/1.json") {
            both.wait();
        }
        Fate::Answered
    };
    let Some(bucket) = Bucket::new("raced", meet) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let sessions = drives(folder.path(), 2);
    let runs = std::thread::scope(|scope| {
        let start = |session| {
            let run = run_on(&bucket, std::slice::from_ref(session));
            scope.spawn(|| ended(run))
        };
        let runs: Vec<_> = sessions.iter().map(start).collect();
        runs.into_iter()
            .map(|run| run.join().unwrap().expect(0).stderr)
            .collect::<Vec<_>>()
    });
    let lost = |said: &&String| said.contains("another run published version 1");
    assert_eq!(runs.iter().filter(lost).count(), 1, "{runs:?}");
    // Both wanted version 1, the loser then version 2.
    assert_eq!(bucket.created(), [3, 1]);
    let layers = asked(&bucket, "layers", &[]);
    assert_eq!(layers, local_layers(folder.path(), &sessions));
}

#[test]
fn a_run_that_was_killed_on_an_object_store_goes_on_where_it_was() {
    const DONE: usize = 5;
    let (written, held) = std::sync::mpsc::channel();
    let receipts = AtomicUsize::new(0);
    let hold = move |request: &Request| {
        if request.puts("receipts/") && receipts.fetch_add(1, Ordering::Relaxed) == DONE {
            // The run waits for this one until it is killed, and the receipt comes to nothing.
            let _ = written.send(());
            std::thread::sleep(Duration::from_secs(2));
            return Fate::Lost;
        }
        Fate::Answered
    };
    let Some(bucket) = Bucket::new("killed", hold) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let sessions = drives(folder.path(), 6);
    let mut run = run_on(&bucket, &sessions);
    let mut run = run
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    held.recv().unwrap();
    run.kill().unwrap();
    assert!(!run.wait().unwrap().success());

    let resumed = ended(run_on(&bucket, &sessions)).expect(0).stderr;
    let words: Vec<_> = resumed.split_whitespace().collect();
    let reused = words.iter().position(|word| word.starts_with("reused"));
    let reused: usize = words[reused.unwrap() - 1].parse().unwrap();
    // Another unit may have ended while this one was held.
    assert!(reused >= DONE, "{resumed}");
    assert_eq!(
        asked(&bucket, "layers", &[]),
        local_layers(folder.path(), &sessions)
    );
}

#[test]
fn requests_and_answers_that_are_lost_change_nothing() {
    let random = Mutex::new(ChaCha8Rng::seed_from_u64(evermap_test_data::seed()));
    let disturbed = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&disturbed);
    let versions = AtomicUsize::new(0);
    let disturb = move |request: &Request| {
        // Whoever publishes does not hear of it.
        if request.puts("versions/") && versions.fetch_add(1, Ordering::Relaxed) == 0 {
            return Fate::Unanswered;
        }
        let fate = match random.lock().unwrap().random_range(0..60) {
            0 => Fate::Refused,
            1 => Fate::Lost,
            2 => Fate::Unanswered,
            3 => Fate::Torn,
            4..=9 => Fate::Late(Duration::from_millis(50)),
            _ => return Fate::Answered,
        };
        counted.fetch_add(1, Ordering::Relaxed);
        fate
    };
    let Some(bucket) = Bucket::new("disturbed", disturb) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let sessions = drives(folder.path(), 4);
    let said = ended(run_on(&bucket, &sessions)).expect(0).stderr;
    // Its own version is no other run's.
    assert!(said.contains("version 1 published"), "{said}");
    assert!(!said.contains("another run"), "{said}");
    assert!(
        disturbed.load(Ordering::Relaxed) > 5,
        "nothing was disturbed"
    );
    assert_eq!(
        asked(&bucket, "layers", &[]),
        local_layers(folder.path(), &sessions)
    );
}

/// `#` and `?` would end a name in a URL: another map was written to, and other logs were read.
#[test]
fn maps_and_logs_whose_names_have_signs_of_urls_are_others_than_those_without() {
    let Some(bucket) = Bucket::new("signs", |_: &Request| Fate::Answered) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let sessions = drives(folder.path(), 2);
    for (index, session) in sessions.iter().enumerate() {
        let name = format!("logs/drive_{index}.mcap");
        bucket.put(&name, std::fs::read(session).unwrap());
    }
    bucket.put("logs/drive_0.mcap%23torn", b"no log".to_vec());
    let run = |map: &str, logs: &str| {
        let (map, logs) = (bucket.url(map), bucket.url(logs));
        let words = ["run", "trajectory", "--progress", "none", "--map", &map];
        ended(on(&bucket, &[&words[..], &["--sessions", &logs]].concat()))
    };
    run("maps/lot", "logs/drive_0.mcap").expect(0);
    run("maps/lot", "logs/drive_1.mcap").expect(0);
    run("maps/lot#2", "logs/drive_?.mcap").expect(0);
    let refused = run("maps/lot", "logs/drive_0.mcap#torn").expect(1).stderr;
    assert!(refused.contains("drive_0.mcap#torn"), "{refused}");

    let other = bucket.url("maps/lot#2");
    let layers = on(&bucket, &["layers", "--map", &other, "--format", "json"]);
    assert_eq!(
        ended(layers).expect(0).json(),
        local_layers(folder.path(), &sessions)
    );
    ended(on(&bucket, &["gc", "--map", &other, "--keep", "1"])).expect(0);
    let versions = "SELECT count(*) AS n FROM versions";
    assert_eq!(asked(&bucket, "sql", &[versions]), json!([{ "n": 2 }]));
}

#[test]
fn a_log_that_is_replaced_during_a_run_on_an_object_store_is_not_mapped_as_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = drives(folder.path(), 2);
    let [first, second] =
        [&sessions[0], &sessions[1]].map(|session| std::fs::read(session).unwrap());
    let other = second.clone();
    let replaced = AtomicUsize::new(0);
    let replace = move |request: &Request| {
        // Its digest is taken.
        if request.puts("maps/lot/logs/") && replaced.fetch_add(1, Ordering::Relaxed) == 0 {
            put("swapped", "logs/a.mcap", other.clone());
        }
        Fate::Answered
    };
    let Some(bucket) = Bucket::new("swapped", replace) else {
        return;
    };
    bucket.put("logs/a.mcap", first);
    let log = [PathBuf::from(bucket.url("logs/a.mcap"))];
    let told = ended(run_on(&bucket, &log)).expect(1).stderr;
    assert!(told.contains("the file changed"), "{told}");
    ended(run_on(&bucket, &log)).expect(0);
    let one = tempfile::tempdir().unwrap();
    let a = one.path().join("a.mcap");
    std::fs::write(&a, second).unwrap();
    assert_eq!(
        asked(&bucket, "layers", &[]),
        local_layers(one.path(), &[a])
    );
}
