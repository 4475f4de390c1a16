//! Common Objects in Context.

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::ground::boxes::area;
use evermap_schemas::Fault;
use serde_json::{Value, json};

use super::described::{Canvas, Described, OF_ANOTHER, which_are};
use super::{Drawn, NAME, Rectangle, Said, Shape, both, kinds, numbers};
use crate::annotate::Losses;
use crate::annotate::geojson::text;
use crate::annotate::mosaic::Picture;

/// The annotations of pictures: segmentations of one outline, else boxes, turned by `attributes.rotation` (degrees,
/// clockwise, about their centre) as CVAT writes them.
///
/// # Errors
/// A user fault for annotations of other pictures alone, and for pictures or categories that have an id in common.
pub(super) fn read(value: &Value, canvases: &[Canvas], losses: &mut Losses) -> Result<Said, Fault> {
    let list = |name: &str| value[name].as_array().map_or(&[][..], Vec::as_slice);
    let pictures = list("images");
    distinct("images", pictures, "file_name")?;
    distinct("categories", list("categories"), "name")?;
    let described: Vec<Described> = pictures.iter().map(described).collect();
    let chosen = which_are(canvases, &described, losses)?;
    let chosen = pictures.iter().zip(chosen);
    let chosen: Vec<(&Value, usize)> = chosen
        .filter_map(|(picture, at)| Some((&picture["id"], at?)))
        .collect();
    // A file without pictures is of the only one that there is.
    let picture_of = |id: &Value| match pictures {
        [] => Some(0),
        _ => chosen.iter().find(|(of, _)| *of == id).map(|(_, at)| *at),
    };
    let category = |id: &Value| {
        let mut categories = list("categories").iter();
        text(&categories.find(|category| category["id"] == *id)?["name"])
    };
    let mut said = Said {
        drawn: Vec::new(),
        seen: chosen.iter().map(|(_, at)| *at).collect(),
        unread: BTreeSet::new(),
    };
    for (number, annotation) in list("annotations").iter().enumerate() {
        let place = format!("annotation {number}");
        let Some(at) = picture_of(&annotation["image_id"]) else {
            losses.note(OF_ANOTHER, &place);
            continue;
        };
        match shape(annotation) {
            Some(shape) => {
                if is_coarse(&annotation["segmentation"]) {
                    losses.note(BOX_OF, &place);
                }
                let kind = category(&annotation["category_id"]);
                let name = text(&annotation["attributes"][NAME]);
                let drawn = Drawn::said(place, kind, shape);
                said.drawn.push(drawn.called(name).on(at));
            }
            None => {
                losses.note("annotation that is neither box nor outline", &place);
                said.unread.insert(at);
            }
        }
    }
    Ok(said)
}

/// What is told of an annotation whose outline is not taken.
const BOX_OF: &str = "annotation of several outlines, or of a mask, taken as the box around it";

/// Whether a segmentation is neither one outline nor none.
fn is_coarse(segmentation: &Value) -> bool {
    match segmentation {
        Value::Array(outlines) => outlines.len() > 1,
        Value::Object(_) => true,
        _ => false,
    }
}

/// That those of a list which have an id in common are one and the same: annotations say nothing else of them.
///
/// # Errors
/// A user fault with what two of them are called.
fn distinct(what: &str, list: &[Value], name: &str) -> Result<(), Fault> {
    let mut first: BTreeMap<String, &Value> = BTreeMap::new();
    for one in list {
        let id = one["id"].to_string();
        let first = *first.entry(id.clone()).or_insert(one);
        if first[name] != one[name] {
            let (one, other) = (&first[name], &one[name]);
            let fault = format!(
                "expected an id of its own for each of {what}, found {id} of {one} and of {other}"
            );
            return Err(Fault::user(fault).next(
                "number them anew: files that were put together each begin with the same ids",
            ));
        }
    }
    Ok(())
}

fn described(picture: &Value) -> Described {
    let size = ["width", "height"].map(|name| picture[name].as_f64());
    Described {
        id: Some(picture["id"].to_string()),
        name: text(&picture["file_name"]),
        size: both(size),
    }
}

fn shape(annotation: &Value) -> Option<Shape> {
    let outlines = annotation["segmentation"].as_array().map(Vec::as_slice);
    if let Some([outline]) = outlines {
        let numbers: Vec<f64> = numbers(outline)?;
        let (pixels, []) = numbers.as_chunks::<2>() else {
            return None;
        };
        return Some(Shape::Closed(pixels.to_vec()));
    }
    let [left, top, width, height]: [f64; 4] = numbers(&annotation["bbox"])?.try_into().ok()?;
    let degrees = annotation["attributes"]["rotation"].as_f64().unwrap_or(0.0);
    let found = Rectangle::about_middle([left, top], [width, height], degrees);
    Some(Shape::Box(found))
}

/// Outlines, with the boxes around them.
pub(super) fn write(drawn: &[Drawn], picture: &Picture) -> String {
    let kinds = kinds(drawn);
    let annotations = drawn.iter().enumerate().map(|(number, drawn)| {
        let points = drawn.shape.points();
        let [[left, top], [right, bottom]] = drawn.shape.bounds();
        let kind = drawn.kind.as_deref().unwrap_or_default();
        json!({
            "id": number + 1,
            "image_id": 1,
            "category_id": kinds.binary_search(&kind).map_or(0, |at| at + 1),
            "segmentation": [points.concat()],
            "bbox": [left, top, right - left, bottom - top],
            "area": area(&points),
            "iscrowd": 0,
            "attributes": { NAME: drawn.name },
        })
    });
    let annotations: Vec<Value> = annotations.collect();
    let [width, height] = picture.size;
    let categories = kinds.iter().enumerate();
    let categories = categories.map(|(at, kind)| json!({ "id": at + 1, "name": kind }));
    let whole = json!({
        "images": [{ "id": 1, "file_name": picture.name, "width": width, "height": height }],
        "categories": categories.collect::<Vec<_>>(),
        "annotations": annotations,
    });
    format!("{whole:#}\n")
}
