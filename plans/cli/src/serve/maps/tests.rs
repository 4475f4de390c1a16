#![allow(clippy::unwrap_used)]
use std::path::Path;

use evermap_engine::erased::Erased;
use evermap_engine::sql::runtime;

use super::*;

/// Publishes a version without layers, of a plan of this name.
pub async fn publish(map: &Path, number: u64, plan: &str) {
    let store = Store::open(map.to_str().unwrap(), true).unwrap();
    let version = Version {
        version: number,
        plan: plan.to_owned(),
        ..Version::default()
    };
    assert!(version.publish(&store).await.unwrap());
}

/// A map as it is served.
pub async fn served(map: &Path) -> Maps {
    let (addresses, limits) = ([map.to_str().unwrap().to_owned()], Limits::default());
    let runtime = runtime(limits).unwrap();
    Maps::open(&addresses, limits, &runtime).await.unwrap()
}

#[tokio::test]
async fn a_torn_version_is_passed_over_and_told_once() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    publish(&map, 1, "").await;
    let maps = served(&map).await;
    let served = maps.only().unwrap();
    let version = async || served.newest().await.unwrap().version();
    assert_eq!(version().await, 1);
    let whole = std::fs::read(map.join("versions/1.json")).unwrap();
    let torn = map.join("versions/2.json");
    std::fs::write(&torn, &whole[..whole.len() / 2]).unwrap();
    assert_eq!((version().await, version().await), (1, 1));
    assert!(!served.is_news(2) && served.is_news(4));
    publish(&map, 3, "").await;
    assert_eq!(version().await, 3);
    // Nobody looks back.
    std::fs::remove_file(torn).unwrap();
    assert_eq!(version().await, 3);
}

#[tokio::test]
async fn versions_that_are_gone_and_a_map_made_anew_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map");
    publish(&map, 1, "").await;
    let maps = served(&map).await;
    let served = maps.only().unwrap();
    let newest = async || served.newest().await.unwrap();
    assert!(Arc::ptr_eq(&newest().await, &newest().await));
    // As `gc --keep 1` leaves it, before anybody has asked for the second.
    for number in [2, 3] {
        publish(&map, number, "").await;
    }
    for number in [1, 2] {
        std::fs::remove_file(map.join(Version::name(number))).unwrap();
    }
    let third = newest().await;
    assert_eq!(third.version(), 3);
    let gone = served.version(Some(1)).await.err().unwrap().to_string();
    assert!(gone.contains("no version 1 in this map"), "{gone}");

    std::fs::remove_dir_all(&map).unwrap();
    let gone = served.newest().await.err().unwrap().to_string();
    assert!(gone.contains("no map at"), "{gone}");
    publish(&map, 1, "fewer versions").await;
    let first = newest().await;
    let of = |opened: &Erased<Opened>| (opened.version(), opened.reader.map.version.plan.clone());
    assert_eq!(of(&first), (1, "fewer versions".to_owned()));
    assert!(first.opening > third.opening);
    std::fs::remove_dir_all(&map).unwrap();
    publish(&map, 1, "as many").await;
    assert_eq!(of(&newest().await), (1, "as many".to_owned()));
    let named = served.version(Some(1)).await.unwrap();
    assert_eq!(of(&named), (1, "as many".to_owned()));
}
