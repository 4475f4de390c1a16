//! Reading a file record by record: the whole of it where it has no sound summary, else the parts that the summary
//! leaves out.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use bytes::Bytes;
use evermap_schemas::Fault;
use mcap::records::{Record, Statistics, op};
use object_store::{ObjectMeta, ObjectStore};

use crate::log::census::longest;
use crate::log::checksum::Checksum;
use crate::log::collector::Collector;
use crate::log::index::{Counts, DataSum, LogIndex, Unit, UnitKind};
use crate::log::pace::{Pace, add};
use crate::log::record::{FRAME, MAGIC, MESSAGE_HEAD, MessageHead, frame, nanoseconds, parse};
use crate::log::summary::Summary;
use crate::log::window::Window;
use crate::losses::{FileLosses, Loss, Reason};

mod checksum;
mod chunks;
mod counts;

pub(super) use counts::as_said;

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
    match ended {
        Ended::Early(at) => {
            scan.torn_chunk(at, meta.size).await?;
            let rest = meta.size - at.min(meta.size);
            let loss = Loss::one(rest);
            losses.note(Reason::Torn, at, loss, "no end record");
        }
        Ended::AtEnd => scan.compare_counts(meta.size),
    }
    scan.note_full();
    let messages = scan.messages();
    let mut index = scan.collector.finish();
    for (channel, pace) in &scan.paces {
        if !index.channels.contains_key(channel) {
            let loss = Loss {
                count: pace.messages,
                bytes: 0,
            };
            let detail = format!("channel {channel}");
            losses.note(Reason::UnknownChannel, u64::from(*channel), loss, detail);
        }
    }
    let counts = scan.paces.iter();
    let counts = counts.map(|(channel, pace)| (*channel, pace.messages));
    index.counts = Some(Counts {
        messages,
        channels: Some(counts.collect()),
    });
    index.paces = scan.paces;
    index.unchecked = match scan.compared {
        true => 0,
        false => scan.loose,
    };
    Ok(index)
}

/// The index of a file as its summary has it.
pub(crate) enum Summarised {
    /// With what lies between its entries.
    Whole(LogIndex),
    /// A record between its entries does not end where the next one begins: it is damaged, or the entry is.
    Cut(LogIndex),
    /// What lies between contradicts the summary.
    Contradicted,
}

/// Completes the index of a file with a sound summary by what lies between the entries of its index: messages
/// outside chunks, and records that the summary does not list.
pub(crate) async fn with_gaps(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    summary: Summary,
    losses: &FileLosses,
) -> Result<Summarised, Fault> {
    let end = summary.gaps.iter().map(|gap| gap.1).max().unwrap_or(0);
    let mut scan = Scan::new(summary.collector, store, meta, end, losses);
    let mut is_cut = false;
    for (start, end) in summary.gaps {
        if let Ended::Early(at) = scan.run(start, end).await?
            && at < end
        {
            let loss = Loss::one(end - at);
            losses.note(Reason::BadRecord, at, loss, "between indexed records");
            is_cut = true;
        }
    }
    scan.note_full();
    if scan.contradicts(summary.indexed) {
        tracing::warn!(file = %meta.location, "the summary contradicts the file: reading the file from its start");
        return Ok(Summarised::Contradicted);
    }
    let sum = scan.left.filter(|_| scan.loose > 0);
    let index = LogIndex {
        sum,
        ..scan.collector.finish()
    };
    Ok(match is_cut {
        true => Summarised::Cut(index),
        false => Summarised::Whole(index),
    })
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
    paces: BTreeMap<u16, Pace>,
    run: Option<Run>,
    /// Messages that are too short, one behind the other: where the first is, and how many.
    short: Option<(u64, Loss)>,
    /// The summary lists the channels of chunks.
    listed: bool,
    /// There are message indexes that no chunk of the summary has.
    stray_indexes: bool,
    /// Of what was read; `None` once it has nothing to say: a stretch is left out, or a chunk with a checksum of its own is
    /// damaged, which says more.
    checksum: Option<Checksum>,
    /// Whether it was compared with one that the recorder made.
    compared: bool,
    /// The one that the recorder made, where there is nothing to compare it with.
    left: Option<DataSum>,
    /// There are chunks with checksums of their own.
    checked: bool,
    /// Messages outside of chunks.
    loose: u64,
    /// What the recorder counted, where that stands behind the end of the data: of several records the last.
    said: Option<Statistics>,
}

/// A growing stretch of messages outside chunks.
struct Run {
    start: u64,
    end: u64,
    channels: BTreeSet<u16>,
    start_time: i64,
    end_time: i64,
    late: u64,
}

impl<'a> Scan<'a> {
    fn new(
        collector: Collector,
        store: &Arc<dyn ObjectStore>,
        meta: &ObjectMeta,
        end: u64,
        losses: &'a FileLosses,
    ) -> Self {
        let mut units = collector.index.units.iter();
        let listed = units.any(|unit| unit.channels.is_some());
        Self {
            listed,
            collector,
            window: Window::new(store.clone(), meta.clone(), end),
            losses,
            paces: BTreeMap::new(),
            run: None,
            short: None,
            stray_indexes: false,
            checksum: Some(Checksum::default()),
            compared: false,
            left: None,
            checked: false,
            loose: 0,
            said: None,
        }
    }

    fn messages(&self) -> u64 {
        self.paces.values().map(|pace| pace.messages).sum()
    }

    /// Whether the file has other messages than the summary says, as far as that can be told without reading chunks.
    fn contradicts(&self, indexed: Option<u64>) -> bool {
        let Some(statistics) = &self.collector.statistics else {
            return self.stray_indexes;
        };
        let index = &self.collector.index;
        let times = (statistics.message_start_time, statistics.message_end_time);
        let times = (nanoseconds(times.0), nanoseconds(times.1));
        let loose = self.messages();
        let total = indexed.map(|indexed| indexed.saturating_add(loose));
        let units = || index.units.iter();
        let listed: BTreeSet<u16> = units()
            .flat_map(|unit| unit.channels.iter().flatten().copied())
            .collect();
        let unlisted = statistics.channel_message_counts.iter();
        let mut unlisted = unlisted.filter(|(id, count)| **count > 0 && !listed.contains(id));
        self.stray_indexes
            || index.time_range().is_some_and(|found| found != times)
            || total.is_some_and(|total| total != statistics.message_count)
            || (unlisted.next().is_some() && units().all(|unit| unit.channels.is_some()))
    }

    /// Says that not everything found room.
    fn note_full(&self) {
        if self.collector.full {
            let detail = "expected at most 48 MiB of schemas, channels and places of records";
            self.losses.note(Reason::NoRoom, 0, Loss::one(0), detail);
        }
    }

    /// Reads the records between two offsets. Behind the end of the data section only definitions are of use, as a damaged
    /// chunk may have been the only other place of them, and what the recorder counted.
    async fn run(&mut self, start: u64, end: u64) -> Result<Ended, Fault> {
        let mut position = start;
        let mut data_ended = false;
        self.hash_from(start).await?;
        while let Some((opcode, length, next)) = self.next_frame(position, end).await? {
            if opcode != op::MESSAGE {
                self.close_short();
            }
            match opcode {
                op::DATA_END => {
                    self.compare(position, length).await?;
                    data_ended = true;
                }
                op::FOOTER => {
                    self.behind(next + MAGIC.len() as u64, end);
                    break;
                }
                op::SCHEMA | op::CHANNEL => self.record(opcode, position, length).await?,
                op::MESSAGE | op::CHUNK if data_ended => {
                    let detail = "behind the end of the data";
                    (self.losses).note(Reason::BadRecord, position, Loss::one(length), detail);
                }
                op::STATISTICS if data_ended => self.statistics(position, length).await?,
                _ if data_ended => {}
                _ => self.record(opcode, position, length).await?,
            }
            self.hash_to(next).await?;
            position = next;
        }
        self.close_run();
        self.close_short();
        Ok(match data_ended {
            true => Ended::AtEnd,
            false => Ended::Early(position),
        })
    }

    /// Says that a file goes on behind the end of its log, as those do that were put together by `cat`.
    fn behind(&self, log_end: u64, file_end: u64) {
        if log_end < file_end {
            let loss = Loss::one(file_end - log_end);
            let detail = "behind the end of the log: expected one log in a file";
            self.losses.note(Reason::BadRecord, log_end, loss, detail);
        }
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
            op::CHUNK => self.chunk(offset, FRAME + length, None).await,
            op::MESSAGE_INDEX => {
                self.stray_indexes |= self.listed;
                Ok(())
            }
            op::ATTACHMENT => {
                self.close_run();
                // Log time, the first field, is all that the index needs.
                let head = self.body(opcode, offset, length.min(8)).await?;
                let time = head
                    .first_chunk()
                    .map_or(0, |time| i64::from_le_bytes(*time));
                let unit = Unit::of_record(UnitKind::Attachment, offset, length + FRAME, time);
                self.collector.add_unit(unit);
                Ok(())
            }
            op::METADATA => {
                self.close_run();
                let unit = Unit::of_record(UnitKind::Metadata, offset, length + FRAME, 0);
                self.collector.add_unit(unit);
                Ok(())
            }
            op::HEADER => {
                let body = self.body(opcode, offset, length).await?;
                match parse(opcode, &body) {
                    Ok(Record::Header(header)) => {
                        self.collector.index.profile = header.profile;
                        self.collector.index.library = header.library;
                    }
                    _ => {
                        let detail = "expected a header, found a record that is cut or malformed";
                        self.bad_record(detail, offset, length);
                    }
                }
                Ok(())
            }
            op::SCHEMA | op::CHANNEL => {
                let body = self.body(opcode, offset, length).await?;
                if let Err(detail) = self.collector.add_definition(opcode, &body) {
                    self.bad_record(detail, offset, length);
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn bad_record(&self, detail: impl Into<String>, offset: u64, length: u64) {
        let loss = Loss::one(FRAME + length);
        self.losses.note(Reason::BadRecord, offset, loss, detail);
    }

    /// The body of a header or definition; of one that is longer than any, nothing.
    async fn body(&mut self, opcode: u8, offset: u64, length: u64) -> Result<Bytes, Fault> {
        let most = longest(opcode);
        if length > most {
            let detail = format!("expected a definition of at most {most} B, found {length} B");
            self.bad_record(detail, offset, length);
            return Ok(Bytes::new());
        }
        Ok(self
            .window
            .get(offset + FRAME, length)
            .await?
            .unwrap_or_default())
    }

    async fn message(&mut self, offset: u64, length: u64) -> Result<(), Fault> {
        let body = self
            .window
            .get(offset + FRAME, length.min(MESSAGE_HEAD as u64));
        let body = body.await?.unwrap_or_default();
        let end = offset + FRAME + length;
        if self
            .run
            .as_ref()
            .is_some_and(|run| end - run.start > RUN && run.end > run.start)
        {
            self.close_run();
        }
        let Some(head) = MessageHead::parse(&body) else {
            let (_, lost) = self.short.get_or_insert((offset, Loss::default()));
            lost.add(Some(FRAME + length));
            return Ok(());
        };
        self.close_short();
        self.loose += 1;
        add(&mut self.paces, head.channel, Pace::of(head.log_time));
        let run = self.run.get_or_insert_with(|| Run {
            start: offset,
            end: offset,
            channels: BTreeSet::new(),
            start_time: i64::MAX,
            end_time: i64::MIN,
            late: 0,
        });
        run.end = end;
        run.late += u64::from(head.is_late());
        run.channels.insert(head.channel);
        run.start_time = run.start_time.min(head.log_time);
        run.end_time = run.end_time.max(head.log_time);
        Ok(())
    }

    fn close_short(&mut self) {
        if let Some((offset, lost)) = self.short.take() {
            let detail =
                format!("expected messages of at least {MESSAGE_HEAD} B, found shorter ones");
            self.losses.note(Reason::BadRecord, offset, lost, detail);
        }
    }

    fn close_run(&mut self) {
        let Some(run) = self.run.take() else { return };
        let length = run.end - run.start;
        self.note_late(run.late, run.start);
        self.collector.add_unit(Unit {
            kind: UnitKind::Loose,
            offset: run.start,
            length,
            size: length,
            channels: Some(run.channels.into_iter().collect()),
            start_time: run.start_time,
            end_time: run.end_time,
        });
    }

    /// Says how many messages of a unit have a log time that is beyond what Arrow holds.
    fn note_late(&self, count: u64, offset: u64) {
        if count > 0 {
            let loss = Loss { count, bytes: 0 };
            self.losses
                .note(Reason::Senseless, offset, loss, MessageHead::LATE);
        }
    }
}
