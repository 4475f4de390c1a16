//! Images in chunks that are too large to be opened: such a chunk is gone through, from front to back, and only its
//! images are kept. Who asks for them in the order of the file goes through it once.

use std::collections::BTreeMap;
use std::io;
use std::sync::Mutex;

use bytes::Bytes;
use datafusion::common::runtime::SpawnedTask;
use evermap_schemas::{Fault, ImageRef};

use super::{ChunkRef, ImageReader, Opening, held, outside};
use crate::log::walk::{Feed, Walk, fed, joined};

/// Chunks that may be half gone through: two for each of two partitions that read side by side.
const WAITING: usize = 4;

/// Chunks that are half gone through, the one that has waited longest first.
#[derive(Default)]
pub(super) struct Walks(Mutex<Vec<Going>>);

impl std::fmt::Debug for Walks {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Walks")
    }
}

struct Going {
    chunk: ChunkRef,
    walk: Walk<'static>,
    feed: Feed,
}

impl Walks {
    /// The one in this chunk that is next to a byte, and not behind it.
    fn take(&self, chunk: &ChunkRef, before: u64) -> Option<Going> {
        let mut walks = held(&self.0);
        let here = |going: &Going| going.chunk == *chunk && going.walk.position() <= before;
        let found = walks.iter().enumerate().filter(|(_, going)| here(going));
        let (nearest, _) = found.max_by_key(|(_, going)| going.walk.position())?;
        Some(walks.remove(nearest))
    }

    fn keep(&self, going: Going) {
        let mut walks = held(&self.0);
        walks.push(going);
        if walks.len() > WAITING {
            walks.remove(0);
        }
    }
}

/// Bytes of a chunk, from one to before another, and the images that lie there.
type ImageRanges = BTreeMap<(u64, u64), Vec<usize>>;

/// The bytes of an image, by its number.
type ImageBytes = Vec<(usize, Result<Bytes, Fault>)>;

impl ImageReader {
    /// The images of a compressed chunk whose numbers these are.
    pub(super) async fn large(
        &self,
        chunk: &ChunkRef,
        images: &[ImageRef],
        indexes: &[usize],
    ) -> Result<ImageBytes, Fault> {
        let mut wanted = ImageRanges::new();
        for index in indexes {
            let image = &images[*index];
            let end = image.offset.saturating_add(image.length);
            wanted.entry((image.offset, end)).or_default().push(*index);
        }
        let first = wanted.keys().next().map_or(0, |(start, _)| *start);
        let going = match self.walks.take(chunk, first) {
            Some(going) => Ok(going),
            None => self.begin(chunk)?,
        };
        let mut going = match going {
            Ok(going) => going,
            Err(fault) => return Ok(indexes.iter().map(|at| (*at, Err(fault.clone()))).collect()),
        };
        let task = SpawnedTask::spawn_blocking(move || {
            let found = collect(&mut going.walk, wanted);
            (going, found)
        });
        let (going, found) = joined(task).await?;
        if found.iter().all(|(_, image)| image.is_ok()) {
            self.walks.keep(going);
        } else {
            // To whoever goes through it, a chunk ends where the store fails.
            let Going { walk, feed, .. } = going;
            drop(walk);
            joined(feed).await.flatten()?;
        }
        let encoded = |(index, image): (usize, Result<Bytes, Fault>)| {
            (
                index,
                image.and_then(|bytes| self.encoded(bytes, &images[index])),
            )
        };
        Ok(found.into_iter().map(encoded).collect())
    }

    /// Begins to go through a chunk; inside, why it cannot be.
    fn begin(&self, chunk: &ChunkRef) -> Result<Result<Going, Fault>, Fault> {
        let part = self.part(&chunk.session, chunk.part)?;
        let end = chunk.offset.saturating_add(chunk.length);
        let Opening::Unpack(compression) = &chunk.opening else {
            return Ok(Err(outside()));
        };
        if end > part.meta.size {
            return Ok(Err(outside()));
        }
        let (pieces, feed) = fed(&part.store, &part.meta, chunk.offset..end);
        let walk = Walk::new(compression, chunk.size, pieces);
        let walk = walk.map_err(|(reason, detail)| Fault::data(format!("{reason}: {detail}")));
        Ok(walk.map(|walk| Going {
            chunk: chunk.clone(),
            walk,
            feed,
        }))
    }
}

fn collect(walk: &mut Walk<'_>, wanted: ImageRanges) -> ImageBytes {
    let mut found = Vec::new();
    for ((start, end), indexes) in wanted {
        let bytes = bytes_at(walk, start, end);
        found.extend(indexes.into_iter().map(|index| (index, bytes.clone())));
    }
    found
}

fn bytes_at(walk: &mut Walk<'_>, start: u64, end: u64) -> Result<Bytes, Fault> {
    let failed = |error: io::Error| Fault::data(error.to_string());
    let mut bytes = Vec::new();
    let before = start.checked_sub(walk.position()).ok_or_else(outside)?;
    let skipped = walk.skip(before).map_err(failed)?;
    let taken = walk.take(end - start, &mut bytes).map_err(failed)?;
    match (skipped, taken) == (before, end - start) {
        true => Ok(bytes.into()),
        false => Err(outside()),
    }
}
