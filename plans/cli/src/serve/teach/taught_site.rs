//! A site with all that was said of it, and the logs that it is written to.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use evermap_algorithms::ground::boxes::mosaic::Mosaic;
use evermap_datasets::annotations::{Annotation, AnnotationLog};
use evermap_engine::erased::Erased;
use evermap_schemas::Fault;
use evermap_schemas::layers::{
    Lane, OverheadGradients, OverheadTile, PersonExample, PersonQuestion, PlacedLabel,
};
use evermap_schemas::roles::ImageAnnotation;
use serde_json::{Value, json};

use super::drawn::is_answer;
use super::made;
use crate::annotate::features::DrawnFeature;
use crate::annotate::geojson::of_image;
use crate::annotate::mapped_image::plane_m;
use crate::annotate::saying::{Speaker, read_back, said};
use crate::annotate::state::{State, image_of, painted};
use crate::annotate::{Losses, begin, taking_in, unwritten};
use crate::ending::Lost;
use crate::progress::line;
use crate::reader::MapReader;
use crate::serve::maps::Opened;

/// A site with all that was said of it.
pub(super) struct TaughtSite {
    pub(super) opened: Erased<Opened>,
    /// Where the map is, as the server was told.
    pub(super) map: String,
    pub(super) state: State,
    pub(super) mosaic: Arc<Mosaic>,
    pub(super) lanes: Arc<Vec<Lane>>,
    /// All that was said of images.
    pub(super) paint: Vec<ImageAnnotation>,
    /// Whom the version asks about, the first one first.
    pub(super) people: Vec<PersonQuestion>,
    /// The answers about people that the version has learnt from, by name.
    pub(super) learnt: BTreeMap<String, PlacedLabel>,
    /// Height of the ground in the vehicle frame, m.
    pub(super) plane_m: f64,
    logs: BTreeMap<String, (AnnotationLog, Instant)>,
    pub(super) folder: PathBuf,
    /// Counts what was said since the server knows the site.
    pub(super) revision: u64,
    pub(super) last_ns: u64,
}

/// What was said and written.
pub struct Saved {
    /// Acts that are on the disk.
    pub acts: usize,
    /// What makes the labels as they were before, as GeoJSON to be said.
    pub undo: Value,
    /// What does not fit.
    pub notes: Vec<String>,
    /// Counts what was said.
    pub revision: u64,
    pub(super) kinds: BTreeSet<String>,
}

impl TaughtSite {
    pub(super) async fn read(
        opened: Erased<Opened>,
        map: &str,
        site: &str,
        folder: PathBuf,
    ) -> Result<Self, Fault> {
        let mut losses = Losses::default();
        let logs = logs(&folder);
        let state = State::read(&opened.reader, Some(site), &logs, &mut losses).await?;
        let paint = painted(&opened.reader, site, &logs).await?;
        losses.tell();
        if !losses.counts.is_empty() {
            let counted = Lost(losses.counts).counted();
            line(&format!("what was said of {site}: {}", counted.trim_end()));
        }
        let mut people: Vec<PersonQuestion> = opened.reader.rows(Some(site)).await?;
        people.sort_by_key(|row| row.question);
        let learnt = learnt(&opened.reader, site).await?;
        let plane_m = plane_m(&opened.reader, site).await?;
        let tiles: Vec<OverheadTile> = opened.reader.rows(Some(site)).await?;
        // A map that an older evermap made has none.
        let known: Vec<OverheadGradients> = opened.reader.rows(Some(site)).await?;
        let lanes: Vec<Lane> = opened.reader.rows(Some(site)).await?;
        let described = move || evermap_catalog::tile_gradients(tiles, known, &mut |_, _| {});
        let (gradients, _) = tokio::task::block_in_place(described)?;
        let mosaic = evermap_catalog::mosaic(gradients, &mut |_, _| {});
        Ok(Self {
            opened,
            map: map.to_owned(),
            state,
            mosaic: Arc::new(mosaic),
            lanes: Arc::new(lanes),
            paint,
            people,
            learnt,
            plane_m,
            logs: BTreeMap::new(),
            folder,
            revision: 1,
            last_ns: 0,
        })
    }

    /// The instant of an act: of two at once, the second is later.
    pub(super) fn now(&mut self) -> u64 {
        let now = chrono::Utc::now().timestamp_nanos_opt();
        self.last_ns = now.map_or(0, |now| now.max(0) as u64).max(self.last_ns + 1);
        self.last_ns
    }

    /// As [`State::know_images`]: to be asked before these features are said.
    pub(super) async fn know_images(&mut self, features: &[DrawnFeature]) -> Result<(), Fault> {
        let reader = &self.opened.reader;
        self.state.know_images(reader, features).await
    }

    pub(super) fn say(&mut self, author: &str, features: &[DrawnFeature]) -> Result<Saved, Fault> {
        let speaker = Speaker {
            author: author.to_owned(),
            stamp_ns: self.now(),
            kind: None,
        };
        let mut losses = Losses::default();
        let said = said(features, &self.state, &speaker, &mut losses)?;
        let refused = || Fault::user(losses.lines.join("; "));
        if said.acts.is_empty() && !losses.lines.is_empty() {
            return Err(refused().next("nothing was saved"));
        }
        let names: BTreeMap<&str, &str> = said
            .acts
            .iter()
            .map(|act| (act.id.as_str(), act.kind.as_str()))
            .collect();
        let undo = names.iter().map(|(label, kind)| self.undo(label, kind));
        let undo = json!({ "type": "FeatureCollection", "features": undo.collect::<Vec<_>>() });
        let kinds = said.acts.iter().map(|act| act.kind.clone());
        let kinds = kinds.chain(
            names
                .keys()
                .filter_map(|label| Some(self.state.labels.get(label)?.kind.clone())),
        );
        let kinds = kinds.collect();
        if !said.acts.is_empty() {
            let session = self.write(author, &said.acts)?;
            let rows = said.acts.iter();
            let rows = rows.map(|act| read_back(act, &self.state.site, &session));
            let rows = rows.collect();
            self.state.add(rows, &mut Losses::default());
            self.revision += 1;
        }
        Ok(Saved {
            acts: said.acts.len(),
            undo,
            notes: losses.counts.into_keys().collect(),
            revision: self.revision,
            kinds,
        })
    }

    /// What makes a label as it is now.
    fn undo(&self, label: &str, kind: &str) -> Value {
        let known = self.state.labels.get(label);
        let image = known.and_then(image_of);
        let image = image.filter(|image| self.state.map_from_vehicle(image).is_some());
        let image = image.as_ref().map(of_image);
        let feature = |geometry: Value, kind: &str, standing: &str| {
            let properties = json!({ "kind": kind, "standing": standing, "image": image });
            json!({ "type": "Feature", "id": label, "geometry": geometry, "properties": properties })
        };
        let Some(known) = known else {
            return feature(Value::Null, kind, "removed");
        };
        let geometry = match known.shape.as_str() {
            "polyline" => json!({ "type": "LineString", "coordinates": known.points }),
            _ => {
                let ring = known.points.iter().chain(known.points.first());
                json!({ "type": "Polygon", "coordinates": [ring.collect::<Vec<_>>()] })
            }
        };
        feature(geometry, &known.kind, &known.standing)
    }

    /// Writes acts to their author's log; the name of its session.
    pub(super) fn write(&mut self, author: &str, acts: &[Annotation]) -> Result<String, Fault> {
        let mut log = match self.logs.remove(author) {
            Some((log, _)) if log.is_there() => log,
            begun => {
                if let Some((log, _)) = begun {
                    gone(author, &log);
                }
                self.begin(author)?
            }
        };
        // A log that cannot be written ends here: what follows is its next part.
        log.say_all(acts).map_err(unwritten)?;
        let session = log.path().file_stem().unwrap_or_default();
        let session = session.to_string_lossy().into_owned();
        self.logs.insert(author.to_owned(), (log, Instant::now()));
        Ok(session)
    }

    fn begin(&self, author: &str) -> Result<AnnotationLog, Fault> {
        let name = file_name(&self.state.site, author)?;
        made(&self.folder)?;
        begin(&self.folder.join(name), &self.opened.reader.map.version)
    }

    /// Ends the logs of those who have said nothing for so long.
    pub(super) fn end(&mut self, silent: Duration) {
        let all = std::mem::take(&mut self.logs);
        for (author, (log, last)) in all {
            if last.elapsed() < silent {
                self.logs.insert(author, (log, last));
                continue;
            }
            if !log.is_there() {
                gone(author.as_str(), &log);
                continue;
            }
            let site = &self.state.site;
            match log.finish() {
                Ok(path) => line(&format!(
                    "{author} said something of {site}: {}; {}",
                    path.display(),
                    taking_in(&self.map, site, &path)
                )),
                Err(error) => tracing::warn!("a log of {author} has no end: {error}"),
            }
        }
    }
}

impl Drop for TaughtSite {
    fn drop(&mut self) {
        self.end(Duration::ZERO);
    }
}

/// Bytes that the names of the first parts of logs have: file systems take 255, and later parts have `_4294967295` at most.
const MOST_BYTES: usize = 255 - 11;

/// What the log of an author is called.
///
/// # Errors
/// A user fault for names that are too long together for that of a file.
fn file_name(site: &str, author: &str) -> Result<String, Fault> {
    let name = format!("{site}_{author}.mcap");
    if name.len() <= MOST_BYTES {
        return Ok(name);
    }
    let found = author.len();
    let most = MOST_BYTES.saturating_sub(name.len() - found);
    let fault = format!("expected an author of at most {most} bytes in UTF-8, found {found}");
    Err(Fault::user(fault).next("choose a shorter name: files are called by it, and by the site"))
}

/// Tells of a log that somebody took away while it was written.
fn gone(author: &str, log: &AnnotationLog) {
    let path = log.path().display();
    line(&format!(
        "{path} is no longer there: what {author} said in it is lost, unless it was moved"
    ));
}

/// The answers about people that a version has learnt from, by name: all that it has, where it learns from answers.
async fn learnt(reader: &MapReader, site: &str) -> Result<BTreeMap<String, PlacedLabel>, Fault> {
    if reader.layer_of::<PersonExample>().is_none() {
        return Ok(BTreeMap::new());
    }
    let labels: Vec<PlacedLabel> = reader.rows(Some(site)).await?;
    let answers = labels.into_iter().filter(is_answer);
    Ok(answers.map(|label| (label.label.clone(), label)).collect())
}

/// The logs of a folder, by name.
fn logs(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut logs: Vec<PathBuf> = paths
        .filter(|path| path.extension().is_some_and(|found| found == "mcap"))
        .collect();
    logs.sort();
    logs
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn an_author_is_as_long_as_the_name_of_a_file_may_be() {
        assert_eq!(file_name("lot", "ada").unwrap(), "lot_ada.mcap");
        let author = "\u{20000}".repeat(58);
        let longest = file_name("lot", &(author.clone() + "abc")).unwrap();
        let part = longest.replace(".mcap", "_4294967295.mcap");
        assert_eq!(part.len(), 255);
        let told = file_name("lot", &(author + "abcd")).unwrap_err();
        let expected = "expected an author of at most 235 bytes in UTF-8, found 236";
        assert!(told.to_string().contains(expected), "{told}");
        let told = file_name(&"a".repeat(250), "ada").unwrap_err();
        assert!(told.to_string().contains("at most 0 bytes"), "{told}");
    }
}
