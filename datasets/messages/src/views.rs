//! Binary columns: views into the blocks that payloads lie in, where those may be kept, else into bytes of their own.

use crate::DecodeError;
use crate::buffers::{Pool, offset};
use arrow::array::{MAX_INLINE_VIEW_LEN, make_view};
use arrow::buffer::Buffer;
use bytes::Bytes;

/// Binary values of this many bytes and more are views into the block that they came from, where that may be kept; a
/// shorter one is copied, which costs less than to keep account of it.
const SHARED: usize = 1 << 10;

/// Views of a binary column, and the bytes of those that are its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Views {
    pub(crate) views: usize,
    pub(crate) data: usize,
}

/// Bytes of one view.
pub(crate) const VIEW: usize = size_of::<u128>();

/// Blocks of payloads that values of the batch are views into.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    /// Where the current payload lies, if its values may keep it.
    source: Option<Bytes>,
    /// Whether the source is the last of the blocks.
    listed: bool,
    pub(crate) blocks: Vec<Buffer>,
    /// Bytes of the values.
    pub(crate) bytes: usize,
}

impl Shared {
    fn set_source(&mut self, source: Option<&Bytes>) {
        let place = |bytes: &Bytes| (bytes.as_ptr(), bytes.len());
        if self.source.as_ref().map(place) != source.map(place) {
            self.source = source.cloned();
            self.listed = false;
        }
    }

    /// Block and offset of bytes that lie in the source, and are worth a view.
    fn place(&mut self, bytes: &[u8]) -> Option<(u32, u32)> {
        let source = self.source.as_ref().filter(|_| bytes.len() >= SHARED)?;
        let start = (bytes.as_ptr() as usize).checked_sub(source.as_ptr() as usize)?;
        if start.checked_add(bytes.len())? > source.len() {
            return None;
        }
        let start = u32::try_from(start).ok()?;
        if !self.listed {
            self.blocks.push(Buffer::from(source.clone()));
            self.listed = true;
        }
        self.bytes += bytes.len();
        // The first buffer of a column is its own.
        Some((u32::try_from(self.blocks.len()).ok()?, start))
    }

    /// A new batch begins.
    fn clear(&mut self) {
        self.listed = false;
        self.blocks.clear();
        self.bytes = 0;
    }
}

impl Pool {
    /// Appends `bytes` as one value of a BinaryView column.
    pub(crate) fn append_view(&mut self, to: Views, bytes: &[u8]) -> Result<(), DecodeError> {
        let (block, start) = match self.shared.place(bytes) {
            Some(place) => place,
            None => {
                let start = offset(self.buffers[to.data].len())?;
                offset(bytes.len())?;
                // Shorter values stand in their view.
                if bytes.len() > MAX_INLINE_VIEW_LEN as usize {
                    self.buffers[to.data].extend_from_slice(bytes);
                }
                (0, start as u32)
            }
        };
        let view = make_view(bytes, block, start).to_ne_bytes();
        self.buffers[to.views].extend_from_slice(&view);
        Ok(())
    }

    /// Says where the next payload lies, if values may keep the whole of that.
    pub(crate) fn set_source(&mut self, source: Option<&Bytes>) {
        self.shared.set_source(source);
    }

    /// A new batch begins.
    pub(crate) fn clear_shared(&mut self) {
        self.shared.clear();
    }
}
