//! A log record by record, for those who want to see the file itself.

use std::sync::Arc;

use evermap_schemas::Fault;
use mcap::records::{Record, op};
use object_store::{ObjectMeta, ObjectStore};

use crate::log::chunk::Block;
use crate::log::record::{FRAME, MAGIC, frame, parse};
use crate::log::window::Window;

/// A record, and where it stands.
#[derive(Debug)]
pub struct RecordAt<'a> {
    /// Offset in the file of the record, or of the chunk that holds it.
    pub offset: u64,
    /// Whether it stands inside a chunk.
    pub in_chunk: bool,
    /// The record, or why it cannot be parsed.
    pub record: Result<Record<'a>, String>,
}

/// Visits every record of a file in order, those of a chunk after the chunk itself, up to the end of the file or the
/// first record that is not complete. Returns the number of bytes behind the last complete record; 8, the closing
/// magic, in a file that is whole.
///
/// # Errors
/// A resource fault when the store fails.
pub async fn each_record(
    store: &Arc<dyn ObjectStore>,
    meta: &ObjectMeta,
    mut visit: impl FnMut(RecordAt<'_>),
) -> Result<u64, Fault> {
    let mut window = Window::new(store.clone(), meta.location.clone(), meta.size);
    let mut offset = MAGIC.len() as u64;
    while let Some(head) = window.get(offset, FRAME).await? {
        let Some((opcode, length)) = frame(&head).filter(|(opcode, _)| *opcode != 0) else {
            break;
        };
        let Some(size) = length.checked_add(FRAME) else {
            break;
        };
        let Some(bytes) = window.get(offset, size).await? else {
            break;
        };
        visit(RecordAt {
            offset,
            in_chunk: false,
            record: parse(opcode, &bytes[FRAME as usize..]),
        });
        if opcode == op::CHUNK {
            match Block::open(&bytes, offset) {
                Ok(block) => block.records().for_each(|(opcode, _, body)| {
                    visit(RecordAt {
                        offset,
                        in_chunk: true,
                        record: parse(opcode, body),
                    });
                }),
                Err((reason, detail)) => visit(RecordAt {
                    offset,
                    in_chunk: true,
                    record: Err(format!("{reason}: {detail}")),
                }),
            }
        }
        offset += size;
    }
    Ok(meta.size.saturating_sub(offset))
}
