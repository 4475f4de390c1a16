#![allow(clippy::unwrap_used)]
use super::*;

/// Somebody at such a place of an image whose name has letters that files do not.
pub(in crate::annotate) fn question(number: u32, rectangle: [f64; 4]) -> PersonQuestion {
    PersonQuestion {
        site: "lot".into(),
        question: number,
        session: "a b".into(),
        stamp: Stamp(1_700_000_000_123_456_789),
        camera: "/front/optical".into(),
        person: number,
        x: f64::from(number),
        y: 0.5,
        range_m: 3.0,
        rectangle: rectangle.to_vec(),
        mean: 0.0,
        variance: 1.0,
        probability: 0.25,
        gain: 0.1,
        reason: "uncertain".into(),
    }
}

#[test]
fn what_is_written_says_which_image_and_place_each_box_is_of() {
    let folder = tempfile::tempdir().unwrap();
    let mut written = PersonImages::default();
    let asked = [
        question(3, [9.5, 19.5, 29.5, 79.5]),
        // Half of it is in the image, and none.
        question(5, [-20.5, 9.5, 19.5, 29.5]),
        question(7, [-20.5, 9.5, -10.5, 29.5]),
        question(8, [f64::NAN, 9.5, 19.5, 29.5]),
    ];
    written.add(([100, 80], "jpg"), &asked);
    let [coco, tasks] = written.texts().unwrap();
    std::fs::write(folder.path().join(INDEX), &coco).unwrap();
    let read = PersonImages::read(folder.path()).unwrap();
    assert_eq!(read.images.len(), 1);
    let image = &read.images[0];
    let expected = "0001_a_b_front_optical_1700000000123456789.jpg";
    assert_eq!(image.file_name, expected);
    let key = (
        "a b".to_owned(),
        asked[0].stamp,
        "/front/optical".to_owned(),
    );
    assert_eq!((image.key(), image.canvas().size), (key, [100, 80]));
    let found: Vec<_> = read
        .asked(image)
        .map(|one| (one.question, one.bounds()))
        .collect();
    let expected = [
        (3, [[10.0, 20.0], [30.0, 80.0]]),
        (5, [[0.0, 10.0], [20.0, 30.0]]),
    ];
    assert_eq!(found, expected);
    let tasks: Value = serde_json::from_str(&tasks).unwrap();
    let result = &tasks[0]["predictions"][0]["result"][0];
    assert_eq!(result["value"]["x"], 10.0);
    assert_eq!(result["value"]["height"], 75.0);
    assert_eq!(result["score"], 0.25);
}

#[test]
fn images_that_nothing_tells_apart_are_refused_with_both() {
    let folder = tempfile::tempdir().unwrap();
    let mut written = PersonImages::default();
    for stamp in [1, 2] {
        let asked = PersonQuestion {
            stamp: Stamp(stamp),
            ..question(1, [9.5, 19.5, 29.5, 79.5])
        };
        written.add(([100, 80], "png"), &[asked]);
    }
    let refused = |images: &PersonImages| {
        let [coco, _] = images.texts().unwrap();
        std::fs::write(folder.path().join(INDEX), coco).unwrap();
        PersonImages::read(folder.path()).unwrap_err().to_string()
    };
    written.images[1].id = 1;
    let said = refused(&written);
    let [one, other] = [
        "0001_a_b_front_optical_1.png",
        "0002_a_b_front_optical_2.png",
    ];
    let both = format!("found {one} and {other}, both with the id 1");
    assert!(said.contains(&both), "{said}");
    written.images[1].id = 2;
    written.images[1].file_name = one.into();
    let said = refused(&written);
    assert!(said.contains("twice, with the ids 1 and 2"), "{said}");
}

#[test]
fn another_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for text in [
        None,
        Some("[]"),
        Some("{"),
        Some(r#"{ "images": [{ "id": 1 }] }"#),
    ] {
        if let Some(text) = text {
            std::fs::write(folder.path().join(INDEX), text).unwrap();
        }
        let said = PersonImages::read(folder.path()).unwrap_err().to_string();
        assert!(
            said.contains("expected a folder of camera images"),
            "{said}"
        );
    }
}
