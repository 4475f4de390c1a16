//! The command line.
//!
//! ```text
//!   arguments ──► commands ──► engine, datasets, worlds, catalog
//!                    │
//!                    ├──► output    rows as table, CSV, JSON, Parquet
//!                    ├──► annotate  labels of other programs, as logs of annotations
//!                    ├──► reader    rows of a map by what they are
//!                    │      ├──► draw, report   pictures and the page, as `templates` lay them out
//!                    │      └──► export         other programs' formats, on earth by `earth`
//!                    ├──► serve     the same rows, pictures and formats by network
//!                    └──► ending    exit status, losses, faults
//! ```
//! Only this crate knows which operators there are (`operators`); the engine is handed the registry. A program with
//! operators of its own calls [`main_with`].

pub mod annotate;
pub mod arguments;
mod camera_frames;
mod camera_images;
mod clocks;
pub mod commands;
mod contents;
pub mod coordinate_frames;
mod cutout;
pub mod draw;
mod earth;
pub mod ending;
pub mod export;
mod fixes;
mod manifest;
mod masks;
pub mod metric;
mod mosaic;
mod moved;
mod odometry_frame;
mod operators;
pub mod output;
mod pictures;
mod printable;
mod progress;
mod prompt;
pub mod quantity;
mod raster;
pub mod reader;
pub mod report;
pub mod scene;
pub mod semantic;
pub mod serve;
mod sessions;
pub mod shipped;
mod shots;
pub mod shown;
mod stable;
mod standard_input;
mod stopped;
mod threads;

use std::convert::Infallible;
use std::ffi::OsString;
use std::sync::Arc;
use std::time::Duration;

use clap::Parser;
use evermap_contract::Entry;
use evermap_engine::sql::Term;
use evermap_schemas::Fault;
use tokio::runtime::Runtime;

use crate::arguments::{Arguments, Command};
use crate::commands::sql::is_prompt;
use crate::ending::{DONE, Ending, panicked, tell};
use crate::stopped::{live_with_limits, stopped, terminated};

/// Reads the command line, does what it says, and tells how it ended.
pub fn main() -> std::process::ExitCode {
    main_with([])
}

/// [`main`] of a program that has these operators beside the catalog's: they can be named in plans, and are listed and
/// run as those are.
pub fn main_with(own: impl IntoIterator<Item = Entry>) -> std::process::ExitCode {
    let arguments = Arguments::parse();
    log();
    evermap_functions::keep_guarded_panics_quiet();
    if let Err(fault) = operators::join(own) {
        return tell(&Err(fault.into()), &mut std::io::stderr()).into();
    }
    let threads = threads::runtime(&arguments.command)
        .and_then(|runtime| Ok((runtime, threads::listening()?)));
    let (runtime, listening) = match threads {
        Ok(threads) => threads,
        Err(fault) => return tell(&Err(fault.into()), &mut std::io::stderr()).into(),
    };
    let ending = listening.block_on(until_interrupted(arguments.command, &runtime));
    let code = tell(&ending, &mut std::io::stderr());
    // Kernels that still run are left behind: what they would write has no name yet.
    runtime.shutdown_background();
    code.into()
}

/// Does what a command line says, for a program that is not ours and tells how it ended itself.
///
/// # Errors
/// Why it failed; a user fault for a line that makes no sense.
pub async fn command(line: impl IntoIterator<Item = OsString>) -> Ending {
    let arguments = Arguments::try_parse_from(line);
    let arguments = arguments.map_err(|error| Fault::user(error.to_string()))?;
    let (unfinished, _all_finished) = tokio::sync::mpsc::channel::<Infallible>(1);
    commands::dispatch(&arguments.command, &unfinished).await
}

/// Runs a command on the threads of a runtime, unless the person stops it. A map changes only by the last step of a run,
/// so stopping leaves it as it was, and what was computed is found again.
async fn until_interrupted(command: Command, runtime: &Runtime) -> Ending {
    live_with_limits();
    let command = Arc::new(command);
    let own_interrupts = matches!(&*command, Command::Sql(args) if is_prompt(args));
    let asked_to_stop = async {
        match own_interrupts {
            true => terminated().await,
            false => stopped().await,
        }
    };
    let (unfinished, mut all_finished) = tokio::sync::mpsc::channel::<Infallible>(1);
    let term = Term::default();
    let mut work = runtime.spawn(term.of({
        let command = Arc::clone(&command);
        async move { commands::dispatch(&command, &unfinished).await }
    }));
    tokio::select! {
        // A library may hear the same signal and end the work: it was stopped, and has not ended by itself.
        biased;
        () = asked_to_stop => {
            term.end();
            work.abort();
            // Temporary files go when the work is dropped; a kernel that is busy is not waited for.
            let ended = tokio::time::timeout(patience(&command), work).await;
            // A run on a cluster cancels its jobs, and a query of a prompt lets its temporary files go.
            if ended.is_ok() {
                let _ = tokio::time::timeout(Duration::from_secs(5), all_finished.recv()).await;
            }
            match ended {
                // It was faster than the signal.
                Ok(Ok(done @ Ok(_))) => done,
                _ => stopping(&command),
            }
        }
        ending = &mut work => ending.unwrap_or_else(|error| Err(panicked(&error))),
    }
}

/// How long a command that was stopped is waited for: a simulation does not pause, and ends with an image, by itself.
fn patience(command: &Command) -> Duration {
    Duration::from_secs(match command {
        Command::Simulate(_) => 10,
        _ => 1,
    })
}

/// How a command ends that was stopped: servers are done, a run says what becomes of its work.
fn stopping(command: &Command) -> Ending {
    let fault = Fault::user("stopped");
    match command {
        #[cfg(feature = "cluster")]
        Command::Scheduler(_) | Command::Executor(_) => DONE,
        Command::Serve(_) => DONE,
        Command::Run(_) => Err(fault
            .next("the map is as it was; the same command goes on where this one stopped")
            .into()),
        _ => Err(fault.into()),
    }
}

fn log() {
    let filter = tracing_subscriber::EnvFilter::try_from_env("EVERMAP_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .init();
}
