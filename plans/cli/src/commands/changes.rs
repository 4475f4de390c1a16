//! `evermap diff` and `evermap gc`.

use std::io::Write;

use evermap_engine::map;
use evermap_engine::map::store::Store;
use evermap_engine::map::version::Version;

use crate::arguments::{DiffArgs, GcArgs};
use crate::ending::{DONE, Ending};
use crate::output::print_rows;
use crate::quantity::{of, of_bytes};

/// Compares two versions.
///
/// # Errors
/// A user fault where there is no such map or version.
pub async fn diff(args: &DiffArgs) -> Ending {
    let store = Store::open(&args.map, false)?;
    let (before, after) = (
        Version::read(&store, args.before).await?,
        Version::read(&store, args.after).await?,
    );
    let diffs = map::diff(&store, &before, &after, &evermap_catalog::registry()).await?;
    print_rows(args.format, diffs).await?;
    DONE
}

/// Forgets old versions.
///
/// # Errors
/// A user fault where there is no such map, a resource fault when files cannot be removed.
pub async fn gc(args: &GcArgs) -> Ending {
    let store = Store::open(&args.map, false)?;
    let found = map::gc(&store, args.keep, args.dry_run).await?;
    let verb = if args.dry_run {
        "would remove"
    } else {
        "removed"
    };
    let (versions, files) = (of(found.versions, "version"), of(found.files, "file"));
    writeln!(
        std::io::stdout(),
        "{verb} {versions}, {files}, {}",
        of_bytes(found.bytes)
    )?;
    DONE
}
