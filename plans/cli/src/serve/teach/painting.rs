//! Paint on images: what lies on them, and what people lay.

use std::collections::BTreeSet;

use evermap_catalog::painted::{ImageKey, by_image, lying, paint};
use evermap_datasets::annotations::{Annotation, DrawnPixels, OnImage};
use evermap_engine::digest::digest_of;
use evermap_schemas::roles::ImageAnnotation;
use evermap_schemas::roles::annotations::is_word;
use evermap_schemas::{Fault, Stamp};
use serde_json::{Value, json};

use super::taught_site::{Saved, TaughtSite};
use crate::annotate::features::{DrawnFeature, Geometry, Point};

/// What lies on an image.
pub struct ImagePaint {
    /// The version that is looked at.
    pub version: u64,
    /// Paint, later over earlier.
    pub lying: Vec<ImageAnnotation>,
    /// The classes of all that lies on images of the site.
    pub classes: BTreeSet<String>,
}

/// What somebody paints on.
pub struct Canvas<'a> {
    /// The image.
    pub image: &'a ImageKey,
    /// Its width and height, px.
    pub size: [u32; 2],
}

impl TaughtSite {
    pub(super) fn painted(&self, image: &ImageKey) -> ImagePaint {
        let images = by_image(self.paint.clone());
        let on = |acts: &Vec<ImageAnnotation>| -> Vec<ImageAnnotation> {
            let found = lying(acts, &mut |_, _| {});
            found.into_iter().cloned().collect()
        };
        let all = images.values().flat_map(on);
        ImagePaint {
            version: self.state.version,
            classes: all.map(|act| act.class).collect(),
            lying: images.get(image).map(on).unwrap_or_default(),
        }
    }

    /// Paints what features have drawn; all of them, or none.
    pub(super) fn paint(
        &mut self,
        author: &str,
        canvas: &Canvas<'_>,
        features: &[DrawnFeature],
    ) -> Result<Saved, Fault> {
        let stamp_ns = self.now();
        let lying = self.painted(canvas.image).lying;
        let mut rows = Vec::with_capacity(features.len());
        let mut undo = Vec::with_capacity(features.len());
        for (sequence, feature) in (0..).zip(features) {
            let before = |id: &str| lying.iter().find(|act| act.id == id);
            let said = said(feature, canvas, &before);
            let (id, class, drawn) = said.map_err(|text| {
                Fault::user(format!("{}: {text}", feature.place)).next("nothing was saved")
            })?;
            undo.push(match before(&id) {
                Some(before) => as_feature(before),
                None => removal(&id, &class),
            });
            rows.push(ImageAnnotation {
                stamp: Stamp(stamp_ns as i64),
                author: author.to_owned(),
                sequence,
                id,
                class,
                map_version: Some(self.state.version),
                ..of_image(canvas.image, &self.state.site, drawn)
            });
        }
        let acts: Vec<Annotation> = rows.iter().map(message).collect();
        if !acts.is_empty() {
            let session = self.write(author, &acts)?;
            let rows = rows.into_iter().map(|row| ImageAnnotation {
                session: session.clone(),
                ..row
            });
            self.paint.extend(rows);
        }
        Ok(Saved {
            acts: acts.len(),
            undo: json!({ "type": "FeatureCollection", "features": undo }),
            notes: Vec::new(),
            revision: self.revision,
            kinds: BTreeSet::new(),
        })
    }
}

/// The label that a feature is about, its class, and what it draws; `None` where it removes the label.
fn said<'b>(
    feature: &DrawnFeature,
    canvas: &Canvas<'_>,
    before: &dyn Fn(&str) -> Option<&'b ImageAnnotation>,
) -> Result<(String, String, Option<DrawnPixels>), String> {
    match feature.standing.as_deref() {
        None | Some("drawn") => {}
        Some("removed") => {
            let id = feature.label.clone().unwrap_or_default();
            let known =
                before(&id).ok_or("expected a label of this image to remove, found none")?;
            return Ok((id, known.class.clone(), None));
        }
        Some(other) => return Err(format!("expected drawn or removed, found {other}")),
    }
    let class = feature.kind.as_deref().map(str::trim);
    let class = class.filter(|class| !class.is_empty());
    let class = class.ok_or("expected a class as kind, found none")?;
    if !is_word(class) || feature.label.as_deref().is_some_and(|id| !is_word(id)) {
        return Err("expected a kind and a label without control characters".to_owned());
    }
    let geometry = feature.geometry.as_ref();
    let drawn = drawn(
        geometry.ok_or("expected a polygon or a line, found none")?,
        feature.brush_px,
    )?;
    let id = match &feature.label {
        Some(label) => label.clone(),
        None => name(canvas.image, &drawn).map_err(|fault| fault.to_string())?,
    };
    let row = of_image(canvas.image, "", Some(drawn.clone()));
    let size = canvas.size.map(|side| side as usize);
    paint(&row, size).map_err(|error| error.to_string())?;
    Ok((id, class.to_owned(), Some(drawn)))
}

fn drawn(geometry: &Geometry, brush_px: Option<f64>) -> Result<DrawnPixels, &'static str> {
    let flat = |points: &[Point]| points.iter().map(|(at, _)| *at).collect::<Vec<_>>();
    Ok(match geometry {
        Geometry::Closed(corners) => {
            let mut points = flat(corners);
            points.dedup();
            if points.len() > 1 && points.first() == points.last() {
                points.pop();
            }
            DrawnPixels {
                shape: "polygon".to_owned(),
                points,
                brush_px: None,
            }
        }
        Geometry::Open(line) => DrawnPixels {
            shape: "polyline".to_owned(),
            points: flat(line),
            brush_px: Some(brush_px.ok_or("expected brush_px of a line, found none")?),
        },
    })
}

/// A name made of what was drawn: the same outline of another class takes its place.
fn name(image: &ImageKey, drawn: &DrawnPixels) -> Result<String, Fault> {
    let (session, stamp, camera) = image;
    let whole = (session, stamp.0, camera, &drawn.points, drawn.brush_px);
    Ok(digest_of(&whole)?.chars().take(16).collect())
}

/// An act on an image, without who said it, and when, and of which label.
fn of_image(
    (session, stamp, camera): &ImageKey,
    site: &str,
    drawn: Option<DrawnPixels>,
) -> ImageAnnotation {
    let act = if drawn.is_some() { "drawn" } else { "removed" };
    let brush_px = drawn.as_ref().and_then(|drawn| drawn.brush_px);
    let (shape, points) = drawn.map(|drawn| (drawn.shape, drawn.points)).unzip();
    ImageAnnotation {
        site: site.to_owned(),
        session: String::new(),
        stamp: Stamp(0),
        author: String::new(),
        sequence: 0,
        id: String::new(),
        class: String::new(),
        act: act.to_owned(),
        map_version: None,
        image_session: session.clone(),
        image_stamp: *stamp,
        image_camera: camera.clone(),
        shape,
        points: points.unwrap_or_default(),
        brush_px,
    }
}

/// The message of an act.
fn message(row: &ImageAnnotation) -> Annotation {
    let drawn = row.shape.clone().map(|shape| DrawnPixels {
        shape,
        points: row.points.clone(),
        brush_px: row.brush_px,
    });
    Annotation {
        stamp_ns: row.stamp.0.max(0) as u64,
        author: row.author.clone(),
        sequence: row.sequence,
        id: row.id.clone(),
        kind: row.class.clone(),
        act: row.act.clone(),
        map_version: row.map_version,
        geometry: None,
        anchor: None,
        image: Some(OnImage {
            session: row.image_session.clone(),
            stamp_ns: row.image_stamp.0.max(0) as u64,
            camera: row.image_camera.clone(),
            drawn,
        }),
    }
}

/// What draws a label as it is.
fn as_feature(row: &ImageAnnotation) -> Value {
    let geometry = match row.brush_px {
        Some(_) => json!({ "type": "LineString", "coordinates": row.points }),
        None => json!({ "type": "Polygon", "coordinates": [row.points] }),
    };
    let properties = json!({ "kind": row.class, "standing": "drawn", "brush_px": row.brush_px });
    json!({ "type": "Feature", "id": row.id, "geometry": geometry, "properties": properties })
}

fn removal(id: &str, class: &str) -> Value {
    let properties = json!({ "kind": class, "standing": "removed" });
    json!({ "type": "Feature", "id": id, "geometry": null, "properties": properties })
}
