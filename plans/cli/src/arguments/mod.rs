//! The command line, as clap reads it.

mod annotate;
#[cfg(feature = "cluster")]
mod cluster;
mod render;
mod serve;
mod sql;
mod versions;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::export::{ExportFormat, Selection};
use crate::output::Format;
use crate::progress::Show;
use crate::quantity;

pub use annotate::AnnotateArgs;
#[cfg(feature = "cluster")]
pub use cluster::{ExecutorArgs, SchedulerArgs};
pub use render::{RenderArgs, ReportArgs, Shown};
pub use serve::{HTTP, ServeArgs};
pub use sql::{FunctionsArgs, SqlArgs};
pub use versions::{DiffArgs, GcArgs, VerifyArgs, VersionsArgs};

/// The memory that a program takes where nobody says it: that of `Limits::default`.
const MEMORY: &str = "4GiB";

const EXITS: &str = "Exit status: 0 done, 1 failed, 2 wrong usage, 3 done with loss (skipped or lost inputs are counted on \
                     stderr). Results go to stdout, everything else to stderr. EVERMAP_LOG=info,evermap=debug logs more.";

/// Turns robot logs into maps that get better with every drive.
#[derive(Debug, Parser)]
#[command(name = "evermap", version, after_help = EXITS, max_term_width = 100)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a plan on sessions; publish a new version of the map.
    Run(RunArgs),
    /// Check a plan: all faults at once.
    Check(PlanArgs),
    /// Run the tests that a plan carries.
    Test(PlanArgs),
    /// Show a plan as it is composed, or, on a map, what a run would recompute, and why.
    Explain(ExplainArgs),
    /// Print the JSON Schema of plans or session manifests, for editors.
    Schema {
        /// What is described.
        #[arg(default_value = "plan")]
        of: SchemaKind,
    },
    /// Query a map or logs with SQL.
    Sql(SqlArgs),
    /// List the functions that queries have beyond those of SQL, with examples.
    Functions(FunctionsArgs),
    /// Say what an MCAP file holds, and whether it is sound.
    Inspect(InspectArgs),
    /// List the operators, or print the page of one.
    Operators(OperatorsArgs),
    /// List the layers of a map.
    Layers(LayersArgs),
    /// List the versions of a map.
    Versions(VersionsArgs),
    /// Compare two versions of a map, layer by layer.
    Diff(DiffArgs),
    /// Forget old versions of a map, every file that only they need, and the records of their runs.
    Gc(GcArgs),
    /// Read all of a map, and say what is missing, damaged or left over.
    Verify(VerifyArgs),
    /// Write a layer in the format of another program.
    Export(ExportArgs),
    /// Say what is where in a map, as a log of annotations; or write what was said.
    Annotate(AnnotateArgs),
    /// Draw a map.
    Render(RenderArgs),
    /// Write one self-contained HTML page about a map.
    Report(ReportArgs),
    /// Serve maps: a page, HTTP, Flight SQL, and the protocol of Postgres.
    Serve(ServeArgs),
    /// Write a simulated world as MCAP, with its exact truth.
    Simulate(SimulateArgs),
    /// Turn other recordings into MCAP.
    #[command(subcommand)]
    Import(ImportArgs),
    /// Serve as the scheduler of a cluster.
    #[cfg(feature = "cluster")]
    Scheduler(SchedulerArgs),
    /// Serve as an executor of a cluster.
    #[cfg(feature = "cluster")]
    Executor(ExecutorArgs),
    /// Print the completion script of a shell.
    Completions {
        /// Shell.
        shell: clap_complete::Shell,
    },
}

/// Which sessions.
#[derive(Debug, Clone, Default, Args)]
pub struct SessionArgs {
    /// MCAP files, folders, patterns or URLs, one session each.
    #[arg(long, num_args = 1.., value_name = "GLOB")]
    pub sessions: Vec<String>,
    /// Session manifest (YAML): files, sites, and which topic plays which role.
    #[arg(long, value_name = "FILE")]
    pub manifest: Option<String>,
    /// Site of the sessions; those of one site make one map.
    #[arg(long, value_name = "NAME")]
    pub site: Option<String>,
}

/// What the program may use.
#[derive(Debug, Args)]
pub struct LimitArgs {
    /// Units that run side by side [default: one a core, and one for 256 MiB of memory].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub jobs: Option<u32>,
    /// Memory for sorts, joins and decoded chunks, all units together.
    #[arg(long, value_name = "BYTES", default_value = MEMORY, value_parser = quantity::bytes)]
    pub memory: usize,
}

/// A plan and its sessions: arguments of `check` and `test`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// Plan file, `-` for standard input, or the name of a plan that ships (car_park, trajectory).
    pub plan: String,
    /// Parameter of a step, in place of the plan's; or a preset of the plan, such as `preview`.
    #[arg(long, value_name = "STEP.PARAM=VALUE | PRESET")]
    pub set: Vec<String>,
    /// Sessions; on a map, those that join it.
    #[command(flatten)]
    pub sessions: SessionArgs,
}

/// Arguments of `run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// What is run.
    #[command(flatten)]
    pub input: PlanArgs,
    /// Folder or URL of the map; made where there is none.
    #[arg(long, value_name = "DIR")]
    pub map: String,
    /// Let a log take the place of another one of the same name that the map has.
    #[arg(long)]
    pub replace: bool,
    /// How progress is shown.
    #[arg(long, default_value = "auto")]
    pub progress: Show,
    /// Scheduler of a cluster that runs the units.
    #[cfg(feature = "cluster")]
    #[arg(long, value_name = "URL")]
    pub cluster: Option<String>,
    /// Give up when no unit has ended on the cluster for so many seconds: more than the longest takes.
    #[cfg(feature = "cluster")]
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 600,
        requires = "cluster"
    )]
    pub deadline_s: u64,
    /// What the program may use.
    #[command(flatten)]
    pub limits: LimitArgs,
}

/// Arguments of `explain`.
#[derive(Debug, Args)]
pub struct ExplainArgs {
    /// What is explained.
    #[command(flatten)]
    pub input: PlanArgs,
    /// Folder or URL of the map; without one, the plan is shown as it is composed.
    #[arg(long, value_name = "DIR")]
    pub map: Option<String>,
    /// Say where the time and the bytes went when the plan was last run on the map.
    #[arg(long, requires = "map")]
    pub analyze: bool,
    /// How it is written.
    #[arg(long, default_value = "table")]
    pub format: Format,
}

/// Arguments of `inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// MCAP file or URL; with --manifest, any number of files, folders and patterns.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// Print a session manifest, ready to edit, instead.
    #[arg(long, conflicts_with_all = ["json", "quick"])]
    pub manifest: bool,
    /// Read only the index; damage inside chunks is not found.
    #[arg(long)]
    pub quick: bool,
}

/// What has a JSON Schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SchemaKind {
    /// Plans.
    Plan,
    /// Session manifests.
    Manifest,
}

/// Arguments of `operators`.
#[derive(Debug, Args)]
pub struct OperatorsArgs {
    /// Operator whose page is printed.
    pub name: Option<String>,
    /// How the list is written.
    #[arg(long, default_value = "table")]
    pub format: Format,
}

/// A map at a version.
#[derive(Debug, Args)]
pub struct MapArgs {
    /// Folder or URL of the map.
    #[arg(long, value_name = "DIR")]
    pub map: String,
    /// Version of the map [default: the newest].
    #[arg(long, value_name = "N")]
    pub version: Option<u64>,
}

/// Arguments of `layers`.
#[derive(Debug, Args)]
pub struct LayersArgs {
    /// Layer whose columns are listed, with types, units, frames and meanings.
    #[arg(conflicts_with_all = ["files", "duckdb"])]
    pub layer: Option<String>,
    /// The map.
    #[command(flatten)]
    pub map: MapArgs,
    /// How the list is written.
    #[arg(long, default_value = "table")]
    pub format: Format,
    /// List the Parquet files of each layer instead, for other programs.
    #[arg(long)]
    pub files: bool,
    /// Print DuckDB's views of the layers instead: `evermap layers --map M --duckdb > map.sql; duckdb -init map.sql`.
    #[arg(long, conflicts_with = "files")]
    pub duckdb: bool,
}

/// Arguments of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Layer; none for mcap, which is of the whole map.
    pub layer: Option<String>,
    /// The map.
    #[command(flatten)]
    pub map: MapArgs,
    /// What it becomes.
    #[arg(long)]
    pub format: ExportFormat,
    /// File to write.
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// What is exported.
    #[command(flatten)]
    pub selection: Selection,
}

/// Arguments of `simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// World.
    #[arg(value_parser = ["car_park", "street"])]
    pub world: String,
    /// Folder to write sessions and truth to.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Everything random is drawn from this number.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Sessions after the initial one, of `car_park`.
    #[arg(long, value_name = "N")]
    pub revisits: Option<usize>,
    /// Sessions, of `street`.
    #[arg(long, value_name = "N", conflicts_with = "revisits")]
    pub visits: Option<usize>,
    /// Any other parameter of the world: `width_px=640`, `loops=1`, `length_m=500`.
    #[arg(long, value_name = "PARAM=VALUE")]
    pub set: Vec<String>,
    /// How progress is shown.
    #[arg(long, default_value = "auto")]
    pub progress: Show,
}

/// What `import` reads.
#[derive(Debug, Subcommand)]
pub enum ImportArgs {
    /// Images of any rig, by a description (YAML) of cameras, calibrations and poses.
    Images {
        /// The description; `datasets/imports` has one to learn from.
        description: PathBuf,
        /// Folder that the description's paths are relative to [default: its own].
        #[arg(long, value_name = "DIR")]
        folder: Option<PathBuf>,
        /// MCAP file to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// A KITTI odometry sequence: poses, images of the left grey camera, or both.
    Kitti {
        /// Poses, twelve numbers a line.
        #[arg(long, value_name = "FILE")]
        poses: Option<PathBuf>,
        /// Stamps, seconds, one a line [default: ten a second].
        #[arg(long, value_name = "FILE")]
        times: Option<PathBuf>,
        /// Folder of images.
        #[arg(long, value_name = "DIR", requires = "calibration")]
        images: Option<PathBuf>,
        /// `calib.txt`, or a file with the nine numbers of K.
        #[arg(long, value_name = "FILE")]
        calibration: Option<PathBuf>,
        /// MCAP file to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Bags of ROS 1 or ROS 2: says what to do instead.
    Rosbag {
        /// Bags.
        files: Vec<String>,
    },
}

#[cfg(test)]
mod tests;
