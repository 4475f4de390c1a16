//! Features of GeoJSON whose coordinates are the map's metres.

use evermap_catalog::painted::ImageKey;
use evermap_schemas::{Fault, Stamp};
use serde_json::Value;

use super::features::{DrawnFeature, Geometry, Point};
use super::{Losses, is_blank};

/// The features of a collection, of one feature, or of a bare geometry.
///
/// # Errors
/// A user fault for a collection without a list of features.
pub fn features(value: &Value, losses: &mut Losses) -> Result<Vec<DrawnFeature>, Fault> {
    if let Some(name) = value["crs"]["properties"]["name"].as_str() {
        // Programs that know of no local metres write one.
        losses.remark(&format!(
            "note: coordinates are read as the map's metres, whatever `crs` of the file says: {name}"
        ));
    }
    let all = match value["type"].as_str() {
        Some("FeatureCollection") => value["features"].as_array().cloned().ok_or_else(|| {
            Fault::user("expected a list of features in a FeatureCollection, found none")
                .next("export the features themselves as GeoJSON (in QGIS: Save Features As)")
        })?,
        Some("Feature") => vec![value.clone()],
        _ => vec![serde_json::json!({ "type": "Feature", "geometry": value })],
    };
    let mut found = Vec::with_capacity(all.len());
    for (number, value) in all.iter().enumerate() {
        let place = match text(label(value)) {
            Some(label) => format!("feature {number}, label {label}"),
            None => format!("feature {number}"),
        };
        match feature(value, &place) {
            Ok(feature) => found.push(feature),
            Err(reason) => losses.note(reason, &place),
        }
    }
    Ok(found)
}

/// # Errors
/// In words, for what is no feature of a map.
fn feature(value: &Value, place: &str) -> Result<DrawnFeature, &'static str> {
    let properties = &value["properties"];
    Ok(DrawnFeature {
        place: place.to_owned(),
        label: said(label(value))?,
        within_m: None,
        kind: said(&properties["kind"])?,
        category: None,
        standing: said(&properties["standing"])?,
        geometry: geometry(&value["geometry"])?,
        brush_px: properties["brush_px"].as_f64(),
        image: image(&properties["image"])?,
    })
}

/// The label that a feature is: its property `label`, and only where it has no such property its `id`, which other programs
/// make of the numbers of rows.
fn label(feature: &Value) -> &Value {
    let property = feature["properties"].get("label");
    property.unwrap_or(&feature["id"])
}

/// A text, where there is one.
///
/// # Errors
/// In words, for what is there and is none: what it says is not known.
fn said(value: &Value) -> Result<Option<String>, &'static str> {
    match value {
        Value::Array(_) | Value::Object(_) | Value::Bool(_) => {
            Err("feature whose label, kind or standing is neither text nor number")
        }
        value => Ok(text(value)),
    }
}

/// A text that is not blank, or a number as text.
pub(super) fn text(value: &Value) -> Option<String> {
    match value {
        Value::String(text) if !is_blank(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

/// The image that shows a feature; `None` where it names none. Its instant (ns) may be a text: JavaScript rounds such numbers.
fn image(value: &Value) -> Result<Option<ImageKey>, &'static str> {
    if value.is_null() {
        return Ok(None);
    }
    let stamp = &value["stamp"];
    let stamp = stamp.as_i64().or_else(|| stamp.as_str()?.parse().ok());
    match (text(&value["session"]), stamp, text(&value["camera"])) {
        (Some(session), Some(stamp), Some(camera)) => Ok(Some((session, Stamp(stamp), camera))),
        _ => Err("feature of an image without session, stamp (ns) and camera"),
    }
}

/// The properties of a feature that say which image shows it.
pub fn of_image((session, stamp, camera): &ImageKey) -> Value {
    serde_json::json!({ "session": session, "stamp": stamp.0.to_string(), "camera": camera })
}

/// The outline of a geometry; `None` for a feature that has none.
fn geometry(value: &Value) -> Result<Option<Geometry>, &'static str> {
    let coordinates = &value["coordinates"];
    let only = |parts: &Value| match parts.as_array().map(Vec::as_slice) {
        Some([one]) => Ok(one.clone()),
        _ => Err("geometry of several parts"),
    };
    Ok(Some(match value["type"].as_str() {
        None if value.is_null() => return Ok(None),
        Some("LineString") => Geometry::Open(points(coordinates)?),
        Some("MultiLineString") => Geometry::Open(points(&only(coordinates)?)?),
        Some("Polygon") => ring(coordinates)?,
        Some("MultiPolygon") => ring(&only(coordinates)?)?,
        _ => return Err("geometry that is neither polygon nor line"),
    }))
}

fn ring(rings: &Value) -> Result<Geometry, &'static str> {
    match rings.as_array().map(Vec::as_slice) {
        Some([outer]) => Ok(Geometry::Closed(points(outer)?)),
        Some([_, ..]) => Err("polygon with holes"),
        _ => Err("polygon without a ring"),
    }
}

fn points(positions: &Value) -> Result<Vec<Point>, &'static str> {
    let bad = "feature with a position that is not a list of numbers";
    let point = |position: &Value| {
        let numbers: Option<Vec<f64>> = position.as_array()?.iter().map(Value::as_f64).collect();
        match numbers?.as_slice() {
            [x, y] => Some(([*x, *y], None)),
            [x, y, z, ..] => Some(([*x, *y], Some(*z))),
            _ => None,
        }
    };
    let points: Option<Vec<Point>> = positions.as_array().ok_or(bad)?.iter().map(point).collect();
    points.ok_or(bad)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use serde_json::json;

    use super::*;

    #[test]
    fn the_property_label_goes_before_the_number_of_a_row() {
        let named = |id: Value, properties: Value| {
            let feature =
                json!({ "type": "Feature", "id": id, "properties": properties, "geometry": null });
            let mut losses = Losses::default();
            let mut found = features(&feature, &mut losses).unwrap();
            assert_eq!((found.len(), losses), (1, Losses::default()));
            found.remove(0).label
        };
        let one = Some("one".to_owned());
        assert_eq!(named("0".into(), json!({ "label": "one" })), one);
        assert_eq!(named(Value::Null, json!({ "label": "one" })), one);
        assert_eq!(named("one".into(), json!({ "kind": "arrow" })), one);
        assert_eq!(named("one".into(), Value::Null), one);
        assert_eq!(named(1.into(), json!({})), Some("1".to_owned()));
        // A row that was drawn among labels: it has none yet.
        assert_eq!(named("4".into(), json!({ "label": null })), None);
    }

    #[test]
    fn an_image_is_named_by_session_stamp_and_camera_or_not_at_all() {
        let read = |image: Value| {
            let properties = json!({ "kind": "person", "image": image });
            let feature = json!({ "type": "Feature", "properties": properties, "geometry": null });
            let mut losses = Losses::default();
            let found = features(&feature, &mut losses).unwrap();
            assert_eq!(found.len() + losses.lines.len(), 1);
            found.into_iter().next().map(|feature| feature.image)
        };
        let image = (
            "a".to_owned(),
            Stamp(1_799_999_999_123_456_789),
            "front".to_owned(),
        );
        assert_eq!(read(of_image(&image)), Some(Some(image.clone())));
        let number = json!({ "session": "a", "stamp": image.1.0, "camera": "front" });
        assert_eq!(read(number), Some(Some(image)));
        assert_eq!(read(Value::Null), Some(None));
        for bad in [
            json!({}),
            json!("a"),
            json!({ "session": "a", "stamp": 1.5, "camera": "front" }),
            json!({ "session": "a", "stamp": "soon", "camera": "front" }),
            json!({ "session": "", "stamp": 1, "camera": "front" }),
            json!({ "session": "a", "stamp": 1 }),
        ] {
            assert_eq!(read(bad.clone()), None, "{bad}");
        }
    }

    #[test]
    fn what_a_feature_says_in_no_words_is_not_taken_for_nothing() {
        for (name, value) in [
            ("label", json!({ "name": "one" })),
            ("kind", json!(["car"])),
            ("standing", json!(true)),
        ] {
            let properties = json!({ name: value });
            let feature = json!({ "type": "Feature", "properties": properties, "geometry": null });
            let mut losses = Losses::default();
            assert!(features(&feature, &mut losses).unwrap().is_empty());
            let told =
                "feature 0: feature whose label, kind or standing is neither text nor number";
            assert_eq!(losses.lines, [told]);
        }
    }

    #[test]
    fn a_reference_system_is_told_and_coordinates_are_metres() {
        let name = "urn:ogc:def:crs:EPSG::4326";
        let crs = json!({ "type": "name", "properties": { "name": name } });
        let file = json!({ "type": "FeatureCollection", "features": [], "crs": crs });
        let mut losses = Losses::default();
        features(&file, &mut losses).unwrap();
        assert!(losses.counts.is_empty() && losses.lines[0].contains(name));
    }

    #[test]
    fn a_collection_without_features_is_refused() {
        let read = |value: Value| features(&value, &mut Losses::default());
        let empty = json!({ "type": "FeatureCollection", "features": [] });
        assert!(read(empty).unwrap().is_empty());
        for features in [Value::Null, 3.into(), json!({ "0": {} })] {
            let fault = read(json!({ "type": "FeatureCollection", "features": features }));
            let said = fault.unwrap_err().to_string();
            assert!(said.contains("expected a list of features"), "{said}");
        }
    }
}
