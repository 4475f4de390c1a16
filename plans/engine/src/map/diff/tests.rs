//! What is not read of two versions is what would have been found the same.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::ops::Range;

use arrow::array::{Array, AsArray};
use arrow::datatypes::Float64Type;
use arrow::util::display::array_value_to_string;
use evermap_schemas::layers::VehiclePose;
use evermap_schemas::{Stamp, batch};
use parquet::arrow::ArrowWriter;

use super::*;
use crate::digest::digest;
use crate::map::receipt::{Artifact, Extent};
use crate::map::store::Store;
use crate::map::version::{StoredLayer, Version};
use crate::sql::{Limits, context};

fn poses(session: &str, seconds: Range<i64>, x: f64) -> Vec<VehiclePose> {
    let pose = |second| VehiclePose {
        site: "lot".into(),
        session: session.into(),
        stamp: Stamp(second * 1_000_000_000),
        map_from_vehicle: Pose {
            x,
            ..Pose::IDENTITY
        },
    };
    seconds.map(pose).collect()
}

/// A file of rows that are of a session, or of all of the lot.
async fn stored(store: &Store, session: Option<&str>, rows: Vec<VehiclePose>) -> Artifact {
    let table = batch(rows).unwrap();
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, table.schema(), None).unwrap();
    writer.write(&table).unwrap();
    writer.close().unwrap();
    let artifact = Artifact {
        content: digest(&bytes),
        rows: table.num_rows() as u64,
        bytes: bytes.len() as u64,
        extent: Extent {
            session: session.map(str::to_owned),
            site: Some("lot".into()),
        },
    };
    store.write(&artifact.name(), bytes).await.unwrap();
    artifact
}

/// Publishes a version of layers of these files.
async fn publish(store: &Store, version: u64, layers: &[(&str, Vec<Artifact>)]) {
    let layer = |(name, artifacts): &(&str, Vec<Artifact>)| {
        let layer = StoredLayer {
            published: true,
            artifacts: artifacts.clone(),
            ..StoredLayer::default()
        };
        ((*name).to_owned(), layer)
    };
    let version = Version {
        version,
        published: "2026-06-01T08:00:00+00:00".into(),
        layers: layers.iter().map(layer).collect(),
        ..Version::default()
    };
    assert!(version.publish(store).await.unwrap());
}

/// What all rows of both versions come to: how many of them each change has, and how far those that changed moved at most.
async fn of_all_rows(compared: &Comparison, layer: &str) -> (BTreeMap<String, u64>, Option<f64>) {
    let mut changes: BTreeMap<String, u64> = BTreeMap::new();
    let mut moved_m: Option<f64> = None;
    let rows = compared.rows(layer).await.unwrap();
    for batch in rows.collect().await.unwrap() {
        let change = batch.column_by_name("change").unwrap();
        let moved = batch.column_by_name("moved_m").unwrap();
        let moved = moved.as_primitive::<Float64Type>();
        for row in 0..batch.num_rows() {
            let change = array_value_to_string(change, row).unwrap();
            if change == "changed" && moved.is_valid(row) {
                moved_m = Some(moved_m.map_or(moved.value(row), |most| most.max(moved.value(row))));
            }
            *changes.entry(change).or_default() += 1;
        }
    }
    (changes, moved_m)
}

#[tokio::test]
async fn files_that_both_versions_have_are_not_read_where_that_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let address = folder.path().to_str().unwrap();
    let store = Store::open(address, true).unwrap();
    let stayed = stored(&store, Some("a"), poses("a", 0..5, 0.0)).await;
    let before = stored(&store, Some("b"), poses("b", 0..4, 0.0)).await;
    let gone = stored(&store, Some("c"), poses("c", 0..3, 0.0)).await;
    let moved = [poses("b", 0..2, 0.0), poses("b", 2..6, 2.0)].concat();
    let after = stored(&store, Some("b"), moved).await;
    let new = stored(&store, Some("d"), poses("d", 0..7, 0.0)).await;
    // Rows that have keys, and contents, of those of a file that stayed.
    let site = stored(&store, None, poses("a", 0..5, 1.0)).await;
    let beside = stored(&store, None, poses("a", 3..6, 1.0)).await;
    let again = stored(
        &store,
        None,
        [poses("a", 1..3, 0.5), poses("a", 3..4, 1.0)].concat(),
    )
    .await;
    let mixed = [vec![site.clone(), beside], vec![site.clone(), again]];

    let sessions = [
        vec![stayed.clone(), before, gone],
        vec![stayed.clone(), after, new],
    ];
    for (at, version) in [(0, 1), (1, 2)] {
        let layers = [
            ("poses", sessions[at].clone()),
            ("places", sessions[at].clone()),
            ("frame_poses", mixed[at].clone()),
            ("words", mixed[at].clone()),
            ("mounts", vec![site.clone()]),
        ];
        publish(&store, version, &layers).await;
    }
    let map = Map::open(address, None).await.unwrap();
    let reading = context(Limits::one_partition()).unwrap();
    let registry = Registry::new([]);
    let compared = Comparison::open(&map, [1, 2], &registry, &reading).await;
    let compared = compared.unwrap();
    let mut summaries = BTreeMap::new();
    for layer in compared.layers() {
        let summary = compared.summary(&layer).await.unwrap();
        let (changes, moved_m) = of_all_rows(&compared, &layer).await;
        let all =
            ["added", "removed", "changed", "same"].map(|change| changes.get(change).copied());
        let all = all.map(Option::unwrap_or_default);
        let found = [
            summary.added,
            summary.removed,
            summary.changed,
            summary.same,
        ];
        assert_eq!((found, summary.max_moved_m), (all, moved_m), "{layer}");
        summaries.insert(layer, summary);
    }
    let LayerDiff {
        added,
        removed,
        changed,
        same,
        ..
    } = summaries["poses"];
    assert_eq!([added, removed, changed, same], [9, 3, 2, 7]);
    assert_eq!(summaries["mounts"].same, 5);

    // What is gone now was not read, where it need not be.
    for artifact in [&stayed, &site] {
        store.remove(&artifact.name()).await.unwrap();
    }
    let compared = Comparison::open(&map, [1, 2], &registry, &reading).await;
    let compared = compared.unwrap();
    for (layer, is_read) in [
        ("poses", false),
        ("places", false),
        ("frame_poses", true),
        ("words", false),
        ("mounts", false),
    ] {
        let summary = compared.summary(layer).await;
        assert_eq!(summary.is_err(), is_read, "{layer}: {summary:?}");
        if let Ok(summary) = summary {
            assert_eq!(summary, summaries[layer], "{layer}");
        }
        assert!(compared.rows(layer).await.is_err(), "{layer}");
    }
}
