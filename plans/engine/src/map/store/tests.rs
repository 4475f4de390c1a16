#![allow(clippy::unwrap_used)]
use super::*;

#[tokio::test]
async fn a_version_is_created_once() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
    let create = |text: &str| store.create("versions/1.json", text.into());
    assert!(create("1").await.unwrap());
    assert!(!create("2").await.unwrap());
    assert_eq!(
        store.read_json::<u32>("versions/1.json").await.unwrap(),
        Some(1)
    );
    assert_eq!(
        store.read_json::<u32>("versions/2.json").await.unwrap(),
        None
    );
    assert_eq!(
        store.list("versions").await.unwrap(),
        [("versions/1.json".to_owned(), 1)]
    );
}

/// What is no file is told at once: who opens a pipe waits for ever.
#[cfg(unix)]
#[tokio::test]
async fn what_is_no_file_is_not_opened() {
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
    let within = |name: &str| folder.path().join(name);
    let made = std::process::Command::new("mkfifo")
        .arg(within("pipe"))
        .status();
    assert!(made.unwrap().success());
    symlink("pipe", within("link")).unwrap();
    symlink("nowhere", within("gone")).unwrap();
    symlink("/dev/zero", within("device")).unwrap();
    let _socket = UnixListener::bind(within("socket")).unwrap();
    std::fs::create_dir(within("folder")).unwrap();
    for (name, found) in [
        ("pipe", "a named pipe"),
        ("link", "a named pipe"),
        ("gone", "a link that leads nowhere"),
        ("device", "a device"),
        ("socket", "a socket"),
        ("folder", "a folder"),
    ] {
        let fault = store.read(name).await.unwrap_err();
        assert_eq!(fault.kind, evermap_schemas::Kind::Data);
        let said = format!("expected a file, found {found}");
        assert!(fault.message.ends_with(&said), "{fault}");
        assert_eq!(store.meta(name).await.unwrap(), None);
        assert_eq!(store.no_file(name).await.unwrap(), Some(found));
    }
    assert_eq!(store.read("nothing").await.unwrap(), None);
    assert_eq!(store.no_file("nothing").await.unwrap(), None);
}

#[test]
fn a_folder_may_be_named_from_one_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let within = |path: &str| folder.path().join(path);
    std::fs::create_dir(within("sub")).unwrap();
    let opened = |path: &str| Store::open(within(path).to_str().unwrap(), true);
    let plain = opened("maps/one").unwrap();
    for path in ["sub/../maps/one", "sub/../sub/../maps/one"] {
        assert_eq!(opened(path).unwrap().url(), plain.url(), "{path}");
    }
    std::fs::write(within("file"), "").unwrap();
    for (path, says) in [("file", "found a file"), ("none/../one", "No such file")] {
        let said = opened(path).unwrap_err().to_string();
        assert!(
            said.contains("cannot create a map at") && said.contains(says),
            "{said}"
        );
    }
}

#[test]
fn a_map_that_is_not_there_says_what_to_do() {
    let text = Store::open("/no/such/map", false).unwrap_err().to_string();
    assert!(text.contains("evermap run"), "{text}");
}

/// DataFusion lists what is under a name that has no file.
#[tokio::test]
async fn an_artifact_that_is_gone_is_no_empty_folder() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap(), true).unwrap();
    let name = "artifacts/rows.parquet";
    store.write(name, b"rows".to_vec()).await.unwrap();
    let listed = async |name: &str| {
        let listed = store.objects().list(Some(&store.path(name)));
        let listed: Result<Vec<ObjectMeta>, _> = listed.try_collect().await;
        listed.map(|found| found.len())
    };
    assert_eq!(listed("artifacts").await.unwrap(), 1);
    store.remove(name).await.unwrap();
    let error = datafusion::error::DataFusionError::from(listed(name).await.unwrap_err());
    let fault = crate::error::fault_of(&error);
    assert_eq!(fault.kind, evermap_schemas::Kind::Data);
    assert!(
        fault
            .message
            .ends_with("rows.parquet: expected rows of a version, found no file"),
        "{fault}"
    );
    assert!(fault.next.contains("evermap gc"), "{fault}");
    for other in ["artifacts", "runs/1.parquet", "artifacts/rows"] {
        assert_eq!(listed(other).await.unwrap(), 0, "{other}");
    }
}

#[test]
fn an_address_names_one_map_whatever_signs_are_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let named = |address: &str| Store::open(address, true).unwrap();
    for (last, name) in [
        ("lot#2", "lot#2"),
        ("lot?x=1", "lot?x=1"),
        ("k%C3%A4rte", "kärte"),
        ("kärte", "kärte"),
        ("two words", "two words"),
    ] {
        let address = format!("file://{}/{last}", folder.path().display());
        let store = named(&address);
        assert_eq!(store.name().unwrap(), name);
        let expected = folder.path().join(name);
        assert_eq!(store.url().to_file_path().unwrap(), expected);
        // What a map's files are called is below it, and a unit that is given its URL finds it again.
        let version = store.url_of("versions/1.json").unwrap();
        assert_eq!(
            version.to_file_path().unwrap(),
            expected.join("versions/1.json")
        );
        assert_eq!(named(store.url().as_str()).url(), store.url());
    }
    let local = folder.path().join("kärte#1");
    assert_eq!(named(local.to_str().unwrap()).name().unwrap(), "kärte#1");
    let fault = Store::open("https://lot.org/map?key=1", true).unwrap_err();
    assert!(fault.next.contains("%3F"), "{fault}");
}
