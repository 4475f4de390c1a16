//! Labelled images to samples, to a forest, to scores of other images.

use evermap_contract::Losses;
use evermap_contract::laws::{Split, inputs_of, run};
use evermap_schemas::layers::{ClassScores, DecisionTree, PixelPerceptron, PixelSamples};
use evermap_schemas::{Bytes, Stamp, record};
use evermap_vision::{Grey, encode_png};
use serde_json::json;

use crate::yields;

const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;
const CLASSES: [&str; 3] = ["sky", "road", "sign"];

record! {
    /// A labelled frame with its pixels.
    #[layer("labelled_frames", key(site, session, stamp, camera))]
    pub struct Labelled {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure.
        stamp: Stamp,
        /// Camera.
        camera: String,
        /// Names of the classes.
        classes: Vec<String>,
        /// Encoded pixels.
        image: Bytes,
        /// The labels.
        png: Bytes,
    }
}

record! {
    /// A frame with its pixels.
    #[layer("frames", key(site, session, stamp, camera))]
    pub struct Shot {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure.
        stamp: Stamp,
        /// Camera.
        camera: String,
        /// Topic.
        topic: String,
        /// When it was recorded.
        log_time: Stamp,
        /// Encoded pixels.
        image: Bytes,
    }
}

/// Class at a pixel of the n-th image: a horizon, and a sign before it that moves along.
fn class(n: i64, u: u32, v: u32) -> u8 {
    let left = 5 + 6 * n as u32;
    match (left..left + 8).contains(&u) && (14..22).contains(&v) {
        true => 2,
        false => u8::from(v > 24 + (n as u32 % 3)),
    }
}

fn pixels() -> impl Iterator<Item = (u32, u32)> {
    (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (u, v)))
}

/// Blue-grey, dark grey and yellow, with noise that is the same on every run.
fn picture(n: i64) -> Vec<u8> {
    let mut bytes = format!("P6\n{WIDTH} {HEIGHT}\n255\n").into_bytes();
    for (u, v) in pixels() {
        let noise = (u.wrapping_mul(2_654_435_761) ^ v.wrapping_mul(40_503) ^ n as u32) >> 7;
        let [r, g, b] =
            [[150, 160, 190], [90, 90, 95], [200, 180, 40]][usize::from(class(n, u, v))];
        bytes.extend([r, g, b].map(|value: u8| value + (noise % 30) as u8));
    }
    bytes
}

fn labels(n: i64) -> Vec<u8> {
    let data = pixels().map(|(u, v)| match v {
        0 => 255,
        _ => class(n, u, v),
    });
    let grey = Grey {
        width: WIDTH,
        height: HEIGHT,
        data: data.collect(),
    };
    encode_png(&grey).unwrap()
}

fn labelled(n: i64) -> Labelled {
    Labelled {
        site: "street".to_owned(),
        session: "a".to_owned(),
        stamp: Stamp(n),
        camera: "front".to_owned(),
        classes: CLASSES.map(str::to_owned).to_vec(),
        image: Bytes(picture(n)),
        png: Bytes(labels(n)),
    }
}

pub fn shot(n: i64, image: Vec<u8>) -> Shot {
    Shot {
        site: "street".to_owned(),
        session: "a".to_owned(),
        stamp: Stamp(n),
        camera: "front".to_owned(),
        topic: "/front".to_owned(),
        log_time: Stamp(n),
        image: Bytes(image),
    }
}

fn samples(frames: Vec<Labelled>) -> (Vec<PixelSamples>, Losses) {
    let inputs = [inputs_of("labelled_frames", frames).unwrap()];
    yields("pixel_samples", json!({ "samples": 300 }), inputs)
}

fn forest(samples: Vec<PixelSamples>) -> (Vec<DecisionTree>, Losses) {
    let params = json!({ "trees": 8, "blocks": 4 });
    yields(
        "pixel_forest",
        params,
        [inputs_of("samples", samples).unwrap()],
    )
}

fn scores(shots: Vec<Shot>, forest: Vec<DecisionTree>) -> (Vec<ClassScores>, Losses) {
    let inputs = [
        inputs_of("frames", shots).unwrap(),
        inputs_of("forest", forest).unwrap(),
    ];
    yields("class_scores", json!({ "stride_px": 2 }), inputs)
}

/// Share of the cells whose likeliest class is that of their central pixel.
fn right(row: &ClassScores) -> f64 {
    let cells = row.probabilities.0.chunks_exact(CLASSES.len());
    let places = pixels().filter(|(u, v)| u % 2 == 1 && v % 2 == 1);
    let found = cells.zip(places).filter(|(cell, (u, v))| {
        let own = cell[usize::from(class(row.stamp.0, *u, *v))];
        cell.iter().all(|p| *p <= own)
    });
    found.count() as f64 / (f64::from(WIDTH * HEIGHT) / 4.0)
}

#[test]
fn what_is_labelled_in_some_images_is_found_in_others() {
    let (samples, losses) = samples((0..4).map(labelled).collect());
    assert!(losses.is_empty(), "{losses:?}");
    assert_eq!(
        samples[0].class_pixels.iter().sum::<u64>(),
        u64::from(WIDTH * (HEIGHT - 1))
    );
    let (trees, losses) = forest(samples);
    assert!(losses.is_empty(), "{losses:?}");
    assert_eq!(trees.len(), 8);
    let held_out: Vec<i64> = trees
        .iter()
        .map(|tree| tree.held_out[0].first_stamp.0)
        .collect();
    assert_eq!(held_out, [0, 1, 2, 3, 0, 1, 2, 3]);
    // Images 0 to 3 were learnt from, by other trees than those that are asked.
    let (rows, losses) = scores((0..8).map(|n| shot(n, picture(n))).collect(), trees);
    assert!(losses.is_empty(), "{losses:?}");
    assert_eq!(rows.len(), 8);
    for row in &rows {
        assert_eq!((row.width, row.height, row.stride_px), (WIDTH, HEIGHT, 2));
        let right = right(row);
        assert!(right > 0.95, "image {}: {right}", row.stamp.0);
    }
}

/// As `scene_labels` learns: from what a network that photographs have taught sees.
fn network() -> Vec<PixelPerceptron> {
    let frames: Vec<_> = (0..4).map(labelled).collect();
    let params = json!({
        "samples": 300, "sift_bins_px": [], "windows_px": [], "backbone_areas_px": [12288]
    });
    let inputs = [inputs_of("labelled_frames", frames).unwrap()];
    let (samples, losses): (Vec<PixelSamples>, _) = yields("pixel_samples", params, inputs);
    assert!(losses.is_empty(), "{losses:?}");
    assert_eq!(samples[0].dimensions, 466);
    let params = json!({ "least_steps": 300 });
    let (members, losses) = yields(
        "pixel_network",
        params,
        [inputs_of("samples", samples).unwrap()],
    );
    assert!(losses.is_empty(), "{losses:?}");
    members
}

#[test]
fn a_network_finds_in_others_what_is_labelled_in_some_images() {
    let members = network();
    let held_out: Vec<i64> = members
        .iter()
        .map(|member| member.held_out[0].first_stamp.0)
        .collect();
    assert_eq!(held_out, [0, 1, 2, 3]);
    let inputs = |members: &[PixelPerceptron], trees: Vec<DecisionTree>| {
        let shots: Vec<Shot> = (0..8).map(|n| shot(n, picture(n))).collect();
        [
            inputs_of("frames", shots).unwrap(),
            inputs_of("forest", trees).unwrap(),
            inputs_of("network", members.to_vec()).unwrap(),
        ]
    };
    let score = |members: &[PixelPerceptron]| -> (Vec<ClassScores>, Losses) {
        yields(
            "class_scores",
            json!({ "stride_px": 2 }),
            inputs(members, Vec::new()),
        )
    };
    let (rows, losses) = score(&members);
    assert!(losses.is_empty() && rows.len() == 8, "{losses:?}");
    for row in &rows {
        let right = right(row);
        assert!(right > 0.93, "image {}: {right}", row.stamp.0);
    }
    // Images 0 to 3 are scored by a member each, the others by all.
    let (first, _) = score(&members[..1]);
    assert!(first[0] == rows[0] && first[1] != rows[1]);
    let (samples, _) = samples((0..4).map(labelled).collect());
    let inputs = inputs(&members, forest(samples).0).into_iter().collect();
    let registry = evermap_catalog::registry();
    let entry = registry.get("class_scores").unwrap();
    let fault = run(entry, &json!({}), &inputs, Split::default()).unwrap_err();
    let said = fault.to_string();
    assert!(
        said.contains("expected a forest or a network, found both"),
        "{said}"
    );
}

#[test]
fn images_that_are_of_no_use_are_counted() {
    let mut frames: Vec<_> = (0..4).map(labelled).collect();
    frames[1].image = Bytes(vec![0xff, 0xd8]);
    frames[2].png = Bytes(b"no image".to_vec());
    let unlabelled = Grey {
        width: WIDTH,
        height: HEIGHT,
        data: vec![255; (WIDTH * HEIGHT) as usize],
    };
    frames[3].png = Bytes(encode_png(&unlabelled).unwrap());
    let (rows, losses) = samples(frames);
    assert_eq!((rows.len(), losses.total()), (1, 3), "{losses:?}");
    let mut other = rows[0].clone();
    other.stamp = Stamp(9);
    other.features = "others".to_owned();
    let mut torn = rows[0].clone();
    torn.stamp = Stamp(10);
    torn.values.0.pop();
    let (trees, losses) = forest(vec![rows[0].clone(), other, torn]);
    assert_eq!((trees.len(), losses.total()), (8, 2), "{losses:?}");
    assert!(
        trees.iter().all(|tree| tree.held_out.is_empty()),
        "one image is one block"
    );
    let mut elsewhere = shot(6, picture(6));
    elsewhere.site = "lot".to_owned();
    let shots = vec![shot(5, vec![1, 2, 3]), elsewhere, shot(7, picture(7))];
    let (rows, losses) = scores(shots, trees);
    assert_eq!((rows.len(), losses.total()), (1, 2), "{losses:?}");
}
