//! `evermap report`.

use crate::arguments::ReportArgs;
use crate::commands::layers::open;
use crate::ending::{DONE, Ending};
use crate::output::write_file;
use crate::report::{gather, page};

/// Writes one self-contained page about a map.
///
/// # Errors
/// A user fault where there is no such map or version.
pub async fn report(args: &ReportArgs) -> Ending {
    let map = open(&args.map).await?;
    let facts = gather(&map, &evermap_catalog::registry(), args.site.as_deref()).await?;
    write_file(&args.out, page(&facts).as_bytes())?;
    DONE
}
