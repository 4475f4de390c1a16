//! Common Objects in Context.

use std::collections::{BTreeSet, HashMap};

use evermap_algorithms::ground::boxes::area;
use evermap_schemas::Fault;
use serde_json::{Value, json};

use super::described::{Canvas, DescribedPicture, OF_ANOTHER, which_are};
use super::{
    DrawnShape, NAME, NO_SHAPE, PictureAnnotations, Rectangle, Shape, degrees, kinds, listed,
    numbers, written,
};
use crate::annotate::Losses;
use crate::annotate::geojson::text;
use crate::annotate::mosaic::Picture;

/// The annotations of pictures: segmentations of one outline, else boxes, turned by `attributes.rotation` (degrees,
/// clockwise, about their centre) as CVAT writes them.
///
/// # Errors
/// A user fault for a file without lists of pictures and annotations, annotations of other pictures alone, and pictures or
/// categories that have an id in common.
pub(super) fn read(
    value: &Value,
    canvases: &[Canvas],
    losses: &mut Losses,
) -> Result<PictureAnnotations, Fault> {
    let list = |name: &str| listed(value, name)?.ok_or_else(|| lacking(name));
    let (pictures, annotations) = (list("images")?, list("annotations")?);
    let categories = listed(value, "categories")?.unwrap_or_default();
    distinct("images", pictures, "file_name")?;
    distinct("categories", categories, "name")?;
    if pictures.is_empty() {
        of_one(annotations)?;
    }
    let described: Vec<DescribedPicture> = pictures.iter().map(described).collect();
    let chosen = which_are(canvases, &described, losses)?;
    let mut said = PictureAnnotations {
        drawn: Vec::new(),
        seen: chosen.iter().copied().flatten().collect(),
        unread: BTreeSet::new(),
    };
    let known = by_id(pictures.iter().zip(chosen));
    let names = by_id(categories.iter().map(|one| (one, text(&one["name"]))));
    // A file without pictures is of the only one that there is.
    let picture_of = |id: &Value| match pictures {
        [] => Some(0),
        _ => known.get(id).copied().flatten(),
    };
    let mut may_be_of_any = false;
    for (number, annotation) in annotations.iter().enumerate() {
        let place = format!("annotation {number}");
        let id = &annotation["image_id"];
        let Some(at) = picture_of(id) else {
            losses.note(OF_ANOTHER, &place);
            may_be_of_any |= !known.contains_key(id);
            continue;
        };
        let read = shape(annotation)
            .and_then(|shape| Ok((shape, category(&names, &annotation["category_id"])?)));
        match read {
            Ok((shape, kind)) => {
                if is_coarse(&annotation["segmentation"]) {
                    losses.note(BOX_OF, &place);
                }
                let name = text(&annotation["attributes"][NAME]);
                let drawn = DrawnShape::said(place, kind, shape);
                said.drawn.push(drawn.called(name).on(at));
            }
            Err(reason) => {
                losses.note(reason, &place);
                said.unread.insert(at);
            }
        }
    }
    if may_be_of_any {
        said.unread.extend(&said.seen);
    }
    Ok(said)
}

/// What is known of each of a list, by its id; of those that have one in common, of the first.
fn by_id<'v, T>(list: impl Iterator<Item = (&'v Value, T)>) -> HashMap<&'v Value, T> {
    let mut known = HashMap::new();
    for (one, what) in list {
        known.entry(&one["id"]).or_insert(what);
    }
    known
}

/// That a file has no such list: nothing that is not in it is gone.
fn lacking(name: &str) -> Fault {
    let fault = Fault::user(format!(
        "expected lists of images and annotations of COCO, found no `{name}`"
    ));
    fault.next("export all of it from the program that it was drawn with")
}

/// That annotations of a file without pictures are all of one.
///
/// # Errors
/// A user fault with two of the pictures.
fn of_one(annotations: &[Value]) -> Result<(), Fault> {
    let pairs = annotations.windows(2);
    let mut pairs = pairs.map(|two| (&two[0]["image_id"], &two[1]["image_id"]));
    match pairs.find(|(one, other)| one != other) {
        None => Ok(()),
        Some((one, other)) => Err(Fault::user(format!(
            "expected the images that annotations are of, found an empty list, and annotations of images {one} and {other}"
        ))
        .next("export the file with its images")),
    }
}

/// What an annotation marks; `None` where it does not say.
///
/// # Errors
/// In words, for a category that has no name.
fn category(
    names: &HashMap<&Value, Option<String>>,
    id: &Value,
) -> Result<Option<String>, &'static str> {
    if id.is_null() {
        return Ok(None);
    }
    let name = names.get(id).cloned().flatten();
    name.map(Some)
        .ok_or("annotation of a category that the file does not name")
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
    let mut first: HashMap<&Value, &Value> = HashMap::new();
    for one in list {
        let id = &one["id"];
        let first = *first.entry(id).or_insert(one);
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

fn described(picture: &Value) -> DescribedPicture {
    DescribedPicture {
        id: Some(picture["id"].to_string()),
        name: text(&picture["file_name"]),
        size: ["width", "height"].map(|name| written(&picture[name])),
    }
}

fn shape(annotation: &Value) -> Result<Shape, &'static str> {
    let outlines = annotation["segmentation"].as_array().map(Vec::as_slice);
    if let Some([outline]) = outlines {
        return closed(outline).ok_or(NO_SHAPE);
    }
    let sides: Option<[f64; 4]> =
        numbers(&annotation["bbox"]).and_then(|sides| sides.try_into().ok());
    let [left, top, width, height] = sides.ok_or(NO_SHAPE)?;
    let degrees = degrees(&annotation["attributes"]["rotation"])?;
    let found = Rectangle::about_middle([left, top], [width, height], degrees);
    Ok(Shape::Box(found))
}

fn closed(outline: &Value) -> Option<Shape> {
    let numbers: Vec<f64> = numbers(outline)?;
    let (pixels, []) = numbers.as_chunks::<2>() else {
        return None;
    };
    Some(Shape::Closed(pixels.to_vec()))
}

/// Outlines, with the boxes around them.
pub(super) fn write(drawn: &[DrawnShape], picture: &Picture) -> String {
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
