//! Every MCAP among the real recordings: each channel's schema parses, each message decodes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr
)]

use evermap_messages::{DecodeError, Decoder, MessageType};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Recordings made to be refused.
const REFUSED: &[(&str, &str)] = &[("wrong_rmw_test_0.mcap", "wrong_format")];

fn logs_below(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            logs_below(&path, found);
        } else if path.extension().is_some_and(|e| e == "mcap") {
            found.push(path);
        }
    }
}

struct Channel {
    decoder: Result<Decoder, String>,
    columns: usize,
    messages: usize,
    lost: Vec<String>,
}

fn open(channel: &mcap::Channel) -> Channel {
    let (name, encoding, data) = match &channel.schema {
        Some(s) => (s.name.as_str(), s.encoding.as_str(), s.data.as_ref()),
        None => ("", "", &[][..]),
    };
    let parsed = MessageType::parse(&channel.message_encoding, encoding, name, data);
    Channel {
        columns: parsed.as_ref().map_or(0, |m| m.fields().len()),
        decoder: parsed
            .map(|message| message.decoder(None))
            .map_err(|error| error.to_string()),
        messages: 0,
        lost: Vec::new(),
    }
}

/// Pushes a payload, decompressed first where the recorder compressed each message.
fn push(decoder: &mut Decoder, payload: &[u8]) -> Result<(), DecodeError> {
    match decoder.push(payload) {
        Err(DecodeError::Compressed) => decoder.push(&zstd::decode_all(payload).unwrap()),
        outcome => outcome,
    }
}

#[test]
fn every_message_of_every_log_decodes() {
    let Some(folder) = evermap_test_data::shared("data/mcap_real") else {
        return;
    };
    let mut logs = Vec::new();
    logs_below(&folder, &mut logs);
    logs.sort();
    let (mut total, mut refused) = (0, Vec::new());
    for log in &logs {
        let bytes = std::fs::read(log).unwrap();
        let mut channels: BTreeMap<String, Channel> = BTreeMap::new();
        let stream = match mcap::MessageStream::new(&bytes) {
            Ok(stream) => stream,
            Err(error) => {
                eprintln!("{}: not read: {error}", log.display());
                continue;
            }
        };
        for message in stream {
            let Ok(message) = message else {
                eprintln!("{}: log ends early", log.display());
                break;
            };
            let channel = channels
                .entry(message.channel.topic.clone())
                .or_insert_with(|| open(&message.channel));
            channel.messages += 1;
            if let Ok(decoder) = &mut channel.decoder
                && let Err(error) = push(decoder, &message.data)
            {
                channel.lost.push(error.to_string());
            }
        }
        let name = log.file_name().unwrap().to_string_lossy().into_owned();
        for (topic, mut channel) in channels {
            match &mut channel.decoder {
                Ok(decoder) => {
                    let rows = decoder.len();
                    let columns = decoder.finish().unwrap();
                    assert_eq!(columns.len(), channel.columns);
                    assert!(columns.iter().all(|column| column.len() == rows));
                    assert_eq!(rows + channel.lost.len(), channel.messages);
                    assert!(
                        channel.lost.is_empty(),
                        "{name} {topic}: {:?}",
                        channel.lost
                    );
                    total += rows;
                }
                Err(error) => refused.push((name.clone(), topic, error.clone())),
            }
        }
    }
    for (log, topic, error) in &refused {
        eprintln!("{log} {topic}: {error}");
        let known = REFUSED
            .iter()
            .any(|(l, reason)| l == log && error.contains(reason));
        assert!(known, "{log} {topic}: {error}");
    }
    eprintln!(
        "{} logs, {total} rows, {} topics refused",
        logs.len(),
        refused.len()
    );
    assert!(total > 0);
}
