//! Label Studio's tasks.

mod tasks;
mod written;

use evermap_schemas::Fault;
use serde_json::{Value, json};

use super::described::{Canvas, OF_ANOTHER, which_are};
use super::{DrawnShape, NAME, NO_SHAPE, PictureAnnotations, Pixel, Rectangle, Shape, degrees};
use crate::annotate::Losses;
use crate::annotate::mosaic::Picture;
use crate::annotate::reading::Member;
use tasks::tasks;
use written::{WrittenResult, WrittenValue};

/// The results of the tasks of pictures: rectangles, turned about their upper left corner, and polygons, in percent of the
/// picture. Predictions are not read: nobody said them; a task with nothing else was not looked at.
///
/// # Errors
/// A user fault for JSON of another form, annotations that are no list, too many tasks or results, or results of other pictures
/// alone.
pub(super) fn read(
    text: &str,
    canvases: &[Canvas],
    losses: &mut Losses,
) -> Result<PictureAnnotations, Fault> {
    let (pictures, annotations) = tasks(text, canvases)?;
    let chosen = which_are(canvases, &pictures, losses)?;
    let mut said = PictureAnnotations::default();
    for (task, (annotations, at)) in annotations.into_iter().zip(chosen).enumerate() {
        if annotations.is_seen {
            said.seen.extend(at);
        }
        if annotations.is_unread {
            losses.note(NO_RESULT, &format!("task {task}"));
            said.unread.extend(at);
        }
        for (number, result) in annotations.results.into_iter().enumerate() {
            let place = format!("task {task}, result {number}");
            let Some((at, canvas)) = at.and_then(|at| Some((at, canvases.get(at)?))) else {
                losses.note(OF_ANOTHER, &place);
                continue;
            };
            if has_several_labels(&result) {
                losses.note(SEVERAL, &place);
                said.unread.insert(at);
                continue;
            }
            let (name, is_region) = (name(&result.id), is_region(&result));
            match shape(result, canvas.size) {
                Ok((kind, shape)) => {
                    let drawn = DrawnShape::said(place, kind, shape);
                    said.drawn.push(drawn.called(name).on(at));
                }
                Err(reason) => {
                    losses.note(reason, &place);
                    said.unread.extend(is_region.then_some(at));
                }
            }
        }
    }
    Ok(said)
}

/// Results that say something of the whole picture, or of other results.
const OF_NO_REGION: [&str; 7] = [
    "choices", "datetime", "number", "rating", "relation", "taxonomy", "textarea",
];

/// Whether a result is to mark a part of the picture.
fn is_region(result: &WrittenResult) -> bool {
    let form = result.form();
    form.is_none_or(|form| !OF_NO_REGION.contains(&form))
}

/// Why an annotation says nothing, not even that there is nothing.
const NO_RESULT: &str = "annotation of Label Studio whose result is no list";

/// Why a result with several labels is left out.
const SEVERAL: &str = "annotation with several labels: which one it marks is not said";

/// Whether a result marks a part of the picture as several things.
fn has_several_labels(result: &WrittenResult) -> bool {
    is_region(result) && result.labels().is_some_and(|labels| labels.count > 1)
}

/// The name of a label, if the id of a result has one.
fn name(id: &Member) -> Option<String> {
    let name = id.text()?.strip_prefix(NAME)?.strip_prefix(':')?;
    Some(name.to_owned())
}

/// What a result marks, where it says so, and its shape.
///
/// # Errors
/// In words, for what is no shape, or a label that cannot be read.
fn shape(result: WrittenResult, size: [u32; 2]) -> Result<(Option<String>, Shape), &'static str> {
    let degrees = degrees(&result.value.rotation)?;
    let kind = match result.labels() {
        None => Ok(None),
        Some(labels) => match (&labels.is, labels.first.first()) {
            (Member::Nothing, _) | (Member::List, None) => Ok(None),
            (Member::List, Some(first @ (Member::Text(_) | Member::Number(_)))) => Ok(first.word()),
            _ => Err("annotation whose label is no text"),
        },
    };
    let form = result.form().unwrap_or_default().to_owned();
    let shape = turned(result.value, &form, (size, degrees))?;
    Ok((kind?, shape))
}

fn turned(
    value: WrittenValue,
    form: &str,
    (size, degrees): ([u32; 2], f64),
) -> Result<Shape, &'static str> {
    let [columns, rows] = size.map(|side| f64::from(side) / 100.0);
    let pixel = |[x, y]: Pixel| [x * columns, y * rows];
    match form {
        "rectanglelabels" | "rectangle" => {
            let sides = (value.x, value.y, value.width, value.height);
            let (Some(x), Some(y), Some(width), Some(height)) = sides else {
                return Err(NO_SHAPE);
            };
            Ok(Shape::Box(Rectangle {
                corner: pixel([x, y]),
                size: pixel([width, height]),
                degrees,
            }))
        }
        "polygonlabels" | "polygon" if value.points.is_list => {
            Ok(match value.points.outline.shape()? {
                Shape::Closed(corners) => Shape::Closed(corners.into_iter().map(pixel).collect()),
                Shape::Around(corners) => Shape::Around(corners.map(pixel)),
                other => other,
            })
        }
        _ => Err(NO_SHAPE),
    }
}

/// One task: labels as an annotation, proposals as a prediction with their probabilities as scores.
pub(super) fn write(labels: &[DrawnShape], proposed: &[DrawnShape], picture: &Picture) -> String {
    let results = |drawn: &[DrawnShape]| {
        let results = drawn.iter().enumerate();
        Value::Array(
            results
                .map(|(number, drawn)| result(number, drawn, picture))
                .collect(),
        )
    };
    let mut task = json!({
        "data": { "image": picture.name },
        "annotations": [{ "result": results(labels) }],
        "predictions": [],
    });
    if !proposed.is_empty() {
        let version = concat!("evermap ", env!("CARGO_PKG_VERSION"));
        task["predictions"] = json!([{ "model_version": version, "result": results(proposed) }]);
    }
    format!("{:#}\n", json!([task]))
}

fn result(number: usize, drawn: &DrawnShape, picture: &Picture) -> Value {
    let [width, height] = picture.size;
    let percent = [100.0 / f64::from(width), 100.0 / f64::from(height)];
    let kind = drawn.kind.as_deref().unwrap_or_default();
    let (form, mut value) = match &drawn.shape {
        Shape::Box(found) => (
            "rectanglelabels",
            json!({
                "x": found.corner[0] * percent[0],
                "y": found.corner[1] * percent[1],
                "width": found.size[0] * percent[0],
                "height": found.size[1] * percent[1],
                "rotation": found.degrees.rem_euclid(360.0),
            }),
        ),
        shape => {
            let points = shape
                .points()
                .into_iter()
                .map(|[x, y]| [x * percent[0], y * percent[1]]);
            (
                "polygonlabels",
                json!({ "points": points.collect::<Vec<_>>(), "closed": true }),
            )
        }
    };
    value[form] = json!([kind]);
    let id = match &drawn.name {
        Some(name) => format!("{NAME}:{name}"),
        None => number.to_string(),
    };
    let mut result = json!({
        "id": id,
        "type": form,
        "from_name": "label",
        "to_name": "image",
        "original_width": width,
        "original_height": height,
        "image_rotation": 0,
        "value": value,
    });
    if let Some(probability) = drawn.probability {
        result["score"] = json!(probability);
    }
    result
}
