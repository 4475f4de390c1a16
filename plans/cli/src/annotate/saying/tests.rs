#![allow(clippy::unwrap_used)]
use evermap_algorithms::labels::shapes;
use evermap_schemas::Wkb;

use super::*;

const SPACE: [[f64; 3]; 4] = [
    [5.0, 2.0, 0.0],
    [0.0, 2.0, 0.0],
    [0.0, 0.0, 0.0],
    [5.0, 0.0, 0.0],
];

/// A space of this name that begins there.
fn space(label: &str, x: f64) -> PlacedLabel {
    PlacedLabel {
        site: "lot".into(),
        label: label.into(),
        kind: "space".into(),
        standing: "drawn".into(),
        author: "ada".into(),
        said: Stamp(1),
        placed_by: "pose".into(),
        anchor: None,
        shape: "box".into(),
        map_from_label: Pose {
            x: x + 2.5,
            y: 1.0,
            ..Pose::IDENTITY
        },
        length_m: Some(5.0),
        width_m: Some(2.0),
        points: SPACE.map(|[along, y, z]| [x + along, y, z]).to_vec(),
        geometry: Wkb::point([0.0; 3]),
    }
}

/// A space that is drawn there, on a picture if its pixels have a size.
fn drawn(x: f64, within_m: Option<f64>) -> (Feature, (&'static str, Outline)) {
    let corners = SPACE.map(|[along, y, z]| [x + along, y, z]);
    let feature = Feature {
        place: String::new(),
        label: None,
        within_m,
        kind: None,
        category: None,
        standing: None,
        geometry: None,
        brush_px: None,
        image: None,
    };
    (feature, ("box", shapes::oriented_box(&corners).unwrap()))
}

#[test]
fn what_lies_on_a_label_is_that_label_and_what_lies_beside_it_is_new() {
    let mut rejected = space("rejected", 20.0);
    rejected.standing = "rejected".into();
    let labels = [space("one", 0.0), space("two", 10.0), rejected];
    let labels: BTreeMap<String, PlacedLabel> = labels
        .into_iter()
        .map(|label| (label.label.clone(), label))
        .collect();
    let (space, other) = ("space".to_owned(), "crossing".to_owned());
    let found = |x: f64, within_m, kind| {
        let (feature, outline) = drawn(x, within_m);
        let found = label_of(&feature, Some(&outline), kind, &labels).unwrap();
        let found = found.unwrap();
        labels.contains_key(&found).then_some(found)
    };
    let two = Some("two".to_owned());
    let pixels = Some(0.025);
    assert_eq!(found(10.02, pixels, Some(&space)), two);
    assert_eq!(found(10.02, pixels, None), two);
    assert_eq!(found(10.0005, None, Some(&space)), two);
    // Pixels are coarse, metres are not.
    assert_eq!(found(10.02, None, Some(&space)), None);
    assert_eq!(found(10.03, pixels, Some(&space)), None);
    assert_eq!(found(10.0, pixels, Some(&other)), None);
    assert_eq!(found(20.0, pixels, Some(&space)), None);
}

#[test]
fn a_name_of_another_program_counts_where_there_is_such_a_label() {
    let labels = BTreeMap::from([("one".to_owned(), space("one", 0.0))]);
    let found = |name: &str, within_m| {
        let (mut feature, outline) = drawn(10.0, within_m);
        feature.label = Some(name.to_owned());
        let found = label_of(&feature, Some(&outline), None, &labels);
        found.unwrap().unwrap()
    };
    assert_eq!(found("one", Some(0.025)), "one");
    assert_ne!(found("two", Some(0.025)), "two");
    assert_eq!(found("two", None), "two");
}

/// Somebody stands at one place in two images: these are two labels.
#[test]
fn what_an_image_shows_is_a_label_of_that_image() {
    let image = |stamp| ("a".to_owned(), Stamp(stamp), "front".to_owned());
    let mut known = space("one", 0.0);
    known.anchor = Some(roles::Anchor {
        session: "a".into(),
        stamp: Stamp(1),
        camera: Some("front".into()),
        vehicle_from_label: Pose::IDENTITY,
    });
    let labels = BTreeMap::from([("one".to_owned(), known)]);
    let found = |image| {
        let (mut feature, outline) = drawn(0.0, None);
        feature.image = image;
        let found = label_of(&feature, Some(&outline), None, &labels);
        found.unwrap().unwrap()
    };
    assert_eq!([found(None), found(Some(image(1)))], ["one", "one"]);
    let [second, third] = [2, 3].map(|stamp| found(Some(image(stamp))));
    assert!(second != "one" && third != "one" && second != third);
    assert_eq!(found(Some(image(2))), second);
}

/// As its act is to have it: points about its own frame.
#[test]
fn the_outline_of_a_label_is_about_its_own_frame() {
    let turned = pose::Pose::from_yaw(7.0, 3.0, 0.6);
    let corners = [
        [2.5, 1.0, 0.0],
        [-2.5, 1.0, 0.0],
        [-2.5, -1.0, 0.0],
        [2.5, -1.0, 0.0],
    ];
    let mut label = space("one", 0.0);
    label.map_from_label = Pose::from_array(turned.to_array());
    let in_map = |point: [f64; 3]| -> [f64; 3] { turned.transform(&Vector3::from(point)).into() };
    label.points = corners.map(in_map).to_vec();
    let found = outline_of(&label).unwrap();
    assert!(found.0 == "box" && shapes::is_box(&found.1.points));
    assert!(!differs(&label, &found, 1e-9));
}
