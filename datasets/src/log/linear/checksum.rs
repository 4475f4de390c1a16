//! Comparing the checksum of all that lies before a log's end record, where all of it is read.

use evermap_schemas::Fault;

use super::Scan;
use crate::log::index::DataSum;
use crate::log::record::{FRAME, MAGIC};
use crate::log::window::PIECE;
use crate::losses::{Loss, Reason};

impl Scan<'_> {
    /// Goes on with the checksum where reading begins; of a file of which stretches are left out, there is none.
    pub(super) async fn hash_from(&mut self, start: u64) -> Result<(), Fault> {
        let first = start == MAGIC.len() as u64;
        let hashed = self.checksum.as_ref().map(|checksum| checksum.hashed());
        if !first && hashed != Some(start) {
            self.checksum = None;
        }
        self.hash_to(start).await
    }

    /// Hashes what lies before this offset. Of records that were just read, nothing is fetched again.
    pub(super) async fn hash_to(&mut self, end: u64) -> Result<(), Fault> {
        while let Some(checksum) = &mut self.checksum
            && checksum.hashed() < end
        {
            let start = checksum.hashed();
            match self.window.get(start, PIECE.min(end - start)).await? {
                Some(piece) => checksum.add(&piece),
                None => self.checksum = None,
            }
        }
        Ok(())
    }

    /// Compares the checksum with that of the end record at `position`, of which 0 stands for none. That all chunks match
    /// their own says nothing of one that is gone.
    pub(super) async fn compare(&mut self, position: u64, length: u64) -> Result<(), Fault> {
        let checksum = self.checksum.take();
        let body = self.window.get(position + FRAME, length.min(4)).await?;
        let body = body.unwrap_or_default();
        let expected = body.first_chunk().map_or(0, |crc| u32::from_le_bytes(*crc));
        let sum = DataSum {
            bytes: position,
            expected,
        };
        let Some(checksum) = checksum else {
            self.left = (expected != 0).then_some(sum);
            return Ok(());
        };
        self.compared = expected != 0;
        let mismatch = sum.mismatch(checksum.finish());
        if let Some(detail) = mismatch.filter(|_| self.compared) {
            let elsewhere = match self.checked {
                true => {
                    ": chunks are missing, or what differs is outside of chunks, which match theirs"
                }
                false => "",
            };
            let detail = format!("{detail}{elsewhere}");
            self.losses
                .note(Reason::BadData, position, Loss::one(0), detail);
        }
        Ok(())
    }
}
