//! `evermap layers` and `evermap versions`.

use evermap_engine::map::store::Store;
use evermap_engine::map::{Map, versions as versions_of};

use crate::arguments::{LayersArgs, VersionsArgs};
use crate::ending::{DONE, Ending, Failure};
use crate::output::{Format, print_rows};
use crate::quantity::short_digest;

/// Lists the layers of a map.
///
/// # Errors
/// A user fault where there is no such map or version.
pub async fn layers(args: &LayersArgs) -> Ending {
    let map = Map::open(&args.map.map, args.map.version).await?;
    print_layers(&map, args.format).await?;
    DONE
}

/// Prints the layers of a map; in a table for people digests are short.
///
/// # Errors
/// That the output is closed.
pub async fn print_layers(map: &Map, format: Format) -> Result<(), Failure> {
    let mut layers = map.layers();
    if format == Format::Table {
        for layer in &mut layers {
            layer.digest = short_digest(&layer.digest);
        }
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
