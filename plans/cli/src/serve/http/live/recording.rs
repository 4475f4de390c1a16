//! What there is to say of a version of a map, made once for all who watch it at the same time.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use datafusion::execution::memory_pool::{MemoryConsumer, MemoryReservation};
use evermap_engine::error::OrFault;
use evermap_schemas::Fault;
use serde_json::Value;
use tokio::sync::Mutex;

use super::protocol;
use crate::ending::Lost;
use crate::export::Selection;
use crate::export::foxglove::{TopicMessage, said};
use crate::serve::maps::{Opened, ServedMap};

/// What there is to say, in the order of time, and how it is divided among channels.
pub struct Recording {
    /// The messages.
    pub said: Vec<TopicMessage>,
    /// Their instants, ns.
    pub stamps: Vec<i64>,
    /// Their channels.
    pub channel_of: Vec<usize>,
    /// The channels, as they are advertised.
    pub channels: Vec<Value>,
    /// Those that hold from then on.
    pub lasting: Vec<usize>,
    /// What it takes of the memory that queries share.
    _memory: MemoryReservation,
}

impl Recording {
    fn new(said: Vec<TopicMessage>, map: &ServedMap) -> Result<Self, Fault> {
        let memory = MemoryConsumer::new("a live recording").register(&map.runtime().memory_pool);
        memory
            .try_grow(said.iter().map(TopicMessage::size).sum())
            .or_fault()?;
        let mut numbers: BTreeMap<&str, usize> = BTreeMap::new();
        let (mut channels, mut channel_of) = (Vec::new(), Vec::with_capacity(said.len()));
        for one in &said {
            let number = match numbers.get(one.topic.as_str()) {
                Some(number) => *number,
                None => {
                    let number = channels.len();
                    let kind = one.kind()?;
                    channels.push(protocol::channel(number, &one.topic, &kind));
                    numbers.insert(&one.topic, number);
                    number
                }
            };
            channel_of.push(number);
        }
        let lasting = said.iter().enumerate().filter(|(_, one)| one.lasts);
        Ok(Self {
            stamps: said.iter().map(|one| one.stamp).collect(),
            lasting: lasting.map(|(number, _)| number).collect(),
            channel_of,
            channels,
            said,
            _memory: memory,
        })
    }
}

/// Which of a version is watched: a site and a session, where they are named.
type Which = (Option<String>, Option<String>);

/// The recordings of a version that somebody watches.
#[derive(Default)]
pub struct Recordings(Mutex<BTreeMap<Which, Weak<Recording>>>);

impl Recordings {
    /// The recording of a selection: the one that others watch, or a new one.
    ///
    /// # Errors
    /// As [`said`], and a resource fault for one that is larger than the memory that is left.
    pub async fn of(
        &self,
        opened: &Opened,
        map: &ServedMap,
        selection: &Selection,
    ) -> Result<Arc<Recording>, Fault> {
        let which = (selection.site.clone(), selection.session.clone());
        let mut watched = self.0.lock().await;
        watched.retain(|_, recording| recording.strong_count() > 0);
        if let Some(recording) = watched.get(&which).and_then(Weak::upgrade) {
            return Ok(recording);
        }
        let mut lost = Lost::default();
        let said = said(&opened.reader, selection, &mut lost).await?;
        for reason in lost.0.keys() {
            tracing::warn!("{reason}");
        }
        let recording = Arc::new(Recording::new(said, map)?);
        watched.insert(which, Arc::downgrade(&recording));
        Ok(recording)
    }
}
