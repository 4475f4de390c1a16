//! People on whole images by HTTP: who was said to be in one, and boxes around those who were missed.

use std::collections::BTreeMap;

use axum::Extension;
use axum::extract::rejection::JsonRejection;
use axum::extract::{Json, Path, Query, State};
use evermap_catalog::PERSON;
use evermap_catalog::painted::ImageKey;
use evermap_schemas::Fault;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::annotate::mapped_image::PixelBox;
use crate::serve::access::Who;
use crate::serve::http::teach::{OfImage, canvas, said};
use crate::serve::http::{App, Asks, MapOf, Refusal, named};
use crate::serve::teach::{Canvas, Site};

/// `GET /teach/{site}/person/boxes?session=…&camera=…&stamp=…`: who was said to be in an image, or to be none, each with the
/// box around who is meant, and how many answers of all images wait for a run.
///
/// # Errors
/// For a site or an image that there is not, another kind, or a server that is not taught.
pub async fn on_image(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Path(path)): Asks<Path<BTreeMap<String, String>>>,
    Asks(Query(of)): Asks<Query<OfImage>>,
) -> Result<Json<Value>, Refusal> {
    let site = app.teaching()?.site(&map, named(&path, "site")).await?;
    let image = named_image(&path, of)?;
    let canvas = canvas(&app, &map, &image).await?;
    Ok(Json(people_on(&site, &canvas).await))
}

/// Whom somebody draws.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drawing {
    /// Who, where the server does not know.
    #[serde(default)]
    author: Option<String>,
    /// Left, top, right and bottom of each, px from the image's upper left corner.
    boxes: Vec<PixelBox>,
}

/// `POST /teach/{site}/person/boxes?session=…&camera=…&stamp=…`: says whom boxes on an image are around: who is asked about is
/// accepted, others were missed. What is answered is on the disk.
///
/// # Errors
/// As [`on_image`], for boxes that make no sense there, and where they cannot be written.
pub async fn draw(
    State(app): State<App>,
    MapOf(map): MapOf,
    Asks(Path(path)): Asks<Path<BTreeMap<String, String>>>,
    Asks(Query(of)): Asks<Query<OfImage>>,
    Extension(Who(user)): Extension<Who>,
    drawing: Result<Json<Drawing>, JsonRejection>,
) -> Result<Json<Value>, Refusal> {
    let teaching = app.teaching()?;
    let Json(drawing) = drawing?;
    let site = teaching.site(&map, named(&path, "site")).await?;
    let image = named_image(&path, of)?;
    let canvas = canvas(&app, &map, &image).await?;
    let author = teaching.author_of(user, drawing.author);
    let saved = site.draw(&author, &canvas, &drawing.boxes).await?;
    Ok(said(saved, people_on(&site, &canvas).await))
}

/// The image that people are drawn on.
fn named_image(path: &BTreeMap<String, String>, of: OfImage) -> Result<ImageKey, Fault> {
    let kind = named(path, "kind");
    if kind != PERSON {
        let text = format!("expected the kind {PERSON} for boxes on images, found {kind}");
        return Err(Fault::user(text).next("draw other kinds in the map: POST /teach/SITE"));
    }
    of.key()?.ok_or_else(|| {
        Fault::user("expected session, camera and stamp of an image, found none of them")
    })
}

async fn people_on(site: &Site, canvas: &Canvas<'_>) -> Value {
    let found = site.on_image(canvas).await;
    let labels = found.said.iter().map(|(label, around)| {
        json!({
            "label": label.label,
            "standing": label.standing,
            "author": label.author,
            "box": around,
        })
    });
    json!({
        "version": found.version,
        "revision": found.revision,
        "waiting": found.waiting,
        "labels": labels.collect::<Vec<_>>(),
    })
}
