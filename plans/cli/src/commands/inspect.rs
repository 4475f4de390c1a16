//! `evermap inspect`.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;

use arrow::array::AsArray;
use arrow::datatypes::{TimestampNanosecondType, UInt64Type};
use datafusion::prelude::SessionContext;
use evermap_datasets::log::index::{LogIndex, UnitKind};
use evermap_datasets::{Dataset, LogPart};
use evermap_engine::sql::{Limits, context};
use evermap_schemas::Fault;
use object_store::ObjectStoreExt;

use crate::arguments::InspectArgs;
use crate::contents::{Attachment, Channel, Chunks, Contents, LossLine};
use crate::ending::Ending;
use crate::reader::{answered, texts};
use crate::sessions::lost;

/// Says what a file holds. Every chunk is read, so that damage is found, unless only the index is asked for.
///
/// # Errors
/// A data fault for a file that is no MCAP, a user fault for one that is not there.
pub async fn inspect(args: &InspectArgs) -> Ending {
    let context = context(Limits::default())?;
    let dataset = Dataset::open(
        &context.runtime_env(),
        std::slice::from_ref(&args.file),
        None,
    )
    .await?;
    dataset.register(&context)?;
    let parts = dataset.parts();
    let [part] = parts.as_slice() else {
        return Err(Fault::user(format!(
            "expected one file, found {} at {}",
            parts.len(),
            args.file
        ))
        .into());
    };
    let counted = if args.quick {
        None
    } else {
        Some(read_all(&context).await?)
    };
    let (attachments, metadata) = (attachments(&context).await?, metadata(&context).await?);
    let contents = contents(&dataset, part, counted.as_ref(), attachments, metadata).await;
    let mut stdout = std::io::stdout().lock();
    if args.json {
        let text = serde_json::to_string_pretty(&contents)
            .map_err(|error| Fault::bug(error.to_string()))?;
        writeln!(stdout, "{text}")?;
    } else {
        stdout.write_all(contents.to_string().as_bytes())?;
    }
    Ok(lost(&dataset))
}

/// Reads every message; how many there are of each topic.
async fn read_all(context: &SessionContext) -> Result<BTreeMap<String, u64>, Fault> {
    let query = "SELECT topic, CAST(count(*) AS BIGINT UNSIGNED) AS n FROM messages GROUP BY topic";
    let mut counts = BTreeMap::new();
    for batch in answered(context, query).await? {
        let (topics, numbers) = (
            batch.column(0).as_string::<i32>(),
            batch.column(1).as_primitive::<UInt64Type>(),
        );
        for (topic, number) in topics.iter().flatten().zip(numbers.values()) {
            *counts.entry(topic.to_owned()).or_default() += number;
        }
    }
    Ok(counts)
}

async fn attachments(context: &SessionContext) -> Result<Vec<Attachment>, Fault> {
    let query = "SELECT name, media_type, size, log_time FROM attachments ORDER BY log_time, name";
    let mut found = Vec::new();
    for batch in answered(context, query).await? {
        let [names, types] = [0, 1].map(|column| batch.column(column).as_string::<i32>());
        let sizes = batch.column(2).as_primitive::<UInt64Type>();
        let times = batch.column(3).as_primitive::<TimestampNanosecondType>();
        found.extend((0..batch.num_rows()).map(|row| Attachment {
            name: names.value(row).to_owned(),
            media_type: types.value(row).to_owned(),
            bytes: sizes.value(row),
            log_time_ns: times.value(row),
        }));
    }
    Ok(found)
}

async fn metadata(context: &SessionContext) -> Result<Vec<String>, Fault> {
    let batches = answered(context, "SELECT name FROM metadata ORDER BY name").await?;
    let names = batches.iter().filter_map(|batch| texts(batch, "name"));
    Ok(names.flatten().flatten().map(str::to_owned).collect())
}

async fn contents(
    dataset: &Dataset,
    part: &LogPart,
    counted: Option<&BTreeMap<String, u64>>,
    attachments: Vec<Attachment>,
    metadata: Vec<String>,
) -> Contents {
    let index = &part.index;
    let range = index.time_range();
    let losses = dataset.losses.entries().into_iter().map(|entry| LossLine {
        reason: entry.reason.text().to_owned(),
        topic: entry.topic,
        offset: entry.offset,
        count: entry.loss.count,
        bytes: entry.loss.bytes,
        detail: entry.detail,
    });
    Contents {
        file: part.url.clone(),
        bytes: part.meta.size,
        profile: index.profile.clone(),
        library: index.library.clone(),
        indexed: index.indexed,
        messages: counted
            .map(|counts| counts.values().sum())
            .or_else(|| index.message_count()),
        start_ns: range.map(|(start, _)| start),
        end_ns: range.map(|(_, end)| end),
        start: range.map(|(start, _)| instant(start)),
        end: range.map(|(_, end)| instant(end)),
        chunks: chunks(part).await,
        channels: channels(part, counted),
        attachments,
        metadata,
        losses: losses.collect(),
    }
}

fn instant(nanoseconds: i64) -> String {
    chrono::DateTime::from_timestamp_nanos(nanoseconds).to_rfc3339()
}

fn channels(part: &LogPart, counted: Option<&BTreeMap<String, u64>>) -> Vec<Channel> {
    let index: &LogIndex = &part.index;
    let channels = index.channels.values().map(|channel| {
        let alone = index.channels_of(&channel.topic).count() == 1;
        let read = counted
            .filter(|_| alone)
            .map(|counts| counts.get(&channel.topic).copied().unwrap_or(0));
        let schema = channel.schema.as_deref();
        let undecodable = match part.message_type(channel.id) {
            Some(Err(error)) => Some(error.to_string()),
            _ => None,
        };
        Channel {
            id: channel.id,
            topic: channel.topic.clone(),
            schema: schema.map(|schema| schema.name.clone()).unwrap_or_default(),
            schema_encoding: schema
                .map(|schema| schema.encoding.clone())
                .unwrap_or_default(),
            message_encoding: channel.message_encoding.clone(),
            messages: read.or_else(|| index.channel_messages(channel.id)),
            undecodable,
        }
    });
    let mut channels: Vec<Channel> = channels.collect();
    channels.sort_by(|a, b| (&a.topic, a.id).cmp(&(&b.topic, b.id)));
    channels
}

/// Chunks whose heads are read to learn how they are compressed.
const HEADS: usize = 16;

async fn chunks(part: &LogPart) -> Chunks {
    let chunks: Vec<_> = part
        .index
        .units
        .iter()
        .filter(|unit| unit.kind == UnitKind::Chunk)
        .collect();
    let mut compression = BTreeSet::new();
    for chunk in chunks.iter().step_by(chunks.len().div_ceil(HEADS).max(1)) {
        let range = chunk.offset..(chunk.offset + 64).min(chunk.end());
        if let Ok(head) = part.store.get_range(&part.meta.location, range).await {
            compression.extend(compression_of(&head));
        }
    }
    Chunks {
        count: chunks.len(),
        bytes: chunks.iter().map(|chunk| chunk.length).sum(),
        uncompressed_bytes: chunks.iter().map(|chunk| chunk.size).sum(),
        compression,
    }
}

/// The compression that a chunk record's head names: opcode, length, two times, size and checksum stand before it.
fn compression_of(head: &[u8]) -> Option<String> {
    let text = head.get(1 + 8 + 8 + 8 + 8 + 4..)?;
    let (length, text) = text.split_first_chunk::<4>()?;
    let name = text.get(..u32::from_le_bytes(*length) as usize)?;
    let name = std::str::from_utf8(name).ok()?;
    Some(if name.is_empty() {
        "none".to_owned()
    } else {
        name.to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_of_a_chunk_names_its_compression() {
        let head = |name: &str| {
            [
                &[6_u8; 37][..],
                &(name.len() as u32).to_le_bytes(),
                name.as_bytes(),
                &[0; 9],
            ]
            .concat()
        };
        assert_eq!(compression_of(&head("zstd")).as_deref(), Some("zstd"));
        assert_eq!(compression_of(&head("")).as_deref(), Some("none"));
        assert_eq!(compression_of(&[6; 38]), None);
        assert_eq!(compression_of(&[0xff; 64]), None);
    }
}
