//! Teaching by HTTP: labels, what is asked, and what people say.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Extension;
use axum::extract::rejection::JsonRejection;
use axum::extract::{Json, Path, Query, State};
use evermap_catalog::painted::ImageKey;
use evermap_catalog::{PERSON, image_size};
use evermap_schemas::layers::{BoxHypothesis, PlacedLabel};
use evermap_schemas::roles::ImageAnnotation;
use evermap_schemas::{Fault, Pose, Stamp};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::annotate::Losses;
use crate::annotate::geojson::{self, GeoJsonFile, of_image};
use crate::camera_images::file;
use crate::serve::access::Who;
use crate::serve::http::{App, Asks, MapOf, Refusal, named};
use crate::serve::maps::ServedMap;
use crate::serve::teach::{Canvas, PlacedQuestion, Saved, Site, Teaching};

/// `GET /teach`: whether people may teach, and as whom.
pub async fn may(
    State(app): State<App>,
    _: MapOf,
    Extension(Who(user)): Extension<Who>,
) -> Json<Value> {
    let teaching = app.teaching.as_deref();
    Json(json!({
        "teach": teaching.is_some(),
        "author": user.as_ref().or(teaching.map(|teaching| &teaching.author)),
        "author_is_known": user.is_some(),
    }))
}

/// The image that is spoken of; the map, where nothing is said.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OfImage {
    #[serde(default)]
    session: Option<String>,
    #[serde(default)]
    camera: Option<String>,
    /// Exposure instant, ns.
    #[serde(default)]
    stamp: Option<i64>,
}

impl OfImage {
    /// # Errors
    /// A user fault where a part of its name is missing.
    pub(super) fn key(self) -> Result<Option<ImageKey>, Fault> {
        match (self.session, self.stamp, self.camera) {
            (Some(session), Some(stamp), Some(camera)) => Ok(Some((session, Stamp(stamp), camera))),
            (None, None, None) => Ok(None),
            _ => Err(Fault::user(
                "expected session, camera and stamp of an image, or none of them, found some",
            )),
        }
    }
}

/// `GET /teach/{site}`: the labels that there are, as all logs have them; with `?session=…&camera=…&stamp=…` those of the
/// pixels of an image.
///
/// # Errors
/// For a site that there is not, or a server that is not taught.
pub async fn labels(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Path(path)): Asks<Path<BTreeMap<String, String>>>,
    Asks(Query(of)): Asks<Query<OfImage>>,
) -> Result<Json<Value>, Refusal> {
    let site = app.teaching()?.site(&map, named(&path, "site")).await?;
    Ok(Json(match of.key()? {
        Some(image) => paint_of(&site, &image).await,
        None => labels_of(&site).await,
    }))
}

/// From which revision on.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RevisionArguments {
    #[serde(default)]
    revision: u64,
    /// Whether to wait until the image was searched, too.
    #[serde(default)]
    searched: bool,
}

/// `GET /teach/{site}/{kind}?revision=…&searched=…`: what may be of a kind, the likeliest first, as all that was said up to
/// a revision, or later, teaches. Waits until it is learnt: a fraction of a second for candidates that are known, longer
/// for a search. Of people, whom the version asks about, each with the image that may show them.
///
/// # Errors
/// As [`labels`]; when it takes too long.
pub async fn hypotheses(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Path(path)): Asks<Path<BTreeMap<String, String>>>,
    Asks(Query(asked)): Asks<Query<RevisionArguments>>,
) -> Result<Json<Value>, Refusal> {
    let site = app.teaching()?.site(&map, named(&path, "site")).await?;
    let kind = named(&path, "kind");
    if kind == PERSON {
        return Ok(Json(people_of(&site).await));
    }
    let learnt = site.learnt(kind, asked.revision, asked.searched);
    let learnt = app.within(learnt).await?;
    Ok(Json(json!({
        "revision": learnt.revision,
        "is_searched": learnt.is_searched,
        "milliseconds": learnt.took.as_millis() as u64,
        "hypotheses": learnt.hypotheses.iter().map(hypothesis).collect::<Vec<_>>(),
    })))
}

/// What somebody says.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Saying {
    /// Who, where the server does not know.
    #[serde(default)]
    author: Option<String>,
    /// GeoJSON, as `evermap annotate --import` reads it; on an image, px from its upper left corner.
    features: GeoJsonFile,
}

/// `POST /teach/{site}`: says what features have drawn, in the map or, named as for [`labels`], on an image. What is
/// answered is on the disk.
///
/// # Errors
/// As [`labels`], for features that make no sense, and where they cannot be written.
pub async fn say(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Path(path)): Asks<Path<BTreeMap<String, String>>>,
    Asks(Query(of)): Asks<Query<OfImage>>,
    Extension(Who(user)): Extension<Who>,
    saying: Result<Json<Saying>, JsonRejection>,
) -> Result<Json<Value>, Refusal> {
    let teaching = app.teaching()?;
    let Json(saying) = saying?;
    let site = teaching.site(&map, named(&path, "site")).await?;
    let author = teaching.author_of(user, saying.author);
    let mut losses = Losses::default();
    let features = geojson::features(saying.features, &mut losses)?;
    if !losses.counts.is_empty() {
        return Err(Fault::user(losses.lines.join("; "))
            .next("nothing was saved")
            .into());
    }
    let (saved, answer) = match of.key()? {
        Some(image) => {
            let canvas = canvas(&app, &map, &image).await?;
            let saved = site.paint(&author, &canvas, &features).await?;
            (saved, paint_of(&site, &image).await)
        }
        None => {
            let saved = site.say(&author, &features).await?;
            (saved, labels_of(&site).await)
        }
    };
    Ok(said(saved, answer))
}

/// What there is now, with what was saved of it.
pub(super) fn said(saved: Saved, mut answer: Value) -> Json<Value> {
    answer["saved"] = saved.acts.into();
    answer["undo"] = saved.undo;
    answer["notes"] = saved.notes.into();
    answer["revision"] = saved.revision.into();
    Json(answer)
}

impl App {
    pub(super) fn teaching(&self) -> Result<&Arc<Teaching>, Fault> {
        let teaching = self.teaching.as_ref();
        teaching.ok_or_else(|| {
            Fault::user("this server is only read").next("start it with --teach FOLDER")
        })
    }
}

async fn labels_of(site: &Site) -> Value {
    let found = site.labels().await;
    let labels: Vec<Value> = found.labels.iter().map(label).collect();
    json!({ "version": found.version, "revision": found.revision, "labels": labels })
}

/// An image of the newest version, to draw on.
pub(super) async fn canvas<'i>(
    app: &App,
    map: &ServedMap,
    image: &'i ImageKey,
) -> Result<Canvas<'i>, Fault> {
    let size = app.within(size(map, image)).await?;
    Ok(Canvas { image, size })
}

/// Width and height of an image of the newest version.
async fn size(map: &ServedMap, image: &ImageKey) -> Result<[u32; 2], Fault> {
    let opened = map.newest().await?;
    let bytes = file(&opened.reader, &opened.context, image).await?;
    image_size(&bytes).map_err(|error| Fault::data(error.to_string()))
}

async fn paint_of(site: &Site, image: &ImageKey) -> Value {
    let found = site.painted(image).await;
    let labels: Vec<Value> = found.lying.iter().map(painted).collect();
    json!({ "version": found.version, "labels": labels, "classes": found.classes })
}

async fn people_of(site: &Site) -> Value {
    let found = site.people().await;
    json!({
        "revision": found.revision,
        "is_searched": true,
        "milliseconds": 0,
        "unplaced": found.unplaced,
        "waiting": found.waiting,
        "hypotheses": found.asked.iter().map(person).collect::<Vec<_>>(),
    })
}

/// Side of the box that is drawn where somebody stands, m.
const FOOTPRINT_M: f64 = 0.4;

fn person(asked: &PlacedQuestion) -> Value {
    let one = &asked.question;
    json!({
        "hypothesis": one.person,
        "probability": one.probability,
        "question": one.question,
        "gain": one.gain,
        "reason": one.reason,
        "map_from_label": pose(&asked.map_from_person),
        "length_m": FOOTPRINT_M,
        "width_m": FOOTPRINT_M,
        "image": of_image(&asked.image()),
        "rectangle": one.rectangle,
    })
}

fn pose(pose: &Pose) -> Value {
    json!({ "x": pose.x, "y": pose.y, "z": pose.z, "qx": pose.qx, "qy": pose.qy, "qz": pose.qz, "qw": pose.qw })
}

fn painted(act: &ImageAnnotation) -> Value {
    json!({
        "label": act.id,
        "kind": act.class,
        "author": act.author,
        "shape": act.shape,
        "points": act.points,
        "brush_px": act.brush_px,
    })
}

fn label(label: &PlacedLabel) -> Value {
    json!({
        "label": label.label,
        "kind": label.kind,
        "standing": label.standing,
        "author": label.author,
        "shape": label.shape,
        "points": label.points,
    })
}

fn hypothesis(one: &BoxHypothesis) -> Value {
    json!({
        "hypothesis": one.hypothesis,
        "probability": one.probability,
        "question": one.question,
        "gain": one.gain,
        "reason": one.reason,
        "map_from_label": pose(&one.map_from_label),
        "length_m": one.length_m,
        "width_m": one.width_m,
    })
}
