//! Containers: MCAP files, and their summaries alone.

use std::cell::LazyCell;
use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use evermap_datasets::log::chunk::Block;
use evermap_datasets::log::index::{LogIndex, UnitKind};
use evermap_datasets::log::record::MAGIC;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use tokio::runtime::{Builder, Runtime};

/// Bytes of the largest chunk that is opened: a larger one takes time and shows nothing else.
const CHUNK_BYTES: u64 = 1 << 20;

thread_local! {
    #[allow(clippy::expect_used)]
    static RUNTIME: LazyCell<Runtime> =
        LazyCell::new(|| Builder::new_current_thread().build().expect("a runtime starts"));
}

/// A file: its index, and all that lies where the index says.
pub fn logs(bytes: &[u8]) {
    let bytes = Bytes::copy_from_slice(bytes);
    let Some(index) = RUNTIME.with(|runtime| runtime.block_on(index(bytes.clone()))) else {
        return;
    };
    assert!(index.fits(bytes.len() as u64), "{index:?}");
    for unit in &index.units {
        let Some(range) = range(unit.offset, unit.end()).filter(|_| unit.size <= CHUNK_BYTES)
        else {
            continue;
        };
        let bytes = bytes.slice(range);
        let block = match unit.kind {
            UnitKind::Chunk => Block::open(&bytes, unit.offset),
            _ => Ok(Block::loose(bytes, unit.offset)),
        };
        if let Ok(block) = block {
            for message in &block.contents(|_| true).messages {
                let _ = block.unpack(message);
            }
        }
    }
}

fn range(start: u64, end: u64) -> Option<Range<usize>> {
    Some(usize::try_from(start).ok()?..usize::try_from(end).ok()?)
}

async fn index(bytes: Bytes) -> Option<LogIndex> {
    let store: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
    let path = Path::from("log.mcap");
    store.put(&path, bytes.into()).await.ok()?;
    let meta = store.head(&path).await.ok()?;
    LogIndex::read(&store, &meta).await.ok()
}

/// The records of a file behind their length (two bytes), then its summary: a file whose footer has no checksum.
pub fn summaries(bytes: &[u8]) {
    let Some((records, summary)) = crate::counted(bytes) else {
        return;
    };
    let start = (MAGIC.len() + records.len()) as u64;
    let footer = [
        &[2][..],
        &20_u64.to_le_bytes(),
        &start.to_le_bytes(),
        &[0; 12],
    ];
    logs(&[MAGIC, records, summary, &footer.concat(), MAGIC].concat());
}
