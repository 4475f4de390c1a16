//! What an MCAP file holds, for people and for programs.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::quantity::{of_bytes, of_seconds};

/// What a file holds.
#[derive(Debug, Serialize)]
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
    /// Why its messages are not decoded; null where they are.
    pub undecodable: Option<String>,
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

/// The contents as lines for people.
pub fn text(contents: &Contents) -> String {
    let mut text = String::new();
    let mut fact = |name: &str, value: String| text.push_str(&format!("{name:<12} {value}\n"));
    fact("file", contents.file.clone());
    fact("size", of_bytes(contents.bytes));
    fact("profile", contents.profile.clone());
    fact("library", contents.library.clone());
    fact(
        "index",
        if contents.indexed {
            "summary"
        } else {
            "none; read from the start"
        }
        .to_owned(),
    );
    let count = contents
        .messages
        .map_or_else(|| "not counted".to_owned(), |count| count.to_string());
    fact("messages", count);
    if let (Some(start), Some(end), Some(from), Some(to)) = (
        &contents.start,
        &contents.end,
        contents.start_ns,
        contents.end_ns,
    ) {
        fact("start", start.clone());
        fact(
            "end",
            format!("{end}  ({})", of_seconds((to - from) as f64 * 1e-9)),
        );
    }
    let chunks = &contents.chunks;
    let kinds: Vec<_> = chunks.compression.iter().map(String::as_str).collect();
    let (packed, size) = (of_bytes(chunks.bytes), of_bytes(chunks.uncompressed_bytes));
    let sizes = format!(
        "{} ({}), {packed} of {size}",
        chunks.count,
        kinds.join(", ")
    );
    fact(
        "chunks",
        if chunks.count == 0 {
            "none".to_owned()
        } else {
            sizes
        },
    );
    text.push_str("\nchannels\n");
    let widest = contents
        .channels
        .iter()
        .map(|channel| channel.topic.chars().count())
        .max()
        .unwrap_or(0);
    for channel in &contents.channels {
        let count = channel
            .messages
            .map_or_else(|| "?".to_owned(), |count| count.to_string());
        let how = format!(
            "{} [{}, {}]",
            channel.schema, channel.message_encoding, channel.schema_encoding
        );
        let why = channel
            .undecodable
            .as_ref()
            .map(|why| format!("  not decoded: {why}"))
            .unwrap_or_default();
        text.push_str(&format!(
            "{count:>10}  {:<widest$}  {how}{why}\n",
            channel.topic
        ));
    }
    for attachment in &contents.attachments {
        let size = of_bytes(attachment.bytes);
        text.push_str(&format!(
            "attachment   {} ({}, {size})\n",
            attachment.name, attachment.media_type
        ));
    }
    contents
        .metadata
        .iter()
        .for_each(|name| text.push_str(&format!("metadata     {name}\n")));
    for loss in &contents.losses {
        let LossLine {
            reason,
            offset,
            count,
            bytes,
            detail,
            ..
        } = loss;
        text.push_str(&format!(
            "loss         at byte {offset}: {count} {reason} ({bytes} B): {detail}\n"
        ));
    }
    text
}
