//! Panoramas with range whose labels are those of another image.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{
    LabelImage, Relocation, SphereView, ViewLink, ViewRegistration, WarpedLabels,
};
use evermap_schemas::{Bytes, Pose, Stamp};
use evermap_vision::{Grey, encode_png};
use serde_json::{Value, json};

use crate::yields;

const SIZE: [u32; 2] = [256, 84];

fn pixels() -> impl Iterator<Item = (u32, u32)> {
    let [width, height] = SIZE;
    (0..height).flat_map(move |v| (0..width).map(move |u| (u, v)))
}

/// Half the sides of a room (m): to the right, down and ahead.
const WALLS_M: [f64; 3] = [2.0, 1.5, 3.0];

/// A panorama, so far ahead (m) of the middle of the room, whose walls have patches of light.
fn sphere(session: &str, stamp: i64, ahead_m: f64) -> SphereView {
    let [width, height] = SIZE;
    let focal = f64::from(width) / std::f64::consts::TAU;
    let centre = SIZE.map(|side| f64::from(side - 1) / 2.0);
    let (mut grey, mut range): (Vec<u8>, Vec<u8>) = (Vec::new(), Vec::new());
    for (u, v) in pixels() {
        let longitude = (f64::from(u) - centre[0]) / focal;
        let latitude = (f64::from(v) - centre[1]) / focal;
        let ray = [
            longitude.sin() * latitude.cos(),
            latitude.sin(),
            longitude.cos() * latitude.cos(),
        ];
        let at = [0.0, 0.0, ahead_m];
        let away = |axis: usize| {
            let ray: f64 = ray[axis];
            (WALLS_M[axis] - ray.signum() * at[axis]) / ray.abs().max(1e-9)
        };
        let away_m = away(0).min(away(1)).min(away(2));
        let patches = (0..3).map(|axis: usize| (5.0 * (at[axis] + away_m * ray[axis])).sin());
        grey.push((128.0 + 40.0 * patches.sum::<f64>()) as u8);
        range.extend(((1000.0 * away_m) as u16).to_be_bytes());
    }
    let image = |most: u32, data: Vec<u8>| {
        let header = format!("P5\n{width} {height}\n{most}\n").into_bytes();
        Bytes([header, data].concat())
    };
    SphereView {
        site: "town".into(),
        session: session.into(),
        stamp: Stamp(stamp),
        camera: "dome".into(),
        width,
        height,
        focal: vec![focal; 2],
        centre: centre.to_vec(),
        image: image(255, grey),
        range: image(65_535, range),
        unit_m: 0.001,
    }
}

/// An image of this size of one label.
fn painted(label: u8, [width, height]: [u32; 2]) -> Bytes {
    let labels = Grey {
        width,
        height,
        data: vec![label; (width * height) as usize],
    };
    Bytes(encode_png(&labels).unwrap())
}

/// Labels of such a view, all of which stay where they are, in an image of this size.
fn labels(session: &str, stamp: i64, [width, height]: [u32; 2]) -> LabelImage {
    LabelImage {
        site: "town".into(),
        session: session.into(),
        stamp: Stamp(stamp),
        camera: "dome".into(),
        width,
        height,
        classes: vec!["car".into(), "wall".into()],
        png: painted(1, [width, height]),
    }
}

/// Labels of half the size.
const HALF: [u32; 2] = [SIZE[0] / 2, SIZE[1] / 2];

/// Panoramas are close to each other: few places are tried.
fn near() -> Value {
    json!({ "reach_m": 2.0 })
}

/// What was counted of so many views.
fn counted(views: u64) -> BTreeMap<String, u64> {
    let reason = "label image has another size than its panorama".to_owned();
    BTreeMap::from([(reason, views)])
}

fn inputs(spheres: Vec<SphereView>, labels: Vec<LabelImage>) -> Vec<(String, RecordBatch)> {
    vec![
        inputs_of("spheres", spheres).unwrap(),
        inputs_of("label_images", labels).unwrap(),
    ]
}

#[test]
fn a_view_whose_labels_have_another_size_is_linked_with_none_and_counted() {
    let linked = |second: [u32; 2]| {
        let spheres = [0, 1, 2].map(|stamp| sphere("a", stamp, 0.2 * stamp as f64));
        let sizes = [(0, SIZE), (1, second), (2, SIZE)];
        let labels = sizes.map(|(stamp, size)| labels("a", stamp, size));
        let inputs = inputs(spheres.to_vec(), labels.to_vec());
        let (found, losses) = yields::<ViewLink>("view_links", near(), inputs);
        (found.len(), losses.0)
    };
    assert_eq!(linked(SIZE), (2, BTreeMap::new()));
    assert_eq!(linked(HALF), (0, counted(1)));
}

#[test]
fn a_view_whose_labels_have_another_size_is_not_registered_and_counted() {
    let relocation = Relocation {
        site: "town".into(),
        session: "b".into(),
        stamp: Stamp(9),
        camera: "dome".into(),
        view: "b/dome/9".into(),
        rank: 0,
        map_session: "a".into(),
        map_stamp: Stamp(7),
        map_camera: "dome".into(),
        map_view: "a/dome/7".into(),
        score: 0.5,
        similarity: 0.5,
        yaw_rad: Some(0.0),
        certainty: None,
    };
    let registered = |of_map: [u32; 2], of_view: [u32; 2]| {
        let spheres = vec![sphere("a", 7, 0.0), sphere("b", 9, 0.2)];
        let labels = vec![labels("a", 7, of_map), labels("b", 9, of_view)];
        let mut inputs = inputs(spheres, labels);
        inputs.push(inputs_of("relocations", vec![relocation.clone()]).unwrap());
        let (found, losses) = yields::<ViewRegistration>("registrations", near(), inputs);
        let states: Vec<String> = found.into_iter().map(|row| row.state).collect();
        (states, losses.0)
    };
    let one = |state: &str| vec![state.to_owned()];
    assert_eq!(registered(SIZE, SIZE), (one("converged"), BTreeMap::new()));
    assert_eq!(registered(SIZE, HALF), (Vec::new(), counted(1)));
    assert_eq!(registered(HALF, SIZE), (one("no range"), counted(1)));
}

#[test]
fn a_view_whose_labels_have_another_size_is_not_looked_through_and_counted() {
    let link = ViewLink {
        site: "town".into(),
        session: "b".into(),
        stamp: Stamp(9),
        camera: "dome".into(),
        kind: "registered".into(),
        other_session: "a".into(),
        other_stamp: Stamp(7),
        other_camera: "dome".into(),
        other_view_from_view: Pose::from_array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        covariance: vec![0.0; 36],
        sigma_m: 0.001,
    };
    // Nothing but a car is seen in visit b.
    let warped = |of_map: [u32; 2], links: Vec<ViewLink>| {
        let spheres = vec![sphere("a", 7, 0.0), sphere("b", 9, 0.0)];
        let car = LabelImage {
            png: painted(0, SIZE),
            ..labels("b", 9, SIZE)
        };
        let labels = vec![labels("a", 7, of_map), car];
        let mut inputs = inputs(spheres, labels.clone());
        inputs.push(inputs_of("labels", labels).unwrap());
        inputs.push(inputs_of("view_links", links).unwrap());
        let (found, losses) = yields::<WarpedLabels>("warped_labels", json!({}), inputs);
        let views = found.into_iter().map(|row| (row.session, row.views));
        (views.collect::<BTreeMap<_, _>>(), losses.0)
    };
    let through = |views: &[(&str, u32)]| {
        let views = views.iter();
        views
            .map(|(session, many)| ((*session).to_owned(), *many))
            .collect::<BTreeMap<_, _>>()
    };
    let linked = || vec![link.clone()];
    let all = (through(&[("a", 0), ("b", 1)]), BTreeMap::new());
    assert_eq!(warped(SIZE, linked()), all);
    let one = (through(&[("b", 0)]), counted(1));
    assert_eq!(warped(HALF, linked()), one);
    assert_eq!(warped(HALF, Vec::new()), one);
}
