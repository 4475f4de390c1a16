//! Forward reading of an object by range requests, with a little read-ahead.

use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use evermap_schemas::Fault;
use object_store::{GetOptions, GetResult, ObjectMeta, ObjectStore};

use crate::fault::store_fault;

/// Read-ahead for small records, so that a file without chunks costs few requests.
const AHEAD: u64 = 4 << 20;
/// Bytes that are hashed, or decompressed, together.
pub(crate) const PIECE: u64 = 1 << 20;

/// A stretch of an object, read from front to back in as few requests as its memory bound allows.
pub struct Window {
    store: Arc<dyn ObjectStore>,
    meta: ObjectMeta,
    end: u64,
    start: u64,
    bytes: Bytes,
}

impl Window {
    /// Reads nothing at or behind `end`, which must not lie behind the object's end.
    pub fn new(store: Arc<dyn ObjectStore>, meta: ObjectMeta, end: u64) -> Self {
        Self {
            store,
            meta,
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
            self.bytes = fetch(&self.store, &self.meta, offset..end).await?;
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
/// A resource fault when the object store fails, has another object there by now, or gives fewer bytes than asked for.
pub async fn fetch(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    range: Range<u64>,
) -> Result<Bytes, Fault> {
    if range.is_empty() {
        return Ok(Bytes::new());
    }
    let (start, length) = (range.start, range.end - range.start);
    let failed = |error| store_fault(&error).at(&meta.location);
    let object = get(store, meta, range).await.map_err(failed)?;
    let bytes = object.bytes().await.map_err(failed)?;
    if bytes.len() as u64 != length {
        return Err(Fault::resource(format!(
            "expected {length} B at {start}, found {}: the file changed while it was read",
            bytes.len()
        ))
        .at(&meta.location));
    }
    Ok(bytes)
}

/// Asks for a range of an object, of the state in which it was found where its store can tell that from others: a strong
/// entity tag stands in quotes. A file on a disk has none, as it may grow while it is read.
///
/// # Errors
/// What the store says; that a precondition failed where it has another object there by now.
pub async fn get(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    range: Range<u64>,
) -> object_store::Result<GetResult> {
    let tag = meta.e_tag.clone().filter(|tag| tag.starts_with('"'));
    let options = GetOptions::new().with_range(Some(range)).with_if_match(tag);
    store.get_opts(&meta.location, options).await
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use object_store::ObjectStoreExt;
    use object_store::memory::InMemory;
    use object_store::path::Path;

    use super::*;

    /// The store in memory names states by numbers without quotes: it is asked for whatever is there.
    #[tokio::test]
    async fn another_object_of_the_same_size_is_not_read_where_tags_tell_it() {
        let store: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
        let path = Path::from("a.mcap");
        store.put(&path, "first".into()).await.unwrap();
        let found = store.head(&path).await.unwrap();
        assert_eq!(fetch(&store, &found, 0..5).await.unwrap(), "first");
        store.put(&path, "other".into()).await.unwrap();
        assert_eq!(fetch(&store, &found, 0..5).await.unwrap(), "other");
        let strong = ObjectMeta {
            e_tag: Some("\"0\"".into()),
            ..found
        };
        let fault = fetch(&store, &strong, 0..5).await.unwrap_err();
        assert!(
            fault.message.contains("changed while it was read"),
            "{fault}"
        );
    }
}
