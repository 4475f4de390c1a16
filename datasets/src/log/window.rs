//! Reading of an object by range requests: forward, with a little read-ahead, or what lies here and there, near parts together.

use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use evermap_schemas::Fault;
use futures::future::try_join_all;
use object_store::{GetOptions, GetResult, ObjectMeta, ObjectStore};

use crate::fault::store_fault;

/// Bytes that are fetched for one reader at a time: ahead of small records, so that a file without chunks costs few
/// requests, or together, as each request costs its own time.
pub(crate) const STRETCH_BYTES: u64 = 4 << 20;
/// And across so many bytes of which nothing is wanted: the message indexes between chunks.
const GAP_BYTES: u64 = 64 << 10;
/// Requests of one reader that are on their way at a time.
pub(crate) const SIDE_BY_SIDE: usize = 16;
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
            let end = wanted_end
                .max(offset.saturating_add(STRETCH_BYTES))
                .min(self.end);
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

/// Fetches some ranges of an object at once, of which there should be [`SIDE_BY_SIDE`] at most: the bytes of each, in order.
///
/// # Errors
/// As [`fetch`].
pub(crate) async fn fetch_all(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    ranges: Vec<Range<u64>>,
) -> Result<Vec<Bytes>, Fault> {
    let fetched = ranges.into_iter().map(|range| {
        // Futures that borrow could not be sent to other threads together.
        let (store, meta) = (Arc::clone(store), meta.clone());
        async move { fetch(&store, &meta, range).await }
    });
    try_join_all(fetched).await
}

/// Whether a range lies so close behind another one that both are fetched with one request.
pub(crate) fn near(before: &Range<u64>, next: &Range<u64>) -> bool {
    (before.end..=before.end.saturating_add(GAP_BYTES)).contains(&next.start)
}

/// Ranges of an object, in its order, near ones joined to stretches of at most so many bytes; a larger range is one of
/// its own.
pub(crate) fn stretches(
    ranges: impl IntoIterator<Item = Range<u64>>,
    most: u64,
) -> Vec<Range<u64>> {
    let mut stretches: Vec<Range<u64>> = Vec::new();
    for range in ranges {
        match stretches.last_mut() {
            Some(last) if near(last, &range) && range.end.saturating_sub(last.start) <= most => {
                last.end = range.end;
            }
            _ => stretches.push(range),
        }
    }
    stretches
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

    #[test]
    fn near_ranges_are_joined_as_far_as_they_are_small() {
        let of = |ranges: &[(u64, u64)], most: u64| {
            let joined = stretches(ranges.iter().map(|(start, end)| *start..*end), most);
            let ends = joined.into_iter().map(|range| (range.start, range.end));
            ends.collect::<Vec<_>>()
        };
        assert_eq!(of(&[(5, 15), (15, 25), (95, 105)], 100), [(5, 105)]);
        let too_many = of(&[(5, 15), (15, 25), (96, 106)], 100);
        assert_eq!(too_many, [(5, 25), (96, 106)]);
        assert_eq!(of(&[(5, 500), (500, 510)], 100), [(5, 500), (500, 510)]);
        let behind = |gap: u64| [(0, 10), (10 + gap, 20 + gap)];
        let last = 20 + GAP_BYTES;
        assert_eq!(of(&behind(GAP_BYTES), u64::MAX), [(0, last)]);
        let far = behind(GAP_BYTES + 1);
        assert_eq!(of(&far, u64::MAX), far);
        // Hostile: at one place, and beyond all files.
        let claims = [(7, 1 << 60), (7, 1 << 60), (u64::MAX, u64::MAX)];
        assert_eq!(of(&claims, u64::MAX), claims);
    }

    #[tokio::test]
    async fn ranges_are_fetched_in_their_order() {
        let store: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
        let path = Path::from("a.mcap");
        store.put(&path, "0123456789".into()).await.unwrap();
        let found = store.head(&path).await.unwrap();
        let ranges = vec![4..6, 0..1, 9..10];
        let fetched = fetch_all(&store, &found, ranges).await.unwrap();
        assert_eq!(fetched, ["45", "0", "9"]);
        let beyond = fetch_all(&store, &found, vec![0..1, 20..30]).await;
        assert!(beyond.is_err());
    }

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
