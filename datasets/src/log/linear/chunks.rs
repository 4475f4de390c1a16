//! Chunks that go by while a file is read record by record.

use evermap_schemas::Fault;

use super::Scan;
use crate::log::census::{Census, census};
use crate::log::chunk::{ChunkHead, Damage, HEAD};
use crate::log::index::{Unit, UnitKind};
use crate::log::pace::add;
use crate::log::walk::{Pieces, feed};
use crate::losses::{Loss, Reason};

impl Scan<'_> {
    /// What is there of a chunk at the end of a file that was cut.
    pub(super) async fn torn_chunk(&mut self, offset: u64, end: u64) -> Result<(), Fault> {
        let present = end.saturating_sub(offset);
        let head = self.window.get(offset, present.min(HEAD)).await?;
        let head = ChunkHead::parse(&head.unwrap_or_default());
        match head {
            Ok(head) => {
                let cut = (Reason::Torn, head.cut(present));
                self.chunk(offset, present, Some(cut)).await
            }
            Err(_) => Ok(()),
        }
    }

    /// Reads the chunk record at `offset`, of which so many bytes are there.
    pub(super) async fn chunk(
        &mut self,
        offset: u64,
        present: u64,
        cut: Option<Damage>,
    ) -> Result<(), Fault> {
        self.close_run();
        let lost = Loss::one(present);
        let head = self.window.get(offset, present.min(HEAD)).await?;
        let census = match ChunkHead::parse(&head.unwrap_or_default()) {
            Ok(head) => {
                let checked = head.crc != 0;
                let census = self.census(offset, present, head, cut).await?;
                let sound = matches!(&census, Ok(census) if census.damage.is_none());
                self.checked |= checked;
                if checked && !sound {
                    self.checksum = None;
                }
                census
            }
            Err(damage) => Err(damage),
        };
        let census = match census {
            Ok(census) => census,
            Err((reason, detail)) => {
                self.losses.note(reason, offset, lost, detail);
                return Ok(());
            }
        };
        if let Some((reason, detail)) = &census.damage {
            self.losses.note(*reason, offset, lost, detail);
        }
        if census.lost.count > 0 {
            let detail = "inside a chunk";
            self.losses
                .note(Reason::BadRecord, offset, census.lost, detail);
        }
        self.note_late(census.late, offset);
        for (opcode, body) in &census.definitions {
            if let Err(detail) = self.collector.add_definition(*opcode, body) {
                self.bad_record(detail, offset, body.len() as u64);
            }
        }
        for (channel, pace) in &census.paces {
            add(&mut self.paces, *channel, *pace);
        }
        let (start_time, end_time) = census.times.unwrap_or_default();
        self.collector.add_unit(Unit {
            kind: UnitKind::Chunk,
            offset,
            length: present,
            size: census.size,
            channels: Some(census.paces.keys().copied().collect()),
            start_time,
            end_time,
        });
        Ok(())
    }

    /// Counts what is in a chunk while it is fetched.
    async fn census(
        &mut self,
        offset: u64,
        present: u64,
        head: ChunkHead,
        cut: Option<Damage>,
    ) -> Result<Result<Census, Damage>, Fault> {
        let start = offset + head.start as u64;
        let end = start.saturating_add(head.packed);
        if end > offset + present && cut.is_none() {
            let damage = (Reason::BadIndex, head.cut(present));
            return Ok(Err(damage));
        }
        let end = end.min(offset + present);
        self.hash_to(start).await?;
        let room = self.collector.room;
        let (sender, pieces) = Pieces::channel();
        let task = tokio::task::spawn_blocking(move || census(&head, cut, room, pieces));
        let checksum = self.checksum.as_mut();
        feed(&mut self.window, start..end, sender, checksum).await?;
        task.await.map_err(|error| Fault::bug(error.to_string()))
    }
}
