//! `evermap export`.

use crate::arguments::ExportArgs;
use crate::ending::{DONE, Ending};
use crate::export::export as write;
use crate::reader::MapReader;

/// Writes a layer in the format of another program.
///
/// # Errors
/// As [`crate::export::export`].
pub async fn export(args: &ExportArgs) -> Ending {
    let reader = MapReader::open(&args.map.map, args.map.version).await?;
    write(
        &reader,
        args.layer.as_deref(),
        &args.selection,
        args.format,
        &args.out,
    )
    .await?;
    DONE
}
