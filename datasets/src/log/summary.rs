//! The summary at the end of a file that was closed properly.

use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use evermap_schemas::Fault;
use mcap::records::{ChunkIndex, Footer, Record, op};
use object_store::{ObjectMeta, ObjectStore};

use crate::log::census::longest;
use crate::log::collector::Collector;
use crate::log::index::{LogIndex, Unit, UnitKind};
use crate::log::record::{FOOTER, FRAME, MAGIC, frame, nanoseconds, parse, split};
use crate::log::window::{SIDE_BY_SIDE, STRETCH_BYTES, Window, fetch, fetch_all, stretches};

/// Bytes fetched from the end of a file at first: most summaries fit.
const TAIL: u64 = 64 << 10;

/// Bytes that are fetched together to look at the frames of records: all that is on its way at a time is one stretch.
const FRAMES_BYTES: u64 = STRETCH_BYTES / SIDE_BY_SIDE as u64;

/// What a sound summary says, and the parts of the data section that it says nothing about.
pub(crate) struct Summary {
    pub collector: Collector,
    pub gaps: Vec<(u64, u64)>,
    /// Messages of all chunks, by the lengths of their message indexes; `None` where a chunk has none.
    pub indexed: Option<u64>,
}

/// What the end of a file says of a summary.
pub(crate) enum TrailingSummary {
    /// There is none, or the file has no end.
    Nothing,
    /// One that is damaged, contradicts the file's size, or does not describe the channels of the file.
    Unbelieved,
    /// One that can be used.
    Sound(Box<Summary>),
}

/// Reads the summary. Where there is no sound one, the file must be read from its start.
///
/// # Errors
/// A resource fault when the store fails.
pub(crate) async fn read(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
) -> Result<TrailingSummary, Fault> {
    if meta.size < 2 * MAGIC.len() as u64 + FOOTER {
        return Ok(TrailingSummary::Nothing);
    }
    let tail_start = meta.size.saturating_sub(TAIL);
    let tail = fetch(store, meta, tail_start..meta.size).await?;
    let Some(footer) = footer(&tail).filter(|footer| footer.summary_start != 0) else {
        return Ok(TrailingSummary::Nothing);
    };
    let window = Window::new(store.clone(), meta.clone(), meta.size);
    let window = window.holding(tail_start, tail);
    let summary = sound(store, meta, &footer, window).await?;
    Ok(summary.map_or(TrailingSummary::Unbelieved, |summary| {
        TrailingSummary::Sound(Box::new(summary))
    }))
}

/// The summary that the footer leads to, where it can be used.
async fn sound(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    footer: &Footer,
    mut window: Window,
) -> Result<Option<Summary>, Fault> {
    let magic = MAGIC.len() as u64;
    let footer_start = meta.size - magic - FOOTER;
    if footer.summary_start < magic || footer.summary_start >= footer_start {
        return Ok(None);
    }
    let section = footer.summary_start..footer_start;
    let Some(found) = Section::read(&mut window, section.clone()).await? else {
        return Ok(None);
    };
    if !checksum_fits(footer, &mut window, section).await? {
        tracing::warn!(file = %meta.location, "the summary does not match its checksum: reading the file from its start");
        return Ok(None);
    }
    // Entries that overlap, or lie outside, cost no request.
    let Some(summary) = found.believed(footer.summary_start) else {
        return Ok(None);
    };
    let fit = entries_fit(store, meta, &summary.collector.index).await?;
    Ok(fit.then_some(summary))
}

/// Whether there is a record of the length that the summary says wherever it has an attachment or metadata: a longer
/// one would cover what the summary leaves out. None overlaps another one. Of those that lie far from each other only
/// the frame is fetched, however large they are.
async fn entries_fit(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    index: &LogIndex,
) -> Result<bool, Fault> {
    let mut entries: Vec<&Unit> = index.attachments.iter().chain(&index.metadata).collect();
    if entries.iter().any(|unit| unit.length < FRAME) {
        return Ok(false);
    }
    entries.sort_unstable_by_key(|unit| unit.offset);
    let frames = entries
        .iter()
        .map(|unit| unit.offset..unit.offset.saturating_add(FRAME));
    let ranges = stretches(frames, FRAMES_BYTES);
    let mut entries = entries.iter().peekable();
    for some in ranges.chunks(SIDE_BY_SIDE) {
        let fetched = fetch_all(store, meta, some.to_vec()).await?;
        for (range, bytes) in some.iter().zip(&fetched) {
            while let Some(unit) = entries.next_if(|unit| unit.offset < range.end) {
                let at = (unit.offset - range.start) as usize;
                if bytes.get(at..).and_then(frame) != said(unit) {
                    return Ok(false);
                }
            }
        }
    }
    Ok(true)
}

/// The opcode and the length of the body that an entry of the index says.
fn said(unit: &Unit) -> Option<(u8, u64)> {
    let opcode = match unit.kind {
        UnitKind::Attachment => op::ATTACHMENT,
        _ => op::METADATA,
    };
    Some((opcode, unit.length.checked_sub(FRAME)?))
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
async fn checksum_fits(
    footer: &Footer,
    window: &mut Window,
    section: Range<u64>,
) -> Result<bool, Fault> {
    if footer.summary_crc == 0 {
        return Ok(true);
    }
    let covered = section.start..section.end + FOOTER - 4;
    Ok(window.checksum(covered).await? == Some(footer.summary_crc))
}

/// The summary's records, and the stretches that hold the message indexes of chunks.
#[derive(Default)]
struct Section {
    collector: Collector,
    message_indexes: Vec<(u64, u64)>,
    /// Messages of the chunks so far; `None` once one does not say.
    indexed: Option<u64>,
    /// An entry contradicts itself.
    senseless: bool,
}

impl Section {
    /// Record by record; `None` where one is cut, malformed, or of the data, or there are more than an index holds.
    async fn read(window: &mut Window, section: Range<u64>) -> Result<Option<Self>, Fault> {
        let mut found = Self {
            indexed: Some(0),
            ..Self::default()
        };
        let mut position = section.start;
        while position < section.end {
            let head = window.get(position, FRAME).await?.unwrap_or_default();
            let next = |length: u64| position.checked_add(FRAME)?.checked_add(length);
            let sized = frame(&head).and_then(|(op, length)| Some((op, length, next(length)?)));
            let Some((opcode, length, end)) =
                sized.filter(|(op, _, end)| *op != 0 && *end <= section.end)
            else {
                return Ok(None);
            };
            if is_data(opcode) {
                return Ok(None);
            }
            if is_summary(opcode) {
                if length > longest(opcode) {
                    return Ok(None);
                }
                let body = window.get(position + FRAME, length).await?;
                if !found.add(opcode, &body.unwrap_or_default()) {
                    return Ok(None);
                }
            }
            position = end;
        }
        Ok(Some(found))
    }

    /// Takes a record; whether it made sense and there was room.
    fn add(&mut self, opcode: u8, body: &[u8]) -> bool {
        let collector = &mut self.collector;
        if matches!(opcode, op::SCHEMA | op::CHANNEL) {
            return collector.add_definition(opcode, body).is_ok() && !collector.full;
        }
        match parse(opcode, body) {
            Ok(Record::ChunkIndex(chunk)) => {
                let unit = Unit::of_chunk(&chunk);
                let end = unit.end().saturating_add(chunk.message_index_length);
                self.message_indexes.push((unit.end(), end));
                let messages = message_count(&chunk);
                let says = !chunk.message_index_offsets.is_empty();
                let backwards = chunk.message_start_time > chunk.message_end_time;
                self.senseless |= says && (messages.is_none() || backwards);
                self.indexed = self.indexed.zip(messages).map(|(sum, more)| sum + more);
                collector.add_unit(unit);
            }
            Ok(Record::AttachmentIndex(entry)) => collector.add_unit(Unit::of_record(
                UnitKind::Attachment,
                entry.offset,
                entry.length,
                nanoseconds(entry.log_time),
            )),
            Ok(Record::MetadataIndex(entry)) => collector.add_unit(Unit::of_record(
                UnitKind::Metadata,
                entry.offset,
                entry.length,
                0,
            )),
            Ok(Record::Statistics(statistics)) => collector.statistics = Some(statistics),
            Ok(_) => {}
            Err(_) => return false,
        }
        !collector.full
    }

    /// The summary, if it can be used, and what of the data section it leaves out.
    fn believed(mut self, summary_start: u64) -> Option<Summary> {
        let collector = &self.collector;
        let units = &collector.index.units;
        let known = units.iter().flat_map(|unit| unit.channels.iter().flatten());
        let statistics = collector.statistics.as_ref();
        let promised = statistics.map_or(0, |found| found.channel_count) as usize;
        let defined = collector.index.channels.len();
        let silent = defined == 0 && statistics.is_none_or(|s| s.message_count > 0);
        // Where nobody counted, the entries of chunks may be any part of what there is.
        let unsaid = statistics.is_none() && !units.is_empty();
        let counted = statistics.map(|found| found.channel_message_counts.keys());
        let known = known.chain(counted.into_iter().flatten()).copied();
        if self.senseless || silent || unsaid || defined < promised || !collector.describes(known) {
            return None;
        }
        let gaps = gaps(collector, self.message_indexes, summary_start)?;
        self.collector.index.indexed = true;
        Some(Summary {
            collector: self.collector,
            gaps,
            indexed: self.indexed,
        })
    }
}

/// Whether a record stands in the data alone: what has one is no summary, wherever a footer says that it begins.
fn is_data(opcode: u8) -> bool {
    matches!(
        opcode,
        op::HEADER
            | op::MESSAGE
            | op::CHUNK
            | op::MESSAGE_INDEX
            | op::ATTACHMENT
            | op::METADATA
            | op::DATA_END
    )
}

fn is_summary(opcode: u8) -> bool {
    matches!(
        opcode,
        op::SCHEMA
            | op::CHANNEL
            | op::CHUNK_INDEX
            | op::ATTACHMENT_INDEX
            | op::METADATA_INDEX
            | op::STATISTICS
    )
}

/// Messages of a chunk, by the length of its message indexes: a record for each channel, with its number, the bytes of
/// its entries, and 16 B for each entry. `None` where it has none, or they are of another length.
fn message_count(chunk: &ChunkIndex) -> Option<u64> {
    const ENTRY: u64 = 16;
    let channels = chunk.message_index_offsets.len() as u64;
    let entries = chunk
        .message_index_length
        .checked_sub(channels * (FRAME + 2 + 4))?;
    (channels > 0 && entries.is_multiple_of(ENTRY)).then_some(entries / ENTRY)
}

/// The stretches between the file's first bytes and its summary that no index entry covers; `None` where entries
/// overlap, lie outside, or are of no bytes.
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
        .collect();
    if covered.iter().any(|(start, end)| start == end) {
        return None;
    }
    covered.extend(
        message_indexes
            .into_iter()
            .filter(|(start, end)| start != end),
    );
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
