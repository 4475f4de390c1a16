//! Rows with the pixels of an image each, worked on side by side.

use arrow::array::{Array, AsArray, BinaryArray, RecordBatch};
use evermap_contract::{Emit, Fault};
use evermap_schemas::{LayerRow, Record, rows};
use rayon::prelude::*;

use super::rig::Reason;

/// The encoded images of a batch, in its column `image`; null where one could not be fetched.
pub(crate) fn images<'a>(batch: &'a RecordBatch, port: &str) -> Result<&'a BinaryArray, Fault> {
    batch
        .column_by_name("image")
        .and_then(|column| column.as_binary_opt::<i32>())
        .ok_or_else(|| Fault::bug(format!("port {port} comes without its pixels")))
}

/// Makes a row of each row and its image, and emits them in order; what cannot be made is counted by reason. `S` is
/// room for decoding, used again for the next image.
pub(crate) fn each_image<T, S, R>(
    batch: &RecordBatch,
    port: &str,
    emit: &mut Emit<'_>,
    make: impl Fn(T, &[u8], &mut S) -> Result<R, Reason> + Sync,
) -> Result<(), Fault>
where
    T: Record + Send,
    S: Default,
    R: LayerRow + Send,
{
    let images = images(batch, port)?;
    let given: Vec<_> = rows::<T>(batch)?.into_iter().enumerate().collect();
    let made: Vec<Result<R, Reason>> = given
        .into_par_iter()
        .map_init(S::default, |room, (index, row)| {
            if images.is_null(index) {
                return Err("image is missing");
            }
            make(row, images.value(index), room)
        })
        .collect();
    let mut kept = Vec::with_capacity(made.len());
    for row in made {
        match row {
            Ok(row) => kept.push(row),
            Err(reason) => emit.skip(reason, 1),
        }
    }
    emit.rows(kept)
}
