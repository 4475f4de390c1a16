//! Foxglove's WebSocket protocol, as far as a server that only shows something needs it.
//!
//! JSON for what is rare, binary for what is not: an opcode, numbers in little endian, and the rest. The protocol is
//! Foxglove's `ws-protocol`, under its old and its new name, with the playback control of the new.

use std::borrow::Cow;

use axum::body::Bytes;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::export::foxglove::MessageKind;

/// Names of the protocol: the new, and the one that Lichtblick and older Foxglove know.
pub const NAMES: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

const MESSAGE: u8 = 1;
const TIME: u8 = 2;
const PLAYBACK: u8 = 5;
/// Of the client: what to play.
const CONTROL: u8 = 3;

/// What a client asks for.
#[derive(Debug, PartialEq)]
pub enum ClientMessage {
    /// To be sent the messages of channels, by a number of the client's own.
    Subscribe(Vec<Subscription>),
    /// No longer to be, by those numbers.
    Unsubscribe(Vec<u32>),
    /// To be shown another time, or faster, or nothing for now.
    Play(Control),
    /// What a server that only shows something has no answer to.
    Nothing,
}

/// A subscription.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription {
    /// The client's number for it.
    pub id: u32,
    /// Which channel.
    pub channel_id: u64,
}

/// What to play.
#[derive(Debug, Clone, PartialEq)]
pub struct Control {
    /// Whether to go on at all.
    pub playing: bool,
    /// How fast, against the time of the drives.
    pub speed: f32,
    /// From when on, ns; `None` goes on from where it is.
    pub seek: Option<u64>,
    /// What the answer names.
    pub request: String,
}

#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Op {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

impl ClientMessage {
    /// Reads a text of the client.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn of_text(text: &str) -> Result<Self, String> {
        let op: Op = serde_json::from_str(text).map_err(|error| {
            format!("expected an operation of Foxglove's protocol, found: {error}")
        })?;
        Ok(match op {
            Op::Subscribe { subscriptions } => Self::Subscribe(subscriptions),
            Op::Unsubscribe { subscription_ids } => Self::Unsubscribe(subscription_ids),
            Op::Other => Self::Nothing,
        })
    }

    /// Reads bytes of the client.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn of_bytes(bytes: &[u8]) -> Result<Self, String> {
        match bytes.split_first() {
            Some((&CONTROL, rest)) => control(rest)
                .map(Self::Play)
                .ok_or_else(|| "expected a playback control request, found other bytes".to_owned()),
            _ => Ok(Self::Nothing),
        }
    }
}

fn control(bytes: &[u8]) -> Option<Control> {
    let (&command, rest) = bytes.split_first()?;
    let (speed, rest) = rest.split_first_chunk::<4>()?;
    let (&seeks, rest) = rest.split_first()?;
    let (seek, rest) = rest.split_first_chunk::<8>()?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let request = rest.get(..u32::from_le_bytes(*length) as usize)?;
    let speed = f32::from_le_bytes(*speed);
    Some(Control {
        playing: match command {
            0 => true,
            1 => false,
            _ => return None,
        },
        speed: Some(speed).filter(|speed| speed.is_finite() && *speed > 0.0)?,
        seek: (seeks != 0).then(|| u64::from_le_bytes(*seek)),
        request: String::from_utf8(request.to_vec()).ok()?,
    })
}

/// Who serves, which names the session too, what it can do, and the time that its messages are of, ns.
pub fn server_info(name: &str, [first, last]: [u64; 2]) -> String {
    let time = |ns: u64| json!({ "sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000 });
    json!({
        "op": "serverInfo",
        "name": name,
        "capabilities": ["time", "playbackControl"],
        "supportedEncodings": [],
        "metadata": {},
        "sessionId": name,
        "dataStartTime": time(first),
        "dataEndTime": time(last),
    })
    .to_string()
}

/// A channel, by its number.
pub fn channel(id: usize, topic: &str, kind: &MessageKind) -> Value {
    let schema = &kind.schema;
    let text = match schema.encoding.as_str() {
        "protobuf" => Cow::Owned(STANDARD.encode(&schema.data)),
        _ => String::from_utf8_lossy(&schema.data),
    };
    json!({
        "id": id,
        "topic": topic,
        "encoding": kind.encoding,
        "schemaName": schema.name,
        "schemaEncoding": schema.encoding,
        "schema": text,
    })
}

/// That there are channels.
pub fn advertise(channels: &[Value]) -> String {
    json!({ "op": "advertise", "channels": channels }).to_string()
}

/// That something is wrong.
pub fn error(message: &str) -> String {
    json!({ "op": "status", "level": 2, "message": message }).to_string()
}

/// A message of a subscription.
pub fn message(subscription: u32, time_ns: u64, payload: &[u8]) -> Bytes {
    let mut bytes = Vec::with_capacity(13 + payload.len());
    bytes.push(MESSAGE);
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(time_ns.to_le_bytes());
    bytes.extend(payload);
    bytes.into()
}

/// What time it is, ns.
pub fn time(time_ns: u64) -> Bytes {
    let mut bytes = vec![TIME];
    bytes.extend(time_ns.to_le_bytes());
    bytes.into()
}

/// Whether messages come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// They do.
    Playing = 0,
    /// The client said not to go on.
    Paused = 1,
    /// All were sent.
    Ended = 3,
}

/// How it stands with playing; `request` is what it answers.
pub fn playback(
    status: Status,
    time_ns: u64,
    speed: f32,
    seeked: bool,
    request: Option<&str>,
) -> Bytes {
    let request = request.unwrap_or_default();
    let mut bytes = vec![PLAYBACK, status as u8];
    bytes.extend(time_ns.to_le_bytes());
    bytes.extend(speed.to_le_bytes());
    bytes.push(u8::from(seeked));
    bytes.extend((request.len() as u32).to_le_bytes());
    bytes.extend(request.as_bytes());
    bytes.into()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_clients_ask_is_read_as_the_protocol_has_it() {
        let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":3}]}"#;
        let subscription = Subscription {
            id: 7,
            channel_id: 3,
        };
        assert_eq!(
            ClientMessage::of_text(subscribe),
            Ok(ClientMessage::Subscribe(vec![subscription]))
        );
        let unsubscribe = r#"{"op":"unsubscribe","subscriptionIds":[7]}"#;
        assert_eq!(
            ClientMessage::of_text(unsubscribe),
            Ok(ClientMessage::Unsubscribe(vec![7]))
        );
        let other = r#"{"op":"getParameters","parameterNames":["a"],"id":"1"}"#;
        assert_eq!(ClientMessage::of_text(other), Ok(ClientMessage::Nothing));
        for wrong in [
            "",
            "[]",
            "{}",
            r#"{"op":"subscribe","subscriptions":[{"id":-1}]}"#,
        ] {
            assert!(ClientMessage::of_text(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_playback_control_request_is_read_whole_or_not_at_all() {
        let mut bytes = vec![CONTROL, 1];
        bytes.extend(2.0_f32.to_le_bytes());
        bytes.push(1);
        bytes.extend(5_u64.to_le_bytes());
        bytes.extend(2_u32.to_le_bytes());
        bytes.extend(b"id");
        let control = Control {
            playing: false,
            speed: 2.0,
            seek: Some(5),
            request: "id".into(),
        };
        assert_eq!(
            ClientMessage::of_bytes(&bytes),
            Ok(ClientMessage::Play(control))
        );
        for length in 1..bytes.len() {
            assert!(
                ClientMessage::of_bytes(&bytes[..length]).is_err(),
                "{length}"
            );
        }
        let mut endless = bytes.clone();
        endless[15..19].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(ClientMessage::of_bytes(&endless).is_err());
        for speed in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let mut wrong = bytes.clone();
            wrong[2..6].copy_from_slice(&speed.to_le_bytes());
            assert!(ClientMessage::of_bytes(&wrong).is_err(), "{speed}");
        }
    }
}
