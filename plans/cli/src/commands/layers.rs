//! `evermap layers` and `evermap versions`.

use evermap_engine::map::store::Store;
use evermap_engine::map::{Map, versions as versions_of};

use crate::arguments::{LayersArgs, MapArgs, VersionsArgs};
use crate::ending::{DONE, Ending, Failure};
use crate::output::{Format, print_rows};

/// Digits of a digest that a person is shown.
pub const SHORT_DIGEST: usize = 12;

/// Opens a map at the version asked for.
///
/// # Errors
/// A user fault where there is no such map or version.
pub async fn open(args: &MapArgs) -> Result<Map, Failure> {
    Ok(Map::open(&args.map, args.version).await?)
}

/// Lists the layers of a map.
///
/// # Errors
/// A user fault where there is no such map or version.
pub async fn layers(args: &LayersArgs) -> Ending {
    print_layers(&open(&args.map).await?, args.format).await?;
    DONE
}

/// Prints the layers of a map; in a table for people digests are short.
///
/// # Errors
/// That the output is closed.
pub async fn print_layers(map: &Map, format: Format) -> Result<(), Failure> {
    let mut layers = map.layers();
    if format == Format::Table {
        layers
            .iter_mut()
            .for_each(|layer| layer.digest.truncate(SHORT_DIGEST));
    }
    print_rows(format, layers).await
}

/// Lists the versions of a map.
///
/// # Errors
/// A user fault where there is no such map.
pub async fn versions(args: &VersionsArgs) -> Ending {
    let store = Store::open(&args.map, false)?;
    print_rows(args.format, versions_of(&store).await?).await?;
    DONE
}
