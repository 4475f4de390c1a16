//! `evermap inspect`.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::sync::Arc;

use datafusion::prelude::SessionContext;
use evermap_datasets::log::definition::LogChannel;
use evermap_datasets::log::index::{LogIndex, UnitKind};
use evermap_datasets::log::pace::Pace;
use evermap_datasets::{Dataset, LogPart, Session};
use evermap_engine::preflight::Needs;
use evermap_engine::prepare::parse;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::Fault;
use evermap_schemas::roles::{self, Role, Topic};
use futures::future::join_all;
use object_store::ObjectStoreExt;

use crate::arguments::InspectArgs;
use crate::contents::{Attachment, Channel, Chunks, Contents, LossLine, PlanLine, RoleLine};
use crate::coordinate_frames::CoordinateFrames;
use crate::ending::Ending;
use crate::manifest::written;
use crate::printable::printable;
use crate::quantity::of;
use crate::sessions::{lost, told};
use crate::shipped;
use crate::{camera_frames, clocks, odometry_frame, operators, pictures};

/// Says what a file holds, or writes a manifest of several. Every chunk is read, so that damage is found, unless only the index is asked for. Memory
/// does not grow with the file.
///
/// # Errors
/// A data fault for a file that is no MCAP, a user fault for one that is not there.
pub async fn inspect(args: &InspectArgs) -> Ending {
    let context = context(Limits::one_partition())?;
    let dataset = Dataset::open(&context.runtime_env(), &args.files, None).await?;
    dataset.register(&context)?;
    if args.manifest {
        let frames = frames(&dataset, &context).await?;
        let manifest = written(&dataset, &frames, &context).await?;
        told(&dataset);
        writeln!(std::io::stdout(), "{manifest}")?;
        return Ok(lost([&dataset]));
    }
    let parts = dataset.parts();
    let [part] = parts.as_slice() else {
        return Err(Fault::user(format!(
            "expected one file, found {} at {}",
            parts.len(),
            args.files.join(" ")
        ))
        .into());
    };
    let frames = match args.quick {
        true => None,
        false => Some(frames(&dataset, &context).await?),
    };
    let read = match args.quick {
        true => Cow::Borrowed(&part.index),
        false => part.survey().await?,
    };
    let vehicle = frames.as_ref().and_then(CoordinateFrames::vehicle);
    let notes = match vehicle {
        Some(vehicle) => {
            let of_odometry = odometry_frame::notes(&dataset, vehicle).await?;
            let of_cameras = camera_frames::notes(&dataset, vehicle).await?;
            [of_odometry, of_cameras].concat()
        }
        None => Vec::new(),
    };
    let ((unmoved, of_motions), of_clocks, of_pictures) = match args.quick {
        true => Default::default(),
        false => (
            odometry_frame::unmoved(&dataset).await,
            clocks::notes(&dataset, |_| true).await,
            pictures::notes(&dataset).await?,
        ),
    };
    let unchecked = (!args.quick).then(|| unchecked(&read)).flatten();
    let of_topics = dataset.notes.iter().cloned();
    let notes = unchecked.into_iter().chain(of_topics).chain(notes);
    let notes = notes.chain([of_motions, of_clocks, of_pictures].concat());
    let notes = notes.collect();
    let unmounted = frames
        .as_ref()
        .is_some_and(CoordinateFrames::no_camera_is_mounted);
    let contents = Contents {
        notes,
        frames,
        plans: plans(&dataset, &unmoved, unmounted)?,
        ..contents(&dataset, part, &read).await?
    };
    let mut stdout = std::io::BufWriter::new(std::io::stdout().lock());
    if args.json {
        serde_json::to_writer_pretty(&mut stdout, &contents).map_err(std::io::Error::from)?;
        writeln!(stdout)?;
    } else {
        stdout.write_all(printable(&contents.to_string()).as_bytes())?;
    }
    stdout.flush()?;
    Ok(lost([&dataset]))
}

/// The coordinate frames of the sessions, which are registered with the context.
async fn frames(dataset: &Dataset, context: &SessionContext) -> Result<CoordinateFrames, Fault> {
    let pictured = |session: &Session| !session.roles.topics("frames").is_empty();
    // What cannot be read of calibrations is told where their rows are read.
    let mounts = match dataset.sessions.iter().any(pictured) {
        true => dataset.camera_mounts().await.unwrap_or_default(),
        false => BTreeMap::new(),
    };
    CoordinateFrames::read(context, &mounts).await
}

/// That flipped bits of some messages would not be seen.
fn unchecked(read: &LogIndex) -> Option<String> {
    let many = (read.unchecked > 0).then(|| of(read.unchecked, "message"))?;
    Some(format!(
        "{many} outside of chunks with no checksum to hold to: bits of them that flipped are read as they are"
    ))
}

/// What the index says, and what `read` found: the same, or more.
async fn contents(dataset: &Dataset, part: &LogPart, read: &LogIndex) -> Result<Contents, Fault> {
    let range = read.time_range();
    let channels = channels(part, read);
    let attachments = part.attachments().await?.into_iter();
    let attachments = attachments.map(|found| Attachment {
        name: found.name,
        media_type: found.media_type,
        bytes: found.bytes,
        log_time_ns: found.log_time,
    });
    let metadata = part.metadata_names().await?;
    // What is damaged of attachments and metadata is among them.
    let losses = dataset.losses.entries().into_iter().map(|entry| LossLine {
        reason: entry.reason.text().to_owned(),
        topic: entry.topic,
        offset: entry.offset,
        count: entry.loss.count,
        bytes: entry.loss.bytes,
        detail: entry.detail,
    });
    Ok(Contents {
        file: part.url.clone(),
        bytes: part.meta.size,
        profile: read.profile.clone(),
        library: read.library.clone(),
        indexed: part.index.indexed,
        unbelieved: part.index.unbelieved,
        messages: channels.iter().map(|channel| channel.messages).sum(),
        start_ns: range.map(|(start, _)| start),
        end_ns: range.map(|(_, end)| end),
        start: range.map(|(start, _)| instant(start)),
        end: range.map(|(_, end)| instant(end)),
        chunks: chunks(part, read).await,
        channels,
        roles: roles(dataset),
        frames: None,
        notes: Vec::new(),
        plans: Vec::new(),
        attachments: attachments.collect(),
        metadata,
        losses: losses.collect(),
    })
}

fn roles(dataset: &Dataset) -> Vec<RoleLine> {
    let roles = dataset.sessions.iter().flat_map(|session| {
        evermap_schemas::roles::ALL.iter().map(|role| RoleLine {
            role: role.name.to_owned(),
            topics: session.roles.topics(role.name).to_vec(),
        })
    });
    roles.filter(|role| !role.topics.is_empty()).collect()
}

/// What each plan that ships lacks to make something of the file alone. Transforms are of no use to those that need images of
/// cameras, too, where none says where a camera is mounted; nor is a role of which nothing comes, as its transforms move no vehicle.
fn plans(
    dataset: &Dataset,
    unmoved: &BTreeSet<&str>,
    unmounted: bool,
) -> Result<Vec<PlanLine>, Fault> {
    let registry = operators::registry();
    let mut plays: BTreeSet<String> = dataset.sessions.iter().flat_map(Session::played).collect();
    plays.retain(|role| !unmoved.contains(role.as_str()));
    let mut without_mounts = plays.clone();
    let unmounted = unmounted && without_mounts.remove(roles::transforms::ROLE.name);
    let of_mounts = [roles::frames::ROLE.name, roles::transforms::ROLE.name];
    let line = |shipped: &(&str, &str)| {
        let plan = parse(&shipped::plain(shipped), &registry);
        let plan = plan.map_err(|faults| Fault::bug(faults.to_string()))?;
        let needs = Needs::of_plan(&plan, &registry);
        let is_needed = |role: &&str| plan.needs.iter().any(|needed| needed == role);
        let unmounted = unmounted && of_mounts.iter().all(is_needed);
        let plays = match unmounted {
            true => &without_mounts,
            false => &plays,
        };
        let lacks = needs.lacks_alone(plays);
        Ok(PlanLine {
            plan: plan.name.clone(),
            unmounted,
            without: match lacks {
                None => needs.without(plays),
                Some(_) => Vec::new(),
            },
            lacks,
        })
    };
    shipped::PLANS.iter().map(line).collect()
}

fn instant(nanoseconds: i64) -> String {
    chrono::DateTime::from_timestamp_nanos(nanoseconds).to_rfc3339()
}

fn channels(part: &LogPart, read: &LogIndex) -> Vec<Channel> {
    let start = read.time_range().map_or(0, |(start, _)| start);
    let channels = read.channels.values().map(|channel| {
        let pace = read.paces.get(&channel.id);
        let paced = pace.filter(|pace| pace.messages > 1);
        let schema = read.schema_of(channel);
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
            messages: read.channel_messages(channel.id),
            rate_hz: pace.and_then(Pace::rate_hz),
            longest_gap_s: paced.map(|pace| pace.longest_gap as f64 * 1e-9),
            gap_after_s: paced.map(|pace| pace.gap_from.saturating_sub(start) as f64 * 1e-9),
            undecodable,
            unfit: unfit(part, channel),
        }
    });
    let mut channels: Vec<Channel> = channels.collect();
    channels.sort_by(|a, b| (&a.topic, a.id).cmp(&(&b.topic, b.id)));
    channels
}

/// Why a channel plays no role, though messages of its type do.
fn unfit(part: &LogPart, channel: &LogChannel) -> Option<&'static str> {
    let schema = part.index.schema_of(channel)?;
    let topic = Topic {
        untyped: part.index.is_untyped(channel),
        ..Topic::new(&channel.topic, &schema.name, 0)
    };
    let played = |role: &&Role| {
        let messages = role.messages();
        messages.is_some_and(|messages| messages.types.contains(&topic.message_type.as_str()))
    };
    let mut roles = evermap_schemas::roles::ALL.iter().filter(played);
    roles.find_map(|role| role.unfit(&topic))
}

/// Chunks whose heads are read to learn how they are compressed.
const HEADS: usize = 16;

async fn chunks(part: &LogPart, read: &LogIndex) -> Chunks {
    let chunks: Vec<_> = read
        .units
        .iter()
        .filter(|unit| unit.kind == UnitKind::Chunk)
        .collect();
    let mut compression = BTreeSet::new();
    let some = chunks.iter().step_by(chunks.len().div_ceil(HEADS).max(1));
    let heads = some.map(|chunk| {
        let range = chunk.offset..(chunk.offset + 64).min(chunk.end());
        // Futures that borrow could not be sent to other threads together.
        let (store, file) = (Arc::clone(&part.store), part.meta.location.clone());
        async move { store.get_range(&file, range).await }
    });
    for head in join_all(heads).await.iter().flatten() {
        compression.extend(compression_of(head));
    }
    Chunks {
        count: chunks.len(),
        bytes: chunks.iter().map(|chunk| chunk.length).sum(),
        uncompressed_bytes: chunks
            .iter()
            .fold(0, |sum, chunk| chunk.size.saturating_add(sum)),
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
