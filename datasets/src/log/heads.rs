//! What attachments and metadata records are called, and whether they are sound, without what they hold.

use evermap_schemas::Fault;
use mcap::records::op;

use crate::log::index::Unit;
use crate::log::metadata;
use crate::log::record::{FRAME, frame, nanoseconds};
use crate::log::window::Window;
use crate::losses::{Loss, Reason};
use crate::session::LogPart;

/// Bytes from the start of a record that are read.
pub(crate) const HEAD: u64 = 64 << 10;
/// Letters of a name that are kept.
pub(crate) const LONGEST_NAME: usize = 256;

/// What stands before an attachment's bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttachmentHead {
    /// Name of the attachment.
    pub name: String,
    /// What the bytes are.
    pub media_type: String,
    /// How many.
    pub bytes: u64,
    /// When it was recorded, ns since the epoch.
    pub log_time: i64,
    /// When it was made, ns since the epoch.
    pub create_time: i64,
}

impl AttachmentHead {
    /// From the first bytes of a record; `None` where they are of no sound attachment, or do not hold all that stands
    /// before its bytes.
    pub(crate) fn parse(record: &[u8]) -> Option<Self> {
        let (opcode, length) = frame(record)?;
        let head = record.get(FRAME as usize..);
        let head = head.filter(|_| opcode == op::ATTACHMENT)?;
        let time = |at: usize| Some(u64::from_le_bytes(*head.get(at..)?.first_chunk()?));
        let mut rest = head.get(16..)?;
        let found = Self {
            name: text(&mut rest)?,
            media_type: text(&mut rest)?,
            bytes: u64::from_le_bytes(*rest.first_chunk()?),
            log_time: nanoseconds(time(0)?),
            create_time: nanoseconds(time(8)?),
        };
        // Their number stands before the bytes, their checksum behind.
        let others = (head.len() - rest.len()) as u64 + 8 + 4;
        (found.bytes.saturating_add(others) <= length).then_some(found)
    }
}

impl LogPart {
    /// The attachments, by time and name, without their bytes. What is malformed, or fails its checksum, is noted as lost.
    ///
    /// # Errors
    /// A resource fault when the store fails.
    pub async fn attachments(&self) -> Result<Vec<AttachmentHead>, Fault> {
        let mut found = Vec::new();
        let mut window = window(self);
        for unit in &self.index.attachments {
            let record = head(&mut window, unit).await?;
            match AttachmentHead::parse(&record) {
                Some(head) if checksum_fits(&mut window, unit).await? => {
                    found.push(AttachmentHead {
                        name: shortened(&head.name),
                        media_type: shortened(&head.media_type),
                        ..head
                    });
                }
                _ => {
                    let detail = format!(
                        "expected a name in the first {HEAD} B and a right checksum, found others"
                    );
                    lose(self, unit, detail);
                }
            }
        }
        found.sort_by(|a, b| (a.log_time, &a.name).cmp(&(b.log_time, &b.name)));
        Ok(found)
    }

    /// Names of the metadata records, sorted. Each is read whole: what is malformed is noted as lost, as it is by queries.
    ///
    /// # Errors
    /// A resource fault when the store fails.
    pub async fn metadata_names(&self) -> Result<Vec<String>, Fault> {
        let mut found = Vec::new();
        let mut window = window(self);
        for unit in &self.index.metadata {
            match metadata::named(&mut window, unit).await? {
                Ok(name) => found.push(name),
                Err(detail) => lose(self, unit, detail),
            }
        }
        found.sort();
        Ok(found)
    }
}

/// Compares an attachment's last four bytes, the checksum of all before or zero.
async fn checksum_fits(window: &mut Window, unit: &Unit) -> Result<bool, Fault> {
    let end = unit.end() - 4;
    let found = window.checksum(unit.offset + FRAME..end).await?;
    let expected = window.get(end, 4).await?.unwrap_or_default();
    let expected = expected
        .first_chunk()
        .map_or(0, |crc| u32::from_le_bytes(*crc));
    Ok(expected == 0 || found == Some(expected))
}

fn window(part: &LogPart) -> Window {
    Window::new(part.store.clone(), part.meta.clone(), part.meta.size)
}

async fn head(window: &mut Window, unit: &Unit) -> Result<bytes::Bytes, Fault> {
    let head = window.get(unit.offset, unit.length.min(HEAD)).await?;
    Ok(head.unwrap_or_default())
}

fn lose(part: &LogPart, unit: &Unit, detail: String) {
    let loss = Loss::one(unit.length);
    part.losses
        .note(Reason::BadAttachment, unit.offset, loss, detail);
}

/// A text behind its length.
fn text(rest: &mut &[u8]) -> Option<String> {
    let (length, behind) = rest.split_first_chunk::<4>()?;
    let (text, behind) = behind.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    *rest = behind;
    Some(String::from_utf8_lossy(text).into_owned())
}

/// The letters of a name that are kept.
fn shortened(name: &str) -> String {
    name.chars().take(LONGEST_NAME).collect()
}
