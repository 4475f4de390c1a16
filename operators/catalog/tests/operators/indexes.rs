//! Indexes of views.

use evermap_contract::laws::inputs_of;
use evermap_schemas::Stamp;
use evermap_schemas::layers::{ClassLeaf, RelatedViews, SemanticArea, SemanticGraph, View};
use serde_json::json;

use crate::yields;

/// A view of one area of each class.
fn view(classes: usize) -> View {
    let area = |class: usize| SemanticArea {
        class: format!("class {class}"),
        pixels: 10,
        u: class as f32,
        v: 5.0,
        major_px: 4.0,
        minor_px: 3.0,
        orientation_rad: 0.0,
        eccentricity: 0.5,
    };
    View {
        site: "town".into(),
        session: "a".into(),
        stamp: Stamp(1),
        view: "a/1".into(),
        camera: "panorama".into(),
        graph: SemanticGraph {
            width: 1000,
            height: 10,
            wraps: false,
            field_of_view_rad: None,
            areas: (0..classes).map(area).collect(),
            edges: Vec::new(),
        },
        map_from_view: None,
        depth: None,
    }
}

/// Queries would be told by an index that the classes without a number are nowhere.
#[test]
fn a_site_of_too_many_classes_has_no_index() {
    for (classes, lost) in [(255, 0), (256, 1)] {
        let views = || [inputs_of("views", vec![view(classes)]).unwrap()];
        let (leaves, of_leaves) = yields::<ClassLeaf>("class_index", json!({}), views());
        let (related, of_related) = yields::<RelatedViews>("relation_index", json!({}), views());
        assert_eq!([leaves.is_empty(), related.is_empty()], [lost > 0; 2]);
        assert_eq!([of_leaves.total(), of_related.total()], [lost; 2]);
    }
}
