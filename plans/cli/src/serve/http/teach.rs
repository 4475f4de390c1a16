//! Teaching by HTTP: labels, what is asked, and what people say.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Extension;
use axum::extract::rejection::JsonRejection;
use axum::extract::{Json, Path, Query, State};
use evermap_schemas::Fault;
use evermap_schemas::layers::{BoxHypothesis, PlacedLabel};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::annotate::{Losses, geojson};
use crate::serve::access::Who;
use crate::serve::http::{App, MapOf, Refusal};
use crate::serve::teach::{Site, Teaching};

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

/// `GET /teach/{site}`: the labels that there are, as all logs have them.
///
/// # Errors
/// For a site that there is not, or a server that is not taught.
pub async fn labels(
    State(app): State<App>,
    MapOf(map): MapOf,
    Path(path): Path<BTreeMap<String, String>>,
) -> Result<Json<Value>, Refusal> {
    let site = app.teaching()?.site(&map, text(&path, "site")).await?;
    Ok(Json(labels_of(&site).await))
}

/// From which revision on.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    #[serde(default)]
    revision: u64,
    /// Whether to wait until the image was searched, too.
    #[serde(default)]
    searched: bool,
}

/// `GET /teach/{site}/{kind}?revision=…&searched=…`: what may be of a kind, the likeliest first, as all that was said up to
/// a revision, or later, teaches. Waits until it is learnt: a fraction of a second for candidates that are known, longer
/// for a search.
///
/// # Errors
/// As [`labels`]; when it takes too long.
pub async fn hypotheses(
    State(app): State<App>,
    MapOf(map): MapOf,
    Path(path): Path<BTreeMap<String, String>>,
    Query(asked): Query<Asked>,
) -> Result<Json<Value>, Refusal> {
    let site = app.teaching()?.site(&map, text(&path, "site")).await?;
    let kind = text(&path, "kind");
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
    /// GeoJSON, as `evermap annotate --import` reads it.
    features: Value,
}

/// `POST /teach/{site}`: says what features have drawn. What is answered is on the disk.
///
/// # Errors
/// As [`labels`], for features that make no sense, and where they cannot be written.
pub async fn say(
    State(app): State<App>,
    MapOf(map): MapOf,
    Path(path): Path<BTreeMap<String, String>>,
    Extension(Who(user)): Extension<Who>,
    saying: Result<Json<Saying>, JsonRejection>,
) -> Result<Json<Value>, Refusal> {
    let teaching = app.teaching()?;
    let Json(saying) = saying.map_err(|error| Fault::user(error.body_text()))?;
    let site = teaching.site(&map, text(&path, "site")).await?;
    let author = user.or(saying.author);
    let author = author.as_deref().unwrap_or(&teaching.author);
    let mut losses = Losses::default();
    let features = geojson::features(&saying.features, &mut losses);
    if !losses.lines.is_empty() {
        return Err(Fault::user(losses.lines.join("; "))
            .next("nothing was saved")
            .into());
    }
    let saved = site.say(author, &features).await?;
    let mut answer = labels_of(&site).await;
    answer["saved"] = saved.acts.into();
    answer["undo"] = saved.undo;
    answer["notes"] = saved.notes.into();
    answer["revision"] = saved.revision.into();
    Ok(Json(answer))
}

impl App {
    fn teaching(&self) -> Result<&Arc<Teaching>, Fault> {
        let teaching = self.teaching.as_ref();
        teaching.ok_or_else(|| {
            Fault::user("this server is only read").next("start it with --teach FOLDER")
        })
    }
}

fn text<'p>(path: &'p BTreeMap<String, String>, name: &str) -> &'p str {
    path.get(name).map_or("", String::as_str)
}

async fn labels_of(site: &Site) -> Value {
    let found = site.labels().await;
    let labels: Vec<Value> = found.labels.iter().map(label).collect();
    json!({ "version": found.version, "revision": found.revision, "labels": labels })
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
    let pose = &one.map_from_label;
    json!({
        "hypothesis": one.hypothesis,
        "probability": one.probability,
        "question": one.question,
        "gain": one.gain,
        "reason": one.reason,
        "map_from_label": { "x": pose.x, "y": pose.y, "z": pose.z, "qx": pose.qx, "qy": pose.qy, "qz": pose.qz, "qw": pose.qw },
        "length_m": one.length_m,
        "width_m": one.width_m,
    })
}
