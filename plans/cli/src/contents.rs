//! What an MCAP file holds, for people (as text) and for programs.

use std::collections::{BTreeMap, BTreeSet};

use askama::Template;
use evermap_engine::preflight::in_words;
use serde::Serialize;

use crate::coordinate_frames::CoordinateFrames;
use crate::{printable, quantity};

/// What a file holds.
#[derive(Debug, Serialize, Template)]
#[template(path = "contents.txt")]
pub struct Contents {
    /// Where it is.
    pub file: String,
    /// Its size.
    pub bytes: u64,
    /// Profile of the header.
    pub profile: String,
    /// Library that wrote it.
    pub library: String,
    /// Whether the file's own summary was used; else it was read from its start.
    pub indexed: bool,
    /// Whether it has a summary that was not: it is damaged, or contradicts the file.
    pub unbelieved: bool,
    /// Messages; null where nobody counted them.
    pub messages: Option<u64>,
    /// Log time of the first message, nanoseconds since the epoch.
    pub start_ns: Option<i64>,
    /// Log time of the last message, nanoseconds since the epoch.
    pub end_ns: Option<i64>,
    /// Log time of the first message, RFC 3339.
    pub start: Option<String>,
    /// Log time of the last message, RFC 3339.
    pub end: Option<String>,
    /// Its chunks.
    pub chunks: Chunks,
    /// Its channels, by topic.
    pub channels: Vec<Channel>,
    /// Topics by the role that they play.
    pub roles: Vec<RoleLine>,
    /// Coordinate frames; null where only the index was read.
    pub frames: Option<CoordinateFrames>,
    /// What is to be known of how it is read, in sentences; where only the index was read, of topics that were chosen.
    pub notes: Vec<String>,
    /// The plans that ship, and what each lacks to make something of this file.
    pub plans: Vec<PlanLine>,
    /// Its attachments.
    pub attachments: Vec<Attachment>,
    /// Names of its metadata records.
    pub metadata: Vec<String>,
    /// What is damaged.
    pub losses: Vec<LossLine>,
}

/// Chunks of a file.
#[derive(Debug, Serialize)]
pub struct Chunks {
    /// How many.
    pub count: usize,
    /// Bytes in the file.
    pub bytes: u64,
    /// Bytes after decompression.
    pub uncompressed_bytes: u64,
    /// How they are compressed; `none` where they are not.
    pub compression: BTreeSet<String>,
}

/// A channel of a file.
#[derive(Debug, Serialize)]
pub struct Channel {
    /// Number within the file.
    pub id: u16,
    /// Topic.
    pub topic: String,
    /// Message type.
    pub schema: String,
    /// Encoding of the message type's definition.
    pub schema_encoding: String,
    /// Encoding of the messages.
    pub message_encoding: String,
    /// Messages; null where nobody counted them.
    pub messages: Option<u64>,
    /// Messages a second between the first and the last, by log time; null for fewer than two, and where only the index
    /// was read.
    pub rate_hz: Option<f64>,
    /// The longest time between two messages, seconds; null as `rate_hz`.
    pub longest_gap_s: Option<f64>,
    /// When that began, seconds after the file's first message.
    pub gap_after_s: Option<f64>,
    /// Why its messages are not decoded; null where they are.
    pub undecodable: Option<String>,
    /// Why it plays no role, though messages of its type do; null where it can.
    pub unfit: Option<&'static str>,
}

/// A role, and who plays it.
#[derive(Debug, Serialize)]
pub struct RoleLine {
    /// Its name.
    pub role: String,
    /// The topics, ascending.
    pub topics: Vec<String>,
}

/// A plan that ships.
#[derive(Debug, Serialize)]
pub struct PlanLine {
    /// Its name.
    pub plan: String,
    /// Roles that it lacks, each with the step that cannot do without; null where it makes something of the file.
    pub lacks: Option<BTreeMap<String, String>>,
    /// Roles that it lacks, though it makes something of the file: nothing comes of the steps that need them.
    pub without: Vec<&'static str>,
    /// Whether it needs to know where cameras are mounted, and no transform says so of any.
    pub unmounted: bool,
}

/// An attachment.
#[derive(Debug, Serialize)]
pub struct Attachment {
    /// Name.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Size.
    pub bytes: u64,
    /// When it was recorded, nanoseconds since the epoch.
    pub log_time_ns: i64,
}

/// One place of damage.
#[derive(Debug, Serialize)]
pub struct LossLine {
    /// What was lost.
    pub reason: String,
    /// Topic, where only one is concerned.
    pub topic: String,
    /// Byte offset in the file.
    pub offset: u64,
    /// How many.
    pub count: u64,
    /// Bytes that were not used.
    pub bytes: u64,
    /// An example in words.
    pub detail: String,
}

impl PlanLine {
    fn state(&self) -> String {
        match &self.lacks {
            None if self.without.is_empty() => "can run on this file".to_owned(),
            None => format!(
                "can run in part: nothing comes of steps that need {}",
                self.without.join(", ")
            ),
            Some(lacks) if self.unmounted => format!(
                "lacks {}: no fixed transform says where a camera is mounted",
                in_words(lacks)
            ),
            Some(lacks) => format!("lacks {}", in_words(lacks)),
        }
    }
}

/// A gap is worth saying that is this many times as long as messages are apart on average.
const NOTABLE: f64 = 3.0;

impl Channel {
    /// The topic, as it is printed.
    fn named(&self) -> String {
        printable::in_line(&self.topic)
    }

    fn rate(&self) -> String {
        match self.rate_hz {
            Some(rate) if rate >= 10.0 => format!("{rate:.0} Hz"),
            Some(rate) => format!("{rate:.2} Hz"),
            None => String::new(),
        }
    }

    /// The longest gap, where it stands out.
    fn gap(&self) -> Option<String> {
        let (rate, gap, after) = (self.rate_hz?, self.longest_gap_s?, self.gap_after_s?);
        let stands_out = gap * rate > NOTABLE && self.messages.is_some_and(|count| count > 2);
        stands_out.then(|| format!("nothing for {gap:.2} s after {after:.2} s"))
    }
}

impl Contents {
    fn length(&self) -> String {
        let (start, end) = (self.start_ns.unwrap_or(0), self.end_ns.unwrap_or(0));
        quantity::of_seconds((end as f64 - start as f64) * 1e-9)
    }

    /// Letters of the longest topic, of those that fit on a line.
    fn widest(&self) -> usize {
        let topics = self.channels.iter();
        let widths = topics.map(|channel| channel.named().chars().count());
        widths.filter(|width| *width <= 80).max().unwrap_or(0)
    }
}
