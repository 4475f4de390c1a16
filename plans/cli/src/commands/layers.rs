//! `evermap layers` and `evermap versions`.

use std::collections::BTreeMap;
use std::io::Write;

use evermap_engine::map::store::Store;
use evermap_engine::map::tables::Tables;
use evermap_engine::map::{LayerFile, Map, versions as versions_of};
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};

use crate::arguments::{LayersArgs, VersionsArgs};
use crate::ending::{DONE, Ending, Failure, Lost};
use crate::operators;
use crate::output::{Format, print_rows};
use crate::quantity::short_digest;

/// Lists the layers of a map, or the columns of one; what is missing or damaged counts as lost.
///
/// # Errors
/// A user fault where there is no such map or version.
pub async fn layers(args: &LayersArgs) -> Ending {
    let map = Map::open(&args.map.map, args.map.version).await?;
    match (args.files, args.duckdb, &args.layer) {
        (_, _, Some(layer)) => {
            let context = context(Limits::default())?;
            let tables = Tables::new(map.clone(), &context, &operators::registry());
            print_rows(args.format, tables.columns_of(layer).await?).await?;
        }
        (true, _, _) => print_rows(args.format, map.files()?).await?,
        (_, true, _) => std::io::stdout().write_all(duckdb_views(&map.files()?).as_bytes())?,
        _ => print_layers(&map, args.format).await?,
    }
    let damages = map.damages().await?.into_iter();
    Ok(Lost(
        damages.map(|damage| (damage.to_string(), 1)).collect(),
    ))
}

/// Statements that make a view of each layer.
fn duckdb_views(files: &[LayerFile]) -> String {
    let mut layers: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for file in files {
        let files = layers.entry(&file.layer).or_default();
        files.push(quoted::text(&file.file));
    }
    let view = |(layer, files): (&str, Vec<String>)| {
        let files = files.join(",\n  ");
        format!(
            "CREATE OR REPLACE VIEW \"{layer}\" AS SELECT * FROM read_parquet([\n  {files}]);\n"
        )
    };
    layers.into_iter().map(view).collect()
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
