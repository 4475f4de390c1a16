//! Logs as tables: what real recordings hold is what SQL finds.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use crate::common::{Log, context, count, files, in_memory, open, open_in, rows, shared, text};
use arrow::array::AsArray;
use arrow::datatypes::Int64Type;
use evermap_datasets::Dataset;

/// Logs of which some topic cannot be decoded, with the reason.
async fn refused(context: &datafusion::prelude::SessionContext) -> Vec<String> {
    let batches = rows(
        context,
        "SELECT topic FROM channels WHERE refused IS NOT NULL",
    )
    .await;
    let topics = batches.iter().flat_map(|batch| {
        let topics = batch.column(0).as_string::<i32>();
        topics
            .iter()
            .flatten()
            .map(str::to_owned)
            .collect::<Vec<_>>()
    });
    topics.collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_real_log_has_the_rows_that_its_statistics_promise() {
    let Some(folder) = shared("data/mcap_real") else {
        return;
    };
    let logs = files(&folder, "mcap");
    assert!(logs.len() > 25, "{}", logs.len());
    for log in logs {
        let (context, dataset) = open(&[log.display().to_string()], 2).await;
        let refused = refused(&context).await;
        let part = &dataset.parts()[0];
        let index = &part.index;
        for topic in dataset.topics() {
            let promised: Option<u64> = part
                .channels_of(&topic)
                .map(|channel| index.channel_messages(channel.id))
                .sum();
            let raw = count(
                &context,
                &format!("SELECT data FROM messages WHERE topic = '{topic}'"),
            )
            .await;
            assert_eq!(Some(raw as u64), promised, "{} {topic}", log.display());
            if refused.contains(&topic) {
                eprintln!("{}: {topic} is refused", log.display());
                continue;
            }
            let decoded = count(&context, &format!("SELECT * FROM \"{topic}\"")).await;
            let lost = dataset.losses.entries();
            assert_eq!(decoded, raw, "{} {topic}: {lost:?}", log.display());
        }
        for role in [
            "frames",
            "odometry",
            "calibration",
            "transforms",
            "attachments",
            "metadata",
        ] {
            count(&context, &format!("SELECT * FROM {role}")).await;
        }
        assert_eq!(dataset.losses.entries(), [], "{}", log.display());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn rows_do_not_depend_on_partitions() {
    let bytes = Log {
        messages: 500,
        ..Log::default()
    }
    .write();
    let store = in_memory(&bytes).await;
    let sql = "SELECT * FROM \"/text\" ORDER BY log_time";
    let (one, _) = open_in(store.clone(), 1).await.unwrap();
    let (four, _) = open_in(store, 4).await.unwrap();
    assert_eq!(text(&rows(&one, sql).await), text(&rows(&four, sql).await));
    let plan = text(&rows(&four, "EXPLAIN SELECT * FROM \"/text\"").await);
    assert!(plan.contains("4 groups"), "{plan}");
}

#[tokio::test]
async fn counts_and_limits_and_projections_agree() {
    let store = in_memory(&Log::default().write()).await;
    let (context, _) = open_in(store, 1).await.unwrap();
    let counted = rows(&context, "SELECT count(*) FROM \"/text\"").await;
    assert_eq!(
        counted[0].column(0).as_primitive::<Int64Type>().value(0),
        30
    );
    assert_eq!(
        count(&context, "SELECT data FROM \"/text\" LIMIT 7").await,
        7
    );
    let found = rows(
        &context,
        "SELECT data, sequence FROM \"/text\" WHERE sequence = 4",
    )
    .await;
    assert!(text(&found).contains("message 000004"));
}

#[tokio::test]
async fn other_formats_are_refused_with_what_to_do() {
    let Some(folder) = shared("data/mcap_real") else {
        return;
    };
    for (extension, next) in [("bag", "rosbags-convert"), ("db3", "ros2 bag convert")] {
        for bag in files(&folder, extension) {
            let paths = [bag.display().to_string()];
            let fault = Dataset::open(&context(1).runtime_env(), &paths, None)
                .await
                .unwrap_err();
            let empty = std::fs::metadata(&bag).unwrap().len() == 0;
            let told = if empty { "empty file" } else { next };
            assert!(fault.to_string().contains(told), "{fault}");
        }
    }
}

#[tokio::test]
async fn parts_that_rosbag2_lists_are_one_session() {
    let Some(folder) = shared("data/mcap_real/ros2_rosbag2/rosbag2_py/test/resources/mcap/wbag")
    else {
        return;
    };
    let (context, dataset) = open(&[format!("{}/*.mcap", folder.display())], 2).await;
    let found = text(
        &rows(
            &context,
            "SELECT session, array_length(files) AS parts FROM sessions",
        )
        .await,
    );
    eprintln!("{found}");
    let listed = folder.join("metadata.yaml").exists();
    assert_eq!(dataset.sessions.len(), if listed { 1 } else { 5 });
}
