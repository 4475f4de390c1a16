#![allow(clippy::unwrap_used)]
use evermap_algorithms::labels::shapes;
use evermap_schemas::Wkb;
use proptest::prelude::*;

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
fn drawn(x: f64, within_m: Option<f64>) -> (DrawnFeature, (&'static str, Outline)) {
    let corners = SPACE.map(|[along, y, z]| [x + along, y, z]);
    let feature = DrawnFeature {
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
    let labels = KnownLabels::from_iter(labels);
    let (space, other) = ("space".to_owned(), "crossing".to_owned());
    let found = |x: f64, within_m, kind| {
        let (feature, outline) = drawn(x, within_m);
        let found = label_of(&feature, Some(&outline), kind, &labels).unwrap();
        let found = found.unwrap();
        labels.get(&found).is_some().then_some(found)
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
    let labels = KnownLabels::from_iter([space("one", 0.0)]);
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
    let labels = KnownLabels::from_iter([known]);
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

/// An outline of these corners from one of them on, `step` cells along the drive.
fn outline(shape: &'static str, step: i32, from: usize) -> (&'static str, Outline) {
    let x = f64::from(step) * 0.01;
    let mut corners = SPACE.map(|[along, y, z]| [x + along, y, z]);
    corners.rotate_left(from);
    let outline = match shape {
        "box" => shapes::oriented_box(&corners).unwrap(),
        "polygon" => shapes::polygon(&corners),
        _ => shapes::polyline(&corners),
    };
    (shape, outline)
}

/// A label of this outline, of one of two kinds, that is rejected or not, and of an image or none.
fn known(
    number: usize,
    (shape, outline): &(&str, Outline),
    (kind, rejected, image): (bool, bool, Option<i64>),
) -> PlacedLabel {
    let mut known = space(&format!("{:02}", 7 * number % 50), 0.0);
    known.shape = (*shape).to_owned();
    known.map_from_label = Pose::from_array(outline.map_from_label.to_array());
    known.points = in_map(outline).collect();
    known.points.rotate_left(number % 4);
    known.kind = if kind { "space" } else { "crossing" }.to_owned();
    known.standing = if rejected { "rejected" } else { "drawn" }.to_owned();
    known.anchor = image.map(|stamp| roles::Anchor {
        session: "a".into(),
        stamp: Stamp(stamp),
        camera: Some("front".into()),
        vehicle_from_label: Pose::IDENTITY,
    });
    known
}

const SHAPES: [&str; 3] = ["box", "polygon", "polyline"];

proptest! {
    /// Labels lie within centimetres of each other, so that several are where a feature is.
    #[test]
    fn labels_are_found_as_by_looking_at_each_in_the_order_of_names(
        labels in prop::collection::vec(
            (0..3_usize, -6..6_i32, 0..4_usize, (any::<bool>(), any::<bool>(), prop::option::of(0..2_i64))),
            0..40,
        ),
        (shape, step, from) in (0..3_usize, -8..8_i32, 0..4_usize),
        kind in prop::option::of(any::<bool>()),
        image in prop::option::of(0..2_i64),
        within_m in prop::sample::select(vec![None, Some(0.01), Some(0.025), Some(3.0), Some(1e9)]),
    ) {
        let labels = labels.iter().enumerate().map(|(number, (shape, step, from, rest))| {
            known(number, &outline(SHAPES[*shape], *step, *from), *rest)
        });
        let labels: KnownLabels = labels.collect();
        let (mut feature, _) = drawn(0.0, within_m);
        feature.image = image.map(|stamp| ("a".to_owned(), Stamp(stamp), "front".to_owned()));
        let drawn = outline(SHAPES[shape], step, from);
        let kind = kind.map(|kind| if kind { "space" } else { "crossing" }.to_owned());
        let mut each = labels.rows().iter();
        let expected = each.find(|known| lies_there(known, &feature, &drawn, kind.as_ref()));
        let found = label_of(&feature, Some(&drawn), kind.as_ref(), &labels).unwrap().unwrap();
        let found = labels.get(&found).map(|known| &known.label);
        prop_assert_eq!(found, expected.map(|known| &known.label));
    }
}
