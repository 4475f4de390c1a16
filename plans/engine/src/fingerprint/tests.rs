#![allow(clippy::unwrap_used)]
use std::path::Path;

use super::*;

/// A log without messages: magic, header, end of data, footer, magic.
const LOG: &[u8] = b"\x89MCAP0\r\n\
    \x01\x08\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\
    \x0f\x04\0\0\0\0\0\0\0\0\0\0\0\
    \x02\x14\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\
    \x89MCAP0\r\n";

/// The library that the log's index names, when it is opened with what is remembered.
async fn library(store: &Store, log: &Path, content: &str) -> String {
    let paths = [log.display().to_string()];
    let found = Recordings::find(&RuntimeEnv::default(), &paths, None).await;
    let opened = open(store, found.unwrap(), Believe::Content(content)).await;
    opened.unwrap().0.parts()[0].index.library.clone()
}

#[tokio::test]
async fn a_remembered_index_is_used_for_the_same_log_only() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.mcap");
    std::fs::write(&log, LOG).unwrap();
    let store = Store::open(folder.path().join("map").to_str().unwrap(), true).unwrap();
    let paths = [log.display().to_string()];
    let dataset = Dataset::open(&RuntimeEnv::default(), &paths, None)
        .await
        .unwrap();
    assert!(dataset.losses.is_empty(), "{:?}", dataset.losses.lines());
    let fresh = fingerprint(&dataset.sessions[0], &AtomicU64::new(0))
        .await
        .unwrap();
    let content = fresh.content.clone();
    // An index that the file does not have, to see which of both is used.
    let mut indexes = fresh.indexes;
    indexes[0].library = "remembered".into();
    let kept = Fingerprint::new(content.clone(), false, fresh.files, indexes).unwrap();
    kept.remember(&store).await.unwrap();
    assert_eq!(library(&store, &log, &content).await, "remembered");
    assert_eq!(library(&store, &log, "another").await, "");

    let mut forged = kept.clone();
    forged.indexes[0].library = "forged".into();
    forged.remember(&store).await.unwrap();
    assert_eq!(library(&store, &log, &content).await, "");

    let mut earlier = kept.clone();
    earlier.seal = digest_of(&(LogIndex::VERSION - 1, &content, &earlier.indexes)).unwrap();
    earlier.remember(&store).await.unwrap();
    assert_eq!(library(&store, &log, &content).await, "");

    kept.remember(&store).await.unwrap();
    std::fs::write(&log, LOG).unwrap();
    let later = std::fs::File::options().append(true).open(&log).unwrap();
    later
        .set_modified(std::time::SystemTime::UNIX_EPOCH)
        .unwrap();
    assert_eq!(library(&store, &log, &content).await, "");
}

/// The first is read before the second is found gone: what comes later takes nothing of what is done.
#[tokio::test]
async fn each_log_is_remembered_as_soon_as_it_is_read_and_only_by_who_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["a", "b"].map(|name| folder.path().join(format!("{name}.mcap")));
    paths
        .iter()
        .for_each(|path| std::fs::write(path, LOG).unwrap());
    let store = Store::open(folder.path().join("map").to_str().unwrap(), true).unwrap();
    let texts = paths.each_ref().map(|path| path.display().to_string());
    let runtime = RuntimeEnv::default();
    let dataset = Dataset::open(&runtime, &texts, None).await.unwrap();
    let sessions = &dataset.sessions;
    let nothing = Contents::new();
    let looked = read(&store, &nothing, sessions, None).await.unwrap();
    assert!(looked.len() == 2 && looked[0] == looked[1]);
    assert!(!folder.path().join("map").exists());

    std::fs::remove_file(&paths[1]).unwrap();
    let ended = read(&store, &nothing, sessions, Some(&mut |_: f64| ())).await;
    assert!(ended.is_err());
    let kept = names_of(&store, &looked.iter().cloned().collect())
        .await
        .unwrap();
    assert_eq!(kept.len(), 1);

    // What is remembered is not read again, nor looked for.
    let remembered = sessions.iter().map(|session| session.name.to_string());
    let remembered: Contents = remembered.zip(looked.clone()).collect();
    let known = read(&store, &remembered, sessions, None).await.unwrap();
    assert_eq!(known, looked);
}
