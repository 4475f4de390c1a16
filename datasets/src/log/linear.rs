//! Reading a file record by record: the whole of it where it has no sound summary, else the parts that the summary
//! leaves out.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use bytes::Bytes;
use evermap_schemas::Fault;
use mcap::records::{Record, op};
use object_store::{ObjectMeta, ObjectStore};

use crate::log::chunk::Block;
use crate::log::index::{Collector, Counts, LogIndex, Unit, UnitKind};
use crate::log::record::{FRAME, MAGIC, MESSAGE_HEAD, MessageHead, frame, parse};
use crate::log::summary::Summary;
use crate::log::window::Window;
use crate::losses::{FileLosses, Loss, Reason};

/// Messages outside chunks are read in runs of this many bytes.
const RUN: u64 = 1 << 20;

/// Reads a whole file.
pub(crate) async fn read(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    losses: &FileLosses,
) -> Result<LogIndex, Fault> {
    let mut scan = Scan::new(Collector::default(), store, meta, meta.size, losses);
    let ended = scan.run(MAGIC.len() as u64, meta.size).await?;
    if let Ended::Early(at) = ended {
        let rest = meta.size - at.min(meta.size);
        let loss = Loss::one(rest);
        losses.note(Reason::Torn, at, loss, "no end record");
    }
    let mut index = scan.collector.finish();
    for (channel, count) in &scan.counts {
        if !index.channels.contains_key(channel) {
            let loss = Loss {
                count: *count,
                bytes: 0,
            };
            let detail = format!("channel {channel}");
            losses.note(Reason::UnknownChannel, u64::from(*channel), loss, detail);
        }
    }
    index.counts = Some(Counts {
        messages: scan.counts.values().sum(),
        channels: Some(scan.counts),
    });
    Ok(index)
}

/// Completes the index of a file with a sound summary by what lies between the entries of its index: messages
/// outside chunks, and records that the summary does not list.
pub(crate) async fn with_gaps(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    summary: Summary,
    losses: &FileLosses,
) -> Result<LogIndex, Fault> {
    let end = summary.gaps.iter().map(|gap| gap.1).max().unwrap_or(0);
    let mut scan = Scan::new(summary.collector, store, meta, end, losses);
    for (start, end) in summary.gaps {
        if let Ended::Early(at) = scan.run(start, end).await?
            && at < end
        {
            let loss = Loss::one(end - at);
            losses.note(Reason::BadRecord, at, loss, "between indexed records");
        }
    }
    Ok(scan.collector.finish())
}

enum Ended {
    /// At the record that ends the data section.
    AtEnd,
    /// At this offset, before such a record.
    Early(u64),
}

struct Scan<'a> {
    collector: Collector,
    window: Window,
    losses: &'a FileLosses,
    counts: BTreeMap<u16, u64>,
    run: Option<Run>,
}

/// A growing stretch of messages outside chunks.
struct Run {
    start: u64,
    end: u64,
    channels: BTreeSet<u16>,
    start_time: i64,
    end_time: i64,
}

impl<'a> Scan<'a> {
    fn new(
        collector: Collector,
        store: &Arc<dyn ObjectStore>,
        meta: &ObjectMeta,
        end: u64,
        losses: &'a FileLosses,
    ) -> Self {
        Self {
            collector,
            window: Window::new(store.clone(), meta.location.clone(), end),
            losses,
            counts: BTreeMap::new(),
            run: None,
        }
    }

    /// Reads the records between two offsets. Behind the end of the data section only definitions are of use: a
    /// damaged chunk may have been the only other place of them.
    async fn run(&mut self, start: u64, end: u64) -> Result<Ended, Fault> {
        let mut position = start;
        let mut data_ended = false;
        while let Some((opcode, length, next)) = self.next_frame(position, end).await? {
            match opcode {
                op::DATA_END => data_ended = true,
                op::FOOTER => break,
                op::SCHEMA | op::CHANNEL => self.record(opcode, position, length).await?,
                _ if data_ended => {}
                _ => self.record(opcode, position, length).await?,
            }
            position = next;
        }
        self.close_run();
        Ok(match data_ended {
            true => Ended::AtEnd,
            false => Ended::Early(position),
        })
    }

    /// Opcode, body length and end of the record at `position`; `None` where there is no complete one.
    async fn next_frame(
        &mut self,
        position: u64,
        end: u64,
    ) -> Result<Option<(u8, u64, u64)>, Fault> {
        let Some(head) = self.window.get(position, FRAME).await? else {
            return Ok(None);
        };
        let complete = frame(&head).and_then(|(opcode, length)| {
            let next = position.checked_add(FRAME)?.checked_add(length)?;
            (opcode != 0 && next <= end).then_some((opcode, length, next))
        });
        Ok(complete)
    }

    async fn record(&mut self, opcode: u8, offset: u64, length: u64) -> Result<(), Fault> {
        match opcode {
            op::MESSAGE => self.message(offset, length).await,
            op::CHUNK => self.chunk(offset, length).await,
            op::ATTACHMENT => {
                self.close_run();
                // Log time, the first field, is all that the index needs.
                let head = self.body(offset, length.min(8)).await?;
                let time = head
                    .first_chunk()
                    .map_or(0, |time| i64::from_le_bytes(*time));
                let unit = Unit::of_record(UnitKind::Attachment, offset, length + FRAME, time);
                self.collector.index.attachments.push(unit);
                Ok(())
            }
            op::METADATA => {
                self.close_run();
                let unit = Unit::of_record(UnitKind::Metadata, offset, length + FRAME, 0);
                self.collector.index.metadata.push(unit);
                Ok(())
            }
            op::HEADER => {
                let body = self.body(offset, length).await?;
                if let Ok(Record::Header(header)) = parse(opcode, &body) {
                    self.collector.index.profile = header.profile;
                    self.collector.index.library = header.library;
                }
                Ok(())
            }
            op::SCHEMA | op::CHANNEL => {
                let body = self.body(offset, length).await?;
                self.collector.add_definition(opcode, &body);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    async fn body(&mut self, offset: u64, length: u64) -> Result<Bytes, Fault> {
        Ok(self
            .window
            .get(offset + FRAME, length)
            .await?
            .unwrap_or_default())
    }

    async fn message(&mut self, offset: u64, length: u64) -> Result<(), Fault> {
        let body = self.body(offset, length.min(MESSAGE_HEAD as u64)).await?;
        let end = offset + FRAME + length;
        if self
            .run
            .as_ref()
            .is_some_and(|run| end - run.start > RUN && run.end > run.start)
        {
            self.close_run();
        }
        let Some(head) = MessageHead::parse(&body) else {
            let loss = Loss::one(FRAME + length);
            self.losses.note(
                Reason::BadRecord,
                offset,
                loss,
                "a message that is too short",
            );
            return Ok(());
        };
        *self.counts.entry(head.channel).or_default() += 1;
        let run = self.run.get_or_insert_with(|| Run {
            start: offset,
            end: offset,
            channels: BTreeSet::new(),
            start_time: i64::MAX,
            end_time: i64::MIN,
        });
        run.end = end;
        run.channels.insert(head.channel);
        run.start_time = run.start_time.min(head.log_time);
        run.end_time = run.end_time.max(head.log_time);
        Ok(())
    }

    fn close_run(&mut self) {
        let Some(run) = self.run.take() else { return };
        let length = run.end - run.start;
        self.collector.index.units.push(Unit {
            kind: UnitKind::Loose,
            offset: run.start,
            length,
            size: length,
            channels: Some(run.channels.into_iter().collect()),
            start_time: run.start_time,
            end_time: run.end_time,
        });
    }

    async fn chunk(&mut self, offset: u64, length: u64) -> Result<(), Fault> {
        self.close_run();
        let Some(record) = self.window.get(offset, FRAME + length).await? else {
            return Ok(());
        };
        let opened = tokio::task::spawn_blocking(move || census(&record, offset))
            .await
            .map_err(|error| Fault::bug(error.to_string()))?;
        match opened {
            Ok(census) => {
                for (opcode, body) in &census.definitions {
                    self.collector.add_definition(*opcode, body);
                }
                for (channel, count) in &census.counts {
                    *self.counts.entry(*channel).or_default() += count;
                }
                self.collector.index.units.push(census.unit);
            }
            Err((reason, detail)) => {
                let loss = Loss::one(FRAME + length);
                self.losses.note(reason, offset, loss, detail);
            }
        }
        Ok(())
    }
}

struct Census {
    unit: Unit,
    definitions: Vec<(u8, Bytes)>,
    counts: BTreeMap<u16, u64>,
}

/// Opens a chunk and counts what is in it.
fn census(record: &Bytes, offset: u64) -> Result<Census, crate::log::chunk::Damage> {
    let block = Block::open(record, offset)?;
    let mut counts = BTreeMap::<u16, u64>::new();
    let mut times: Option<(i64, i64)> = None;
    let mut definitions = Vec::new();
    for (opcode, _, body) in block.records() {
        match opcode {
            op::SCHEMA | op::CHANNEL => definitions.push((opcode, Bytes::copy_from_slice(body))),
            op::MESSAGE => {
                let Some(head) = MessageHead::parse(body) else {
                    continue;
                };
                *counts.entry(head.channel).or_default() += 1;
                let (start, end) = times.unwrap_or((head.log_time, head.log_time));
                times = Some((start.min(head.log_time), end.max(head.log_time)));
            }
            _ => {}
        }
    }
    let (start_time, end_time) = times.unwrap_or_default();
    let unit = Unit {
        kind: UnitKind::Chunk,
        offset,
        length: record.len() as u64,
        size: block.bytes.len() as u64,
        channels: Some(counts.keys().copied().collect()),
        start_time,
        end_time,
    };
    Ok(Census {
        unit,
        definitions,
        counts,
    })
}
