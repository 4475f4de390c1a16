//! The summary at the end of a file that was closed properly.

use std::sync::Arc;

use bytes::Bytes;
use evermap_schemas::Fault;
use mcap::records::{Footer, Record, op};
use object_store::{ObjectMeta, ObjectStore};

use crate::log::index::{Collector, Unit, UnitKind};
use crate::log::record::{FOOTER, FRAME, MAGIC, nanoseconds, parse, split};
use crate::log::window::fetch;

/// Bytes fetched from the end of a file at first: most summaries fit.
const TAIL: u64 = 64 << 10;

/// What a sound summary says, and the parts of the data section that it says nothing about.
pub(crate) struct Summary {
    pub collector: Collector,
    pub gaps: Vec<(u64, u64)>,
}

/// Reads the summary; `None` where there is none, where it is damaged, where it contradicts the file's size, or where
/// it does not describe the channels of the file. Then the file must be read from its start.
///
/// # Errors
/// A resource fault when the store fails.
pub(crate) async fn read(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
) -> Result<Option<Summary>, Fault> {
    let magic = MAGIC.len() as u64;
    if meta.size < 2 * magic + FOOTER {
        return Ok(None);
    }
    let tail_start = meta.size.saturating_sub(TAIL);
    let tail = fetch(store, &meta.location, tail_start..meta.size).await?;
    let footer_start = meta.size - magic - FOOTER;
    let Some(footer) = footer(&tail) else {
        return Ok(None);
    };
    if footer.summary_start < magic || footer.summary_start >= footer_start {
        return Ok(None);
    }
    let section = if footer.summary_start >= tail_start {
        tail.slice((footer.summary_start - tail_start) as usize..)
    } else {
        fetch(store, &meta.location, footer.summary_start..meta.size).await?
    };
    if !checksum_fits(&footer, &section) {
        tracing::warn!(file = %meta.location, "the summary does not match its checksum: reading the file from its start");
        return Ok(None);
    }
    let records = section.slice(..(footer_start - footer.summary_start) as usize);
    Ok(collect(&records)
        .and_then(|(collector, indexes)| believe(collector, indexes, footer.summary_start)))
}

fn footer(tail: &Bytes) -> Option<Footer> {
    let record = tail.strip_suffix(MAGIC)?;
    let (opcode, body, _) = split(record.get(record.len().checked_sub(FOOTER as usize)?..)?)?;
    match parse(opcode, body) {
        Ok(Record::Footer(footer)) if body.len() as u64 == FOOTER - FRAME => Some(footer),
        _ => None,
    }
}

/// The checksum covers the summary and the footer up to the checksum itself.
fn checksum_fits(footer: &Footer, section: &[u8]) -> bool {
    let covered = section.len().saturating_sub(MAGIC.len() + 4);
    footer.summary_crc == 0 || crc32fast::hash(&section[..covered]) == footer.summary_crc
}

/// The summary's records, and the stretches that hold the message indexes of chunks.
fn collect(records: &Bytes) -> Option<(Collector, Vec<(u64, u64)>)> {
    let mut collector = Collector::default();
    let mut message_indexes = Vec::new();
    let mut offset = 0;
    while offset < records.len() {
        let (opcode, body, used) = split(&records[offset..])?;
        offset += used;
        if matches!(opcode, op::SCHEMA | op::CHANNEL) {
            collector.add_definition(opcode, body);
            continue;
        }
        let index = &mut collector.index;
        match parse(opcode, body).ok()? {
            Record::ChunkIndex(chunk) => {
                let unit = Unit::of_chunk(&chunk);
                let end = unit.end().saturating_add(chunk.message_index_length);
                message_indexes.push((unit.end(), end));
                index.units.push(unit);
            }
            Record::AttachmentIndex(entry) => index.attachments.push(Unit::of_record(
                UnitKind::Attachment,
                entry.offset,
                entry.length,
                nanoseconds(entry.log_time),
            )),
            Record::MetadataIndex(entry) => index.metadata.push(Unit::of_record(
                UnitKind::Metadata,
                entry.offset,
                entry.length,
                0,
            )),
            Record::Statistics(statistics) => collector.statistics = Some(statistics),
            _ => {}
        }
    }
    Some((collector, message_indexes))
}

/// Whether the summary can be used, and what of the data section it leaves out.
fn believe(
    mut collector: Collector,
    message_indexes: Vec<(u64, u64)>,
    summary_start: u64,
) -> Option<Summary> {
    let known: Vec<u16> = collector
        .index
        .units
        .iter()
        .flat_map(|unit| unit.channels.iter().flatten().copied())
        .collect();
    let statistics = collector.statistics.as_ref();
    let promised = statistics.map_or(0, |found| found.channel_count) as usize;
    let silent = collector.channel_count() == 0 && statistics.is_none_or(|s| s.message_count > 0);
    if silent || collector.channel_count() < promised || !collector.describes(known.into_iter()) {
        return None;
    }
    let gaps = gaps(&collector, message_indexes, summary_start)?;
    collector.index.indexed = true;
    Some(Summary { collector, gaps })
}

/// The stretches between the file's first bytes and its summary that no index entry covers; `None` where entries
/// overlap or lie outside.
fn gaps(
    collector: &Collector,
    message_indexes: Vec<(u64, u64)>,
    summary_start: u64,
) -> Option<Vec<(u64, u64)>> {
    let index = &collector.index;
    let mut covered: Vec<(u64, u64)> = index
        .units
        .iter()
        .chain(&index.attachments)
        .chain(&index.metadata)
        .map(|unit| (unit.offset, unit.end()))
        .chain(message_indexes)
        .filter(|(start, end)| start != end)
        .collect();
    covered.sort_unstable();
    let mut gaps = Vec::new();
    let mut position = MAGIC.len() as u64;
    for (start, end) in covered {
        if start < position || end > summary_start {
            return None;
        }
        if start > position {
            gaps.push((position, start));
        }
        position = end;
    }
    if position < summary_start {
        gaps.push((position, summary_start));
    }
    Some(gaps)
}
