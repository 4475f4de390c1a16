//! How many messages were read of a file, held against how many its summary says: who forges the lengths of message indexes too,
//! or writes none, is found out when all of a channel was read, by however many scans. What was not read cries no wolf.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use crate::log::index::{LogIndex, Unit};

/// The units of a file that were read whole, and what was in them.
#[derive(Debug, Default)]
pub(crate) struct Tally(Mutex<Option<Left>>);

/// What is left to read.
#[derive(Debug, Default)]
struct Left {
    /// Where the units lie that were read.
    read: BTreeSet<u64>,
    /// Units that are left.
    units: usize,
    /// Those of them of which nobody says what channels they hold.
    unlisted: usize,
    /// The others, by channel.
    listed: BTreeMap<u16, usize>,
    /// Messages that were read, by channel.
    found: BTreeMap<u16, u64>,
}

/// That there are fewer messages than the summary says.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Short {
    /// Of this channel, or in all.
    pub channel: Option<u16>,
    /// So many are said.
    pub said: u64,
    /// So many are there.
    pub found: u64,
}

impl Tally {
    /// Takes a unit that was read whole, nothing of it lost, with its messages by channel. Says what is known by now to be fewer
    /// than the summary says; nothing where nobody counted, or something was lost when the index was read.
    pub fn add(
        &self,
        index: &LogIndex,
        unit: &Unit,
        found: impl Iterator<Item = (u16, u64)>,
    ) -> Vec<Short> {
        if !index.indexed || index.counts.is_none() || !index.losses.is_empty() {
            return Vec::new();
        }
        let mut left = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let left = left.get_or_insert_with(|| Left::of(index));
        if !left.read.insert(unit.offset) {
            return Vec::new();
        }
        for (channel, messages) in found {
            *left.found.entry(channel).or_default() += messages;
        }
        let mut short = left.finish(index, unit);
        short.retain(|short| short.found < short.said);
        short
    }
}

impl Left {
    fn of(index: &LogIndex) -> Self {
        let mut left = Self {
            units: index.units.len(),
            ..Self::default()
        };
        for unit in &index.units {
            match &unit.channels {
                Some(channels) => {
                    for channel in channels {
                        *left.listed.entry(*channel).or_default() += 1;
                    }
                }
                None => left.unlisted += 1,
            }
        }
        left
    }

    /// Crosses out a unit; of the channels that are read to their end with it, and of all where it is the last, what was said and
    /// what was found.
    fn finish(&mut self, index: &LogIndex, unit: &Unit) -> Vec<Short> {
        self.units = self.units.saturating_sub(1);
        match &unit.channels {
            Some(channels) => {
                for channel in channels {
                    let left = self.listed.entry(*channel).or_default();
                    *left = left.saturating_sub(1);
                }
            }
            None => self.unlisted = self.unlisted.saturating_sub(1),
        }
        if self.unlisted > 0 {
            return Vec::new();
        }
        let candidates: Vec<u16> = match &unit.channels {
            Some(channels) => channels.clone(),
            None => index.channels.keys().copied().collect(),
        };
        let ended = |channel: &u16| self.listed.get(channel).is_none_or(|left| *left == 0);
        let ended = candidates.into_iter().filter(ended);
        let mut finished: Vec<Short> = ended
            .filter_map(|channel| self.of_channel(index, channel))
            .collect();
        // What channels are short of is said of them.
        let all = index.counts.as_ref().filter(|all| {
            let of_channels = all.channels.iter().flat_map(|each| each.values());
            self.units == 0 && of_channels.copied().fold(0, u64::saturating_add) < all.messages
        });
        finished.extend(all.map(|all| Short {
            channel: None,
            said: all.messages,
            found: self.found.values().sum(),
        }));
        finished
    }

    fn of_channel(&self, index: &LogIndex, channel: u16) -> Option<Short> {
        Some(Short {
            channel: Some(channel),
            said: index.channel_messages(channel)?,
            found: self.found.get(&channel).copied().unwrap_or(0),
        })
    }
}
