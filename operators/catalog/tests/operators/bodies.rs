//! The vehicle's own body: found in what its camera saw, and left out of what is made of that.

use arrow::array::RecordBatch;
use evermap_contract::GivenFile;
use evermap_contract::laws::{Split, inputs_of, run};
use evermap_schemas::layers::{BodyMask, Features, Keyframe};
use evermap_schemas::{Bytes, Pose, Stamp, record};
use evermap_vision::{Grey, decode_labels, encode_png};
use serde_json::{Value, json};

use crate::yields;

const WIDTH: u32 = 400;
const HEIGHT: u32 = 300;

record! {
    /// One image of a keyframe with its pixels.
    #[layer("keyframe_images", key(site, session, stamp, camera))]
    pub struct Photo {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Instant.
        stamp: Stamp,
        /// Number.
        keyframe: u32,
        /// Camera.
        camera: String,
        /// Encoded pixels.
        image: Bytes,
    }
}

/// A bonnet with a bright emblem.
fn body(u: u32, v: u32) -> Option<u8> {
    let emblem = (180..220).contains(&u) && (250..264).contains(&v);
    (v >= 235).then_some(if emblem { 230 } else { 40 })
}

/// Blocks that are others in every image, and the body below them.
fn photo(n: u32) -> Photo {
    let mut bytes = format!("P5\n{WIDTH} {HEIGHT}\n255\n").into_bytes();
    for at in 0..WIDTH * HEIGHT {
        let (u, v) = (at % WIDTH, at / WIDTH);
        let block = u64::from(u / 12) * 1009 + u64::from(v / 12) * 9176 + u64::from(n) * 31;
        let mixed = block.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let scenery = 100 + ((mixed >> 40) % 120) as u8;
        bytes.push(body(u, v).unwrap_or(scenery));
    }
    Photo {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(i64::from(n)),
        keyframe: n,
        camera: "front".into(),
        image: Bytes(bytes),
    }
}

fn drive(count: u32) -> [(String, RecordBatch); 2] {
    let keyframes = (0..count).map(|n| Keyframe {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(i64::from(n)),
        keyframe: n,
        distance_m: 1.5 * f64::from(n),
        stretch: 0,
        odom_from_vehicle: Pose::IDENTITY,
        images: Vec::new(),
    });
    [
        inputs_of("images", (0..count).map(photo).collect()).unwrap(),
        inputs_of("keyframes", keyframes.collect()).unwrap(),
    ]
}

fn masks(count: u32) -> Vec<BodyMask> {
    masks_with(count, json!({}))
}

fn masks_with(count: u32, params: Value) -> Vec<BodyMask> {
    let (masks, losses) = yields("body_masks", params, drive(count));
    assert!(losses.is_empty(), "{losses:?}");
    masks
}

/// What a manifest gives for an image of this size that shows the vehicle below a row.
fn file([width, height]: [u32; 2], below: u32) -> GivenFile {
    let pixels = (0..width * height).map(|at| u8::from(at / width >= below));
    let image = Grey {
        width,
        height,
        data: pixels.collect(),
    };
    GivenFile {
        file: "body.png".into(),
        hex: encode_png(&image).unwrap(),
    }
}

/// Features above and on the body.
fn features(masks: Vec<BodyMask>) -> [usize; 2] {
    features_with(masks, json!({}))
}

fn features_with(masks: Vec<BodyMask>, params: Value) -> [usize; 2] {
    let inputs = [
        inputs_of("images", vec![photo(7)]).unwrap(),
        inputs_of("body_masks", masks).unwrap(),
    ];
    let (found, _) = yields::<Features>("features", params, inputs);
    let on_body = found[0].v.iter().filter(|v| **v > 240.0).count();
    [found[0].v.len() - on_body, on_body]
}

#[test]
fn a_bonnet_is_learnt_and_has_no_features() {
    let learnt = masks(60);
    let mask = decode_labels(&learnt[0].png.0).unwrap();
    let wrong = (0..WIDTH * HEIGHT).filter(|at| {
        let is_body = body(at % WIDTH, at / WIDTH).is_some();
        (mask.data[*at as usize] > 0) != is_body
    });
    // Every other image is 3 m from the one before; the outline is a cell or two thick.
    assert_eq!(learnt[0].images, 30);
    assert!(wrong.count() as u32 <= 6 * WIDTH);
    let ([above, on_body], [above_too, masked]) = (features(vec![]), features(learnt));
    assert!(on_body > 0 && masked == 0, "{on_body} and {masked}");
    assert!(above > 50 && above_too > 50, "{above} and {above_too}");
}

#[test]
fn a_short_drive_masks_nothing() {
    let learnt = masks(20);
    assert_eq!((learnt[0].images, learnt[0].share), (10, 0.0));
    assert!(features(learnt)[1] > 0);
}

/// Where a mask covers the image: the highest row, and how many pixels.
fn covered(mask: &BodyMask) -> (u32, usize) {
    let shown = decode_labels(&mask.png.0).unwrap();
    assert_eq!([shown.width, shown.height], [WIDTH, HEIGHT]);
    assert!(shown.data.iter().all(|value| [0, 255].contains(value)));
    let first = shown.data.iter().position(|value| *value > 0).unwrap();
    let pixels = shown.data.iter().filter(|value| **value > 0).count();
    (first as u32 / WIDTH, pixels)
}

#[test]
fn an_image_that_somebody_gives_takes_the_place_of_what_is_learnt() {
    // Of a camera that saw too little to learn from, and of one that saw enough.
    for count in [1, 60] {
        let params = json!({ "mask": { "/front": file([WIDTH, HEIGHT], 100) } });
        let given = masks_with(count, params.clone());
        assert_eq!(covered(&given[0]), (100, (WIDTH * 200) as usize));
        assert_eq!((given[0].images, given[0].share), (0, 2.0 / 3.0));
        let below = |row: f32, params: Value, masks: Vec<BodyMask>| {
            let inputs = [
                inputs_of("images", vec![photo(7)]).unwrap(),
                inputs_of("body_masks", masks).unwrap(),
            ];
            let (found, losses) = yields::<Features>("features", params, inputs);
            assert!(losses.is_empty(), "{losses:?}");
            let below = found[0].v.iter().filter(|v| **v > row).count();
            [found[0].v.len() - below, below]
        };
        // By the layer, by the parameter alone, and by the parameter in place of what was learnt.
        let learnt = masks(count);
        for (params, masks) in [
            (json!({}), given),
            (params.clone(), vec![]),
            (params, learnt),
        ] {
            let [above, masked] = below(105.0, params, masks);
            assert!(above > 50 && masked == 0, "{above} and {masked}");
        }
    }
}

#[test]
fn polygons_are_masked_beside_what_is_learnt_by_all_that_use_masks() {
    let pole = json!({ "*": [[[40, 0], [60, 0], [60, 200], [40, 200]]] });
    let learnt = covered(&masks(60)[0]);
    let both = masks_with(60, json!({ "mask": pole }));
    assert_eq!(covered(&both[0]), (0, learnt.1 + 20 * 200));
    assert_eq!(both[0].images, 30);
    let share = covered(&both[0]).1 as f64 / f64::from(WIDTH * HEIGHT);
    assert_eq!(both[0].share, share);
    assert_eq!(features(both)[1], 0);
    let other = json!({ "mask": { "rear": [[[40, 0], [60, 0], [60, 200]]] } });
    assert_eq!(masks_with(60, other), masks(60));
}

#[test]
fn an_image_of_another_size_is_refused_with_its_camera() {
    let registry = evermap_catalog::registry();
    let params = json!({ "mask": { "front": file([WIDTH / 2, HEIGHT], 100) } });
    let entry = registry.get("body_masks").unwrap();
    let refused = run(entry, &params, &drive(3).into(), Split::default());
    let said = refused.map(drop).unwrap_err().to_string();
    let expected = "expected a mask of camera `front` of 400 x 300 pixels, as its images in session a have, found one \
                    of 200 x 300";
    assert!(said.contains(expected), "{said}");
    // Where nothing is made of the vehicle's body, images of another size are left out and counted.
    let images = [inputs_of("images", vec![photo(7)]).unwrap()];
    let (found, losses) = yields::<Features>("features", params, images);
    assert!(found.is_empty() && losses.total() == 1, "{losses:?}");
}

#[test]
fn a_file_that_is_no_image_is_refused_with_its_camera() {
    let registry = evermap_catalog::registry();
    for operator in ["body_masks", "features"] {
        let entry = registry.get(operator).unwrap();
        let text = json!({ "file": "body.txt", "hex": "626f6479" });
        let faults = entry.faults(&json!({ "mask": { "front": text } }));
        let [fault] = faults.as_slice() else {
            panic!("{faults:?}");
        };
        assert_eq!((&*fault.param, &*fault.entry), ("mask", "front"));
        let said = "expected an image that masks camera `front`, found body.txt: expected a png or pgm with one value";
        assert!(fault.message.starts_with(said), "{}", fault.message);
    }
}
