//! Views: where their cameras were, and what is said where that is not known.

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{LabelImage, VehiclePose, View};
use evermap_schemas::roles::{OdometryPose, Transform};
use evermap_schemas::{Bytes, Pose, Stamp};
use evermap_vision::{Grey, encode_png};
use serde_json::{Value, json};

use crate::keyframes::drive;
use crate::yields;

const SECOND: i64 = 1_000_000_000;

/// Reasons, and how many views each of them is said of.
type Said = BTreeMap<String, u64>;

/// A label image of two classes.
fn image(stamp: i64) -> LabelImage {
    let labels = Grey {
        width: 2,
        height: 1,
        data: vec![0, 1],
    };
    LabelImage {
        site: "s".into(),
        session: "a".into(),
        stamp: Stamp(stamp),
        camera: "roof".into(),
        width: 2,
        height: 1,
        classes: vec!["sky".into(), "road".into()],
        png: Bytes(encode_png(&labels).unwrap()),
    }
}

/// A frame that is fixed a metre ahead of another.
fn mount(parent: &str, child: &str) -> Transform {
    Transform {
        site: "s".into(),
        session: "a".into(),
        stamp: Stamp(0),
        parent: parent.into(),
        child: child.into(),
        parent_from_child: Pose {
            x: 1.0,
            ..Pose::IDENTITY
        },
        fixed: true,
    }
}

/// A drive of 20 s at 1 m/s.
fn steady() -> Vec<OdometryPose> {
    drive(1.0, 20.0)
}

/// Views of 21 images, one a second from 0 to 20 s: where along x those are that have a position, and what was counted.
fn views(params: Value, odometry: Vec<OdometryPose>, mounts: Vec<Transform>) -> (Vec<f64>, Said) {
    let inputs = [
        inputs_of("odometry", odometry).unwrap(),
        inputs_of("transforms", mounts).unwrap(),
    ];
    views_of(params, inputs.into())
}

fn views_of(params: Value, mut inputs: Vec<(String, RecordBatch)>) -> (Vec<f64>, Said) {
    let images = (0..=20).map(|second| image(second * SECOND));
    inputs.push(inputs_of("labels", images.collect()).unwrap());
    let (found, losses) = yields::<View>("views", params, inputs);
    assert_eq!(found.len(), 21, "every view is kept");
    let placed = found.into_iter().filter_map(|view| view.map_from_view);
    (placed.map(|pose| pose.x).collect(), losses.0)
}

fn said(reason: &str, views: u64) -> Said {
    BTreeMap::from([(reason.to_owned(), views)])
}

#[test]
fn views_of_a_camera_that_is_not_mounted_on_the_vehicle_are_kept_and_counted() {
    let params = |vehicle: &str| json!({ "vehicle_frame": vehicle });
    let (placed, losses) = views(json!({}), steady(), vec![mount("base_link", "roof")]);
    assert_eq!(placed.len(), 21);
    assert!((placed[7] - 8.0).abs() < 1e-9, "{placed:?}");
    assert_eq!(losses, Said::new());
    for (vehicle, parent) in [("chasis", "base_link"), ("base_link", "rear_axle")] {
        let (placed, losses) = views(params(vehicle), steady(), vec![mount(parent, "roof")]);
        let reason =
            format!("fixed transforms from frame `roof` lead to `{parent}`, not to `{vehicle}`");
        assert_eq!((placed.len(), losses), (0, said(&reason, 21)));
    }
    let elsewhere = vec![mount("base_link", "bumper")];
    let (placed, losses) = views(json!({}), steady(), elsewhere);
    let reason = "no fixed transforms from frame `roof` to `base_link`";
    assert_eq!((placed.len(), losses), (0, said(reason, 21)));
}

#[test]
fn views_that_odometry_does_not_reach_are_kept_and_counted_with_how_far_they_are() {
    let of = |odometry| {
        let (placed, losses) = views(json!({}), odometry, vec![mount("base_link", "roof")]);
        (placed.len(), losses)
    };
    let shifted = |seconds: i64| {
        let mut rows = steady();
        let shift = |row: &mut OdometryPose| row.stamp.0 += seconds * SECOND;
        rows.iter_mut().for_each(shift);
        rows
    };
    for (seconds, reason) in [
        (3_620, "frame that is hours before odometry begins"),
        (120, "frame that is minutes before odometry begins"),
        (-100_000, "frame that is days after odometry ends"),
    ] {
        assert_eq!(of(shifted(seconds)), (0, said(reason, 21)));
    }
    // A tenth of the drive is borne: two of 20 s, one of 10 s.
    for seconds in [-2, 2] {
        assert_eq!(of(shifted(seconds)), (19, Said::new()));
    }
    let late = "frame that is seconds after odometry ends";
    assert_eq!(of(drive(1.0, 10.0)), (11, said(late, 9)));

    let mut paused = steady();
    paused.retain(|row| !(6 * SECOND..8 * SECOND).contains(&row.stamp.0));
    assert_eq!(of(paused), (19, said("frame where odometry has a gap", 2)));

    let mut senseless = steady();
    let spoil = |row: &mut OdometryPose| row.odom_from_vehicle.qw = 0.0;
    senseless.iter_mut().for_each(spoil);
    let none = "odometry has no pose that is a rigid transform";
    assert_eq!(of(senseless), (0, said(none, 21)));
}

#[test]
fn poses_of_a_map_are_called_so() {
    let poses = steady().into_iter().map(|row| VehiclePose {
        site: row.site,
        session: row.session,
        stamp: Stamp(row.stamp.0 - 60 * SECOND),
        map_from_vehicle: row.odom_from_vehicle,
    });
    let inputs = vec![
        inputs_of("poses", poses.collect()).unwrap(),
        inputs_of("odometry", steady()).unwrap(),
        inputs_of("transforms", vec![mount("base_link", "roof")]).unwrap(),
    ];
    let (placed, losses) = views_of(json!({}), inputs);
    let reason = |far: &str| format!("frame that is {far} after the map's trajectory ends");
    let expected = [(reason("seconds"), 20), (reason("minutes"), 1)];
    assert_eq!((placed.len(), losses), (0, Said::from(expected)));
}

#[test]
fn a_session_without_odometry_or_transforms_has_views_without_a_position_and_nothing_is_amiss() {
    let mounted = || vec![mount("base_link", "roof")];
    let mut moving = mounted();
    moving[0].fixed = false;
    for (odometry, mounts) in [
        (Vec::new(), mounted()),
        (steady(), Vec::new()),
        (steady(), moving),
    ] {
        let (placed, losses) = views(json!({}), odometry, mounts);
        assert_eq!((placed.len(), losses), (0, Said::new()));
    }
}
