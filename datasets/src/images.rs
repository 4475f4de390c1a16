//! From the references of frames to image bytes.

mod large;
mod video;

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use evermap_messages::{MessageType, bytes_of_base64};
use evermap_schemas::roles::IMAGE_MEMBER;
use evermap_schemas::{Fault, ImageRef};
use evermap_video::Codec;
use futures::{StreamExt, TryStreamExt};
use tokio::sync::OnceCell;

use crate::dataset::Dataset;
use crate::log::chunk::Block;
use crate::log::index::{Unit, UnitKind};
use crate::log::unpack::{LARGEST_CHUNK, unpack};
use crate::log::window::fetch;
use crate::session::LogPart;

/// Chunks that one call opens at the same time.
const OPEN_AT_ONCE: usize = 2;

/// Fetches images by reference, chunk by chunk: a chunk that several images lie in is fetched and decompressed once,
/// also when several threads ask for it at the same time, and kept for a while.
///
/// A chunk larger than what is kept is gone through for its images instead.
///
/// The bytes of an image from a chunk share the chunk's memory. So a call holds the chunks of the references that it
/// is given: give references in portions.
#[derive(Debug)]
pub struct ImageReader {
    parts: BTreeMap<(Arc<str>, u32), Arc<LogPart>>,
    cache: Mutex<Cache>,
    tracks: video::Tracks,
    /// Bytes of the largest chunk that is opened whole.
    largest: u64,
    walks: large::Walks,
}

/// A chunk, or what stands in for one: the bytes of an image outside any chunk.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct ChunkRef {
    session: String,
    part: u32,
    offset: u64,
    length: u64,
    size: u64,
    opening: Opening,
}

/// What is done with the bytes of a [`ChunkRef`].
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Opening {
    /// They are taken as they are.
    Plain,
    /// The data of a chunk: they are decompressed.
    Unpack(String),
    /// A whole chunk record.
    Chunk,
}

type Slot = Arc<OnceCell<Result<Bytes, Fault>>>;

#[derive(Debug)]
struct Cache {
    slots: BTreeMap<ChunkRef, Slot>,
    /// Least recently used first.
    order: VecDeque<ChunkRef>,
    bytes: u64,
    limit: u64,
}

impl Cache {
    fn slot(&mut self, chunk: &ChunkRef) -> Slot {
        if let Some(slot) = self.slots.get(chunk) {
            let slot = slot.clone();
            self.order.retain(|other| other != chunk);
            self.order.push_back(chunk.clone());
            return slot;
        }
        let slot = Slot::default();
        self.bytes += chunk.size;
        self.slots.insert(chunk.clone(), slot.clone());
        self.order.push_back(chunk.clone());
        while self.bytes > self.limit {
            let Some(oldest) = self.order.pop_front() else {
                break;
            };
            self.slots.remove(&oldest);
            self.bytes -= oldest.size;
        }
        slot
    }
}

impl ChunkRef {
    /// Where an image lies, if of the chunks that are opened whole the largest has so many bytes.
    fn of(image: &ImageRef, largest: u64) -> Self {
        let plain = |offset: u64| (offset, image.length, image.length, Opening::Plain);
        let (offset, length, size, opening) = match image.chunk {
            Some(chunk) if image.compression.is_empty() && image.chunk_size > largest => {
                plain(chunk.saturating_add(image.offset))
            }
            Some(chunk) => {
                let opening = Opening::Unpack(image.compression.clone());
                (chunk, image.chunk_length, image.chunk_size, opening)
            }
            None => plain(image.offset),
        };
        Self {
            session: image.session.clone(),
            part: image.part,
            offset,
            length,
            size,
            opening,
        }
    }

    fn of_unit(part: &LogPart, unit: &Unit) -> Self {
        Self {
            session: part.session.to_string(),
            part: part.part,
            offset: unit.offset,
            length: unit.length,
            size: unit.size,
            opening: match unit.kind {
                UnitKind::Chunk => Opening::Chunk,
                _ => Opening::Plain,
            },
        }
    }
}

impl ImageReader {
    /// Bytes of opened chunks that readers usually keep.
    pub const CACHE_BYTES: u64 = 64 << 20;

    /// A reader of the images of a dataset that keeps up to `cache_bytes` of opened chunks.
    pub fn new(dataset: &Dataset, cache_bytes: u64) -> Self {
        let parts = dataset.parts().into_iter();
        Self {
            parts: parts
                .map(|part| ((part.session.clone(), part.part), part))
                .collect(),
            cache: Mutex::new(Cache {
                slots: BTreeMap::new(),
                order: VecDeque::new(),
                bytes: 0,
                limit: cache_bytes,
            }),
            tracks: video::Tracks::default(),
            largest: cache_bytes,
            walks: large::Walks::default(),
        }
    }

    /// The bytes of each image, in order: encoded as [`ImageRef::format`] says, with base64 already undone. A frame of
    /// video is decoded, from the last key frame of its topic on: its bytes are a netpbm file.
    ///
    /// # Errors
    /// A user fault when a reference names a session that the dataset does not have. What is wrong with one image, or
    /// with its chunk, is that image's own fault.
    pub async fn resolve(&self, images: &[ImageRef]) -> Result<Vec<Result<Bytes, Fault>>, Fault> {
        let mut chunks = BTreeMap::<ChunkRef, Vec<usize>>::new();
        let mut videos = Vec::new();
        for (index, image) in images.iter().enumerate() {
            match Codec::named(&image.format) {
                Some(codec) => videos.push((index, image, codec)),
                None => {
                    let chunk = ChunkRef::of(image, self.largest);
                    chunks.entry(chunk).or_default().push(index);
                }
            }
        }
        let missing = || Err(Fault::bug("an image was not resolved"));
        let mut resolved: Vec<Result<Bytes, Fault>> = images.iter().map(|_| missing()).collect();
        let large = |chunk: &ChunkRef, _: &mut Vec<usize>| {
            chunk.size > self.largest && matches!(chunk.opening, Opening::Unpack(_))
        };
        for (chunk, indexes) in chunks.extract_if(.., large) {
            for (index, image) in self.large(&chunk, images, &indexes).await? {
                resolved[index] = image;
            }
        }
        let mut opened = futures::stream::iter(chunks)
            .map(|(chunk, indexes)| async move {
                let content = self.open(&chunk).await?;
                Ok::<_, Fault>((content, chunk, indexes))
            })
            .buffered(OPEN_AT_ONCE);
        while let Some((content, chunk, indexes)) = opened.try_next().await? {
            for index in indexes {
                resolved[index] = match &content {
                    Ok(bytes) => self.image_bytes(bytes, &chunk, &images[index]),
                    Err(fault) => Err(fault.clone()),
                };
            }
        }
        for (index, decoded) in self.video(&videos).await? {
            resolved[index] = decoded;
        }
        Ok(resolved)
    }

    /// The topic that an image was recorded on; `None` where the log that the reference names does not say.
    pub async fn topic(&self, image: &ImageRef) -> Option<String> {
        let found = self.topic_and_unit(image).await.ok()?;
        found.ok().map(|(topic, _)| topic)
    }

    fn part(&self, session: &str, part: u32) -> Result<&Arc<LogPart>, Fault> {
        self.parts.get(&(session.into(), part)).ok_or_else(|| {
            Fault::user(format!(
                "expected the log of session {session}, part {part}, found no such file"
            ))
            .next("give the sessions that the frames come from")
        })
    }

    fn image_bytes(
        &self,
        opened: &Bytes,
        chunk: &ChunkRef,
        image: &ImageRef,
    ) -> Result<Bytes, Fault> {
        let start = match chunk.opening {
            Opening::Plain => 0,
            _ => image.offset,
        };
        let end = start.checked_add(image.length);
        let Some(end) = end.filter(|end| *end <= opened.len() as u64) else {
            return Err(outside());
        };
        self.encoded(opened.slice(start as usize..end as usize), image)
    }

    /// The image in the bytes that a reference names.
    fn encoded(&self, bytes: Bytes, image: &ImageRef) -> Result<Bytes, Fault> {
        if !is_base64(&bytes, image, self.part(&image.session, image.part)?) {
            return Ok(bytes);
        }
        let decoded = bytes_of_base64(&bytes);
        decoded.map(Bytes::from).map_err(Fault::data)
    }

    async fn open(&self, chunk: &ChunkRef) -> Result<Result<Bytes, Fault>, Fault> {
        let part = self.part(&chunk.session, chunk.part)?;
        let slot = held(&self.cache).slot(chunk);
        let bytes = slot.get_or_init(|| read(part, chunk)).await;
        Ok(bytes.clone())
    }
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Fetches and decompresses.
async fn read(part: &LogPart, chunk: &ChunkRef) -> Result<Bytes, Fault> {
    let at = |fault: Fault| fault.at(format!("{} at {}", part.url, chunk.offset));
    let end = chunk.offset.saturating_add(chunk.length);
    if end > part.meta.size || chunk.size > LARGEST_CHUNK {
        return Err(at(Fault::data(
            "expected an image inside the file, found none there",
        )));
    }
    let bytes = fetch(&part.store, &part.meta, chunk.offset..end).await?;
    let (chunk, size) = (chunk.clone(), chunk.size);
    let opened = tokio::task::spawn_blocking(move || match &chunk.opening {
        Opening::Plain => Ok((bytes, None)),
        Opening::Unpack(compression) => unpack(compression, bytes, size),
        Opening::Chunk => Block::open(&bytes, chunk.offset).map(|block| (block.bytes, None)),
    });
    let opened = opened.await;
    let opened = opened.map_err(|error| Fault::bug(error.to_string()))?;
    // The size is what the scan got out of the chunk, whatever the chunk claims.
    match opened {
        Ok((bytes, None)) => Ok(bytes),
        Ok((bytes, Some(_))) if bytes.len() as u64 == size => Ok(bytes),
        Ok((_, Some((reason, detail)))) | Err((reason, detail)) => {
            Err(at(Fault::data(format!("{reason}: {detail}"))))
        }
    }
}

fn outside() -> Fault {
    Fault::data("expected an image inside its chunk, found none there")
}

/// Whether bytes are base64, as images of JSON messages are. A reference does not say so, but an encoded image never
/// consists of letters only; of a raw one the log says how such messages are encoded. Where it has both, a raw one has the
/// size that its rows need.
fn is_base64(bytes: &Bytes, image: &ImageRef, part: &LogPart) -> bool {
    let letter = |byte: &u8| byte.is_ascii_alphanumeric() || matches!(byte, b'+' | b'/' | b'=');
    if !bytes.iter().take(64).all(letter) {
        return false;
    }
    let (Some(height), Some(step)) = (image.height, image.step) else {
        return true;
    };
    has_raw_images(part, true)
        && (!has_raw_images(part, false)
            || u64::from(height) * u64::from(step) != image.length && bytes.iter().all(letter))
}

/// Whether a log has channels whose messages may be raw images, in JSON or in another encoding.
fn has_raw_images(part: &LogPart, in_json: bool) -> bool {
    let mut channels = part.index.channels.values();
    channels.any(|channel| {
        let known = || part.message_type(channel.id)?.as_ref().ok();
        let has = |known: &MessageType, name| known.fields().find(name).is_some();
        (channel.message_encoding == "json") == in_json
            && known().is_some_and(|known| has(known, "encoding") && has(known, IMAGE_MEMBER))
    })
}
