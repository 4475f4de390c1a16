//! Label images of logs: what has a class, and what is counted.

use std::collections::BTreeMap;

use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::LabelImage;
use evermap_schemas::roles::LabelClass;
use evermap_vision::decode_labels;
use serde_json::json;

use crate::pixels::shot;
use crate::yields;

/// A PGM of three pixels of 16 bits.
fn sixteen_bits(values: [u16; 3]) -> Vec<u8> {
    let values = values.map(u16::to_be_bytes).concat();
    [b"P5\n3 1\n65535\n".to_vec(), values].concat()
}

#[test]
fn images_with_values_above_255_are_kept_and_counted_and_those_have_no_class() {
    let shots = vec![
        shot(0, sixteen_bits([0, 7, 255])),
        shot(1, sixteen_bits([0, 26_000, 7])),
    ];
    let class = |(value, class): (u8, &str)| LabelClass {
        site: "street".into(),
        session: "a".into(),
        value,
        class: class.into(),
    };
    let classes = [(0, "road"), (7, "car"), (255, "sky")].map(class);
    let inputs = [
        inputs_of("labels", shots).unwrap(),
        inputs_of("classes", classes.to_vec()).unwrap(),
    ];
    let (found, losses) = yields::<LabelImage>("recorded_labels", json!({}), inputs);
    let pixels = found.iter().map(|row| decode_labels(&row.png.0).unwrap());
    let pixels: Vec<_> = pixels.map(|labels| labels.data).collect();
    assert_eq!(pixels, [[0, 1, 2], [0, 255, 1]]);
    assert_eq!(found[0].classes, ["road", "car", "sky"]);
    let reason = "label image has values without a class".to_owned();
    assert_eq!(losses.0, BTreeMap::from([(reason, 1)]));
}
