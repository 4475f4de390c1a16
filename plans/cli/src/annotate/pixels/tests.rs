#![allow(clippy::unwrap_used)]
use evermap_schemas::{Pose, Stamp, Wkb};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;
use crate::annotate::reading::MOST_FEATURES;

/// A picture of 400 × 300 px of 5 cm, whose upper left corner is at (10, 20) m.
fn picture(folder: &Path) -> Picture {
    let path = folder.join("lot.png");
    let mut encoder = png::Encoder::new(std::fs::File::create(&path).unwrap(), 400, 300);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&vec![0; 400 * 300]).unwrap();
    std::fs::write(
        path.with_extension("pgw"),
        "0.05\n0\n0\n-0.05\n10.025\n19.975\n",
    )
    .unwrap();
    Picture::read(&path).unwrap()
}

fn label(name: &str, shape: &str, points: &[[f64; 2]]) -> PlacedLabel {
    PlacedLabel {
        site: "lot".into(),
        label: name.into(),
        kind: "a <kind> & \"more\"".into(),
        standing: "drawn".into(),
        author: "ada".into(),
        said: Stamp(1),
        placed_by: "pose".into(),
        anchor: None,
        shape: shape.into(),
        map_from_label: Pose::from_array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        length_m: None,
        width_m: None,
        points: points.iter().map(|[x, y]| [*x, *y, 0.0]).collect(),
        geometry: Wkb::point([0.0; 3]),
    }
}

/// Corners of a box as labels have them.
fn of_box([x, y]: [f64; 2], yaw: f64, [length, width]: [f64; 2]) -> Vec<[f64; 2]> {
    let (sin, cos) = yaw.sin_cos();
    let sides = [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]];
    let corner = |[ahead, left]: [f64; 2]| {
        let (u, v) = (0.5 * length * ahead, 0.5 * width * left);
        [x + cos * u - sin * v, y + sin * u + cos * v]
    };
    sides.map(corner).to_vec()
}

fn points(feature: &DrawnFeature) -> Vec<[f64; 2]> {
    match feature.geometry.as_ref().unwrap() {
        Geometry::Closed(points) | Geometry::Open(points) => {
            points.iter().map(|(at, _)| *at).collect()
        }
    }
}

/// Whether the corners are the same, begun anywhere, in either sense.
fn same(found: &[[f64; 2]], expected: &[[f64; 2]]) -> bool {
    let near = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-6;
    found.len() == expected.len() && expected.iter().all(|b| found.iter().any(|a| near(a, b)))
}

fn round_trip(program: Program, labels: &[PlacedLabel]) -> (Vec<DrawnFeature>, Losses) {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let path = folder.path().join(match program {
        Program::Cvat => "labels.xml",
        Program::YoloObb => "labels.txt",
        _ => "labels.json",
    });
    let mut losses = Losses::default();
    let text = program
        .write(&path, &picture, (labels, &[]), &mut losses)
        .unwrap();
    assert_eq!(Program::of(&path, &text), Some(program), "{text}");
    let found = program.read(&path, &text, &picture, &mut losses).unwrap();
    (found, losses)
}

const ALL: [Program; 4] = [
    Program::Coco,
    Program::Cvat,
    Program::LabelStudio,
    Program::YoloObb,
];

proptest! {
    #[test]
    fn boxes_come_back_where_they_were(
        at in (11.0..29.0, 6.0..19.0), yaw in -4.0..4.0_f64, size in (0.5..6.0, 0.5..6.0),
    ) {
        let corners = of_box([at.0, at.1], yaw, [size.0, size.1]);
        for program in ALL {
            let (found, losses) = round_trip(program, &[label("a", "box", &corners)]);
            prop_assert!(losses.counts.is_empty() && found.len() == 1);
            prop_assert_eq!(found[0].category.as_deref(), Some("a <kind> & \"more\""));
            let name = (program != Program::YoloObb).then_some("a");
            prop_assert_eq!(found[0].label.as_deref(), name);
            let half = found[0].within_m.unwrap();
            prop_assert!((half - 0.025).abs() < 1e-12, "half a pixel: {}", half);
            let found = points(&found[0]);
            prop_assert!(same(&found, &corners), "{:?}: {:?}", program, found);
        }
    }
}

#[test]
fn what_a_program_has_no_form_for_is_counted() {
    let inside = [[12.0, 12.0], [14.0, 12.0], [13.0, 15.0]];
    let outside = inside.map(|[x, y]| [x + 100.0, y]);
    let mut rejected = label("d", "polygon", &inside);
    rejected.standing = "rejected".into();
    let labels = [
        label("a", "polygon", &inside),
        label("b", "polyline", &inside),
        label("c", "polygon", &outside),
        rejected,
    ];
    for (program, kept, lost) in [
        (Program::Coco, 1, 2),
        (Program::Cvat, 2, 1),
        (Program::LabelStudio, 1, 2),
        (Program::YoloObb, 0, 3),
    ] {
        let (found, losses) = round_trip(program, &labels);
        assert_eq!(found.len(), kept, "{program:?}");
        assert_eq!(
            losses.counts.values().sum::<u64>(),
            lost,
            "{program:?}: {losses:?}"
        );
        assert!(found.iter().all(|feature| same(&points(feature), &inside)));
    }
}

#[test]
fn yolo_is_told_by_its_first_line_and_by_its_name_where_there_is_none() {
    let of = |name: &str, text: &str| Program::of(Path::new(name), text);
    let a_box = "\n0 0.1 0.1 0.2 0.1 0.2 0.2 0.1 0.2\n";
    for (name, text, program) in [
        ("a.labels", a_box, Some(Program::YoloObb)),
        ("a.labels", "0 0.1 0.1 0.2 0.1", None),
        ("a.labels", "", None),
        ("a.txt", "", Some(Program::YoloObb)),
        ("a.txt", "0 0.1 0.1 0.2 0.1", Some(Program::YoloObb)),
        ("a.txt", "<annotations/>", Some(Program::Cvat)),
        ("a.txt", r#"{"type": "FeatureCollection"}"#, None),
    ] {
        assert_eq!(of(name, text), program, "{name} {text:?}");
    }
}

/// As the programs' documentation shows them.
#[test]
fn what_the_programs_write_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    std::fs::write(folder.path().join("classes.txt"), "car\nspace\n").unwrap();
    let cvat = r#"<?xml version="1.0" encoding="utf-8"?>
<annotations><version>1.1</version><meta><task/></meta>
  <image id="0" name="lot.png" width="400" height="300">
    <box label="space" source="manual" occluded="0" xtl="80" ytl="90" xbr="120" ybr="110" rotation="90.00" z_order="0"></box>
    <points label="space" points="1,2"></points>
  </image>
  <image id="1" name="other.png" width="4" height="3"><box label="space" xtl="0" ytl="0" xbr="1" ybr="1"/></image>
</annotations>"#;
    let yolo = "1 0.225 0.2666667 0.275 0.2666667 0.275 0.4 0.225 0.4\n1 0.1 0.2\n";
    let expected = [[14.5, 16.0], [15.5, 16.0], [15.5, 14.0], [14.5, 14.0]];
    let files = [
        ("a.xml", cvat, 2),
        ("a.txt", yolo, 1),
        ("a.labels", yolo, 1),
    ];
    for (name, text, lost) in files {
        let path = folder.path().join(name);
        let mut losses = Losses::default();
        let program = Program::of(&path, text).unwrap();
        let found = program.read(&path, text, &picture, &mut losses).unwrap();
        assert_eq!(found.len(), 1, "{name}");
        assert_eq!(found[0].category.as_deref(), Some("space"));
        let found = points(&found[0]);
        let close = expected.iter().all(|b| {
            found
                .iter()
                .any(|a| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-4)
        });
        assert!(close, "{name}: {found:?}");
        assert_eq!(
            losses.counts.values().sum::<u64>(),
            lost,
            "{name}: {losses:?}"
        );
    }
    for (text, expected) in [
        ("<a", "expected XML of CVAT"),
        ("<svg/>", "found XML of <svg>"),
        ("<annotations>\n<image>\n</imag></annotations>", "in line 3"),
        (
            r#"<!DOCTYPE a [<!ENTITY a "&b;&b;"><!ENTITY b "&a;&a;">]><annotations/>"#,
            "a document type",
        ),
        (
            r#"<annotations><image name="&a;"/></annotations>"#,
            "expected XML of CVAT",
        ),
        (
            r#"<annotations><track id="0" label="space"><box frame="0" xtl="1" ytl="1" xbr="5" ybr="9"/></track></annotations>"#,
            "export from CVAT as `CVAT for images 1.1`",
        ),
        (
            r#"[{ "image": "lot.png", "id": 1, "label": [{ "x": 10, "rectanglelabels": ["space"] }], "annotator": 1 }]"#,
            "export from Label Studio as `JSON`, not as `JSON-MIN`",
        ),
        (
            r#"[{ "image_id": 1, "category_id": 1, "bbox": [1, 1, 4, 8], "score": 0.5 }]"#,
            "found JSON of another form",
        ),
    ] {
        let path = Path::new("a.xml");
        let fault = Program::of(path, text)
            .unwrap()
            .read(path, text, &picture, &mut Losses::default())
            .unwrap_err();
        assert!(fault.to_string().contains(expected), "{fault}");
    }
}

#[test]
fn proposals_are_predictions_with_their_probability() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let proposal = BoxHypothesis {
        site: "lot".into(),
        kind: "space".into(),
        hypothesis: 0,
        map_from_label: Pose::from_array([15.0, 15.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        length_m: 2.0,
        width_m: 1.0,
        mean: 0.5,
        variance: 0.1,
        probability: 0.875,
        question: None,
        gain: None,
        reason: None,
        geometry: Wkb::point([0.0; 3]),
    };
    let path = folder.path().join("tasks.json");
    let mut losses = Losses::default();
    let text = Program::LabelStudio
        .write(&path, &picture, (&[], &[proposal]), &mut losses)
        .unwrap();
    let tasks: Value = serde_json::from_str(&text).unwrap();
    let result = &tasks[0]["predictions"][0]["result"][0];
    assert_eq!(result["score"], 0.875);
    let near = |name: &str, expected: f64| {
        (result["value"][name].as_f64().unwrap() - expected).abs() < 1e-9
    };
    assert!(
        near("x", 20.0) && near("y", 30.0) && near("width", 10.0),
        "{result}"
    );
    let read = Program::LabelStudio
        .read(&path, &text, &picture, &mut losses)
        .unwrap();
    assert_eq!(
        (read.len(), losses.counts.len()),
        (0, 0),
        "nobody said a prediction"
    );
}

/// Pictures by name and size; each has a box whose kind is its name.
type Pictures<'a> = &'a [(&'a str, [u32; 2])];

/// What a program writes of them.
type Write = fn(Pictures<'_>) -> String;

fn coco(pictures: Pictures<'_>) -> String {
    let all = || pictures.iter().enumerate();
    let images = all().map(|(id, (name, [width, height]))| {
        json!({ "id": id, "file_name": name, "width": width, "height": height })
    });
    let categories = all().map(|(id, (name, _))| json!({ "id": id, "name": name }));
    let annotations =
        all().map(|(id, _)| json!({ "image_id": id, "category_id": id, "bbox": [1, 1, 20, 10] }));
    let [images, categories, annotations]: [Vec<Value>; 3] = [
        images.collect(),
        categories.collect(),
        annotations.collect(),
    ];
    json!({ "images": images, "categories": categories, "annotations": annotations }).to_string()
}

fn cvat(pictures: Pictures<'_>) -> String {
    let image = |(name, [width, height]): &(&str, [u32; 2])| {
        format!(
            r#"<image name="{name}" width="{width}" height="{height}"><box label="{name}" xtl="1" ytl="1" xbr="21" ybr="11"/></image>"#
        )
    };
    let images: String = pictures.iter().map(image).collect();
    format!("<annotations>{images}</annotations>")
}

fn studio(pictures: Pictures<'_>) -> String {
    let task = |(name, [width, height]): &(&str, [u32; 2])| {
        let value = json!({ "x": 1, "y": 1, "width": 5, "height": 3, "rectanglelabels": [name] });
        let result = json!({
            "type": "rectanglelabels", "original_width": width, "original_height": height, "value": value,
        });
        json!({ "data": { "scan": name }, "annotations": [{ "result": [result] }] })
    };
    Value::Array(pictures.iter().map(task).collect()).to_string()
}

#[test]
fn annotations_of_another_picture_are_not_laid_on_the_mosaic() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let programs: [(Write, &str); 3] = [(coco, "a.json"), (cvat, "a.xml"), (studio, "a.json")];
    for (write, name) in programs {
        let read = |pictures: Pictures<'_>| {
            let (text, path) = (write(pictures), folder.path().join(name));
            let mut losses = Losses::default();
            let program = Program::of(&path, &text).unwrap();
            let found = program.read(&path, &text, &picture, &mut losses);
            found.map(|found| (found, losses))
        };
        // That of its name, wherever it stands; others are counted.
        let (found, losses) = read(&[("a.png", [4, 3]), ("north/lot.png", [400, 300])]).unwrap();
        let kinds: Vec<_> = found.iter().map(|one| one.category.as_deref()).collect();
        assert_eq!(kinds, [Some("north/lot.png")], "{name}");
        let counts: Vec<_> = losses.counts.into_iter().collect();
        assert_eq!(counts, [("annotation of another picture".to_owned(), 1)]);
        // The only one, of the same size.
        let (found, losses) = read(&[("old.png", [400, 300])]).unwrap();
        assert_eq!((found.len(), losses.counts.len()), (1, 0), "{name}");
        let told = "note: annotations of old.png are taken for those of lot.png";
        assert_eq!(losses.lines, [told]);
        let refused: [(Pictures<'_>, &str); 3] = [
            (
                &[("lot.png", [1600, 1200])],
                "expected annotations of a picture of 400 × 300 px, found those of one of 1600 × 1200 px",
            ),
            (&[("old.png", [200, 150])], "of one of 200 × 150 px"),
            (
                &[("a.png", [400, 300]), ("b.png", [400, 300])],
                "expected annotations of lot.png, found those of `a.png`, `b.png`",
            ),
        ];
        for (pictures, expected) in refused {
            let fault = read(pictures).unwrap_err().to_string();
            assert!(fault.contains(expected), "{name}: {fault}");
        }
    }
}

#[test]
fn boxes_are_of_the_image_of_their_name_and_no_other() {
    let canvas = |name: &str, size| Canvas {
        name: name.into(),
        size,
    };
    let known = [
        canvas("0001_a.jpg", [400, 300]),
        canvas("0002_a.jpg", [200, 100]),
        canvas("0003_a.jpg", [400, 300]),
    ];
    let programs: [(Write, &str); 3] = [(coco, "a.json"), (cvat, "a.xml"), (studio, "a.json")];
    for (write, name) in programs {
        let read = |pictures: Pictures<'_>| {
            let (text, path) = (write(pictures), Path::new(name));
            let mut losses = Losses::default();
            let program = Program::of(path, &text).unwrap();
            let found = program.boxes(path, &text, &known, &mut losses);
            found.map(|found| (found, losses))
        };
        let (found, losses) = read(&[
            ("images/0003_a.jpg", [400, 300]),
            ("other.jpg", [400, 300]),
            ("3f2a1b4c-0002_a.jpg", [200, 100]),
        ])
        .unwrap();
        let pictures: Vec<usize> = found.boxes.iter().map(|one| one.picture).collect();
        assert_eq!(pictures, [2, 1], "{name}");
        assert_eq!(found.seen, BTreeSet::from([1, 2]), "{name}");
        let counts: Vec<_> = losses.counts.into_iter().collect();
        assert_eq!(counts, [("annotation of another picture".to_owned(), 1)]);
        // One that is called otherwise may be any of them.
        let fault = read(&[("other.jpg", [400, 300])]).unwrap_err().to_string();
        let told = "expected annotations of the images of the folder, found those of `other.jpg`";
        assert!(fault.contains(told), "{name}: {fault}");
        let fault = read(&[("0001_a.jpg", [200, 150])]).unwrap_err().to_string();
        assert!(fault.contains("of one of 200 × 150 px"), "{name}: {fault}");
    }
    let yolo = Program::YoloObb.boxes(Path::new("a.txt"), "", &known, &mut Losses::default());
    let fault = yolo.unwrap_err().to_string();
    assert!(fault.contains("do not name their image"), "{fault}");
}

/// Of several folders, put together in one file.
#[test]
fn pictures_of_one_name_are_told_apart_or_refused_with_both() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let read = |name: &str, text: &str| {
        let (path, mut losses) = (Path::new(name), Losses::default());
        let found = Program::of(path, text)
            .unwrap()
            .read(path, text, &picture, &mut losses);
        let kinds = |found: Vec<DrawnFeature>| found.into_iter().map(|one| one.category.unwrap());
        found.map(|found| (kinds(found).collect::<Vec<_>>(), losses.counts))
    };
    let size = [400, 300];
    let programs: [(Write, &str); 3] = [(coco, "a.json"), (cvat, "a.xml"), (studio, "a.json")];
    for (write, name) in programs {
        // The one that is called just so.
        let text = write(&[("south/lot.png", size), ("lot.png", size)]);
        let (kinds, lost) = read(name, &text).unwrap();
        let other = ("annotation of another picture".to_owned(), 1);
        assert_eq!(kinds, ["lot.png"], "{name}");
        assert_eq!(lost.into_iter().collect::<Vec<_>>(), [other]);
        let text = write(&[("south/lot.png", size), ("north/lot.png", size)]);
        let said = read(name, &text).unwrap_err().to_string();
        let has = |what: &str| said.contains(what);
        assert!(has("south/lot.png") && has("north/lot.png"), "{said}");
    }
    // Of one name, and two ids.
    let twice = coco(&[("lot.png", size), ("lot.png", size)]);
    let said = read("a.json", &twice).unwrap_err().to_string();
    let both = "found lot.png (id 0) and lot.png (id 1)";
    assert!(said.contains(both), "{said}");
    let image = |id: u32| format!(r#"<image id="{id}" name="lot.png"/>"#);
    let twice = format!("<annotations>{}{}</annotations>", image(0), image(1));
    let said = read("a.xml", &twice).unwrap_err().to_string();
    assert!(said.contains(both), "{said}");
    // Tasks of one picture, which several people had.
    let twice = studio(&[("lot.png", size), ("lot.png", size)]);
    assert_eq!(read("a.json", &twice).unwrap().0.len(), 2);
}

#[test]
fn ids_that_several_have_are_refused_with_both() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let refused = |file: Value| {
        let read = Program::Coco.read(
            Path::new("a.json"),
            &file.to_string(),
            &picture,
            &mut Losses::default(),
        );
        read.err().map(|fault| fault.to_string())
    };
    let image = |name: &str| json!({ "id": 7, "file_name": name });
    let category = |name: &str| json!({ "id": 3, "name": name });
    let file = |images: [Value; 2], categories: [Value; 2]| json!({ "images": images, "categories": categories, "annotations": [] });
    let (images, categories) = (["lot.png"; 2].map(image), ["space"; 2].map(category));
    // The same one, twice.
    assert_eq!(refused(file(images.clone(), categories.clone())), None);
    for (file, both) in [
        (
            file(["lot.png", "other.png"].map(image), categories),
            "found 7 of \"lot.png\" and of \"other.png\"",
        ),
        (
            file(images, ["space", "car"].map(category)),
            "found 3 of \"space\" and of \"car\"",
        ),
    ] {
        let said = refused(file).unwrap();
        assert!(said.contains(both), "{said}");
    }
}

#[test]
fn a_rectangle_of_several_labels_is_told_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let result = |labels: &[&str]| {
        let value = json!({ "x": 10, "y": 10, "width": 5, "height": 3, "rectanglelabels": labels });
        json!({ "type": "rectanglelabels", "value": value })
    };
    let choices =
        json!({ "type": "choices", "value": { "choices": ["dark", "wet"] }, "id": "weather" });
    let results = [result(&["space", "car"]), result(&["space"]), choices];
    let tasks = json!([{ "data": { "image": "lot.png" }, "annotations": [{ "result": results }] }]);
    let (path, mut losses) = (Path::new("a.json"), Losses::default());
    let found = Program::LabelStudio.read(path, &tasks.to_string(), &picture, &mut losses);
    assert_eq!(found.unwrap().len(), 1);
    let told = [
        "task 0, result 0: annotation with several labels: which one it marks is not said",
        "task 0, result 2: annotation that is neither box, outline nor line",
    ];
    assert_eq!(losses.lines, told);
}

/// Who only opened a task of Label Studio, or gave it up, has said nothing of its image.
#[test]
fn an_image_was_looked_at_where_somebody_said_something_of_it_or_that_there_is_nothing() {
    let canvases = ["a.png", "b.png", "c.png"].map(|name| Canvas {
        name: name.into(),
        size: [40, 30],
    });
    let task = |name: &str, annotations: Value| json!({ "data": { "image": name }, "predictions": [{ "result": [] }], "annotations": annotations });
    let tasks = json!([
        task("a.png", json!([])),
        task("b.png", json!([{ "result": [] }])),
        task("c.png", json!([{ "was_cancelled": true, "result": [] }])),
    ]);
    let mut losses = Losses::default();
    let found = Program::LabelStudio.boxes(
        Path::new("a.json"),
        &tasks.to_string(),
        &canvases,
        &mut losses,
    );
    let found = found.unwrap();
    assert_eq!((found.boxes.len(), found.seen), (0, BTreeSet::from([1])));
    assert_eq!(losses, Losses::default());
}

/// Who copies a shape copies its name; which of them is the label, its place tells.
#[test]
fn shapes_that_share_a_name_have_none() {
    let corners = |x: f64| of_box([x, 15.0], 0.5, [2.0, 1.0]);
    let labels = [("a", 13.0), ("b", 17.0), ("a", 21.0)];
    let labels = labels.map(|(name, x)| label(name, "box", &corners(x)));
    for program in [Program::Coco, Program::Cvat, Program::LabelStudio] {
        let (found, _) = round_trip(program, &labels);
        let names: Vec<_> = found.iter().map(|one| one.label.as_deref()).collect();
        assert_eq!(names, [None, Some("b"), None], "{program:?}");
    }
}

#[test]
fn a_blank_kind_is_none() {
    let text = r#"<annotations><image name="lot.png"><box label=" " xtl="1" ytl="1" xbr="9" ybr="5"/></image></annotations>"#;
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let read = Program::Cvat.read(Path::new("a.xml"), text, &picture, &mut Losses::default());
    let kinds: Vec<_> = read.unwrap().into_iter().map(|one| one.category).collect();
    assert_eq!(kinds, [None]);
}

#[test]
fn what_becomes_the_box_around_it_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let annotation = |segmentation: Value| json!({ "image_id": 1, "category_id": 1, "bbox": [40, 40, 100, 60], "segmentation": segmentation });
    let one = [40, 40, 140, 40, 40, 100];
    let other = [140, 100, 100, 100, 140, 60];
    let all = [
        annotation(json!([one])),
        annotation(json!([one, other])),
        annotation(json!({ "size": [300, 400], "counts": "abc" })),
        annotation(json!([])),
    ];
    let file = json!({
        "images": [{ "id": 1, "file_name": "lot.png" }],
        "categories": [{ "id": 1, "name": "area" }],
        "annotations": all,
    });
    let (path, mut losses) = (Path::new("a.json"), Losses::default());
    let found = Program::Coco.read(path, &file.to_string(), &picture, &mut losses);
    let corners: Vec<usize> = found.unwrap().iter().map(|one| points(one).len()).collect();
    assert_eq!(corners, [3, 4, 4, 4]);
    let told = "annotation of several outlines, or of a mask, taken as the box around it";
    let told = [1, 2].map(|number| format!("annotation {number}: {told}"));
    assert_eq!(losses.lines, told);
}

/// What a file of one picture, `a.png`, says of it: boxes, whether it was seen, whether something was not read; or why it is
/// refused.
fn told(text: &str) -> Result<(usize, bool, bool), String> {
    let canvases = [Canvas {
        name: "a.png".into(),
        size: [400, 300],
    }];
    let path = Path::new("a.file");
    let program = Program::of(path, text).unwrap();
    let found = program.boxes(path, text, &canvases, &mut Losses::default());
    let found = found.map_err(|fault| fault.to_string())?;
    let has = |pictures: &BTreeSet<usize>| pictures.contains(&0);
    Ok((found.boxes.len(), has(&found.seen), has(&found.unread)))
}

/// What cannot be read is not gone: nobody is rejected for it.
#[test]
fn what_is_no_list_of_annotations_is_refused_or_not_seen() {
    let images = json!([{ "id": 7, "file_name": "a.png" }]);
    let of = |id: Value| json!([{ "image_id": id, "bbox": [1, 1, 20, 10] }]);
    let lists = "expected lists of images and annotations of COCO, found no `annotations`";
    for (annotations, expected) in [
        (of(7.into()), Ok((1, true, false))),
        (json!([]), Ok((0, true, false))),
        // No picture has this id: the box may be of any.
        (of("7".into()), Ok((0, true, true))),
        (of(Value::Null), Ok((0, true, true))),
        (Value::Null, Err(lists)),
        (
            json!({ "0": {} }),
            Err("expected a list of annotations, found an object"),
        ),
        (
            json!("none"),
            Err("expected a list of annotations, found a text"),
        ),
    ] {
        let file = json!({ "images": images, "annotations": annotations }).to_string();
        has(told(&file), expected, &file);
    }
    let missing = json!({ "images": images }).to_string();
    has(told(&missing), Err(lists), &missing);
    for (annotations, expected) in [
        (json!([{ "result": [] }]), Ok((0, true, false))),
        (json!([{ "result": null }]), Ok((0, false, true))),
        (json!([{ "result": { "x": 1 } }]), Ok((0, false, true))),
        (json!([5]), Ok((0, false, true))),
        (json!([{ "result": [] }, {}]), Ok((0, true, true))),
        (Value::Null, Ok((0, false, false))),
        (
            json!({ "result": [] }),
            Err("expected a list of annotations, found an object"),
        ),
    ] {
        let task = json!({ "data": { "image": "a.png" }, "annotations": annotations });
        let file = json!([task]).to_string();
        has(told(&file), expected, &file);
    }
}

/// Holds what a file says to what is expected, or why it is refused to a part of that.
fn has(
    told: Result<(usize, bool, bool), String>,
    expected: Result<(usize, bool, bool), &str>,
    file: &str,
) {
    match (told, expected) {
        (Err(told), Err(expected)) => assert!(told.contains(expected), "{file}: {told}"),
        (told, expected) => assert_eq!(told.ok(), expected.ok(), "{file}"),
    }
}

#[test]
fn what_is_there_and_cannot_be_read_is_not_as_if_it_were_missing() {
    let read = Ok((1, true, false));
    let unread = Ok((0, true, true));
    let other = Err("expected annotations of a picture of 400 × 300 px, found those of one of");
    let coco = |image: Value, annotation: Value| {
        let mut images = json!([{ "id": 7, "file_name": "a.png" }]);
        let mut annotations = json!([{ "image_id": 7, "bbox": [1, 1, 20, 10] }]);
        for (into, more) in [(&mut images[0], image), (&mut annotations[0], annotation)] {
            let more = more.as_object().cloned().unwrap_or_default();
            into.as_object_mut().unwrap().extend(more);
        }
        let categories = json!([{ "id": 3, "name": "car" }, { "id": 4 }]);
        json!({ "images": images, "categories": categories, "annotations": annotations })
            .to_string()
    };
    let size =
        |width: Value, height: Value| coco(json!({ "width": width, "height": height }), json!({}));
    let says = |annotation: Value| coco(json!({}), annotation);
    let cvat = |image: &str, shape: &str| {
        format!(
            r#"<annotations><image name="a.png" {image}><box label="car" xtl="1" ytl="1" xbr="21" ybr="11" {shape}/></image></annotations>"#
        )
    };
    let studio = |result: Value, value: Value| {
        let mut whole = json!({
            "type": "rectanglelabels",
            "value": { "x": 1, "y": 1, "width": 5, "height": 3, "rectanglelabels": ["car"] },
        });
        let more = value.as_object().cloned().unwrap_or_default();
        whole["value"].as_object_mut().unwrap().extend(more);
        let more = result.as_object().cloned().unwrap_or_default();
        whole.as_object_mut().unwrap().extend(more);
        json!([{ "data": { "image": "a.png" }, "annotations": [{ "result": [whole] }] }])
            .to_string()
    };
    let original = |width: Value| studio(json!({ "original_width": width }), json!({}));
    let value = |value: Value| studio(json!({}), value);
    for (file, expected) in [
        (size(400.into(), 300.into()), read),
        (size("400".into(), Value::Null), read),
        (size("800".into(), "600".into()), other),
        (size("wide".into(), 300.into()), other),
        (size(Value::Null, 600.into()), other),
        (says(json!({ "attributes": { "rotation": 45 } })), read),
        (says(json!({ "attributes": { "rotation": "45" } })), unread),
        (says(json!({ "category_id": 3 })), read),
        (says(json!({ "category_id": "3" })), unread),
        (says(json!({ "category_id": 4 })), unread),
        (says(json!({ "category_id": 77 })), unread),
        (
            cvat(r#"width="400" height="300""#, r#"rotation="45""#),
            read,
        ),
        (cvat(r#"width="400px" height="300px""#, ""), other),
        (cvat("", r#"rotation="45 degrees""#), unread),
        (original(400.into()), read),
        (original("800".into()), other),
        (value(json!({ "rotation": 45 })), read),
        (value(json!({ "rotation": "45" })), unread),
        (value(json!({ "rectanglelabels": [] })), read),
        (value(json!({ "rectanglelabels": "car" })), unread),
    ] {
        has(told(&file), expected, &file);
    }
}

#[test]
fn a_file_without_pictures_has_annotations_of_one() {
    let file = |ids: &[u32]| {
        let annotations = ids.iter();
        let annotations = annotations.map(|id| json!({ "image_id": id, "bbox": [1, 1, 20, 10] }));
        let annotations: Vec<Value> = annotations.collect();
        json!({ "images": [], "annotations": annotations }).to_string()
    };
    assert_eq!(told(&file(&[7, 7])).map(|(boxes, ..)| boxes), Ok(2));
    let said = told(&file(&[99, 7])).unwrap_err();
    assert!(said.contains("annotations of images 99 and 7"), "{said}");
}

/// Whatever else it has, and however long its lists are.
#[test]
fn a_file_of_too_many_annotations_is_refused() {
    let many = |one: &str| vec![one; MOST_FEATURES + 1].join(",");
    let found = "found 500001";
    for (text, said) in [
        (
            format!(
                r#"{{"images": [{{"file_name": "a.png"}}], "annotations": [{}]}}"#,
                many("0")
            ),
            "expected at most 500000 annotations",
        ),
        (
            format!(r#"{{"images": [{}], "annotations": []}}"#, many("0")),
            "expected at most 500000 images",
        ),
        (
            format!(
                r#"{{"images": [], "annotations": [], "categories": [{}]}}"#,
                many("0")
            ),
            "expected at most 500000 categories",
        ),
        (
            format!("[{}]", many(r#"{"data":0}"#)),
            "expected at most 500000 tasks",
        ),
        (
            format!(
                r#"[{{"data": {{}}, "annotations": [{{"result": [{}]}}]}}]"#,
                many("0")
            ),
            "expected at most 500000 results",
        ),
        (
            format!(
                "<annotations>{}</annotations>",
                "<image/>".repeat(MOST_FEATURES + 1)
            ),
            "expected at most 500000 pictures",
        ),
        (
            format!(
                "<annotations><image>{}</image></annotations>",
                "<a/>".repeat(MOST_FEATURES + 1)
            ),
            "expected at most 500000 annotations",
        ),
        // Those of several annotations, in several lists, are counted together.
        (
            format!(
                r#"[{{"completions": [{{"result": [0]}}], "annotations": [{{"result": [0]}}, {{"result": [{}]}}]}}]"#,
                vec!["0"; MOST_FEATURES - 1].join(",")
            ),
            "expected at most 500000 results",
        ),
    ] {
        let told = told(&text).unwrap_err();
        assert!(told.contains(said) && told.contains(found), "{told}");
    }
}

/// Of more corners than a label may have, none is held: on a mosaic it is counted, around a person it is a box all the same.
#[test]
fn an_outline_of_too_many_corners_is_the_box_around_it_or_counted() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    // A zigzag from (10, 10) to (110, 60) px.
    let corners = |count: usize| {
        let corner = |at: usize| {
            let share = at as f64 / (count - 1) as f64;
            [
                10.0 + 100.0 * share,
                if at.is_multiple_of(2) { 10.0 } else { 60.0 },
            ]
        };
        (0..count).map(corner).collect::<Vec<_>>()
    };
    let coco = |count: usize| {
        let annotation = json!({ "image_id": 1, "segmentation": [corners(count).concat()] });
        let images = json!([{ "id": 1, "file_name": "lot.png" }]);
        json!({ "images": images, "annotations": [annotation] }).to_string()
    };
    let studio = |count: usize| {
        let points = corners(count).into_iter().map(|[x, y]| [x / 4.0, y / 3.0]);
        let value = json!({ "points": points.collect::<Vec<_>>() });
        let result = json!({ "value": value, "type": "polygonlabels" });
        let annotations = json!([{ "result": [result] }]);
        json!([{ "data": { "image": "lot.png" }, "annotations": annotations }]).to_string()
    };
    let cvat = |count: usize| {
        let points = corners(count).into_iter().map(|[x, y]| format!("{x},{y}"));
        let points = points.collect::<Vec<_>>().join(";");
        format!(
            r#"<annotations><image name="lot.png"><polygon points="{points}"/></image></annotations>"#
        )
    };
    let canvases = [Canvas {
        name: "lot.png".into(),
        size: [400, 300],
    }];
    for (program, text) in [
        (Program::Coco, &coco as &dyn Fn(usize) -> String),
        (Program::LabelStudio, &studio),
        (Program::Cvat, &cvat),
    ] {
        let path = Path::new("a.json");
        for count in [4096, 4097] {
            let (text, mut losses) = (text(count), Losses::default());
            let found = program.boxes(path, &text, &canvases, &mut losses).unwrap();
            let bounds = found.boxes[0].bounds.concat();
            let expected = [10.0, 10.0, 110.0, 60.0];
            let off = bounds.iter().zip(expected).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 1e-9, "{program:?}: {bounds:?}");
            assert!(losses.counts.is_empty() && found.unread.is_empty());
            let features = program.read(path, &text, &picture, &mut losses).unwrap();
            let told = losses.counts.get(TOO_MANY_POINTS).copied();
            let expected = if count > 4096 {
                (0, Some(1))
            } else {
                (1, None)
            };
            assert_eq!((features.len(), told), expected, "{program:?}");
        }
    }
}

/// What nobody looks for costs no more than its bytes, whatever it is and however deep.
#[test]
fn xml_of_any_form_is_read_in_one_pass() {
    let attributes: String = (0..100_000).map(|at| format!(" a{at}=\"\"")).collect();
    let nested = ["<g>".repeat(200_000), "</g>".repeat(200_000)].concat();
    let text = format!(
        r#"<?xml version="1.0"?><!-- a --><annotations><meta>{nested}</meta><image{attributes} name="a.png">
        <box{attributes} label="a &amp; &#98;" xtl="1" ytl="1" xbr="21" ybr="11">{nested}<attribute name="evermap_label">
        a &lt;<![CDATA[<b>]]> </attribute><attribute name="evermap_label">c</attribute></box></image></annotations>"#
    );
    assert_eq!(told(&text), Ok((1, true, false)));
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let path = Path::new("a.xml");
    let mut losses = Losses::default();
    let found = Program::Cvat.read(path, &text, &picture, &mut losses);
    let found = found.unwrap();
    assert_eq!(found[0].category.as_deref(), Some("a & b"));
    assert_eq!(found[0].label.as_deref(), Some("a <<b>"));
    // Cut anywhere it is no whole file, and says so.
    let short = text.replace(&attributes, "").replace(&nested, "<g></g>");
    for end in 1..short.len() {
        if let Some(cut) = short.get(..end) {
            assert!(told(cut).is_err(), "{cut}");
        }
    }
}

/// What a result is comes behind what it says, and what nobody looks for lies between.
#[test]
fn members_may_come_in_any_order() {
    let studio = r#"[{"annotations": [{"result": [{"value": {"rectanglelabels": ["car"], "other": [[], {}],
        "height": 3, "width": 5, "x": 1, "y": 2}, "type": "rectanglelabels", "meta": {"a": [1]}}],
        "was_cancelled": false}], "data": {"notes": ["b.png"], "text": "x", "photo": "a.png"}}]"#;
    assert_eq!(told(studio), Ok((1, true, false)));
    let cancelled = studio.replace("false", "true");
    assert_eq!(told(&cancelled), Ok((0, false, false)));
    let coco = r#"{"annotations": [{"bbox": [1, 2, 3, 4], "image_id": "x", "category_id": 2, "segmentation": []}],
        "categories": [{"name": "car", "id": 2}], "images": [{"file_name": "a.png", "id": "x"}]}"#;
    assert_eq!(told(coco), Ok((1, true, false)));
}

fn of_kind(kind: &str, x: f64) -> PlacedLabel {
    PlacedLabel {
        kind: kind.into(),
        ..label("a", "box", &of_box([x, 15.0], 0.5, [2.0, 1.0]))
    }
}

/// Files of a folder share the names of their classes.
#[test]
fn classes_of_boxes_that_are_there_keep_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let write = |name: &str, labels: &[PlacedLabel]| {
        let (path, mut losses) = (folder.path().join(name), Losses::default());
        Program::YoloObb.write(&path, &picture, (labels, &[]), &mut losses)
    };
    let classes = || std::fs::read_to_string(folder.path().join("classes.txt")).unwrap();
    let first = write("a.txt", &[of_kind("space", 13.0)]).unwrap();
    assert!(first.starts_with("0 ") && classes() == "space\n");
    let second = write("b.txt", &[of_kind("arrow", 13.0), of_kind("space", 17.0)]).unwrap();
    let numbers: Vec<&str> = second.lines().map(|line| &line[..2]).collect();
    assert_eq!(numbers, ["1 ", "0 "]);
    assert_eq!(classes(), "space\narrow\n");
    // With fewer, what is there stays.
    let third = write("c.txt", &[of_kind("arrow", 13.0)]).unwrap();
    assert!(third.starts_with("1 ") && classes() == "space\narrow\n");
    for name in ["classes.txt", "Classes.TXT"] {
        assert!(write(name, &[of_kind("space", 13.0)]).is_err(), "{name}");
    }
    assert_eq!(classes(), "space\narrow\n");
}

/// It would be two classes of YOLO, and no XML.
#[test]
fn a_kind_of_two_lines_is_counted() {
    for program in ALL {
        let (found, losses) = round_trip(program, &[of_kind("a\nb", 13.0), of_kind("c", 17.0)]);
        let kinds: Vec<_> = found.iter().map(|one| one.category.as_deref()).collect();
        assert_eq!(kinds, [Some("c")], "{program:?}");
        let counts: Vec<_> = losses.counts.into_iter().collect();
        let told = "label whose kind or name has a control character";
        assert_eq!(counts, [(told.to_owned(), 1)], "{program:?}");
    }
}

/// Of as many as there are, it would take minutes to look for each anew.
#[test]
fn annotations_of_tens_of_thousands_of_images_are_told_apart_by_id() {
    const IMAGES: usize = 40_000;
    let folder = tempfile::tempdir().unwrap();
    let picture = picture(folder.path());
    let image = |id: usize| match id + 1 == IMAGES {
        true => json!({ "id": id, "file_name": "lot.png" }),
        false => json!({ "id": id, "file_name": format!("{id}.png") }),
    };
    let category = |id: usize| json!({ "id": id, "name": format!("kind {id}") });
    // Each image has three; of others that are not there, there are two.
    let annotation = |number: usize| {
        let id = number % (2 * IMAGES);
        json!({ "image_id": id, "category_id": id % IMAGES, "bbox": [1, 1, 4, 8] })
    };
    let file = json!({
        "images": (0..IMAGES).map(image).collect::<Vec<_>>(),
        "categories": (0..IMAGES).map(category).collect::<Vec<_>>(),
        "annotations": (0..5 * IMAGES).map(annotation).collect::<Vec<_>>(),
    });
    let (path, mut losses) = (Path::new("a.json"), Losses::default());
    let found = Program::Coco.read(path, &file.to_string(), &picture, &mut losses);
    let found = found.unwrap();
    assert_eq!(found.len(), 3);
    let kind = format!("kind {}", IMAGES - 1);
    assert!(found.iter().all(|one| one.category.as_ref() == Some(&kind)));
    let lost = losses.counts.values().sum::<u64>();
    assert_eq!(lost, 5 * IMAGES as u64 - 3);
}
