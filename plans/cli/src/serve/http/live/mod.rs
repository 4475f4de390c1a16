//! A map as a live source of Foxglove and Lichtblick: what `evermap export --format mcap` writes, played by a WebSocket.
//!
//! ```text
//!   Recording ── what there is to say of a version, one for all viewers of it
//!   Player ───── which of it is due, for one viewer
//!   protocol ─── how that is said
//! ```
//! A viewer has a clock of its own: it may stand still, go faster and begin anew. What is said is sent message by message,
//! and nothing waits in a queue: a viewer that takes it slowly sees it slowly, and one that takes nothing is let go.

mod player;
mod protocol;
mod recording;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Extension, Query, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use evermap_schemas::Fault;
use futures::stream::{SplitSink, SplitStream};
use futures::{SinkExt, StreamExt};
use serde::Deserialize;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, sleep_until, timeout};

use crate::export::Selection;
use crate::export::foxglove::{Images, TopicMessage};
use crate::serve::access::{Who, is_this_machine};
use crate::serve::http::{App, Asks, MapOf, Refusal};
use crate::serve::maps::{Opened, ServedMap};

use player::Player;
use protocol::{ClientMessage, Control, Status, Subscription};
use recording::Recording;
pub use recording::Recordings;

/// Viewers at once.
const MOST_VIEWERS: usize = 16;
/// A viewer that takes nothing for so long is let go.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes of the longest message of a viewer.
const LONGEST: usize = 1 << 20;
/// Channels that are named in one message.
const TOGETHER: usize = 64;
/// The page of the viewer that is a program in a browser. The others have no page, or one on this machine.
const VIEWER: &str = "https://app.foxglove.dev";

/// Permits of viewers.
pub fn viewers() -> Arc<Semaphore> {
    Arc::new(Semaphore::new(MOST_VIEWERS))
}

/// What is watched, and as whom: viewers in a browser have an address and nothing beside it.
#[derive(Debug, Default, Deserialize)]
pub struct LiveArguments {
    #[serde(default)]
    site: Option<String>,
    #[serde(default)]
    session: Option<String>,
    #[serde(default)]
    token: Option<String>,
}

/// The token in an address of this door; `None` in any other.
pub fn token(uri: &Uri) -> Option<String> {
    let of_map = uri.path().strip_prefix("/maps/");
    let door = of_map.map_or(uri.path().strip_prefix('/'), |of_map| {
        of_map.split_once('/').map(|(_, door)| door)
    });
    if door != Some("foxglove") {
        return None;
    }
    Query::<LiveArguments>::try_from_uri(uri).ok()?.0.token
}

/// Whether a page, by the header `Origin` that browsers send and pages cannot change, may watch: any page may open a
/// WebSocket to this machine, and would read maps through a person's browser. Who has a user's token was given it, whatever
/// page it is used on; where there are no users, nobody was given one, and any page could make one up.
fn may_watch(headers: &HeaderMap, has_token: bool) -> bool {
    let Some(origin) = headers.get(header::ORIGIN) else {
        return true;
    };
    let origin = origin.to_str().unwrap_or_default();
    let host = origin.split_once("://").map_or("", |(_, host)| host);
    let served = headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok());
    // A desktop program's page is a file.
    has_token
        || origin == VIEWER
        || origin == "file://"
        || is_this_machine(host)
        || served == Some(host)
}

/// `GET /foxglove?session=…&site=…&token=…`, a WebSocket: the newest version of a map, played.
///
/// # Errors
/// For a page that may not, a client of another protocol, or too many viewers.
pub async fn watch(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Query(watched)): Asks<Query<LiveArguments>>,
    Extension(Who(user)): Extension<Who>,
    headers: HeaderMap,
    Asks(upgrade): Asks<WebSocketUpgrade>,
) -> Result<Response, Refusal> {
    let has_token = user.is_some() && watched.token.is_some();
    if !may_watch(&headers, has_token) {
        return Ok(StatusCode::FORBIDDEN.into_response());
    }
    let upgrade = upgrade.protocols(protocol::NAMES);
    if upgrade.selected_protocol().is_none() {
        let names = protocol::NAMES.join(" or ");
        let fault = Fault::user(format!("expected the protocol {names}, found another"));
        return Err(fault.into());
    }
    let place = Arc::clone(&app.viewers).try_acquire_owned();
    let busy =
        || Fault::resource(format!("{MOST_VIEWERS} viewers watch")).next("close one of them");
    let place = place.map_err(|_| busy())?;
    let selection = Selection {
        session: watched.session,
        site: watched.site,
        ..Selection::default()
    };
    let upgrade = upgrade.max_message_size(LONGEST).max_frame_size(LONGEST);
    Ok(upgrade.on_upgrade(move |socket| watching(app, map, selection, socket, place)))
}

async fn watching(
    app: App,
    map: Arc<ServedMap>,
    selection: Selection,
    socket: WebSocket,
    _place: OwnedSemaphorePermit,
) {
    let (sink, said) = socket.split();
    let mut out = Out(sink);
    let recorded = async {
        let opened = map.newest().await?;
        let recording = opened.recordings.of(&opened, &map, &selection);
        let recording = app.within(recording).await?;
        Ok::<_, Fault>((opened, recording))
    };
    let ended = match recorded.await {
        Ok((opened, recording)) => {
            Viewer::new(&map, &opened, &recording, out)
                .shown(said)
                .await
        }
        Err(fault) => {
            let info = protocol::server_info(&map.name, [0; 2]);
            let told = async {
                out.send(Message::text(info)).await?;
                out.error(&fault.to_string()).await?;
                out.send(Message::Close(None)).await
            };
            told.await
        }
    };
    if let Err(Gone(why)) = ended {
        tracing::debug!("a viewer went: {why}");
    }
}

/// A viewer that is there no longer, and why.
struct Gone(String);

/// What is sent to a viewer, one message after the other.
struct Out(SplitSink<WebSocket, Message>);

impl Out {
    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        match timeout(PATIENCE, self.0.send(message)).await {
            Ok(sent) => sent.map_err(|error| Gone(error.to_string())),
            Err(_) => Err(Gone(format!("it took nothing for {PATIENCE:?}"))),
        }
    }

    async fn error(&mut self, message: &str) -> Result<(), Gone> {
        self.send(Message::text(protocol::error(message))).await
    }
}

/// One viewer of a recording.
struct Viewer<'r> {
    name: String,
    recording: &'r Recording,
    player: Player<'r>,
    images: Images<'r>,
    /// The viewer's number for each channel that it asked for.
    subscriptions: BTreeMap<usize, u32>,
    /// Whether it has begun, or the viewer said when it shall.
    begun: bool,
    out: Out,
}

/// An instant as the protocol has it: none before the epoch.
fn ns(stamp: i64) -> u64 {
    u64::try_from(stamp).unwrap_or_default()
}

impl<'r> Viewer<'r> {
    fn new(map: &ServedMap, opened: &'r Opened, recording: &'r Recording, out: Out) -> Self {
        Self {
            name: format!("evermap {}, version {}", map.name, opened.version()),
            recording,
            player: Player::new(&recording.stamps),
            images: Images::new(&opened.reader, Arc::clone(map.runtime())),
            subscriptions: BTreeMap::new(),
            begun: false,
            out,
        }
    }

    /// Shows it all, as it is asked for, until the viewer goes.
    async fn shown(mut self, mut said: SplitStream<WebSocket>) -> Result<(), Gone> {
        self.introduced().await?;
        loop {
            let due = self.player.next(Instant::now());
            let at = due.unwrap_or_else(Instant::now);
            tokio::select! {
                // What a viewer asks is heard between any two messages, however many are due.
                biased;
                message = said.next() => match message {
                    Some(Ok(Message::Close(_))) | None => return Ok(()),
                    Some(Ok(message)) => self.heard(message).await?,
                    Some(Err(error)) => return Err(Gone(error.to_string())),
                },
                () = sleep_until(at), if due.is_some() => self.go_on().await?,
            }
        }
    }

    /// Says who serves, what there is, and how it stands.
    async fn introduced(&mut self) -> Result<(), Gone> {
        let stamps = &self.recording.stamps;
        let ends = [stamps.first(), stamps.last()].map(|stamp| ns(stamp.copied().unwrap_or(0)));
        let info = protocol::server_info(&self.name, ends);
        self.out.send(Message::text(info)).await?;
        for channels in self.recording.channels.chunks(TOGETHER) {
            let channels = protocol::advertise(channels);
            self.out.send(Message::text(channels)).await?;
        }
        self.stands(false, None).await
    }

    async fn stands(&mut self, seeked: bool, request: Option<&str>) -> Result<(), Gone> {
        let time = ns(self.player.time(Instant::now()));
        let (status, speed) = (self.player.status(), self.player.speed());
        let state = protocol::playback(status, time, speed, seeked, request);
        self.out.send(Message::Binary(state)).await
    }

    async fn heard(&mut self, message: Message) -> Result<(), Gone> {
        let asked = match &message {
            Message::Text(text) => ClientMessage::of_text(text.as_str()),
            Message::Binary(bytes) => ClientMessage::of_bytes(bytes),
            _ => return Ok(()),
        };
        match asked {
            Ok(ClientMessage::Subscribe(subscriptions)) => {
                for subscription in subscriptions {
                    self.subscribe(subscription).await?;
                }
                Ok(())
            }
            Ok(ClientMessage::Unsubscribe(numbers)) => {
                self.subscriptions
                    .retain(|_, number| !numbers.contains(number));
                Ok(())
            }
            Ok(ClientMessage::Play(control)) => self.play(control).await,
            Ok(ClientMessage::Nothing) => Ok(()),
            Err(wrong) => self.out.error(&wrong).await,
        }
    }

    /// Begins with the first subscription; what holds until now of a channel is said when it is asked for.
    async fn subscribe(
        &mut self,
        Subscription { id, channel_id }: Subscription,
    ) -> Result<(), Gone> {
        let channel = usize::try_from(channel_id).unwrap_or(usize::MAX);
        if channel >= self.recording.channels.len() {
            return self
                .out
                .error(&format!("there is no channel {channel_id}"))
                .await;
        }
        self.subscriptions.insert(channel, id);
        if !std::mem::replace(&mut self.begun, true) {
            self.player.play(true, 1.0, Instant::now());
            self.stands(false, None).await?;
        }
        self.hold(Some(channel)).await
    }

    async fn play(&mut self, control: Control) -> Result<(), Gone> {
        self.begun = true;
        let now = Instant::now();
        let anew = control.playing && self.player.status() == Status::Ended;
        let first = self.recording.stamps.first().map(|first| ns(*first));
        let seek = control.seek.or(first.filter(|_| anew));
        if let Some(to) = seek {
            self.player.seek(i64::try_from(to).unwrap_or(i64::MAX), now);
        }
        self.player
            .play(control.playing, f64::from(control.speed), now);
        self.stands(seek.is_some(), Some(&control.request)).await?;
        match seek {
            Some(_) => self.hold(None).await,
            None => Ok(()),
        }
    }

    /// Says what holds until now, of a channel or of all that are asked for.
    async fn hold(&mut self, channel: Option<usize>) -> Result<(), Gone> {
        let played = self.player.played();
        let recording = self.recording;
        let before = recording.lasting.iter().copied();
        for message in before.take_while(|message| *message < played) {
            if channel.is_none_or(|channel| recording.channel_of[message] == channel) {
                self.tell(&[message], true).await?;
            }
        }
        Ok(())
    }

    /// Says what is due.
    async fn go_on(&mut self) -> Result<(), Gone> {
        let due = self.player.due(Instant::now());
        if due.is_empty() {
            return Ok(());
        }
        let time = protocol::time(ns(self.recording.stamps[due.end - 1]));
        self.out.send(Message::Binary(time)).await?;
        self.tell(&due.collect::<Vec<usize>>(), false).await?;
        match self.player.status() {
            Status::Ended => self.stands(false, None).await,
            _ => Ok(()),
        }
    }

    /// Sends messages, those that are asked for; what comes again holds at the time that it is.
    async fn tell(&mut self, messages: &[usize], again: bool) -> Result<(), Gone> {
        let recording = self.recording;
        let number = |message: &usize| self.subscriptions.get(&recording.channel_of[*message]);
        let asked: Vec<(usize, u32)> = messages
            .iter()
            .filter_map(|message| Some((*message, *number(message)?)))
            .collect();
        let time = self.player.time(Instant::now());
        let said: Vec<&TopicMessage> = asked
            .iter()
            .map(|(message, _)| &recording.said[*message])
            .collect();
        let payloads = match self.images.payloads(&said).await {
            Ok(payloads) => payloads,
            Err(fault) => return self.out.error(&fault.to_string()).await,
        };
        for (((_, number), said), payload) in asked.iter().zip(&said).zip(payloads) {
            let stamp = if again { time } else { said.stamp };
            let sent = protocol::message(*number, ns(stamp), &payload.bytes);
            self.out.send(Message::Binary(sent)).await?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_read_in_the_address_of_this_door_and_of_no_other() {
        for (address, found) in [
            ("/foxglove?token=t0ken", Some("t0ken")),
            ("/maps/lot/foxglove?session=a&token=t0ken", Some("t0ken")),
            ("http://a:1/foxglove?token=t0ken", Some("t0ken")),
            ("/foxglove", None),
            ("/layers/foxglove?token=t0ken", None),
            ("/maps/lot/layers/foxglove?token=t0ken", None),
            ("/maps/foxglove?token=t0ken", None),
            ("/teach/lot/foxglove?token=t0ken", None),
        ] {
            let token = token(&Uri::from_static(address));
            assert_eq!(token.as_deref(), found, "{address}");
        }
    }
}
