//! Sessions as the command line names them.

use std::collections::BTreeMap;
use std::path::Path;

use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_contract::Registry;
use evermap_datasets::manifest::Vehicle;
use evermap_datasets::{Dataset, Manifest, Recordings};
use evermap_engine::preflight::unknown::topics;
use evermap_engine::prepare::{Prepared, located};
use evermap_engine::run::Event;
use evermap_schemas::Fault;

use crate::arguments::{PlanArgs, RunArgs, SessionArgs};
use crate::ending::{Failure, Lost};
use crate::progress::{Progress, line};
use crate::shipped;

/// The manifest that the command line names, with its site; `None` where it names neither.
///
/// # Errors
/// A user fault with line and column.
pub fn manifest(args: &SessionArgs) -> Result<Option<Manifest>, Fault> {
    let read = args
        .manifest
        .as_deref()
        .map(|path| Manifest::load(Path::new(path)))
        .transpose()?;
    Ok(match (&args.site, read) {
        (Some(site), read) => Some(Manifest {
            site: Some(site.clone()),
            ..read.unwrap_or_default()
        }),
        (None, read) => read,
    })
}

/// A plan's run on a map, with the sessions that the command line names. Nothing is written.
///
/// # Errors
/// The plan's faults, or what is wrong with the sessions or the map.
pub async fn prepare(args: &PlanArgs, registry: &Registry, map: &str) -> Result<Prepared, Failure> {
    let plan = shipped::of(args)?;
    let manifest = manifest(&args.sessions)?;
    let sessions = &args.sessions.sessions;
    Ok(Prepared::new(&plan, registry, map, sessions, manifest.as_ref(), None).await?)
}

/// What logs are called while they are read.
const READING: &str = "reading logs";

/// As [`prepare`], of what is then run: logs that are read are remembered, and where that takes long it is said on stderr
/// how far it is. The logs, opened, are for who tells what is odd about them: units open their own.
///
/// # Errors
/// As [`prepare`], or that the map cannot be written.
pub async fn prepare_run(
    args: &RunArgs,
    registry: &Registry,
) -> Result<(Prepared, Dataset), Failure> {
    let plan = shipped::of(&args.input)?;
    let manifest = manifest(&args.input.sessions)?;
    let sessions = &args.input.sessions.sessions;
    let mut progress = None;
    let mut told = |share| {
        let progress = progress.get_or_insert_with(|| {
            let mut progress = Progress::new(args.progress);
            progress.note(&Event::Started { label: READING });
            progress
        });
        progress.note(&Event::Advanced {
            label: READING,
            share: Some(share),
        });
    };
    let (map, manifest) = (&args.map, manifest.as_ref());
    let prepared = Prepared::new(&plan, registry, map, sessions, manifest, Some(&mut told)).await;
    if let Some(progress) = progress {
        progress.finish();
    }
    let mut prepared = prepared?;
    let logs = std::mem::take(&mut prepared.logs);
    Ok((prepared, logs))
}

/// Opens the sessions, and says on stderr what was chosen for the person. They are read for the vehicle that a plan says, if
/// any, in place of the manifest's.
///
/// # Errors
/// As [`Dataset::open`].
pub async fn open(
    runtime: &RuntimeEnv,
    args: &SessionArgs,
    vehicle: Option<Vehicle>,
) -> Result<Dataset, Fault> {
    let (manifest, text) = (manifest(args)?, shipped::manifest(args)?);
    let placed = |fault| located(fault, text.as_ref());
    let found = Recordings::find(runtime, &args.sessions, manifest.as_ref()).await;
    let mut found = found.map_err(placed)?;
    if let Some(vehicle) = vehicle {
        found = found.of_vehicle(vehicle);
    }
    let dataset = found.open().await.map_err(placed)?;
    told(&dataset);
    let unknown = topics(&dataset);
    unknown
        .iter()
        .for_each(|unknown| line(&format!("warning: {unknown}")));
    Ok(dataset)
}

/// Tells which topics were chosen though others would do.
pub fn told(dataset: &Dataset) {
    let notes = dataset.notes.iter();
    notes.for_each(|note| line(&format!("note: {note}")));
}

/// What reading logs has lost so far.
pub fn lost<'d>(datasets: impl IntoIterator<Item = &'d Dataset>) -> Lost {
    let mut sums = BTreeMap::new();
    for dataset in datasets {
        sums.extend(dataset.losses.told());
    }
    Lost(sums)
}
