//! Features of GeoJSON whose coordinates are the map's metres.

mod coordinates;
mod members;

use evermap_catalog::painted::ImageKey;
use evermap_schemas::Fault;
use serde_json::Value;

use super::Losses;
use super::features::DrawnFeature;
use crate::annotate::geojson::members::WrittenFeature;
use crate::annotate::reading::Member;

pub use crate::annotate::geojson::members::GeoJsonFile;

/// The features of a collection, of one feature, or of a bare geometry.
///
/// # Errors
/// A user fault for a collection without a list of features, or with too many.
pub fn features(file: GeoJsonFile, losses: &mut Losses) -> Result<Vec<DrawnFeature>, Fault> {
    if let Some(name) = file.crs.name() {
        // Programs that know of no local metres write one.
        losses.remark(&format!(
            "note: coordinates are read as the map's metres, whatever `crs` of the file says: {name}"
        ));
    }
    let all = listed(file)?;
    let mut found = Vec::with_capacity(all.len());
    for (number, feature) in all.into_iter().enumerate() {
        let place = feature.place(number);
        match feature.drawn(place.clone()) {
            Ok(feature) => found.push(feature),
            Err(reason) => losses.note(reason, &place),
        }
    }
    Ok(found)
}

/// The features of a file as they stand there.
///
/// # Errors
/// As [`features`].
fn listed(file: GeoJsonFile) -> Result<Vec<WrittenFeature>, Fault> {
    match file.geometry.kind.text() {
        Some("FeatureCollection") if file.features.is != Member::List => {
            let fault =
                Fault::user("expected a list of features in a FeatureCollection, found none");
            Err(fault.next("export the features themselves as GeoJSON (in QGIS: Save Features As)"))
        }
        Some("FeatureCollection") => file.features.all("features"),
        Some("Feature") => Ok(vec![file.feature]),
        _ => Ok(vec![WrittenFeature::bare(file.geometry)]),
    }
}

/// The properties of a feature that say which image shows it.
pub fn of_image((session, stamp, camera): &ImageKey) -> Value {
    serde_json::json!({ "session": session, "stamp": stamp.0.to_string(), "camera": camera })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_schemas::Stamp;
    use serde_json::json;

    use super::*;
    use crate::annotate::reading::MOST_FEATURES;

    /// The features of a file, as it is read.
    fn features(value: &Value, losses: &mut Losses) -> Result<Vec<DrawnFeature>, Fault> {
        let file = serde_json::from_str(&value.to_string()).unwrap();
        super::features(file, losses)
    }

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
    fn a_collection_of_too_many_features_is_refused_and_they_are_not_held() {
        let read = |count: usize| {
            let listed = vec!["0"; count].join(",");
            let text = format!(r#"{{"features": [{listed}], "type": "FeatureCollection"}}"#);
            let file: GeoJsonFile = serde_json::from_str(&text).unwrap();
            assert!(file.features.first.len() <= MOST_FEATURES);
            super::features(file, &mut Losses::default())
        };
        assert_eq!(read(3).unwrap().len(), 3);
        let said = read(MOST_FEATURES + 1).unwrap_err().to_string();
        let expected = "expected at most 500000 features, found 500001";
        assert!(said.contains(expected), "{said}");
    }

    /// Whatever order its members have, and whatever they are.
    #[test]
    fn json_is_a_file_of_no_a_few_or_odd_features_and_never_more_than_it_says() {
        let told = |text: &str| {
            let file: GeoJsonFile = serde_json::from_str(text).unwrap();
            let mut losses = Losses::default();
            let found = super::features(file, &mut losses).unwrap();
            let drawn = found.iter().filter(|feature| feature.geometry.is_some());
            (found.len(), drawn.count(), losses.lines)
        };
        let line = r#"{"coordinates": [[0, 1], [2, 3]], "type": "LineString", "bbox": [0, 1e9]}"#;
        assert_eq!(told(line), (1, 1, vec![]));
        let feature = format!(r#"{{"geometry": {line}, "type": "Feature", "properties": [1]}}"#);
        assert_eq!(told(&feature), (1, 1, vec![]));
        let nothing = r#"{"geometry": null, "id": " "}"#;
        let all =
            format!(r#"{{"features": [{feature}, {nothing}, []], "type": "FeatureCollection"}}"#);
        assert_eq!(told(&all), (3, 1, vec![]));
        assert_eq!(told("null"), (1, 0, vec![]));
        let other = "feature 0: geometry that is neither polygon nor line".to_owned();
        for odd in [
            "3",
            "[]",
            "\"LineString\"",
            "{}",
            r#"{"type": ["Feature"]}"#,
        ] {
            assert_eq!(told(odd), (0, 0, vec![other.clone()]), "{odd}");
        }
        let odd = r#"{"type": "Feature", "id": true, "properties": {"label": {"a": 1}}}"#;
        let told = told(odd).2;
        assert!(told[0].contains("neither text nor number"), "{told:?}");
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
