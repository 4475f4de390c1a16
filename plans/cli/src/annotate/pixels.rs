//! Boxes and outlines drawn on a mosaic with programs that know pixels: COCO, Label Studio.

use serde_json::Value;

use super::Losses;
use super::features::{Feature, Geometry};
use super::geojson::text;
use super::mosaic::Georeference;

/// A place in a picture, px from its upper left corner.
type Pixel = [f64; 2];

/// The annotations of a COCO file, all of one picture: segmentations of one outline, else boxes, turned by
/// `attributes.rotation` (degrees, clockwise, about their centre) as CVAT writes them.
pub(super) fn coco(value: &Value, mosaic: &Georeference, losses: &mut Losses) -> Vec<Feature> {
    let list = |name: &str| value[name].as_array().map_or(&[][..], Vec::as_slice);
    let pictures = list("images");
    let category = |id: &Value| {
        let mut categories = list("categories").iter();
        text(&categories.find(|category| category["id"] == *id)?["name"])
    };
    let mut found = Vec::new();
    for (number, annotation) in list("annotations").iter().enumerate() {
        let place = format!("annotation {number}");
        if pictures
            .first()
            .is_some_and(|first| first["id"] != annotation["image_id"])
        {
            losses.note("annotation of another picture than the first", &place);
            continue;
        }
        match coco_outline(annotation) {
            Some(outline) => found.push(feature(
                place,
                category(&annotation["category_id"]),
                &outline,
                mosaic,
            )),
            None => losses.note("annotation that is neither box nor outline", &place),
        }
    }
    found
}

fn coco_outline(annotation: &Value) -> Option<Vec<Pixel>> {
    let outlines = annotation["segmentation"].as_array().map(Vec::as_slice);
    if let Some([outline]) = outlines {
        let numbers: Vec<f64> = numbers(outline)?;
        let (pixels, []) = numbers.as_chunks::<2>() else {
            return None;
        };
        return Some(pixels.to_vec());
    }
    let [left, top, width, height]: [f64; 4] = numbers(&annotation["bbox"])?.try_into().ok()?;
    let degrees = annotation["attributes"]["rotation"].as_f64().unwrap_or(0.0);
    let centre = [left + width / 2.0, top + height / 2.0];
    let corners = rectangle([left, top], [width, height], 0.0);
    Some(
        corners
            .map(|corner| turned(corner, centre, degrees))
            .to_vec(),
    )
}

/// The results of Label Studio's tasks, all of one picture: rectangles, turned about their upper left corner, and polygons,
/// in percent of the picture.
pub(super) fn label_studio(
    tasks: &[Value],
    mosaic: &Georeference,
    losses: &mut Losses,
) -> Vec<Feature> {
    let mut found = Vec::new();
    for (task, value) in tasks.iter().enumerate() {
        let annotations = ["annotations", "completions"].map(|name| &value[name]);
        let annotations = annotations
            .into_iter()
            .filter_map(Value::as_array)
            .flatten();
        let held = annotations.filter(|annotation| annotation["was_cancelled"] != true);
        let results = held.filter_map(|annotation| annotation["result"].as_array());
        for (number, result) in results.flatten().enumerate() {
            let place = format!("task {task}, result {number}");
            match label_studio_outline(result) {
                Some((kind, outline)) => found.push(feature(place, kind, &outline, mosaic)),
                None => losses.note("annotation that is neither box nor outline", &place),
            }
        }
    }
    found
}

fn label_studio_outline(result: &Value) -> Option<(Option<String>, Vec<Pixel>)> {
    let size = [&result["original_width"], &result["original_height"]];
    let [width_px, height_px] = size.map(Value::as_f64);
    let (value, scale) = (&result["value"], [width_px? / 100.0, height_px? / 100.0]);
    let number = |name: &str| value[name].as_f64();
    match result["type"].as_str()? {
        kind @ ("rectanglelabels" | "rectangle") => {
            let corner = [number("x")? * scale[0], number("y")? * scale[1]];
            let size = [number("width")? * scale[0], number("height")? * scale[1]];
            let degrees = number("rotation").unwrap_or(0.0);
            Some((
                text(&value[kind][0]),
                rectangle(corner, size, degrees).to_vec(),
            ))
        }
        kind @ ("polygonlabels" | "polygon") => {
            let pixel = |point: &Value| {
                let [x, y]: [f64; 2] = numbers(point)?.try_into().ok()?;
                Some([x * scale[0], y * scale[1]])
            };
            let outline: Option<_> = value["points"].as_array()?.iter().map(pixel).collect();
            Some((text(&value[kind][0]), outline?))
        }
        _ => None,
    }
}

fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}

/// Corners of a rectangle that is turned clockwise, as seen, about its upper left one.
fn rectangle(corner: Pixel, [width, height]: [f64; 2], degrees: f64) -> [Pixel; 4] {
    let [x, y] = corner;
    let corners = [
        [x, y],
        [x + width, y],
        [x + width, y + height],
        [x, y + height],
    ];
    corners.map(|at| turned(at, corner, degrees))
}

/// A pixel turned clockwise, as seen, about another: rows grow downward.
fn turned(at: Pixel, about: Pixel, degrees: f64) -> Pixel {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (x, y) = (at[0] - about[0], at[1] - about[1]);
    [about[0] + cos * x - sin * y, about[1] + sin * x + cos * y]
}

fn feature(
    place: String,
    kind: Option<String>,
    outline: &[Pixel],
    mosaic: &Georeference,
) -> Feature {
    let corners = outline.iter().map(|pixel| (mosaic.place(*pixel), None));
    Feature {
        place,
        label: None,
        kind,
        standing: None,
        geometry: Some(Geometry::Closed(corners.collect())),
    }
}
