//! `evermap diff` and `evermap gc`.

use std::io::Write;

use evermap_engine::map;
use evermap_engine::map::store::Store;
use evermap_engine::map::version::Version;
use evermap_schemas::{LayerRow, record};

use crate::arguments::{DiffArgs, GcArgs};
use crate::ending::{DONE, Ending};
use crate::output::print_rows;
use crate::quantity::{of, of_bytes};

record! {
    /// What became of one layer between two versions.
    pub struct Change {
        /// Layer.
        layer: String,
        /// Rows whose key is new.
        added: u64,
        /// Rows whose key is gone.
        removed: u64,
        /// Rows whose key is in both, with other content.
        changed: u64,
        /// Rows that are the same.
        same: u64,
    }
}
impl LayerRow for Change {
    const NAME: &'static str = "changes";
    const DOC: &'static str = "What became of one layer between two versions.";
    const KEY: &'static [&'static str] = &["layer"];
}

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
    let rows = diffs.into_iter().map(|diff| Change {
        layer: diff.layer,
        added: diff.added,
        removed: diff.removed,
        changed: diff.changed,
        same: diff.same,
    });
    print_rows(args.format, rows.collect()).await?;
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
