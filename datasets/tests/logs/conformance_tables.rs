//! The conformance suite once more, through the tables: whatever indexes a file has or lacks, its messages, attachments
//! and metadata are rows, value by value.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::{context, files, rows, shared};
use arrow::array::{AsArray, RecordBatch};
use evermap_datasets::Dataset;
use serde_json::Value;

/// A kind of record: how its table's rows, and the fields that the suite lists, become the same text.
struct Kind {
    name: &'static str,
    query: &'static str,
    fields: &'static [&'static str],
}

const KINDS: [Kind; 3] = [
    Kind {
        name: "Message",
        query: "SELECT concat_ws('|', channel, sequence, CAST(log_time AS BIGINT), CAST(publish_time AS BIGINT),
                encode(data, 'hex')) FROM messages",
        fields: &["channel_id", "sequence", "log_time", "publish_time", "data"],
    },
    Kind {
        name: "Attachment",
        query: "SELECT concat_ws('|', name, media_type, CAST(log_time AS BIGINT), CAST(create_time AS BIGINT),
                encode(data, 'hex')) FROM attachments",
        fields: &["name", "media_type", "log_time", "create_time", "data"],
    },
    Kind {
        name: "Metadata",
        query: "SELECT concat_ws('|', name, array_to_string(map_keys(metadata), ','),
                array_to_string(map_values(metadata), ',')) FROM metadata",
        fields: &["name", "metadata"],
    },
];

impl Kind {
    /// What the suite lists of this kind, sorted.
    fn listed(&self, records: &[Value]) -> Vec<String> {
        let of_kind = records.iter().filter(|record| record["type"] == self.name);
        let mut listed: Vec<String> = of_kind
            .map(|record| {
                let fields = record["fields"].as_array().unwrap();
                let value = |name: &&str| {
                    let found = fields.iter().find(|field| field[0] == **name);
                    text(&found.unwrap()[1])
                };
                self.fields.iter().map(value).collect::<Vec<_>>().join("|")
            })
            .collect();
        listed.sort();
        listed
    }
}

/// A value of the suite: texts, bytes as decimal numbers, maps.
fn text(value: &Value) -> String {
    match value {
        Value::Array(bytes) => {
            let byte = |byte: &Value| byte.as_str().unwrap().parse::<u8>().unwrap();
            bytes
                .iter()
                .map(|found| format!("{:02x}", byte(found)))
                .collect()
        }
        Value::Object(map) => {
            let keys: Vec<&str> = map.keys().map(String::as_str).collect();
            let values: Vec<&str> = map.values().map(|value| value.as_str().unwrap()).collect();
            format!("{}|{}", keys.join(","), values.join(","))
        }
        other => other.as_str().unwrap().to_owned(),
    }
}

fn texts(batch: &RecordBatch) -> Vec<String> {
    let found = batch.column(0).as_string::<i32>().iter();
    found.map(|text| text.unwrap().to_owned()).collect()
}

#[tokio::test]
async fn all_messages_attachments_and_metadata_are_rows() {
    let Some(folder) = shared("data/mcap_conformance") else {
        return;
    };
    let mut compared = [0; 3];
    for log in files(&folder, "mcap") {
        let expected = std::fs::read_to_string(log.with_extension("json")).unwrap();
        let expected: Value = serde_json::from_str(&expected).unwrap();
        let records = expected["records"].as_array().unwrap();
        let context = context(1);
        let paths = [log.display().to_string()];
        let dataset = Dataset::open(&context.runtime_env(), &paths, None).await;
        let dataset = dataset.unwrap();
        dataset.register(&context).unwrap();
        for (kind, compared) in KINDS.iter().zip(&mut compared) {
            let mut found: Vec<String> = rows(&context, kind.query)
                .await
                .iter()
                .flat_map(texts)
                .collect();
            found.sort();
            assert_eq!(
                found,
                kind.listed(records),
                "{} of {}",
                kind.name,
                log.display()
            );
            *compared += found.len();
        }
        let losses = &dataset.losses;
        assert!(
            losses.is_empty(),
            "{}: {:?}",
            log.display(),
            losses.entries()
        );
    }
    assert!(
        compared.iter().all(|compared| *compared > 10),
        "{compared:?}"
    );
}
