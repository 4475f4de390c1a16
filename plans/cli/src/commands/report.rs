//! `evermap report`.

use crate::arguments::ReportArgs;
use crate::ending::{DONE, Ending};
use crate::output::write_file;
use crate::reader::MapReader;
use crate::report::gather;

/// Writes one self-contained page about a map.
///
/// # Errors
/// A user fault where there is no such map or version.
pub async fn report(args: &ReportArgs) -> Ending {
    let reader = MapReader::open(&args.map.map, args.map.version).await?;
    let facts = gather(&reader, args.site.as_deref()).await?;
    write_file(&args.out, facts.to_string().as_bytes())?;
    DONE
}
