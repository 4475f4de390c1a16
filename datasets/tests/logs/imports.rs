//! Imports are logs like any other: their roles read back as they were given.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use crate::common::{open, rows, shared};
use evermap_datasets::ImageReader;
use evermap_datasets::import::{ImageImport, Kitti};
use evermap_schemas::roles::{Calibration, Frame, LabelClass, OdometryPose, Transform};
use evermap_schemas::{LayerRow, rows as typed};

async fn read<T: LayerRow>(context: &datafusion::prelude::SessionContext, sql: &str) -> Vec<T> {
    let batches = rows(context, sql).await;
    batches
        .iter()
        .flat_map(|batch| typed::<T>(batch).unwrap())
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn four_fisheyes_of_a_car_park_become_a_rig() {
    let Some(folder) = shared("data/avm_fisheye/pjlab/ocam_samples") else {
        return;
    };
    let description = concat!(env!("CARGO_MANIFEST_DIR"), "/imports/pjlab.yaml");
    let text = std::fs::read_to_string(description).unwrap();
    let scratch = tempfile::tempdir().unwrap();
    let copy = scratch.path().join("pjlab.yaml");
    std::fs::write(
        &copy,
        text.replace("ocam_samples", &folder.display().to_string()),
    )
    .unwrap();
    let out = scratch.path().join("pjlab.mcap");
    let imported = ImageImport::load(&copy).unwrap().write(&out).unwrap();
    assert_eq!((imported.images, imported.poses), (4, 1));

    let (context, dataset) = open(&[out.display().to_string()], 2).await;
    let frames: Vec<Frame> = read(&context, "SELECT * FROM frames ORDER BY camera").await;
    let names: Vec<&str> = frames.iter().map(|frame| frame.camera.as_str()).collect();
    assert_eq!(names, ["back", "front", "left", "right"]);
    let images: Vec<_> = frames.iter().map(|frame| frame.image.clone()).collect();
    let bytes = ImageReader::new(&dataset, 1 << 20)
        .resolve(&images)
        .await
        .unwrap();
    assert_eq!(
        bytes[1].as_ref().unwrap(),
        &std::fs::read(folder.join("imgs/Front.png")).unwrap()
    );

    let lenses: Vec<Calibration> =
        read(&context, "SELECT * FROM calibration ORDER BY camera").await;
    assert!(
        lenses
            .iter()
            .all(|lens| lens.model == "ocam" && lens.distortion.len() == 11)
    );
    assert!(
        lenses
            .iter()
            .all(|lens| (lens.width, lens.height) == (1280, 960))
    );

    let rig: Vec<Transform> = read(&context, "SELECT * FROM transforms ORDER BY child").await;
    assert!(rig.iter().all(|t| t.fixed && t.parent == "base_link"));
    let at = |i: usize| &rig[i].parent_from_child;
    assert!(
        at(0).x < -4.0 && at(1).x > 3.0 && at(2).y > 1.0 && at(3).y < -1.0,
        "{rig:?}"
    );
    assert!(
        rig.iter()
            .all(|t| (1.0..1.6).contains(&t.parent_from_child.z)),
        "{rig:?}"
    );
    assert!(dataset.losses.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn kitti_drives_forward() {
    let Some(folder) = shared("data") else { return };
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join("kitti00.mcap");
    let kitti = Kitti {
        poses: Some(folder.join("kitti_poses/00.txt")),
        times: Some(folder.join("kitti00_seq/times_00.txt")),
        images: Some(folder.join("kitti00_seq/image_0")),
        calibration: Some(folder.join("kitti00_seq/K.txt")),
    };
    let imported = kitti.write(&out).unwrap();
    assert_eq!(imported.images, 100);
    let (context, _) = open(&[out.display().to_string()], 2).await;
    let poses: Vec<OdometryPose> = read(&context, "SELECT * FROM odometry ORDER BY stamp").await;
    assert_eq!(poses.len(), imported.poses);
    let (start, later) = (&poses[0].odom_from_vehicle, &poses[50].odom_from_vehicle);
    assert!(start.x.abs() < 1e-6 && start.z.abs() < 1e-6);
    // Fifty frames of driving straight on: forward is x, and the road is flat.
    assert!(
        later.x > 20.0 && later.y.abs() < 10.0 && later.z.abs() < 2.0,
        "{later:?}"
    );
    let frames: Vec<Frame> = read(&context, "SELECT * FROM frames ORDER BY stamp").await;
    assert_eq!(frames.len(), 100);
    let lens: Vec<Calibration> = read(&context, "SELECT * FROM calibration").await;
    assert_eq!(lens.len(), 1);
    assert_eq!(lens[0].camera, frames[0].camera);
    assert!((lens[0].intrinsics[0] - 718.856).abs() < 1e-9);
}

#[tokio::test(flavor = "multi_thread")]
async fn labelled_images_come_with_their_labels_and_classes() {
    let Some(folder) = shared("data/camvid") else {
        return;
    };
    let description = concat!(env!("CARGO_MANIFEST_DIR"), "/imports/camvid_0006R0.yaml");
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join("camvid.mcap");
    let import = ImageImport::load(Path::new(description))
        .unwrap()
        .within(&folder);
    let imported = import.write(&out).unwrap();
    assert_eq!((imported.images, imported.labels), (50, 50));

    let (context, dataset) = open(&[out.display().to_string()], 2).await;
    let both: Vec<Frame> = read(
        &context,
        "SELECT l.* FROM label_frames l JOIN frames f ON f.camera = l.camera AND f.stamp = l.stamp",
    )
    .await;
    assert_eq!(both.len(), 50);
    assert!(both.iter().all(|frame| frame.camera == "camera"));
    let classes: Vec<LabelClass> =
        read(&context, "SELECT * FROM label_classes ORDER BY value").await;
    let names: Vec<_> = classes
        .iter()
        .map(|row| (row.value, row.class.as_str()))
        .collect();
    assert_eq!(
        (names.len(), names[0], names[10]),
        (11, (0, "sky"), (10, "bicyclist"))
    );
    assert!(dataset.losses.is_empty());
}

#[test]
fn a_description_that_is_wrong_is_refused_with_its_place() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("wrong.yaml");
    std::fs::write(&path, "cameras: []\nspeed: 3\n").unwrap();
    let fault = ImageImport::load(&path).unwrap_err().to_string();
    assert!(
        fault.contains("speed") && fault.contains("wrong.yaml"),
        "{fault}"
    );
}
