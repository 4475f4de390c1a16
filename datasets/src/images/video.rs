//! Frames of video: decoded from the last key frame on, and for neighbours from where decoding stands.
//!
//! A reference says where its own frame lies. Which messages come before it, and which of them is the last key frame,
//! the log says: the chunks before are opened one by one until it is found. What a chunk holds of a topic is then known.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use evermap_messages::bytes_of_base64;
use evermap_schemas::roles::IMAGE_MEMBER;
use evermap_schemas::{Fault, ImageRef};
use evermap_video::{Codec, Decoder, Failure};

use crate::images::{ChunkRef, ImageReader, held};
use crate::log::chunk::{Block, Message};
use crate::log::record::MessageHead;
use crate::session::LogPart;

/// Decoders of one topic that wait for the frame behind their last one: one for each reader that goes through it.
const WAITING: usize = 4;

/// Where a frame stands in its session: file, unit of the file, place among the topic's frames in the unit.
type At = (u32, usize, usize);

/// The frames of a topic in a unit.
type Frames = Arc<Vec<FrameSpan>>;

/// The topics whose frames were asked for, by session and topic.
#[derive(Debug, Default)]
pub struct Tracks(Mutex<BTreeMap<(String, String), Arc<Track>>>);

/// What is known of the frames of one topic.
#[derive(Debug, Default)]
struct Track {
    units: Mutex<BTreeMap<(u32, usize), Frames>>,
    /// No frame up to this unit is a key frame.
    barren: Mutex<Option<(u32, usize)>>,
    runs: Mutex<Vec<Run>>,
}

/// A frame in an opened unit.
#[derive(Debug, Clone)]
struct FrameSpan {
    start: usize,
    end: usize,
    base64: bool,
    begins: bool,
}

/// A decoder on its way from a key frame on.
#[derive(Debug)]
struct Run {
    key: At,
    last: Option<At>,
    /// Behind a frame that was not decoded, why not.
    decoder: Result<Decoder, String>,
}

/// What came out for a frame.
type Decoded = Result<Bytes, Fault>;

impl FrameSpan {
    fn bytes(&self, unit: &Bytes) -> Option<Bytes> {
        let bytes = unit.slice(self.start..self.end);
        if self.base64 {
            return bytes_of_base64(&bytes).ok().map(Bytes::from);
        }
        Some(bytes)
    }
}

impl Run {
    fn new(codec: Codec, key: At) -> Self {
        Self {
            key,
            last: None,
            decoder: Ok(Decoder::new(codec)),
        }
    }

    /// Whether it can go on to this frame of the group that begins with `key`.
    fn leads_to(&self, key: At, frame: At) -> bool {
        self.key == key && self.last.is_none_or(|last| last < frame)
    }

    /// Decodes frames that follow each other; the pictures of those that are wanted.
    ///
    /// # Errors
    /// A resource fault where nothing is there to decode them.
    fn decode(
        &mut self,
        frames: Vec<(At, Option<Bytes>, bool)>,
    ) -> Result<Vec<(At, Decoded)>, Fault> {
        let mut decoded = Vec::new();
        for (at, bytes, wanted) in frames {
            let shown = self.push(bytes, wanted)?;
            self.last = Some(at);
            if wanted {
                decoded.push((at, shown));
            }
        }
        Ok(decoded)
    }

    fn push(&mut self, bytes: Option<Bytes>, wanted: bool) -> Result<Decoded, Fault> {
        let decoder = match &mut self.decoder {
            Ok(decoder) => decoder,
            Err(reason) => {
                let after = format!("video frame after one that {reason}");
                return Ok(Err(Fault::data(after)));
            }
        };
        let bytes = bytes.ok_or_else(|| Failure::Frame("is not base64".to_owned()));
        match bytes.and_then(|bytes| decoder.push(&bytes, wanted)) {
            Ok(Some(Ok(file))) => Ok(Ok(file.into())),
            Ok(Some(Err(reason))) => Ok(Err(Fault::data(format!("video frame: {reason}")))),
            // Nobody asked for its picture.
            Ok(None) => Ok(Ok(Bytes::new())),
            Err(Failure::Frame(reason)) => {
                let lost = format!("video frame {reason}");
                self.decoder = Err(reason);
                Ok(Err(Fault::data(lost)))
            }
            Err(Failure::Process(reason)) => Err(Fault::resource(reason)),
        }
    }
}

impl ImageReader {
    /// Decodes the frames that these references name; what is wrong with one is its own fault.
    pub(super) async fn video(
        &self,
        images: &[(usize, &ImageRef, Codec)],
    ) -> Result<Vec<(usize, Decoded)>, Fault> {
        let mut found = Vec::new();
        let mut topics = BTreeMap::<(&str, String, &str), Vec<(At, usize, Codec)>>::new();
        for (index, image, codec) in images {
            match self.topic_and_unit(image).await? {
                Err(fault) => found.push((*index, Err(fault))),
                Ok((topic, unit)) => match self.place(image, &topic, unit, *codec).await? {
                    Err(fault) => found.push((*index, Err(fault))),
                    Ok(at) => {
                        let key = (image.session.as_str(), topic, image.format.as_str());
                        topics.entry(key).or_default().push((at, *index, *codec));
                    }
                },
            }
        }
        for ((session, topic, _), mut wanted) in topics {
            wanted.sort_by_key(|(at, index, _)| (*at, *index));
            found.extend(self.decode(session, &topic, &wanted).await?);
        }
        Ok(found)
    }

    /// The topic that an image was recorded on, and the unit of its file that holds it.
    pub(super) async fn topic_and_unit(
        &self,
        image: &ImageRef,
    ) -> Result<Result<(String, usize), Fault>, Fault> {
        let part = self.part(&image.session, image.part)?;
        let lost = || {
            let place = image.chunk.unwrap_or(image.offset);
            let fault = "expected an image where the reference says, found none";
            Fault::data(fault).at(format!("{} at {place}", part.url))
        };
        let place = image.chunk.unwrap_or(image.offset);
        let units = &part.index.units;
        let behind = units.partition_point(|unit| unit.offset <= place);
        let Some(unit) = behind.checked_sub(1).filter(|at| place < units[*at].end()) else {
            return Ok(Err(lost()));
        };
        let bytes = match self.unit(part, unit).await? {
            Ok(bytes) => bytes,
            Err(fault) => return Ok(Err(fault)),
        };
        let start = within(part, unit, image);
        let messages = Block::loose(bytes, 0).contents(|_| true).messages;
        let holds = |message: &&Message| (message.start..message.end).contains(&start);
        let channel = messages.iter().find(holds).map(|found| found.head.channel);
        let channel = channel.and_then(|channel| part.index.channels.get(&channel));
        Ok(channel
            .map(|channel| (channel.topic.clone(), unit))
            .ok_or_else(lost))
    }

    async fn place(
        &self,
        image: &ImageRef,
        topic: &str,
        unit: usize,
        codec: Codec,
    ) -> Result<Result<At, Fault>, Fault> {
        let part = self.part(&image.session, image.part)?;
        let frames = match self.frames(part, topic, unit, codec).await? {
            Ok(frames) => frames,
            Err(fault) => return Ok(Err(fault)),
        };
        let start = within(part, unit, image);
        let found = frames.iter().position(|frame| frame.start == start);
        Ok(found
            .map(|frame| (image.part, unit, frame))
            .ok_or_else(|| Fault::data("expected a video frame in the message, found none")))
    }

    async fn decode(
        &self,
        session: &str,
        topic: &str,
        wanted: &[(At, usize, Codec)],
    ) -> Result<Vec<(usize, Decoded)>, Fault> {
        let track = self.track(session, topic);
        let mut decoded = Vec::new();
        let mut run: Option<Run> = None;
        let mut last: Option<(At, Decoded)> = None;
        for (at, index, codec) in wanted {
            if let Some((_, file)) = last.as_ref().filter(|(same, _)| same == at) {
                decoded.push((*index, file.clone()));
                continue;
            }
            let file = match self.key_frame(session, topic, *at, *codec).await? {
                Err(fault) => Err(fault),
                Ok(key) => {
                    let going = run.take().filter(|run| run.leads_to(key, *at));
                    let going = going.or_else(|| track.take(key, *at));
                    let mut going = going.unwrap_or_else(|| Run::new(*codec, key));
                    let file;
                    (going, file) = self.go_on(session, topic, going, *at, *codec).await?;
                    run = Some(going);
                    file
                }
            };
            last = Some((*at, file.clone()));
            decoded.push((*index, file));
        }
        track.keep(run);
        Ok(decoded)
    }

    /// Feeds a run all frames up to one; its picture.
    async fn go_on(
        &self,
        session: &str,
        topic: &str,
        mut run: Run,
        to: At,
        codec: Codec,
    ) -> Result<(Run, Decoded), Fault> {
        let from = run
            .last
            .map_or(run.key, |(part, unit, frame)| (part, unit, frame + 1));
        let mut decoded = Err(Fault::bug("a video frame was not decoded"));
        for (part, unit) in self.units(session, topic, (from.0, from.1), (to.0, to.1)) {
            let log = self.part(session, part)?;
            let opened = self.unit(log, unit).await?;
            let frames = self.frames(log, topic, unit, codec).await?;
            let (bytes, frames) = match (opened, frames) {
                (Ok(bytes), Ok(frames)) => (bytes, frames),
                (Err(fault), _) | (_, Err(fault)) => return Ok((run, Err(fault))),
            };
            let all = frames.iter().enumerate();
            let due: Vec<_> = all
                .map(|(frame, found)| ((part, unit, frame), found))
                .filter(|(at, _)| (from..=to).contains(at))
                .map(|(at, found)| (at, found.bytes(&bytes), at == to))
                .collect();
            let work = move || {
                let decoded = run.decode(due);
                (run, decoded)
            };
            let done = tokio::task::spawn_blocking(work).await;
            let found;
            (run, found) = done.map_err(|error| Fault::bug(error.to_string()))?;
            if let Some((_, file)) = found?.into_iter().next_back() {
                decoded = file;
            }
        }
        Ok((run, decoded))
    }

    /// The last frame up to this one that decoding can begin with.
    async fn key_frame(
        &self,
        session: &str,
        topic: &str,
        (part, unit, frame): At,
        codec: Codec,
    ) -> Result<Result<At, Fault>, Fault> {
        let track = self.track(session, topic);
        let mut barren = None;
        for (at, number) in self.units(session, topic, (0, 0), (part, unit)).rev() {
            let own = (at, number) == (part, unit);
            // Behind the frame there may be key frames in its own unit: only those before are known to have none.
            barren = barren.max((!own).then_some((at, number)));
            if held(&track.barren).is_some_and(|barren| (at, number) <= barren) {
                break;
            }
            let log = self.part(session, at)?;
            let frames = match self.frames(log, topic, number, codec).await? {
                Ok(frames) => frames,
                Err(fault) => return Ok(Err(fault)),
            };
            let until = if own { frame + 1 } else { frames.len() };
            let found = frames.iter().take(until).rposition(|frame| frame.begins);
            if let Some(found) = found {
                return Ok(Ok((at, number, found)));
            }
        }
        let mut known = held(&track.barren);
        *known = (*known).max(barren);
        let reason = "video frame without a key frame before it";
        Ok(Err(Fault::data(reason)))
    }

    /// The units from one to another, inclusive, that may hold messages of a topic.
    fn units(
        &self,
        session: &str,
        topic: &str,
        from: (u32, usize),
        to: (u32, usize),
    ) -> impl DoubleEndedIterator<Item = (u32, usize)> {
        let session: Arc<str> = session.into();
        let parts = self
            .parts
            .range((session.clone(), from.0)..=(session, to.0));
        parts.flat_map(move |((_, number), part)| {
            let channels: Vec<u16> = part.channels_of(topic).map(|channel| channel.id).collect();
            let units = &part.index.units;
            let first = if *number == from.0 { from.1 } else { 0 };
            let behind = if *number == to.0 {
                to.1 + 1
            } else {
                units.len()
            };
            let holding = move |unit: &usize| {
                let mut channels = channels.iter();
                units
                    .get(*unit)
                    .is_some_and(|unit| channels.any(|channel| unit.may_hold(*channel)))
            };
            (first..behind)
                .filter(holding)
                .map(move |unit| (*number, unit))
        })
    }

    fn track(&self, session: &str, topic: &str) -> Arc<Track> {
        let mut tracks = held(&self.tracks.0);
        let key = (session.to_owned(), topic.to_owned());
        tracks.entry(key).or_default().clone()
    }

    /// The frames of a topic in a unit, in order.
    async fn frames(
        &self,
        part: &Arc<LogPart>,
        topic: &str,
        unit: usize,
        codec: Codec,
    ) -> Result<Result<Frames, Fault>, Fault> {
        let track = self.track(&part.session, topic);
        let known = held(&track.units).get(&(part.part, unit)).cloned();
        if let Some(known) = known {
            return Ok(Ok(known));
        }
        let bytes = match self.unit(part, unit).await? {
            Ok(bytes) => bytes,
            Err(fault) => return Ok(Err(fault)),
        };
        let frames = Arc::new(find(part, topic, &bytes, codec));
        held(&track.units).insert((part.part, unit), frames.clone());
        Ok(Ok(frames))
    }

    /// The records of a unit.
    async fn unit(&self, part: &Arc<LogPart>, unit: usize) -> Result<Decoded, Fault> {
        self.open(&ChunkRef::of_unit(part, &part.index.units[unit]))
            .await
    }
}

impl Track {
    /// The waiting run that needs the fewest frames.
    fn take(&self, key: At, frame: At) -> Option<Run> {
        let mut runs = held(&self.runs);
        let fit = runs.iter().enumerate();
        let fit = fit.filter(|(_, run)| run.leads_to(key, frame));
        let (best, _) = fit.max_by_key(|(_, run)| run.last)?;
        Some(runs.remove(best))
    }

    /// Lets a run wait; the one that has waited longest goes.
    fn keep(&self, run: Option<Run>) {
        let mut runs = held(&self.runs);
        runs.extend(run);
        if runs.len() > WAITING {
            runs.remove(0);
        }
    }
}

/// Where an image begins in the records of its unit.
fn within(part: &LogPart, unit: usize, image: &ImageRef) -> usize {
    let start = match image.chunk {
        Some(_) => image.offset,
        None => image.offset - part.index.units[unit].offset,
    };
    usize::try_from(start).unwrap_or(usize::MAX)
}

fn find(part: &LogPart, topic: &str, bytes: &Bytes, codec: Codec) -> Vec<FrameSpan> {
    let channels: Vec<u16> = part.channels_of(topic).map(|channel| channel.id).collect();
    let wanted = |head: &MessageHead| channels.contains(&head.channel);
    let messages = Block::loose(bytes.clone(), 0).contents(wanted).messages;
    let frame = |message: Message| {
        let message_type = part.message_type(message.head.channel)?.as_ref().ok()?;
        let payload = &bytes[message.start..message.end];
        let located = message_type.locate(payload, &[IMAGE_MEMBER]).ok()??;
        let mut found = FrameSpan {
            start: message.start + located.range.start,
            end: message.start + located.range.end,
            base64: located.base64,
            begins: false,
        };
        (found.end <= message.end).then_some(())?;
        found.begins = found.bytes(bytes).is_some_and(|frame| codec.begins(&frame));
        Some(found)
    };
    messages.into_iter().filter_map(frame).collect()
}
