//! Forward reading of an object by range requests, with a little read-ahead.

use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use evermap_schemas::Fault;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};

/// Read-ahead for small records, so that a file without chunks costs few requests.
const AHEAD: u64 = 4 << 20;
/// Bytes that are hashed, or decompressed, together.
pub(crate) const PIECE: u64 = 1 << 20;

/// A stretch of an object, read from front to back in as few requests as its memory bound allows.
pub struct Window {
    store: Arc<dyn ObjectStore>,
    path: Path,
    end: u64,
    start: u64,
    bytes: Bytes,
}

impl Window {
    /// Reads nothing at or behind `end`, which must not lie behind the object's end.
    pub fn new(store: Arc<dyn ObjectStore>, path: Path, end: u64) -> Self {
        Self {
            store,
            path,
            end,
            start: 0,
            bytes: Bytes::new(),
        }
    }

    /// With bytes that are known already, those at `start`.
    pub fn holding(self, start: u64, bytes: Bytes) -> Self {
        Self {
            start,
            bytes,
            ..self
        }
    }

    /// The bytes at `offset`; `None` where fewer than `length` are left.
    ///
    /// # Errors
    /// A resource fault when the object store fails.
    pub async fn get(&mut self, offset: u64, length: u64) -> Result<Option<Bytes>, Fault> {
        let Some(wanted_end) = offset.checked_add(length).filter(|end| *end <= self.end) else {
            return Ok(None);
        };
        let held = self.start..self.start + self.bytes.len() as u64;
        if offset < held.start || wanted_end > held.end {
            let end = wanted_end.max(offset.saturating_add(AHEAD)).min(self.end);
            self.bytes = fetch(&self.store, &self.path, offset..end).await?;
            self.start = offset;
        }
        let from = (offset - self.start) as usize;
        Ok(Some(self.bytes.slice(from..from + length as usize)))
    }

    /// The checksum of the bytes in a range, fetched in pieces; `None` where not all are there.
    ///
    /// # Errors
    /// A resource fault when the object store fails.
    pub async fn checksum(&mut self, range: Range<u64>) -> Result<Option<u32>, Fault> {
        let mut crc = crc32fast::Hasher::new();
        let mut position = range.start;
        while position < range.end {
            let length = PIECE.min(range.end - position);
            let Some(piece) = self.get(position, length).await? else {
                return Ok(None);
            };
            crc.update(&piece);
            position += length;
        }
        Ok(Some(crc.finalize()))
    }
}

/// Fetches a range of an object: exactly its bytes, or a fault.
///
/// # Errors
/// A resource fault when the object store fails or gives fewer bytes than asked for.
pub async fn fetch(
    store: &Arc<dyn ObjectStore>,
    path: &Path,
    range: Range<u64>,
) -> Result<Bytes, Fault> {
    if range.is_empty() {
        return Ok(Bytes::new());
    }
    let length = range.end - range.start;
    let bytes = store
        .get_range(path, range.clone())
        .await
        .map_err(|error| store_fault(&error).at(path))?;
    if bytes.len() as u64 != length {
        return Err(Fault::resource(format!(
            "expected {length} B at {}, found {}: the file changed while it was read",
            range.start,
            bytes.len()
        ))
        .at(path));
    }
    Ok(bytes)
}

/// An object store's error as a fault.
pub fn store_fault(error: &object_store::Error) -> Fault {
    match error {
        object_store::Error::NotFound { path, .. } => {
            Fault::user(format!("expected a file, found nothing at {path}"))
        }
        other => Fault::resource(other.to_string()),
    }
}
