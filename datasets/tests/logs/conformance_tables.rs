//! The conformance suite once more, through the tables: whatever indexes a file has or lacks, its messages are rows.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::{context, files, shared};
use arrow::array::RecordBatch;
use datafusion::physical_plan::collect;
use evermap_datasets::Dataset;
use serde_json::Value;

#[tokio::test]
async fn all_messages_attachments_and_metadata_are_rows() {
    let Some(folder) = shared("data/mcap_conformance") else {
        return;
    };
    let context = context(1);
    for log in files(&folder, "mcap") {
        let text = std::fs::read_to_string(log.with_extension("json")).unwrap();
        let expected: Value = serde_json::from_str(&text).unwrap();
        let records = expected["records"].as_array().unwrap();
        let paths = [log.display().to_string()];
        let dataset = Dataset::open(&context.runtime_env(), &paths, None)
            .await
            .unwrap();
        let tables = dataset.tables().unwrap();
        for (table, kind) in [
            ("messages", "Message"),
            ("attachments", "Attachment"),
            ("metadata", "Metadata"),
        ] {
            let plan = tables[table]
                .scan(&context.state(), None, &[], None)
                .await
                .unwrap();
            let batches = collect(plan, context.task_ctx()).await.unwrap();
            let found: usize = batches.iter().map(RecordBatch::num_rows).sum();
            let promised = records
                .iter()
                .filter(|record| record["type"] == kind)
                .count();
            assert_eq!(found, promised, "{kind} of {}", log.display());
        }
        assert!(
            dataset.losses.is_empty(),
            "{}: {:?}",
            log.display(),
            dataset.losses.entries()
        );
    }
}
