//! Arguments of `versions`, `diff`, `gc` and `verify`.

use clap::Args;

use crate::arguments::MapArgs;
use crate::output::Format;

/// Arguments of `versions`.
#[derive(Debug, Args)]
pub struct VersionsArgs {
    /// Folder or URL of the map.
    #[arg(long, value_name = "DIR")]
    pub map: String,
    /// How the list is written.
    #[arg(long, default_value = "table")]
    pub format: Format,
}

/// Arguments of `diff`.
#[derive(Debug, Args)]
pub struct DiffArgs {
    /// The earlier version.
    pub before: u64,
    /// The later version.
    pub after: u64,
    /// Only this layer [default: each].
    #[arg(long, value_name = "NAME")]
    pub layer: Option<String>,
    /// Folder or URL of the map.
    #[arg(long, value_name = "DIR")]
    pub map: String,
    /// How the list is written.
    #[arg(long, default_value = "table")]
    pub format: Format,
}

/// Arguments of `gc`.
#[derive(Debug, Args)]
pub struct GcArgs {
    /// Folder or URL of the map. Beside a run nothing is removed.
    #[arg(long, value_name = "DIR")]
    pub map: String,
    /// Newest versions to keep.
    #[arg(long, value_name = "N")]
    pub keep: usize,
    /// Only say what would be removed.
    #[arg(long)]
    pub dry_run: bool,
}

/// Arguments of `verify`.
#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// The map; without a version, all of it.
    #[command(flatten)]
    pub map: MapArgs,
    /// How the findings are written.
    #[arg(long, default_value = "table")]
    pub format: Format,
}
