//! What a file really holds, whatever its summary says.

use std::sync::Arc;

use evermap_schemas::Fault;
use object_store::{ObjectMeta, ObjectStore};

use crate::log::index::{LogIndex, Unit, UnitKind};
use crate::log::linear;
use crate::losses::{FileLosses, Loss, Reason};

impl LogIndex {
    /// Reads the whole file, also where it has a sound summary: what it really holds, beside whose losses those of the
    /// summary are noted, where it says other things. `None` where the index comes from reading the whole file already.
    /// Memory does not grow with the file or its chunks.
    ///
    /// # Errors
    /// A resource fault when the store fails.
    pub(crate) async fn survey(
        &self,
        store: &Arc<dyn ObjectStore>,
        meta: &ObjectMeta,
        losses: &FileLosses,
    ) -> Result<Option<Self>, Fault> {
        if !self.indexed {
            return Ok(None);
        }
        let found = linear::read(store, meta, losses).await?;
        self.compare_channels(&found, losses);
        self.compare_chunks(&found, losses);
        let (said, counted) = (self.message_count(), found.message_count());
        if let (Some(said), Some(counted)) = (said, counted)
            && said != counted
        {
            let detail = linear::as_said(said, counted);
            losses.note(Reason::BadSummary, meta.size, Loss::one(0), detail);
        }
        Ok(Some(found))
    }

    fn compare_channels(&self, found: &Self, losses: &FileLosses) {
        for (id, channel) in &found.channels {
            let same = self
                .channels
                .get(id)
                .map(|said| said == channel && self.schema_of(said) == found.schema_of(channel));
            let detail = match same {
                Some(true) => continue,
                Some(false) => format!(
                    "expected channel {id} as the summary defines it, found it defined otherwise"
                ),
                None => format!("expected channel {id} in the summary, found none"),
            };
            let count = found.channel_messages(*id).unwrap_or(0).max(1);
            let loss = Loss { count, bytes: 0 };
            let topic = &channel.topic;
            losses.note_topic(Reason::BadSummary, topic, u64::from(*id), loss, detail);
        }
    }

    fn compare_chunks(&self, found: &Self, losses: &FileLosses) {
        for unit in found
            .units
            .iter()
            .filter(|unit| unit.kind == UnitKind::Chunk)
        {
            let said = self
                .units
                .binary_search_by_key(&unit.offset, |said| said.offset);
            let detail = match said.map(|at| &self.units[at]) {
                Ok(said) if covers(said, unit) => continue,
                Ok(_) => {
                    "expected a chunk of the channels and times that the summary says, found others in it"
                }
                Err(_) => "expected no chunk where the summary has none, found one",
            };
            losses.note(Reason::BadSummary, unit.offset, Loss::one(0), detail);
        }
    }
}

/// Whether whoever looks for a message of the chunk by what is said of it finds it.
fn covers(said: &Unit, found: &Unit) -> bool {
    let channels = found.channels.as_deref().unwrap_or_default();
    let times = said.start_time <= found.start_time && found.end_time <= said.end_time;
    channels.is_empty() || (times && channels.iter().all(|channel| said.may_hold(*channel)))
}
