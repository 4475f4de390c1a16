//! What people say is on the disk when it was said, whatever happens then, and is read like any other log.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::fs;
use std::path::Path;

use crate::common::{open, rows};
use evermap_datasets::Reason;
use evermap_messages::annotation::{
    Anchor, Annotation, DrawnPixels, Geometry, NAME, OnImage, SCHEMA,
};
use evermap_recording::annotations::{AnnotationLog, parts};
use evermap_schemas::roles::{self, Role};
use evermap_schemas::rows as typed;

const SQUARE: [[f64; 3]; 4] = [
    [2.5, 1.2, 0.0],
    [-2.5, 1.2, 0.0],
    [-2.5, -1.2, 0.0],
    [2.5, -1.2, 0.0],
];

fn drawn(number: u64) -> Annotation {
    Annotation {
        stamp_ns: 1_700_000_000_123_456_789 + number,
        author: "ada".into(),
        sequence: number,
        id: format!("space {number}"),
        kind: "parking_space".into(),
        act: "drawn".into(),
        map_version: Some(3),
        geometry: Some(Geometry {
            shape: "box".into(),
            points: SQUARE.to_vec(),
            map_from_label: [1.0, 2.0, 0.5, 0.0, 0.0, 0.6, 0.8],
        }),
        anchor: Some(Anchor {
            session: "monday".into(),
            stamp_ns: 1_600_000_000_000_000_001,
            camera: None,
            vehicle_from_label: [0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        }),
        image: None,
    }
}

fn removed(number: u64) -> Annotation {
    Annotation {
        act: "removed".into(),
        map_version: None,
        geometry: None,
        anchor: None,
        ..drawn(number)
    }
}

/// Pixels of an image that are painted.
fn painted(number: u64) -> Annotation {
    Annotation {
        kind: "road".into(),
        geometry: None,
        anchor: None,
        image: Some(OnImage {
            session: "monday".into(),
            stamp_ns: 1_600_000_000_000_000_001,
            camera: "front".into(),
            drawn: Some(DrawnPixels {
                shape: "polyline".into(),
                points: vec![[1.5, 2.0], [30.0, 4.25]],
                brush_px: Some(12.0),
            }),
        }),
        ..drawn(number)
    }
}

async fn read(path: &Path) -> (Vec<roles::Annotation>, Vec<Reason>) {
    let (context, dataset) = open(&[path.to_str().unwrap().to_owned()], 1).await;
    let batches = rows(&context, "SELECT * FROM annotations ORDER BY sequence").await;
    let found = batches.iter().flat_map(|batch| typed(batch).unwrap());
    let lost = dataset.losses.losses().into_keys();
    (found.collect(), lost.collect())
}

#[tokio::test]
async fn what_was_said_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("labels.mcap");
    let mut log = AnnotationLog::begin(&target, |_| false, "a test").unwrap();
    log.say_all(&[drawn(0)]).unwrap();
    log.say_all(&[removed(1)]).unwrap();
    assert_eq!(log.finish().unwrap(), target);
    let (found, lost) = read(&target).await;
    assert!(lost.is_empty(), "{lost:?}");
    let [first, second] = found.as_slice() else {
        panic!("{found:?}")
    };
    assert_eq!((&*first.id, &*first.author), ("space 0", "ada"));
    assert_eq!(first.stamp.0, 1_700_000_000_123_456_789);
    assert_eq!(first.map_version, Some(3));
    assert_eq!(first.points, SQUARE);
    let place = first.map_from_label.as_ref().unwrap();
    assert_eq!((place.x, place.z, place.qw), (1.0, 0.5, 0.8));
    let anchor = first.anchor.as_ref().unwrap();
    assert_eq!((&*anchor.session, &anchor.camera), ("monday", &None));
    assert_eq!(anchor.stamp.0, 1_600_000_000_000_000_001);
    assert_eq!(anchor.vehicle_from_label.y, 3.0);
    assert_eq!(
        (&*second.act, &second.shape, &second.anchor),
        ("removed", &None, &None)
    );
}

/// Who writes on says things into a file that has no name any more.
#[test]
fn a_log_is_there_until_it_is_removed_or_another_takes_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("labels.mcap");
    let mut log = AnnotationLog::begin(&target, |_| false, "a test").unwrap();
    assert!(log.is_there());
    log.say_all(&[drawn(0)]).unwrap();
    assert!(log.is_there());
    fs::remove_file(&target).unwrap();
    assert!(!log.is_there());
    fs::write(&target, "another file").unwrap();
    assert!(!log.is_there());

    let next = AnnotationLog::begin(&target, |_| false, "a test").unwrap();
    assert!(next.is_there() && next.path().ends_with("labels_2.mcap"));
    fs::rename(next.path(), folder.path().join("moved.mcap")).unwrap();
    assert!(!next.is_there());
}

#[tokio::test]
async fn a_killed_program_leaves_all_that_was_said_and_is_gone_on_from() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("labels.mcap");
    let mut log = AnnotationLog::begin(&target, |_| false, "a test").unwrap();
    log.say_all(&[drawn(0)]).unwrap();
    let one = fs::metadata(&target).unwrap().len();
    log.say_all(&[drawn(1)]).unwrap();
    // Killed: nothing is written any more.
    std::mem::forget(log);
    let left = fs::read(&target).unwrap();
    let (found, lost) = read(&target).await;
    assert_eq!((found.len(), lost), (2, vec![Reason::Torn]));

    // Torn anywhere within the second act, the first is there.
    let torn = folder.path().join("torn.mcap");
    for length in [one, one + 1, one + 9, left.len() as u64 - 1] {
        fs::write(&torn, &left[..length as usize]).unwrap();
        let (found, lost) = read(&torn).await;
        assert_eq!((found.len(), lost), (1, vec![Reason::Torn]), "{length}");
    }

    // The next sitting has a part of its own, and leaves the first one alone.
    let mut log = AnnotationLog::begin(&target, |_| false, "a test").unwrap();
    log.say_all(&[drawn(2)]).unwrap();
    let second = log.finish().unwrap();
    assert_eq!(second.file_name().unwrap(), "labels_2.mcap");
    assert_eq!(fs::read(&target).unwrap(), left);
    assert_eq!(parts(&target), [target, second]);
}

#[tokio::test]
async fn one_who_speaks_twice_at_once_writes_two_parts() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("labels.mcap");
    let begin = || AnnotationLog::begin(&target, |_| false, "a test").unwrap();
    let mut logs = [begin(), begin()];
    for number in 0..4 {
        logs[number % 2].say_all(&[drawn(number as u64)]).unwrap();
    }
    for log in logs {
        let (found, lost) = read(&log.finish().unwrap()).await;
        assert_eq!((found.len(), lost), (2, vec![]));
    }
    assert_eq!(parts(&target).len(), 2);
}

#[test]
fn a_name_that_the_map_has_is_not_taken_again_and_parts_may_be_missing() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("labels.mcap");
    let taken = |name: &str| ["labels", "labels_2"].contains(&name);
    let log = AnnotationLog::begin(&target, taken, "a test").unwrap();
    assert_eq!(log.path(), folder.path().join("labels_3.mcap"));
    for other in [
        "labels_x.mcap",
        "labels_04.mcap",
        "labels_5.json",
        "label.mcap",
    ] {
        fs::write(folder.path().join(other), "").unwrap();
    }
    assert_eq!(parts(&target), [log.path()]);
}

#[tokio::test]
async fn messages_that_make_no_sense_are_counted_and_the_others_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("labels.mcap");
    let mut log = AnnotationLog::begin(&path, |_| false, "a test").unwrap();
    let changed = |number, change: fn(&mut Annotation)| {
        let mut act = drawn(number);
        change(&mut act);
        act
    };
    log.say_all(&[drawn(0)]).unwrap();
    for act in [
        changed(1, |act| act.act = "painted".into()),
        changed(2, |act| {
            act.geometry.as_mut().unwrap().shape = "circle".into()
        }),
        changed(3, |act| act.geometry.as_mut().unwrap().points.clear()),
        changed(4, |act| {
            act.geometry.as_mut().unwrap().map_from_label = [0.0; 7]
        }),
        changed(5, |act| act.geometry = None),
        changed(6, |act| act.id.clear()),
        changed(7, |act| act.id = "a\u{1}b".into()),
        changed(7, |act| act.kind = "parking\nspace".into()),
        changed(7, |act| act.author = "ada\t".into()),
    ] {
        log.say_all(&[act]).unwrap();
    }
    // Kinds are data.
    log.say_all(&[changed(7, |act| act.kind = "heliport".into())])
        .unwrap();
    log.finish().unwrap();
    let (context, dataset) = open(&[path.to_str().unwrap().to_owned()], 1).await;
    let batches = rows(&context, "SELECT * FROM annotations ORDER BY sequence").await;
    let found: Vec<roles::Annotation> = batches.iter().flat_map(|b| typed(b).unwrap()).collect();
    let kinds: Vec<&str> = found.iter().map(|act| act.kind.as_str()).collect();
    assert_eq!(kinds, ["parking_space", "heliport"]);
    let lost = dataset.losses.losses();
    assert_eq!(lost[&Reason::Senseless].count, 9, "{lost:?}");
}

#[tokio::test]
async fn what_is_said_of_images_is_a_table_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("labels.mcap");
    let mut log = AnnotationLog::begin(&path, |_| false, "a test").unwrap();
    let changed = |number, change: fn(&mut OnImage)| {
        let mut act = painted(number);
        act.image.iter_mut().for_each(change);
        act
    };
    log.say_all(&[drawn(0)]).unwrap();
    log.say_all(&[painted(1)]).unwrap();
    let mut removed = changed(2, |image| image.drawn = None);
    removed.act = "removed".into();
    log.say_all(&[removed]).unwrap();
    for bad in [
        changed(3, |image| image.drawn = None),
        changed(4, |image| image.stamp_ns = 0),
        changed(5, |image| {
            image
                .drawn
                .iter_mut()
                .for_each(|drawn| drawn.shape = "box".into())
        }),
        changed(6, |image| {
            image
                .drawn
                .iter_mut()
                .for_each(|drawn| drawn.brush_px = None)
        }),
        Annotation {
            act: "moved".into(),
            ..painted(7)
        },
        Annotation {
            kind: String::new(),
            ..painted(8)
        },
        Annotation {
            kind: "ro\nad".into(),
            ..painted(9)
        },
    ] {
        log.say_all(&[bad]).unwrap();
    }
    log.finish().unwrap();
    let (in_map, lost) = read(&path).await;
    assert_eq!((in_map.len(), lost), (1, vec![]));
    let (context, dataset) = open(&[path.to_str().unwrap().to_owned()], 1).await;
    let batches = rows(
        &context,
        "SELECT * FROM image_annotations ORDER BY sequence",
    )
    .await;
    let found: Vec<roles::ImageAnnotation> =
        batches.iter().flat_map(|b| typed(b).unwrap()).collect();
    let [first, second] = found.as_slice() else {
        panic!("{found:?}")
    };
    assert_eq!((&*first.class, &*first.act), ("road", "drawn"));
    assert_eq!(
        (&*first.image_session, &*first.image_camera),
        ("monday", "front")
    );
    assert_eq!(first.image_stamp.0, 1_600_000_000_000_000_001);
    assert_eq!(first.shape.as_deref(), Some("polyline"));
    assert_eq!(
        (&*first.points, first.brush_px),
        (&[[1.5, 2.0], [30.0, 4.25]][..], Some(12.0))
    );
    assert_eq!(
        (&*second.act, &second.shape, second.points.len()),
        ("removed", &None, 0)
    );
    assert_eq!(dataset.losses.losses()[&Reason::Senseless].count, 7);
}

#[test]
fn the_schema_names_what_is_written_and_the_role_reads_it() {
    let schema: serde_json::Value = serde_json::from_str(SCHEMA).unwrap();
    let declared = schema["properties"].as_object().unwrap();
    let payload: serde_json::Value = serde_json::from_slice(&drawn(0).encode()).unwrap();
    for member in payload.as_object().unwrap().keys() {
        assert!(declared.contains_key(member), "{member}");
    }
    assert_eq!(
        declared["act"]["enum"],
        serde_json::json!(roles::annotations::ACTS)
    );
    let shapes = roles::annotations::SHAPES.map(|(shape, _)| shape);
    assert_eq!(declared["shape"]["enum"], serde_json::json!(shapes));
    let Role { source, .. } = roles::annotations::ROLE;
    let roles::Source::Messages(messages) = source else {
        panic!()
    };
    assert_eq!(messages.types, [NAME]);
    let read: Vec<&str> = messages.members.to_vec();
    assert!(
        declared
            .keys()
            .all(|member| read.contains(&member.as_str()))
    );
}
