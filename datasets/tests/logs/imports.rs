//! Imports are logs like any other: their roles read back as they were given.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use crate::common::{open, rows, shared};
use evermap_datasets::ImageReader;
use evermap_datasets::import::{ImageImport, Imported, Kitti};
use evermap_schemas::roles::{Calibration, Frame, LabelClass, OdometryPose, Transform};
use evermap_schemas::{Fault, LayerRow, rows as typed};

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
    let imported = ImageImport::load(&copy)
        .unwrap()
        .write(&out, &|| false)
        .unwrap();
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
    let imported = kitti.write(&out, &|| false).unwrap();
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
    let imported = import.write(&out, &|| false).unwrap();
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

/// A PNG image as far as its size says, which is all that an import looks at.
fn png_head(width: u32, height: u32) -> Vec<u8> {
    let mut head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    head.extend(width.to_be_bytes());
    head.extend(height.to_be_bytes());
    head
}

/// Imports three images of 4 by 3 pixels to `out.mcap` in their folder, with a description and files beside it.
fn import(folder: &Path, described: &str, beside: &[(&str, &str)]) -> Result<Imported, Fault> {
    for name in ["1.png", "2.png", "3.png"] {
        std::fs::write(folder.join(name), png_head(4, 3)).unwrap();
    }
    for (name, text) in beside {
        std::fs::write(folder.join(name), text).unwrap();
    }
    let description = folder.join("import.yaml");
    std::fs::write(&description, described).unwrap();
    ImageImport::load(&description)?.write(&folder.join("out.mcap"), &|| false)
}

/// One camera with the images of the folder.
const FRONT: &str = "cameras: [{name: front, images: ['*.png']}]\n";
/// Poses of three images, 1, 2 and 3 m ahead.
const AHEAD: &str = "1 0 0 1 0 1 0 0 0 0 1 0\n1 0 0 2 0 1 0 0 0 0 1 0\n1 0 0 3 0 1 0 0 0 0 1 0\n";

#[tokio::test(flavor = "multi_thread")]
async fn poses_stay_with_their_images_where_times_fall() {
    let scratch = tempfile::tempdir().unwrap();
    let described = format!("{FRONT}times: times.txt\nposes: {{file: poses.txt, format: kitti}}\n");
    let beside = [
        ("times.txt", "\u{feff}# t\n12\n11\n10\n"),
        ("poses.txt", AHEAD),
    ];
    let imported = import(scratch.path(), &described, &beside).unwrap();
    assert_eq!((imported.images, imported.poses), (3, 3));
    let out = scratch.path().join("out.mcap");
    let (context, _) = open(&[out.display().to_string()], 2).await;
    let poses: Vec<OdometryPose> = read(&context, "SELECT * FROM odometry ORDER BY stamp").await;
    let ahead: Vec<f64> = poses.iter().map(|pose| pose.odom_from_vehicle.x).collect();
    assert_eq!(ahead, [3.0, 2.0, 1.0]);
}

/// That an import is refused with these words, and leaves no log.
fn is_refused(described: &str, beside: &[(&str, &str)], words: &[&str]) {
    let scratch = tempfile::tempdir().unwrap();
    let fault = import(scratch.path(), described, beside).unwrap_err();
    let fault = fault.to_string();
    let unsaid = words.iter().find(|word| !fault.contains(**word));
    assert!(unsaid.is_none(), "{unsaid:?}: {fault}");
    assert!(!scratch.path().join("out.mcap").exists(), "{fault}");
}

#[test]
fn times_that_are_none_or_come_twice_are_refused_with_their_line() {
    let described = format!("{FRONT}times: times.txt\n");
    for (times, words) in [
        ("10,1\n10,2\n10,3\n", ["2 numbers", "times.txt: line 1"]),
        ("10.0\n10.0\n11.0\n", ["10.0 again", "times.txt: line 2"]),
    ] {
        is_refused(&described, &[("times.txt", times)], &words);
    }
}

#[test]
fn a_matrix_that_is_written_column_by_column_is_refused() {
    let columns = "[[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [1.5, 0, 1.2, 1]]";
    let camera = format!(
        "cameras: [{{name: front, images: ['*.png'], vehicle_from_camera: {{matrix: {columns}}}}}]"
    );
    is_refused(
        &camera,
        &[],
        &["1.5, 0, 1.2, 1", "camera front", "transpose"],
    );
    let vehicle = format!("{FRONT}vehicle_from_reference: {{matrix: {columns}}}\n");
    is_refused(&vehicle, &[], &["1.5, 0, 1.2, 1", "vehicle_from_reference"]);
    let file = format!(r#"{{"front": {{"param": {{"sensor_calib": {{"data": {columns}}}}}}}}}"#);
    let camera =
        "cameras: [{name: front, images: ['*.png'], camera_from_reference: {file: front.json}}]";
    is_refused(
        camera,
        &[("front.json", file.as_str())],
        &["1.5, 0, 1.2, 1", "front.json"],
    );
}

#[test]
fn images_of_several_sizes_are_refused_and_the_other_one_is_named() {
    let scratch = tempfile::tempdir().unwrap();
    std::fs::write(scratch.path().join("4.png"), png_head(3, 4)).unwrap();
    let calibrated =
        "cameras: [{name: front, images: ['*.png'], intrinsics: [30, 0, 2, 0, 30, 1, 0, 0, 1]}]";
    let fault = import(scratch.path(), calibrated, &[])
        .unwrap_err()
        .to_string();
    for said in ["4 x 3", "found 3 x 4", "camera front", "4.png"] {
        assert!(fault.contains(said), "{said}: {fault}");
    }
    assert!(!scratch.path().join("out.mcap").exists());
}

#[test]
fn images_of_several_sizes_are_refused_of_a_kitti_sequence_too() {
    let scratch = tempfile::tempdir().unwrap();
    let images = scratch.path().join("image_0");
    std::fs::create_dir(&images).unwrap();
    std::fs::write(images.join("000000.png"), png_head(4, 3)).unwrap();
    std::fs::write(images.join("000001.png"), png_head(3, 4)).unwrap();
    let calibration = scratch.path().join("K.txt");
    std::fs::write(&calibration, "30 0 2\n0 30 1\n0 0 1\n").unwrap();
    let kitti = Kitti {
        images: Some(images),
        calibration: Some(calibration),
        ..Kitti::default()
    };
    let fault = kitti
        .write(&scratch.path().join("out.mcap"), &|| false)
        .unwrap_err();
    let fault = fault.to_string();
    assert!(
        fault.contains("found 3 x 4") && fault.contains("000001.png"),
        "{fault}"
    );
}

#[test]
fn what_a_folder_is_called_is_no_pattern() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("run[1] *?]");
    std::fs::create_dir(&folder).unwrap();
    let imported = import(&folder, FRONT, &[]).unwrap();
    assert_eq!(imported.images, 3);
    let missing = "cameras: [{name: front, images: ['*.jpg']}]";
    let fault = import(&folder, missing, &[]).unwrap_err().to_string();
    let said = folder.join("*.jpg").display().to_string();
    assert!(fault.contains(&said), "{fault}");
}

#[test]
fn two_cameras_of_one_name_are_refused() {
    let twins = "cameras: [{name: front, images: [1.png]}, {name: front, images: [2.png]}]";
    is_refused(twins, &[], &["two called front"]);
}

#[test]
fn a_file_of_poses_without_any_is_refused() {
    for format in ["tum", "kitti"] {
        let described = format!("{FRONT}poses: {{file: poses.txt, format: {format}}}\n");
        for text in ["", "# stamp x y z\n\n"] {
            is_refused(
                &described,
                &[("poses.txt", text)],
                &["found none", "poses.txt"],
            );
        }
    }
}

#[test]
fn an_import_that_is_stopped_leaves_nothing() {
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join("out.mcap");
    import(scratch.path(), FRONT, &[]).unwrap();
    std::fs::remove_file(&out).unwrap();
    let before = std::fs::read_dir(scratch.path()).unwrap().count();
    let stopped = ImageImport::load(&scratch.path().join("import.yaml")).unwrap();
    let fault = stopped.write(&out, &|| true).unwrap_err();
    assert!(fault.to_string().contains("stopped"), "{fault}");
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), before);
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
