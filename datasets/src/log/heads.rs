//! What attachments and metadata records are called, and whether they are sound, without what they hold.

use evermap_schemas::Fault;
use mcap::records::op;

use crate::escapes::escaped;
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
        let (found, behind) = Self::split(head)?;
        // The checksum stands behind the bytes.
        let others = (head.len() - behind.len()) as u64 + 4;
        (found.bytes.saturating_add(others) <= length).then_some(found)
    }

    /// From the body of a whole record, with the attachment's bytes.
    ///
    /// # Errors
    /// In words, where it is malformed or does not match its checksum.
    pub(crate) fn whole(body: &[u8]) -> Result<(Self, &[u8]), String> {
        let cut = || format!("expected a longer record, found {} B", body.len());
        let (head, behind) = Self::split(body).ok_or_else(cut)?;
        let bytes = usize::try_from(head.bytes).ok();
        let bytes = bytes.and_then(|bytes| behind.split_at_checked(bytes));
        let (bytes, behind) = bytes.ok_or_else(cut)?;
        let expected = u32::from_le_bytes(*behind.first_chunk().ok_or_else(cut)?);
        let found = crc32fast::hash(&body[..body.len() - behind.len()]);
        match expected == 0 || expected == found {
            true => Ok((head, bytes)),
            false => Err(format!(
                "expected the checksum {expected:08x}, found {found:08x}"
            )),
        }
    }

    /// What stands before an attachment's bytes, and what there is from these on.
    fn split(body: &[u8]) -> Option<(Self, &[u8])> {
        let (log_time, rest) = body.split_first_chunk::<8>()?;
        let (create_time, mut rest) = rest.split_first_chunk::<8>()?;
        let (name, media_type) = (text(&mut rest)?, text(&mut rest)?);
        let (bytes, behind) = rest.split_first_chunk::<8>()?;
        let head = Self {
            name,
            media_type,
            bytes: u64::from_le_bytes(*bytes),
            log_time: nanoseconds(u64::from_le_bytes(*log_time)),
            create_time: nanoseconds(u64::from_le_bytes(*create_time)),
        };
        Some((head, behind))
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

/// A text behind its length; what is not UTF-8 has escapes.
fn text(rest: &mut &[u8]) -> Option<String> {
    let (length, behind) = rest.split_first_chunk::<4>()?;
    let (text, behind) = behind.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    *rest = behind;
    let plain = std::str::from_utf8(text).map(str::to_owned);
    Some(plain.unwrap_or_else(|_| escaped(text)))
}

/// The letters of a name that are kept.
fn shortened(name: &str) -> String {
    name.chars().take(LONGEST_NAME).collect()
}
