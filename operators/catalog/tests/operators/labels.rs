//! Labels: folded, tied to poses, and placed again when the map has moved.

use std::collections::BTreeMap;

use evermap_contract::Losses;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{
    BoxModel, FramePose, LabelAnchor, Landmark, MapFrame, OverheadGradients, ParkingSpace,
    PlacedLabel, VehiclePose,
};
use evermap_schemas::roles::{Anchor, Annotation, Calibration, Transform};
use evermap_schemas::{Bytes, Pose, Stamp, Wkb};
use serde_json::json;

use crate::yields;

/// Side of a cell of the overhead image, where nothing else is said (m).
const CELL_M: f64 = 0.05;

fn at(x: f64, y: f64, yaw: f64) -> Pose {
    Pose {
        x,
        y,
        qz: (yaw / 2.0).sin(),
        qw: (yaw / 2.0).cos(),
        ..Pose::IDENTITY
    }
}

/// A drive along the x axis, a pose a metre, of which the one at second `s` was at `x = s`; all moved by so much.
fn drive(session: &str, moved: [f64; 2]) -> Vec<VehiclePose> {
    let pose = |second: i64| VehiclePose {
        site: "lot".into(),
        session: session.into(),
        stamp: Stamp(second),
        map_from_vehicle: at(second as f64 + moved[0], moved[1], 0.0),
    };
    (0..20).map(pose).collect()
}

/// What ties a label to the vehicle of session `a` at an instant.
fn anchor(stamp: i64, vehicle_from_label: Pose) -> Anchor {
    Anchor {
        session: "a".into(),
        stamp: Stamp(stamp),
        camera: None,
        vehicle_from_label,
    }
}

fn drawn(label: &str, x: f64, y: f64) -> Annotation {
    Annotation {
        site: "lot".into(),
        session: "ada_1".into(),
        stamp: Stamp(100),
        author: "ada".into(),
        sequence: 0,
        id: label.into(),
        kind: "parking_space".into(),
        act: "drawn".into(),
        map_version: Some(1),
        shape: Some("box".into()),
        points: vec![
            [2.0, 1.0, 0.0],
            [-2.0, 1.0, 0.0],
            [-2.0, -1.0, 0.0],
            [2.0, -1.0, 0.0],
        ],
        map_from_label: Some(at(x, y, 0.5)),
        anchor: None,
    }
}

fn frame(frame: u32, x: f64) -> MapFrame {
    MapFrame {
        site: "lot".into(),
        frame,
        session: "a".into(),
        stamp: Stamp(0),
        map_from_frame: at(x, 0.0, 0.0),
        moved_m: None,
        moved_rad: None,
    }
}

/// The map of one version.
#[derive(Default, Clone)]
struct Version {
    poses: Vec<VehiclePose>,
    frames: Vec<MapFrame>,
}

impl Version {
    fn of(poses: Vec<VehiclePose>, frames: Vec<MapFrame>) -> Self {
        Self { poses, frames }
    }
}

fn anchors(
    annotations: Vec<Annotation>,
    now: &Version,
    before: &Version,
    held: Vec<LabelAnchor>,
) -> (Vec<LabelAnchor>, Losses) {
    yields(
        "label_anchors",
        json!({}),
        [
            inputs_of("annotations", annotations).unwrap(),
            inputs_of("poses", now.poses.clone()).unwrap(),
            inputs_of("frames", now.frames.clone()).unwrap(),
            inputs_of("previous_poses", before.poses.clone()).unwrap(),
            inputs_of("previous_frames", before.frames.clone()).unwrap(),
            inputs_of("previous", held).unwrap(),
        ],
    )
}

fn placed(labels: Vec<LabelAnchor>, now: &Version) -> (Vec<PlacedLabel>, Losses) {
    yields(
        "placed_labels",
        json!({}),
        [
            inputs_of("labels", labels).unwrap(),
            inputs_of("poses", now.poses.clone()).unwrap(),
            inputs_of("frames", now.frames.clone()).unwrap(),
        ],
    )
}

fn place(label: &PlacedLabel) -> [f64; 2] {
    [label.map_from_label.x, label.map_from_label.y].map(|value| (value * 1e9).round() / 1e9)
}

#[test]
fn a_label_is_tied_once_to_the_version_that_was_looked_at_and_follows_it() {
    let first = Version::of(drive("a", [0.0, 0.0]), vec![frame(0, 0.0)]);
    let second = Version::of(drive("a", [0.5, -0.25]), vec![frame(0, 0.5)]);
    // Said on the first version, read in the run that makes the second.
    let (held, losses) = anchors(vec![drawn("one", 7.2, 3.0)], &second, &first, vec![]);
    assert!(losses.is_empty(), "{losses:?}");
    let anchor = held[0].anchor.clone().unwrap();
    assert_eq!((&*anchor.session, anchor.stamp), ("a", Stamp(7)));
    let (now, _) = placed(held.clone(), &second);
    assert_eq!((place(&now[0]), &*now[0].placed_by), ([7.7, 2.75], "pose"));
    assert_eq!((now[0].length_m, now[0].width_m), (Some(4.0), Some(2.0)));
    // In the next version the label is said to be where it was drawn: it stays tied to its pose.
    let third = Version::of(drive("a", [-1.0, 0.0]), vec![frame(0, -1.0)]);
    let (kept, _) = anchors(vec![drawn("one", 7.2, 3.0)], &third, &second, held.clone());
    assert_eq!(kept, held);
    assert_eq!(place(&placed(kept, &third).0[0]), [6.2, 3.0]);
    // Drawn elsewhere, it is tied anew, to the version before.
    let (anew, _) = anchors(vec![drawn("one", 12.4, 3.0)], &third, &second, held);
    let stamp = anew[0].anchor.as_ref().unwrap().stamp;
    assert_eq!(stamp, Stamp(12), "the pose at 12.5 m of the second version");
}

#[test]
fn a_label_whose_session_is_gone_is_counted_and_goes_with_its_frame() {
    let first = Version::of(drive("a", [0.0, 0.0]), vec![frame(3, 5.0)]);
    let (held, _) = anchors(
        vec![drawn("one", 7.0, 3.0)],
        &first,
        &Version::default(),
        vec![],
    );
    let gone = Version::of(drive("b", [0.0, 0.0]), vec![frame(3, 6.0)]);
    let (now, losses) = placed(held.clone(), &gone);
    assert_eq!((place(&now[0]), &*now[0].placed_by), ([8.0, 3.0], "frame"));
    assert_eq!(
        losses.0["label whose session is gone, placed by its frame"],
        1
    );
    let (now, losses) = placed(held, &Version::of(drive("b", [0.0, 0.0]), vec![]));
    assert_eq!(
        (place(&now[0]), &*now[0].placed_by),
        ([7.0, 3.0], "drawing")
    );
    assert_eq!(losses.total(), 1);
}

#[test]
fn a_frame_is_the_one_that_was_made_from_the_same_pose_whatever_its_number() {
    let first = Version::of(drive("a", [0.0, 0.0]), vec![frame(3, 5.0)]);
    let said = || vec![drawn("one", 7.0, 3.0)];
    let (held, _) = anchors(said(), &first, &Version::default(), vec![]);
    let now = |frames: Vec<MapFrame>| {
        let (now, losses) = placed(held.clone(), &Version::of(drive("b", [0.0, 0.0]), frames));
        (place(&now[0]), now[0].placed_by.clone(), losses)
    };
    // Of the session that came in its place: the number is that of a pose elsewhere.
    let other = MapFrame {
        session: "b".into(),
        ..frame(3, 25.0)
    };
    let later = MapFrame {
        stamp: Stamp(1),
        ..frame(3, 25.0)
    };
    for stranger in [other.clone(), later] {
        let (at, by, losses) = now(vec![stranger]);
        assert_eq!((at, &*by), ([7.0, 3.0], "drawing"));
        let told = "label whose session is gone, placed as it was drawn";
        assert_eq!(losses.0[told], 1);
    }
    // Where the version before had it, as long as it is tied to the same pose.
    let tied_anew = |label: &PlacedLabel| PlacedLabel {
        anchor: Some(Anchor {
            stamp: Stamp(9),
            ..label.anchor.clone().unwrap()
        }),
        ..label.clone()
    };
    let second = Version::of(drive("a", [0.5, 0.0]), vec![frame(3, 5.5)]);
    let (before, _) = placed(held.clone(), &second);
    for (before, expected) in [
        (before[0].clone(), (7.5, "before")),
        (tied_anew(&before[0]), (7.0, "drawing")),
    ] {
        let inputs = [
            inputs_of("labels", held.clone()).unwrap(),
            inputs_of("poses", drive("b", [0.0, 0.0])).unwrap(),
            inputs_of("frames", vec![other.clone()]).unwrap(),
            inputs_of("previous", vec![before]).unwrap(),
        ];
        let (now, losses) = yields::<PlacedLabel>("placed_labels", json!({}), inputs);
        assert_eq!((place(&now[0])[0], &*now[0].placed_by), expected);
        assert_eq!(losses.total(), 1);
    }
    // The frame itself, a metre on, under another number.
    let (at, by, _) = now(vec![other, frame(8, 6.0)]);
    assert_eq!((at, &*by), ([8.0, 3.0], "frame"));

    // A map that was made before frames were noted so: its labels are held as new ones are.
    let before = LabelAnchor {
        frame_session: None,
        frame_stamp: None,
        ..held[0].clone()
    };
    let (again, _) = anchors(said(), &first, &first, vec![before]);
    assert_eq!(again, held);
}

#[test]
fn a_pose_of_the_version_before_goes_with_its_own_frame_and_not_with_a_new_one_of_its_number() {
    let before = FramePose {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(5),
        frame: 3,
        frame_from_vehicle: at(1.0, 0.0, 0.0),
        map_from_vehicle: at(6.0, 0.0, 0.0),
    };
    let now = |frame: MapFrame| {
        let inputs = [
            inputs_of("poses", drive("b", [0.0, 0.0])).unwrap(),
            inputs_of("frames", vec![frame]).unwrap(),
            inputs_of("previous", vec![before.clone()]).unwrap(),
        ];
        let (poses, _) = yields::<FramePose>("frame_poses", json!({}), inputs);
        let pose = poses.into_iter().find(|pose| pose.session == "a");
        let pose = pose.unwrap();
        [pose.map_from_vehicle.x, pose.frame_from_vehicle.x]
    };
    let kept = MapFrame {
        moved_m: Some(2.0),
        moved_rad: Some(0.0),
        ..frame(3, 7.0)
    };
    assert_eq!(now(kept), [8.0, 1.0]);
    assert_eq!(now(frame(3, 25.0)), [6.0, -19.0], "its frame is gone");
}

#[test]
fn poses_chosen_anew_hold_labels_in_between_but_not_across_gaps() {
    let version = |seconds: &[i64]| {
        let mut poses = drive("a", [0.0, 1.0]);
        poses.retain(|pose| seconds.contains(&pose.stamp.0));
        Version::of(poses, vec![])
    };
    let anchor = anchor(7, at(0.0, 2.0, 0.0));
    let (held, _) = anchors(
        vec![Annotation {
            anchor: Some(anchor.clone()),
            ..drawn("one", 0.0, 0.0)
        }],
        &version(&[7]),
        &Version::default(),
        vec![],
    );
    assert_eq!(held[0].anchor, Some(anchor), "what was said holds");
    let by = |seconds: &[i64]| {
        placed(held.clone(), &version(seconds)).0[0]
            .placed_by
            .clone()
    };
    assert_eq!(by(&[7]), "pose");
    assert_eq!(by(&[6, 8]), "drawing", "two metres are too far");
    let params = json!({ "gap_m": 2.0 });
    let inputs = [
        inputs_of("labels", held.clone()).unwrap(),
        inputs_of("poses", version(&[6, 8]).poses).unwrap(),
    ];
    let (now, _) = yields::<PlacedLabel>("placed_labels", params, inputs);
    assert_eq!(place(&now[0]), [7.0, 3.0]);
}

/// As one drawn in UTM is, or one whose height is no height.
#[test]
fn a_label_kilometres_from_every_pose_is_counted_and_makes_nothing_larger() {
    let map = Version::of(drive("a", [0.0, 0.0]), vec![frame(0, 0.0)]);
    let high = Annotation {
        map_from_label: Some(Pose {
            z: 1e6,
            ..at(3.0, 3.0, 0.0)
        }),
        ..drawn("high", 0.0, 0.0)
    };
    // Its anchor is near, it is not.
    let beside = anchor(7, at(0.0, 5000.0, 0.0));
    let tied = Annotation {
        anchor: Some(beside),
        ..drawn("tied", 7.0, 5000.0)
    };
    let said = vec![
        drawn("near", 7.0, 3.0),
        drawn("outside", 1900.0, 0.0),
        drawn("utm", 500_000.0, 5_540_000.0),
        high,
        tied,
    ];
    let (held, _) = anchors(said, &map, &Version::default(), vec![]);
    assert_eq!(held.len(), 5, "what people say is kept");
    let (now, losses) = placed(held.clone(), &map);
    let names: Vec<&str> = now.iter().map(|row| &*row.label).collect();
    assert_eq!(names, ["near", "outside"]);
    let told = "label kilometres from every vehicle pose, in no layer that labels make";
    assert_eq!((losses.0[told], losses.total()), (3, 3), "{losses:?}");
    // Where nothing is known of the place, nothing is far.
    let (now, _) = placed(held, &Version::default());
    assert_eq!(now.len(), 5);
}

#[test]
fn of_an_instant_without_a_pose_it_is_not_said_that_the_session_is_gone() {
    let map = Version::of(drive("a", [0.0, 0.0]), vec![frame(0, 0.0)]);
    let anchor = anchor(1_000_000, at(0.0, 2.0, 0.0));
    let said = Annotation {
        anchor: Some(anchor),
        ..drawn("one", 7.0, 3.0)
    };
    let (held, _) = anchors(vec![said], &map, &Version::default(), vec![]);
    let (now, losses) = placed(held, &map);
    assert_eq!(&*now[0].placed_by, "frame");
    let told = "label of an instant that its session has no pose at, placed by its frame";
    assert_eq!((losses.0[told], losses.total()), (1, 1), "{losses:?}");
}

#[test]
fn of_spaces_that_were_drawn_on_one_place_the_one_said_last_holds() {
    let at_stamp = |stamp: i64, act: Annotation| Annotation {
        stamp: Stamp(stamp),
        ..act
    };
    let (sin, cos) = 0.5_f64.sin_cos();
    let beside = drawn("beside", 7.0 - 2.0 * sin, 3.0 + 2.0 * cos);
    let arrow = Annotation {
        kind: "arrow".into(),
        ..drawn("arrow", 7.0, 3.0)
    };
    let rejected = Annotation {
        act: "rejected".into(),
        ..drawn("rejected", 7.0, 3.0)
    };
    let said = vec![
        at_stamp(300, drawn("one", 7.0, 3.0)),
        at_stamp(200, drawn("two", 7.2, 3.1)),
        at_stamp(400, rejected),
        arrow,
        beside,
    ];
    let map = Version::of(drive("a", [0.0, 0.0]), vec![]);
    let (held, _) = anchors(said, &map, &Version::default(), vec![]);
    let (labels, _) = placed(held, &map);
    let inputs = [inputs_of("labels", labels.clone()).unwrap()];
    let (spaces, losses) = yields::<ParkingSpace>("parking_spaces", json!({}), inputs);
    let mut held: Vec<_> = spaces.into_iter().filter_map(|space| space.label).collect();
    held.sort();
    assert_eq!(held, ["beside", "one"]);
    assert_eq!(losses.0["parking space that lies on another one"], 1);

    // Nor is it learnt twice what the place looks like.
    assert_eq!(
        not_learnt(labels, CELL_M)["box of a kind that lies on another one"],
        1
    );
}

/// What `box_models` counts of labels on an image that shows nothing, with cells of this side (m).
fn not_learnt(labels: Vec<PlacedLabel>, cell_m: f64) -> BTreeMap<String, u64> {
    not_learnt_of(labels, vec![unreadable(0, cell_m)])
}

/// A tile so many east of the map's origin that does not read, with cells of this side (m).
fn unreadable(tile_x: i32, cell_m: f64) -> OverheadGradients {
    OverheadGradients {
        site: "lot".into(),
        tile_x,
        tile_y: 0,
        cell_m,
        content: String::new(),
        png: Bytes(vec![]),
    }
}

/// What `box_models` counts of labels on an image of which no tile reads.
fn not_learnt_of(labels: Vec<PlacedLabel>, tiles: Vec<OverheadGradients>) -> BTreeMap<String, u64> {
    let inputs = [
        inputs_of("labels", labels).unwrap(),
        inputs_of("gradients", tiles).unwrap(),
    ];
    let (models, losses) = yields::<BoxModel>("box_models", json!({}), inputs);
    assert!(models.is_empty());
    losses.0
}

#[test]
fn boxes_of_more_cells_than_are_looked_at_at_a_time_are_counted() {
    let map = Version::of(drive("a", [0.0, 0.0]), vec![]);
    let (held, _) = anchors(
        vec![drawn("one", 7.0, 3.0)],
        &map,
        &Version::default(),
        vec![],
    );
    let (labels, _) = placed(held, &map);
    let too_long = "box is no longer than a few cells, or longer than 50 m or 1000 cells";
    // It is 4 m long.
    for (cell_m, expected) in [
        (CELL_M, None),
        (0.0045, None),
        (0.0035, Some(1)),
        (1e-9, Some(1)),
    ] {
        let counted = not_learnt(labels.clone(), cell_m);
        assert_eq!(counted.get(too_long).copied(), expected, "{cell_m}");
    }
}

#[test]
fn of_the_overhead_image_only_what_labels_are_learnt_from_is_read() {
    let map = Version::of(drive("a", [0.0, 0.0]), vec![]);
    let said = vec![drawn("one", 7.0, 3.0)];
    let (held, _) = anchors(said, &map, &Version::default(), vec![]);
    let (labels, _) = placed(held, &map);
    // Parts have eight tiles in a row, of 12.8 m, and the next one is looked at, too.
    let tiles = [0, 7, 8, 9, 100].map(|tile_x| unreadable(tile_x, CELL_M));
    let counted = not_learnt_of(labels, tiles.to_vec());
    assert_eq!(counted["tile is not as overhead_gradients makes them"], 3);
}

/// A post that was taken for a person is rejected in two images: neither of them is a box on the floor.
#[test]
fn people_are_no_boxes_on_the_floor() {
    let person = |label: &str, kind: &str| Annotation {
        kind: kind.into(),
        ..drawn(label, 7.0, 3.0)
    };
    let counted = |kind: &str| {
        let said = vec![person("one", kind), person("two", kind)];
        let map = Version::of(drive("a", [0.0, 0.0]), vec![]);
        let (held, _) = anchors(said, &map, &Version::default(), vec![]);
        let (labels, _) = placed(held, &map);
        let count = |reason: &str| not_learnt(labels.clone(), CELL_M).get(reason).copied();
        [
            count("box of a kind that lies on another one"),
            count("drawn box that the overhead image does not show"),
        ]
    };
    assert_eq!(counted("crossing"), [Some(1), Some(1)]);
    assert_eq!(counted("person"), [None, None]);
}

#[test]
fn bad_annotations_are_counted_and_the_others_kept() {
    let tie = Annotation {
        shape: Some("polygon".into()),
        points: vec![
            [0.0, 0.0, 0.0],
            [2.0, 2.0, 0.0],
            [2.0, 0.0, 0.0],
            [0.0, 2.0, 0.0],
        ],
        ..drawn("tie", 3.0, 3.0)
    };
    let skew = Annotation {
        points: vec![
            [2.0, 1.0, 0.0],
            [-2.0, 1.5, 0.0],
            [-2.0, -1.0, 0.0],
            [2.0, -1.0, 0.0],
        ],
        ..drawn("skew", 3.0, 3.0)
    };
    let copy = Annotation {
        session: "copy_of_ada_1".into(),
        ..drawn("one", 4.0, 3.0)
    };
    let other = Annotation {
        author: "bob".into(),
        session: "bob_1".into(),
        stamp: Stamp(200),
        ..drawn("one", 5.0, 3.0)
    };
    let stray = Annotation {
        act: "removed".into(),
        ..drawn("never drawn", 0.0, 0.0)
    };
    let twice_at_once = Annotation {
        sequence: 0,
        kind: "heliport".into(),
        ..drawn("two", 8.0, 3.0)
    };
    let said = vec![
        tie,
        skew,
        drawn("one", 4.0, 3.0),
        copy,
        other,
        stray,
        twice_at_once,
        drawn("far", 90.0, 0.0),
    ];
    let first = Version::of(drive("a", [0.0, 0.0]), vec![frame(0, 0.0)]);
    let (held, losses) = anchors(said, &first, &Version::default(), vec![]);
    let labels: Vec<_> = held
        .iter()
        .map(|row| (&*row.label, &*row.author, &*row.kind))
        .collect();
    let expected = [
        ("far", "ada", "parking_space"),
        ("one", "bob", "parking_space"),
        ("two", "ada", "heliport"),
    ];
    assert_eq!(labels, expected);
    assert!(held[0].anchor.is_none() && held[0].frame == Some(0));
    for (reason, count) in [
        ("label whose outline crosses itself", 1),
        ("box that is not a rectangle around its frame", 1),
        (
            "annotation that contradicts another person's; the later holds",
            1,
        ),
        ("annotation of a label that was never drawn", 1),
        ("label too far from every vehicle pose", 1),
    ] {
        assert_eq!(losses.0[reason], count, "{reason}: {losses:?}");
    }
    assert_eq!(losses.total(), 5);
}

/// The camera of session a, 1 m above the ground, looks ahead.
fn camera() -> (Calibration, Transform) {
    let calibration = Calibration {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(0),
        camera: "ahead".into(),
        width: 640,
        height: 480,
        model: "plumb_bob".into(),
        intrinsics: vec![320.0, 0.0, 319.5, 0.0, 320.0, 239.5, 0.0, 0.0, 1.0],
        distortion: vec![],
        mount: None,
    };
    let mount = Transform {
        site: "lot".into(),
        session: "a".into(),
        stamp: Stamp(0),
        parent: "base_link".into(),
        child: "ahead".into(),
        parent_from_child: Pose {
            z: 1.0,
            qx: -0.5,
            qy: 0.5,
            qz: -0.5,
            qw: 0.5,
            ..Pose::IDENTITY
        },
        fixed: true,
    };
    (calibration, mount)
}

fn landmark(number: u32, x: f64, y: f64, z: f64) -> Landmark {
    Landmark {
        site: "lot".into(),
        landmark: number,
        x,
        y,
        z,
        sigma_m: 0.0,
        parallax_rad: 0.0,
        rms_px: 0.0,
        view: [0.0; 3],
        view_cos: 0.0,
        near_m: 0.0,
        far_m: 0.0,
        descriptors: Bytes(vec![]),
        sightings: vec![],
        sources: vec![],
        geometry: Wkb::point([x, y, z]),
    }
}

#[test]
fn the_camera_that_sees_a_label_most_centrally_and_freely_holds_it() {
    let (calibration, mount) = camera();
    let tied = |landmarks: Vec<Landmark>| {
        let inputs = [
            inputs_of("annotations", vec![drawn("one", 12.0, 2.0)]).unwrap(),
            inputs_of("poses", drive("a", [0.0, 0.0])).unwrap(),
            inputs_of("calibration", vec![calibration.clone()]).unwrap(),
            inputs_of("transforms", vec![mount.clone()]).unwrap(),
            inputs_of("landmarks", landmarks).unwrap(),
        ];
        let (held, _) = yields::<LabelAnchor>("label_anchors", json!({}), inputs);
        let anchor = held[0].anchor.clone().unwrap();
        (anchor.stamp.0, anchor.camera)
    };
    // Of the poses within 8 m, the farthest looks along the ray best.
    let ahead = Some("ahead".to_owned());
    assert_eq!(tied(vec![]), (5, ahead.clone()));
    // A post 2 m ahead of that pose, on its ray, and near that of the next.
    let post = landmark(0, 7.0, 2.0 * 2.0 / 7.0, 0.8);
    assert_eq!(tied(vec![post]), (7, ahead));
    // A wall.
    let wall = [0.35, 0.6].into_iter().zip([1, 41]).flat_map(|(z, first)| {
        (0..40).map(move |at| landmark(first + at, 11.3, f64::from(at) * 0.1, z))
    });
    assert_eq!(tied(wall.collect()), (12, None), "the nearest pose");
}
