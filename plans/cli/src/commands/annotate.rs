//! `evermap annotate`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use evermap_datasets::annotations::{Annotation, parts};
use evermap_engine::map::version::Version;
use evermap_schemas::layers::{BoxHypothesis, PlacedLabel};
use evermap_schemas::{Fault, LayerRow, batch};

use crate::annotate::features::{DrawnFeature, read};
use crate::annotate::mapped_image::plane_m;
use crate::annotate::mosaic::Picture;
use crate::annotate::saying::{Speaker, said};
use crate::annotate::state::State;
use crate::annotate::{Losses, begin, people, taking_in, unwritten, user};
use crate::arguments::AnnotateArgs;
use crate::earth::Earth;
use crate::ending::{Ending, Failure, Lost};
use crate::export::geojson;
use crate::output::{Sink, write_file};
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
    let mut state = State::read(&reader, args.site.as_deref(), &logs, &mut losses).await?;
    if let Some(kind) = &args.kind
        && let Some(meant) = state.meant(kind)
    {
        line(&format!(
            "note: there are no labels of kind `{kind}` yet; did you mean `{meant}`?"
        ));
    }
    match (&args.import, &args.out, &args.export) {
        (Some(file), Some(log), _) => {
            let features = features(args, file, (&state, &reader), &mut losses).await?;
            state.know_images(&reader, &features).await?;
            import(
                args,
                &features,
                log,
                (&state, &reader.map.version),
                &mut losses,
            )?;
        }
        (_, _, Some(file)) => export(args, file, (state, &reader), &mut losses).await?,
        _ => {}
    }
    losses.tell();
    Ok(Lost(losses.counts))
}

/// What a file has drawn: in the map, on a mosaic, or on camera images.
async fn features(
    args: &AnnotateArgs,
    file: &Path,
    (state, reader): (&State, &MapReader),
    losses: &mut Losses,
) -> Result<Vec<DrawnFeature>, Fault> {
    let Some(folder) = &args.images else {
        let mosaic = args.mosaic.as_deref().map(Picture::read).transpose()?;
        return read(file, mosaic.as_ref(), losses);
    };
    let plane_m = plane_m(reader, &state.site).await?;
    people::read(file, folder, (state, plane_m), losses)
}

fn import(
    args: &AnnotateArgs,
    features: &[DrawnFeature],
    log: &Path,
    (state, version): (&State, &Version),
    losses: &mut Losses,
) -> Result<(), Failure> {
    let now = chrono::Utc::now().timestamp_nanos_opt();
    let speaker = Speaker {
        author: args.author.clone().unwrap_or_else(user),
        stamp_ns: now.map_or(0, |now| now.max(0) as u64),
        kind: args.kind.clone(),
    };
    let said = said(features, state, &speaker, losses)?;
    let unchanged = match said.unchanged {
        0 => String::new(),
        count => format!(", {count} as they were"),
    };
    if said.acts.is_empty() {
        line(&format!("nothing new to say{unchanged}"));
        return Ok(());
    }
    let written = write(log, version, &said.acts)?;
    let counts = counts(&said.acts);
    line(&format!("{}: {counts}{unchanged}", written.display()));
    line(&format!(
        "in the map once a run has it: {}",
        taking_in(&args.map.map, &state.site, &written)
    ));
    Ok(())
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

/// Writes a part of a log.
fn write(log: &Path, map: &Version, acts: &[Annotation]) -> Result<PathBuf, Fault> {
    let mut writing = begin(log, map)?;
    writing.say_all(acts).map_err(unwritten)?;
    writing.finish().map_err(unwritten)
}

async fn export(
    args: &AnnotateArgs,
    file: &Path,
    (state, reader): (State, &MapReader),
    losses: &mut Losses,
) -> Result<(), Failure> {
    let wanted = |kind: &String| args.kind.as_ref().is_none_or(|wanted| wanted == kind);
    let labels = state.labels.into_rows().into_iter();
    let labels: Vec<PlacedLabel> = labels.filter(|label| wanted(&label.kind)).collect();
    if labels.is_empty() {
        line("there are no labels yet");
    }
    let (Some(program), Some(picture)) = (args.program, args.mosaic.as_deref()) else {
        let title = format!("labels of {}, version {}", state.site, state.version);
        let rows = batch(labels)?;
        let mut sink = Sink::file(file)?;
        let layer = PlacedLabel::layer();
        geojson(
            vec![rows],
            Some(&layer),
            &title,
            &Earth::default(),
            &mut sink,
        )?;
        return sink.finish();
    };
    let mut proposed: Vec<BoxHypothesis> = reader.rows(Some(&state.site)).await?;
    proposed.retain(|found| wanted(&found.kind));
    let text = program.write(file, &Picture::read(picture)?, (&labels, &proposed), losses)?;
    write_file(file, text.as_bytes())
}
