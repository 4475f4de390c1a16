//! Common Objects in Context.

mod written;

use std::collections::{BTreeSet, HashMap};

use evermap_algorithms::ground::boxes::area;
use evermap_schemas::Fault;
use serde_json::{Value, json};

use super::described::{Canvas, DescribedPicture, OF_ANOTHER, which_are};
use super::{DrawnShape, NAME, PictureAnnotations, kinds};
use crate::annotate::mosaic::Picture;
use crate::annotate::reading::{AnyJson, Listed, Member};
use crate::annotate::{Losses, no_json};
use written::{CocoFile, WrittenAnnotation, WrittenPicture};

/// The annotations of pictures: segmentations of one outline, else boxes, turned by `attributes.rotation` (degrees,
/// clockwise, about their centre) as CVAT writes them.
///
/// # Errors
/// A user fault for a file without lists of pictures and annotations, or with too long ones, annotations of other pictures alone,
/// and pictures or categories that have an id in common.
pub(super) fn read(
    text: &str,
    canvases: &[Canvas],
    losses: &mut Losses,
) -> Result<PictureAnnotations, Fault> {
    let read = serde_json::from_str::<AnyJson<CocoFile>>(text);
    let AnyJson(file) = read.map_err(|error| no_json(&error))?;
    let pictures = required(file.images, "images")?;
    let annotations = required(file.annotations, "annotations")?;
    let categories = file.categories.if_there("categories")?.unwrap_or_default();
    distinct(
        "images",
        pictures.iter().map(|one| (&one.id, &one.file_name)),
    )?;
    distinct(
        "categories",
        categories.iter().map(|one| (&one.id, &one.name)),
    )?;
    if pictures.is_empty() {
        of_one(&annotations)?;
    }
    let described: Vec<DescribedPicture> = pictures.iter().map(described).collect();
    let chosen = which_are(canvases, &described, losses)?;
    let mut said = PictureAnnotations {
        drawn: Vec::new(),
        seen: chosen.iter().copied().flatten().collect(),
        unread: BTreeSet::new(),
    };
    let known = by_id(pictures.iter().map(|one| &one.id).zip(chosen));
    let names = by_id(categories.iter().map(|one| (&one.id, one.name.word())));
    // A file without pictures is of the only one that there is.
    let picture_of = |id: &Member| match pictures.is_empty() {
        true => Some(0),
        false => known.get(id).copied().flatten(),
    };
    let mut may_be_of_any = false;
    for (number, annotation) in annotations.into_iter().enumerate() {
        let place = format!("annotation {number}");
        let id = &annotation.image_id;
        let Some(at) = picture_of(id) else {
            losses.note(OF_ANOTHER, &place);
            may_be_of_any |= !known.contains_key(id);
            continue;
        };
        let (name, is_coarse) = (annotation.name(), annotation.is_coarse());
        let kind = category(&names, &annotation.category_id);
        match annotation.shape().and_then(|shape| Ok((shape, kind?))) {
            Ok((shape, kind)) => {
                if is_coarse {
                    losses.note(BOX_OF, &place);
                }
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

/// A list that a file must have.
///
/// # Errors
/// A user fault where there is none, or too long a one.
fn required<T>(list: Listed<T>, name: &str) -> Result<Vec<T>, Fault> {
    list.if_there(name)?.ok_or_else(|| lacking(name))
}

/// What is known of each of a list, by its id; of those that have one in common, of the first.
fn by_id<'v, T>(list: impl Iterator<Item = (&'v Member, T)>) -> HashMap<&'v Member, T> {
    let mut known = HashMap::new();
    for (id, what) in list {
        known.entry(id).or_insert(what);
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
fn of_one(annotations: &[WrittenAnnotation]) -> Result<(), Fault> {
    let pairs = annotations.windows(2);
    let mut pairs = pairs.map(|two| (&two[0].image_id, &two[1].image_id));
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
    names: &HashMap<&Member, Option<String>>,
    id: &Member,
) -> Result<Option<String>, &'static str> {
    if *id == Member::Nothing {
        return Ok(None);
    }
    let name = names.get(id).cloned().flatten();
    name.map(Some)
        .ok_or("annotation of a category that the file does not name")
}

/// What is told of an annotation whose outline is not taken.
const BOX_OF: &str = "annotation of several outlines, or of a mask, taken as the box around it";

/// That those of a list which have an id in common are one and the same, by the names that they have: annotations say nothing else
/// of them.
///
/// # Errors
/// A user fault with what two of them are called.
fn distinct<'v>(
    what: &str,
    list: impl Iterator<Item = (&'v Member, &'v Member)>,
) -> Result<(), Fault> {
    let mut first: HashMap<&Member, &Member> = HashMap::new();
    for (id, name) in list {
        let known = *first.entry(id).or_insert(name);
        if known != name {
            let fault = format!(
                "expected an id of its own for each of {what}, found {id} of {known} and of {name}"
            );
            return Err(Fault::user(fault).next(
                "number them anew: files that were put together each begin with the same ids",
            ));
        }
    }
    Ok(())
}

fn described(picture: &WrittenPicture) -> DescribedPicture {
    DescribedPicture {
        id: Some(picture.id.to_string()),
        name: picture.file_name.word(),
        size: [&picture.width, &picture.height].map(Member::written),
    }
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
