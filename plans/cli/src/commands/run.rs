//! `evermap run`.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use evermap_contract::Registry;
#[cfg(feature = "cluster")]
use evermap_engine::cluster::ClusterRunner;
use evermap_engine::map::Map;
use evermap_engine::map::version::Version;
use evermap_engine::preflight::in_words;
use evermap_engine::prepare::{Prepared, Replaced};
use evermap_engine::run::record::record_run;
use evermap_engine::run::runner::{LocalRunner, Runner, Unfinished};
use evermap_engine::run::{RunEnd, RunResult};
use evermap_engine::sql::Limits;

use evermap_schemas::Fault;

use crate::arguments::{LimitArgs, RunArgs};
#[cfg(feature = "cluster")]
use crate::commands::cluster::WithinProcess;
use crate::commands::layers::print_layers;
use crate::ending::{Ending, Lost};
use crate::output::Format;
use crate::progress::{Progress, line};
use crate::quantity::{of, of_seconds};
use crate::sessions;
use crate::{clocks, fixes, masks, odometry_frame, operators};

/// Runs a plan.
///
/// # Errors
/// The plan's faults before anything runs; then the first unit's.
pub async fn run(args: &RunArgs, unfinished: &Unfinished) -> Ending {
    let begun = Instant::now();
    let registry = operators::registry();
    let (mut prepared, logs) = sessions::prepare_run(args, &registry).await?;
    if let (Some(replaced), false) = (prepared.replaced.first(), args.replace) {
        return Err(is_another_log(replaced).into());
    }
    prepared
        .program
        .warnings
        .iter()
        .for_each(|warning| line(&format!("warning: {warning}")));
    let warnings = prepared.unknown.iter().chain(&prepared.overwritten);
    warnings.for_each(|warning| line(&format!("warning: {warning}")));
    let notes = prepared.notes.iter();
    notes.for_each(|note| line(&format!("note: {note}")));
    warn_of_missing(&prepared);
    if let Some(warning) = masks::warning(&masks::masked(&prepared.program), &logs).await? {
        line(&format!("warning: {warning}"));
    }
    let vehicle = odometry_frame::vehicle(&prepared.program);
    let of_odometry = odometry_frame::notes(&logs, vehicle).await?;
    let of_fixes = fixes::notes(&logs, &prepared.program).await?;
    let program = &prepared.program;
    let of_clocks = clocks::notes(&logs, |role| program.reads_source(role)).await;
    for note in [of_odometry, of_clocks, of_fixes].iter().flatten() {
        line(&format!("note: {note}"));
    }
    drop(logs);
    prepared.unplayed.notes().iter().for_each(|note| line(note));
    let jobs = jobs(&args.limits);
    let runner = runner(args, &registry, jobs, unfinished).await?;
    let result = loop {
        let run = prepared.run(&registry, limits(&args.limits, jobs));
        let mut progress = Progress::new(args.progress);
        let ended = run
            .execute(runner.as_ref(), &mut |event| progress.note(&event))
            .await;
        progress.finish();
        let by = match ended? {
            RunEnd::Done(result) => break *result,
            RunEnd::Overtaken { by } => by,
        };
        line(&format!(
            "another run published version {by} while this one was at work: it goes on from there"
        ));
        let (anew, _) = sessions::prepare_run(args, &registry).await?;
        anew.agrees_with(&prepared)?;
        prepared = anew;
    };
    record_run(&prepared.store, &result).await?;
    line(&summary(&result, begun.elapsed()));
    let published = result.version.published();
    let without = published.filter(|(_, layer)| layer.rows() == 0);
    let without: Vec<&str> = without.map(|(name, _)| name.as_str()).collect();
    if let Some(note) = prepared.unplayed.note_of_empty(&without) {
        line(&note);
    }
    let mut lost = Lost(result.version.losses.clone());
    lost.0.extend(prepared.unreadable.clone());
    let idle = prepared.idle.iter();
    lost.0.extend(
        idle.map(|(session, lacks)| (format!("session without {}: {session}", in_words(lacks)), 1)),
    );
    lost.0.extend(empty(&result.version, &prepared));
    let map = Map::of(prepared.store, result.version);
    print_layers(&map, Format::Table).await?;
    Ok(lost)
}

/// That nothing came out of a run, or of some of the sessions given: of a log whose topics have nothing that makes sense.
fn empty(version: &Version, prepared: &Prepared) -> BTreeMap<String, u64> {
    let artifacts = || version.layers.values().flat_map(|layer| &layer.artifacts);
    if artifacts().all(|artifact| artifact.rows == 0) {
        let nothing = "run of which nothing came out: no layer has rows".to_owned();
        return BTreeMap::from([(nothing, 1)]);
    }
    let mut rows = BTreeMap::<&str, u64>::new();
    for artifact in artifacts() {
        if let Some(session) = &artifact.extent.session {
            *rows.entry(session).or_default() += artifact.rows;
        }
    }
    let idle: BTreeSet<&String> = prepared.idle.iter().map(|(session, _)| session).collect();
    let given = prepared.given.iter().filter(|name| !idle.contains(name));
    let empty = given.filter(|name| rows.get(name.as_str()) == Some(&0));
    let told = empty.map(|name| (format!("session of which nothing came out: {name}"), 1));
    told.collect()
}

/// Two logs of one name are most often two drives, in two folders.
fn is_another_log(replaced: &Replaced) -> Fault {
    let Replaced {
        session,
        before,
        now,
    } = replaced;
    Fault::user(format!(
        "the map has a session {session} of another log: expected {before}, found {now}"
    ))
    .next("give the session another name in a manifest or rename the file; --replace puts it in the place of the other")
}

/// A layer of the version before that is not there reads as empty: right for a new step, a surprise after another plan.
fn warn_of_missing(prepared: &Prepared) {
    let version = prepared.base.as_ref().map_or(0, |base| base.version);
    if prepared.begins_anew {
        let layers = prepared.missing.join(", ");
        line(&format!(
            "note: version {version} has no layer {layers}: another plan made it, and all sessions are new to this one"
        ));
        return;
    }
    for layer in &prepared.missing {
        line(&format!(
            "warning: version {version} has no layer {layer}, which the plan reads as previous.{layer}; it reads as empty"
        ));
    }
}

/// Memory without which no further unit runs beside others, unless it is asked for.
const UNIT_BYTES: usize = 256 << 20;

/// Units that run side by side.
fn jobs(args: &LimitArgs) -> usize {
    let cores = Limits::default().partitions;
    let fit = (args.memory / UNIT_BYTES).max(1);
    args.jobs.map_or(cores.min(fit), |jobs| jobs as usize)
}

/// What each of so many units may use.
fn limits(args: &LimitArgs, jobs: usize) -> Limits {
    Limits {
        memory_bytes: (args.memory / jobs.max(1)).max(1 << 20),
        ..Limits::default()
    }
}

/// Runs units on a cluster inside this process, for trying one out.
#[cfg(feature = "cluster")]
const IN_PROCESS: &str = "in-process";

#[cfg(feature = "cluster")]
async fn runner(
    args: &RunArgs,
    registry: &Registry,
    jobs: usize,
    unfinished: &Unfinished,
) -> Result<Box<dyn Runner>, Fault> {
    let deadline = Duration::from_secs(args.deadline_s);
    let registry = registry.clone();
    Ok(match args.cluster.as_deref() {
        Some(IN_PROCESS) => {
            Box::new(WithinProcess::new(registry, jobs, deadline, unfinished).await?)
        }
        Some(url) => Box::new(ClusterRunner::new(url, registry, deadline, unfinished)),
        None => Box::new(LocalRunner::new(registry, jobs)),
    })
}

#[cfg(not(feature = "cluster"))]
async fn runner(
    _: &RunArgs,
    registry: &Registry,
    jobs: usize,
    _: &Unfinished,
) -> Result<Box<dyn Runner>, Fault> {
    Ok(Box::new(LocalRunner::new(registry.clone(), jobs)))
}

fn summary(result: &RunResult, elapsed: Duration) -> String {
    let computed = result.units.iter().filter(|(_, done)| !done.cached).count();
    let reused = result.units.len() - computed;
    let end = if result.published {
        "published"
    } else {
        "stays: nothing has changed"
    };
    format!(
        "version {} {end}; {} computed, {reused} reused, in {}",
        result.version.version,
        of(computed as u64, "unit"),
        of_seconds(elapsed.as_secs_f64())
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_shared_by_the_units_side_by_side() {
        let args = LimitArgs {
            jobs: Some(4),
            memory: 1 << 30,
        };
        assert_eq!(limits(&args, jobs(&args)).memory_bytes, 1 << 28);
        assert_eq!(
            jobs(&LimitArgs {
                jobs: None,
                memory: UNIT_BYTES
            }),
            1
        );
    }
}
