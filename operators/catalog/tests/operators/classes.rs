//! As many classes as labels tell apart, and one more.

use std::collections::BTreeSet;

use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{
    InferredLabels, LabelImage, OcclusionProbability, View, WarpedLabels,
};
use evermap_schemas::{Bytes, Stamp};
use evermap_vision::{Grey, encode_png};
use serde_json::json;

use crate::yields;

/// A side of the image: 16 × 16 pixels have all 256 values.
const SIDE: u32 = 16;

fn classes(number: usize) -> Vec<String> {
    (0..number).map(|class| format!("class {class}")).collect()
}

/// Each value once, row by row.
fn png() -> Bytes {
    let image = Grey {
        width: SIDE,
        height: SIDE,
        data: (0..=u8::MAX).collect(),
    };
    Bytes(encode_png(&image).unwrap())
}

#[test]
fn views_have_as_many_classes_as_labels_tell_apart() {
    for (number, shown, lost) in [(255, 1, 0), (256, 0, 1)] {
        let image = LabelImage {
            site: "town".into(),
            session: "a".into(),
            stamp: Stamp(1),
            camera: "panorama".into(),
            width: SIDE,
            height: SIDE,
            classes: classes(number),
            png: png(),
        };
        let labels = [inputs_of("labels", vec![image]).unwrap()];
        let (views, losses) = yields::<View>("views", json!({ "min_area_share": 0.0 }), labels);
        assert_eq!((views.len(), losses.total()), (shown, lost), "{losses:?}");
        for view in views {
            let found = view.graph.areas.iter().map(|area| area.class.clone());
            let found: BTreeSet<String> = found.collect();
            assert_eq!(found, classes(number).into_iter().collect());
        }
    }
}

#[test]
fn the_last_class_of_all_may_be_what_moves() {
    for (number, told, lost) in [(255, 1, 0), (256, 0, 1)] {
        let warped = WarpedLabels {
            site: "town".into(),
            session: "a".into(),
            stamp: Stamp(1),
            camera: "panorama".into(),
            width: SIDE,
            height: SIDE,
            classes: classes(number),
            png: png(),
            views: 0,
            occlusions: Vec::new(),
            unseen_px: 1,
            unclear_px: 0,
        };
        let behind = OcclusionProbability {
            site: "town".into(),
            dynamic: "class 254".into(),
            class: "class 253".into(),
            pixels: 10,
            probability: 1.0,
            deviation: 0.1,
        };
        let tables = [
            inputs_of("warped_labels", vec![warped]).unwrap(),
            inputs_of("occlusion_model", vec![behind]).unwrap(),
        ];
        let params = json!({ "dynamic": ["class 254"], "min_area_share": 0.0 });
        let (rows, losses) = yields::<InferredLabels>("inferred_labels", params, tables);
        assert_eq!((rows.len(), losses.total()), (told, lost), "{losses:?}");
        for row in rows {
            let inferred = row.inferred.iter();
            let inferred = inferred.map(|area| (area.dynamic.as_str(), area.class.as_str()));
            assert_eq!(inferred.collect::<Vec<_>>(), [("class 254", "class 253")]);
        }
    }
}
