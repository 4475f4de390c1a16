//! `evermap annotate`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use evermap_datasets::annotations::{Annotation, AnnotationLog, RecordingError, parts};
use evermap_schemas::layers::PlacedLabel;
use evermap_schemas::{Fault, LayerRow, batch};

use crate::annotate::Losses;
use crate::annotate::features::read;
use crate::annotate::mosaic::Georeference;
use crate::annotate::saying::{Speaker, said};
use crate::annotate::state::State;
use crate::arguments::AnnotateArgs;
use crate::ending::{Ending, Failure, Lost};
use crate::export::geojson;
use crate::progress::line;
use crate::reader::MapReader;

/// Says what a file has drawn, or writes what was said.
///
/// # Errors
/// A user fault for a file that cannot be read, a resource fault for a log that cannot be written.
pub async fn annotate(args: &AnnotateArgs) -> Ending {
    let reader = MapReader::open(&args.map.map, args.map.version).await?;
    let logs = args.out.as_deref().map(parts).unwrap_or_default();
    let mut losses = Losses::default();
    let state = State::read(&reader, args.site.as_deref(), &logs, &mut losses).await?;
    match (&args.import, &args.out, &args.export) {
        (Some(file), Some(log), _) => {
            let sessions = reader.map.version.sessions.iter();
            let names: BTreeSet<_> = sessions
                .map(|session| session.log.session.as_str())
                .collect();
            import(args, file, log, (&state, &names), &mut losses)?;
        }
        (_, _, Some(file)) => export(args, file, state)?,
        _ => {}
    }
    losses.tell();
    Ok(Lost(losses.counts))
}

fn import(
    args: &AnnotateArgs,
    file: &Path,
    log: &Path,
    (state, sessions): (&State, &BTreeSet<&str>),
    losses: &mut Losses,
) -> Result<(), Failure> {
    let mosaic = args.mosaic.as_deref().map(Georeference::read).transpose()?;
    let features = read(file, mosaic.as_ref(), losses)?;
    let now = chrono::Utc::now().timestamp_nanos_opt();
    let speaker = Speaker {
        author: args.author.clone().unwrap_or_else(user),
        stamp_ns: now.map_or(0, |now| now.max(0) as u64),
        kind: args.kind.clone(),
    };
    let said = said(&features, state, &speaker, losses)?;
    let unchanged = match said.unchanged {
        0 => String::new(),
        count => format!(", {count} as they were"),
    };
    if said.acts.is_empty() {
        line(&format!("nothing new to say{unchanged}"));
        return Ok(());
    }
    let written = write(log, sessions, &said.acts).map_err(fault)?;
    let counts = counts(&said.acts);
    line(&format!("{}: {counts}{unchanged}", written.display()));
    line(&format!(
        "in the map once a run has it: evermap run PLAN --map {} --site {} --sessions {}",
        args.map.map,
        state.site,
        written.display()
    ));
    Ok(())
}

/// The name of the person at the machine.
fn user() -> String {
    let named = ["USER", "USERNAME"]
        .into_iter()
        .find_map(|name| std::env::var(name).ok());
    let named = named.filter(|name| !name.is_empty());
    named.unwrap_or_else(|| "unknown".to_owned())
}

/// Acts as people count them: `3 drawn, 1 moved`.
fn counts(acts: &[Annotation]) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for act in acts {
        *counts.entry(&act.act).or_default() += 1;
    }
    let counts = counts.iter().map(|(act, count)| format!("{count} {act}"));
    counts.collect::<Vec<_>>().join(", ")
}

/// Writes a part of a log whose name no session of the map has: it would take that one's place.
fn write(
    log: &Path,
    sessions: &BTreeSet<&str>,
    acts: &[Annotation],
) -> Result<std::path::PathBuf, RecordingError> {
    let library = concat!("evermap ", env!("CARGO_PKG_VERSION"));
    let mut writing = AnnotationLog::begin(log, |name| sessions.contains(name), library)?;
    writing.say_all(acts)?;
    writing.finish()
}

fn fault(error: RecordingError) -> Fault {
    match error {
        RecordingError::Io { .. } => Fault::resource(error.to_string()),
        RecordingError::Mcap(_) => Fault::bug(error.to_string()),
    }
}

fn export(args: &AnnotateArgs, file: &Path, state: State) -> Result<(), Failure> {
    let wanted = |label: &PlacedLabel| args.kind.as_ref().is_none_or(|kind| *kind == label.kind);
    let labels: Vec<PlacedLabel> = state.labels.into_values().filter(wanted).collect();
    if labels.is_empty() {
        line("there are no labels yet");
    }
    let title = format!("labels of {}, version {}", state.site, state.version);
    let rows = batch(labels)?;
    geojson(&[rows], Some(&PlacedLabel::layer()), &title, file)
}
