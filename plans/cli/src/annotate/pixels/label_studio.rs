//! Label Studio's tasks.

use evermap_schemas::Fault;
use serde_json::{Value, json};

use super::described::{Canvas, DescribedPicture, OF_ANOTHER, is_file, which_are};
use super::{
    DrawnShape, NAME, NO_SHAPE, PictureAnnotations, Rectangle, Shape, degrees, listed, numbers,
    written,
};
use crate::annotate::Losses;
use crate::annotate::geojson::text;
use crate::annotate::mosaic::Picture;

/// The results of the tasks of pictures: rectangles, turned about their upper left corner, and polygons, in percent of the
/// picture. Predictions are not read: nobody said them; a task with nothing else was not looked at.
///
/// # Errors
/// A user fault for JSON of another form, annotations that are no list, or results of other pictures alone.
pub(super) fn read(
    tasks: &Value,
    canvases: &[Canvas],
    losses: &mut Losses,
) -> Result<PictureAnnotations, Fault> {
    let tasks = tasks.as_array().map_or(&[][..], Vec::as_slice);
    if !tasks.iter().all(is_task) {
        return Err(Fault::user(
            "expected tasks of Label Studio with their annotations, found JSON of another form",
        )
        .next("export from Label Studio as `JSON`, not as `JSON-MIN`"));
    }
    let annotations = tasks.iter().map(annotations);
    let annotations: Vec<Vec<&Value>> = annotations.collect::<Result<_, _>>()?;
    let pictures = tasks.iter().zip(&annotations);
    let pictures = pictures.map(|(task, said)| described(task, said, canvases));
    let pictures: Vec<DescribedPicture> = pictures.collect();
    let chosen = which_are(canvases, &pictures, losses)?;
    let mut said = PictureAnnotations::default();
    for (task, (annotations, at)) in annotations.iter().zip(chosen).enumerate() {
        let of_task = annotations.iter().copied();
        let (read, unread): (Vec<&Value>, Vec<&Value>) =
            of_task.partition(|annotation| annotation["result"].is_array());
        if !read.is_empty() {
            said.seen.extend(at);
        }
        if !unread.is_empty() {
            losses.note(NO_RESULT, &format!("task {task}"));
            said.unread.extend(at);
        }
        for (number, result) in results(&read).enumerate() {
            let place = format!("task {task}, result {number}");
            let Some((at, canvas)) = at.and_then(|at| Some((at, canvases.get(at)?))) else {
                losses.note(OF_ANOTHER, &place);
                continue;
            };
            if has_several_labels(result) {
                losses.note(SEVERAL, &place);
                said.unread.insert(at);
                continue;
            }
            match shape(result, canvas.size) {
                Ok((kind, shape)) => {
                    let drawn = DrawnShape::said(place, kind, shape);
                    said.drawn.push(drawn.called(name(&result["id"])).on(at));
                }
                Err(reason) => {
                    losses.note(reason, &place);
                    said.unread.extend(is_region(result).then_some(at));
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
fn is_region(result: &Value) -> bool {
    let form = result["type"].as_str();
    form.is_none_or(|form| !OF_NO_REGION.contains(&form))
}

/// Why an annotation says nothing, not even that there is nothing.
const NO_RESULT: &str = "annotation of Label Studio whose result is no list";

/// Why a result with several labels is left out.
const SEVERAL: &str = "annotation with several labels: which one it marks is not said";

/// Whether a result marks a part of the picture as several things.
fn has_several_labels(result: &Value) -> bool {
    let form = result["type"].as_str().unwrap_or_default();
    let labels = result["value"][form].as_array();
    is_region(result) && labels.is_some_and(|labels| labels.len() > 1)
}

/// The name of a label, if the id of a result has one.
fn name(id: &Value) -> Option<String> {
    let name = id.as_str()?.strip_prefix(NAME)?.strip_prefix(':')?;
    Some(name.to_owned())
}

/// What people said of a task's picture, each time that somebody looked at it and did not give up.
///
/// # Errors
/// A user fault for what is no list.
fn annotations(task: &Value) -> Result<Vec<&Value>, Fault> {
    let [annotations, completions] = ["annotations", "completions"].map(|name| listed(task, name));
    let all = [annotations?, completions?];
    let all = all.into_iter().flatten().flatten();
    let all = all.filter(|annotation| annotation["was_cancelled"] != true);
    Ok(all.collect())
}

/// What they have drawn on it.
fn results<'v>(annotations: &[&'v Value]) -> impl Iterator<Item = &'v Value> {
    let results = annotations.iter().copied();
    let results = results.filter_map(|annotation| annotation["result"].as_array());
    results.flatten()
}

/// The picture of a task, under whatever word the project has it, with the size that a result says.
fn described(task: &Value, annotations: &[&Value], canvases: &[Canvas]) -> DescribedPicture {
    let data = &task["data"];
    let texts = data.as_object().into_iter().flat_map(|data| data.values());
    let texts: Vec<&str> = texts.filter_map(Value::as_str).collect();
    let is_one = |text: &&str| canvases.iter().any(|canvas| is_file(text, &canvas.name));
    let name = texts.iter().copied().find(is_one);
    let name = name.or(data["image"].as_str());
    let size =
        |result: &Value| ["original_width", "original_height"].map(|name| written(&result[name]));
    let mut sizes = results(annotations).map(size);
    DescribedPicture {
        // Several tasks may be of one picture.
        id: None,
        name: name.or(texts.first().copied()).map(str::to_owned),
        size: sizes
            .find(|size| size.iter().any(Option::is_some))
            .unwrap_or_default(),
    }
}

/// Whether it is a task as `JSON` has it: `JSON-MIN` has its members, and none of these.
fn is_task(task: &Value) -> bool {
    let members = ["data", "annotations", "completions", "predictions"];
    members.iter().any(|name| task.get(name).is_some())
}

/// What a result marks, where it says so, and its shape.
///
/// # Errors
/// In words, for what is none.
fn shape(result: &Value, size: [u32; 2]) -> Result<(Option<String>, Shape), &'static str> {
    let value = &result["value"];
    let degrees = degrees(&value["rotation"])?;
    let form = result["type"].as_str().unwrap_or_default();
    let shape = turned(value, form, (size, degrees)).ok_or(NO_SHAPE)?;
    let (labels, label) = (&value[form], &value[form][0]);
    let says_none = labels.is_null() || labels.as_array().is_some_and(Vec::is_empty);
    match says_none || label.is_string() || label.is_number() {
        true => Ok((text(label), shape)),
        false => Err("annotation whose label is no text"),
    }
}

fn turned(value: &Value, form: &str, (size, degrees): ([u32; 2], f64)) -> Option<Shape> {
    let scale = size.map(|side| f64::from(side) / 100.0);
    let number = |name: &str| value[name].as_f64();
    match form {
        "rectanglelabels" | "rectangle" => {
            let found = Rectangle {
                corner: [number("x")? * scale[0], number("y")? * scale[1]],
                size: [number("width")? * scale[0], number("height")? * scale[1]],
                degrees,
            };
            Some(Shape::Box(found))
        }
        "polygonlabels" | "polygon" => {
            let pixel = |point: &Value| {
                let [x, y]: [f64; 2] = numbers(point)?.try_into().ok()?;
                Some([x * scale[0], y * scale[1]])
            };
            let outline: Option<_> = value["points"].as_array()?.iter().map(pixel).collect();
            Some(Shape::Closed(outline?))
        }
        _ => None,
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
        Shape::Closed(points) | Shape::Open(points) => {
            let points = points.iter().map(|[x, y]| [x * percent[0], y * percent[1]]);
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
