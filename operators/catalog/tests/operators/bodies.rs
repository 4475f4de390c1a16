//! The vehicle's own body: found in what its camera saw, and left out of what is made of that.

use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{BodyMask, Features, Keyframe};
use evermap_schemas::{Bytes, Pose, Stamp, record};
use evermap_vision::decode_labels;
use serde_json::json;

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

fn masks(count: u32) -> Vec<BodyMask> {
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
    let inputs = [
        inputs_of("images", (0..count).map(photo).collect()).unwrap(),
        inputs_of("keyframes", keyframes.collect()).unwrap(),
    ];
    let (masks, losses) = yields("body_masks", json!({}), inputs);
    assert!(losses.is_empty(), "{losses:?}");
    masks
}

/// Features above and on the body.
fn features(masks: Vec<BodyMask>) -> [usize; 2] {
    let inputs = [
        inputs_of("images", vec![photo(7)]).unwrap(),
        inputs_of("body_masks", masks).unwrap(),
    ];
    let (found, _) = yields::<Features>("features", json!({}), inputs);
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
