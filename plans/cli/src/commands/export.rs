//! `evermap export`.

use crate::arguments::ExportArgs;
use crate::commands::layers::open;
use crate::ending::{DONE, Ending};
use crate::export::{Selection, export as write};

/// Writes a layer in the format of another program.
///
/// # Errors
/// As [`crate::export::export`].
pub async fn export(args: &ExportArgs) -> Ending {
    let map = open(&args.map).await?;
    let selection = Selection {
        session: args.session.clone(),
        site: args.site.clone(),
        zoom: args.zoom,
    };
    write(
        &map,
        &evermap_catalog::registry(),
        &args.layer,
        &selection,
        args.format,
        &args.out,
    )
    .await?;
    DONE
}
