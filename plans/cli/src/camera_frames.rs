//! Frames of cameras: those that are not optical, whose images are read as if they were, and those that move.

use std::collections::{BTreeMap, BTreeSet};

use datafusion::prelude::SessionContext;
use evermap_algorithms::geometry::pose::Pose;
use evermap_datasets::Dataset;
use evermap_engine::quoted;
use evermap_engine::sql::{Limits, context};
use evermap_schemas::Fault;
use evermap_schemas::roles::{CameraMount, Transform, frame_names};

use crate::coordinate_frames::{TRANSFORMS, cameras_of, texts_of};
use crate::odometry_frame::{LOOKED_AT, fixed_transforms, tied};

/// The cameras of a session are known after so many images.
const IMAGES: usize = 64;

/// How close to straight up a camera's z axis is that hardly looks along it: cos 30°.
const STEEP: f64 = 0.866;

/// What a person is told of the first [`LOOKED_AT`] sessions that have a camera whose frame looks along x, as its z axis goes
/// up, or that moves on the vehicle. Cameras that name the frame of another one are counted as these are read.
///
/// # Errors
/// A fault of ours.
pub async fn notes(dataset: &Dataset, vehicle: &str) -> Result<Vec<String>, Fault> {
    let mut notes = Vec::new();
    let pictured = dataset.sessions.iter();
    let pictured = pictured.filter(|session| !session.roles.topics("frames").is_empty());
    for session in pictured.take(LOOKED_AT) {
        // A table of all sessions looks at the files of all.
        let (context, dataset) = (
            context(Limits::one_partition())?,
            dataset.of_session(session),
        );
        dataset.register(&context)?;
        // What cannot be read of a log is told where its rows are read.
        let cameras = cameras_of(&context, &session.name, IMAGES).await;
        let cameras = cameras.unwrap_or_default();
        let transforms = fixed_transforms(&context, &session.name).await;
        let transforms = transforms.unwrap_or_default();
        let moving = moving_transforms(&context, &session.name).await;
        let mounts = dataset.camera_mounts().await.unwrap_or_default();
        let found = [
            not_optical(&transforms, &cameras, &mounts, vehicle),
            unfixed(&transforms, &moving.unwrap_or_default(), &cameras, &mounts),
        ];
        let found = found.into_iter().flatten();
        notes.extend(found.map(|note| format!("session {}: {note}", session.name)));
    }
    Ok(notes)
}

/// Parents and children of the transforms of a session that move, of its first [`TRANSFORMS`].
async fn moving_transforms(
    context: &SessionContext,
    session: &str,
) -> Result<Vec<[String; 2]>, Fault> {
    let session = quoted::text(session);
    let moving = format!(
        "SELECT DISTINCT parent, child FROM (SELECT * FROM transforms WHERE session = {session} LIMIT {TRANSFORMS}) \
         WHERE NOT fixed ORDER BY parent, child"
    );
    texts_of(context, &moving).await
}

/// That cameras move on the vehicle, and which.
fn unfixed(
    fixed: &[Transform],
    moving: &[[String; 2]],
    cameras: &BTreeSet<String>,
    mounts: &BTreeMap<String, CameraMount>,
) -> Option<String> {
    let moves = |camera: &String| {
        let frame = mounts.get(camera).map_or(camera, |mount| &mount.frame);
        let frame = frame_names::plain(frame);
        let is_fixed = fixed.iter().any(|found| found.child == frame);
        let [parent, _] = moving.iter().find(|[_, child]| child == frame)?;
        (!is_fixed).then(|| format!("{camera} in {parent}"))
    };
    let moving: Vec<String> = cameras.iter().filter_map(moves).collect();
    (!moving.is_empty()).then(|| {
        format!(
            "expected cameras that are fixed to the vehicle, found some that transforms move: {}; their images are left \
             out of maps",
            moving.join(", ")
        )
    })
}

/// That cameras look along axes that go up on the vehicle, by their frames or by where they are mounted in others, and
/// which.
fn not_optical(
    transforms: &[Transform],
    cameras: &BTreeSet<String>,
    mounts: &BTreeMap<String, CameraMount>,
    vehicle: &str,
) -> Option<String> {
    let camera_from_vehicle = |camera: &String| {
        let Some(mount) = mounts.get(camera) else {
            return Some(tied(transforms, camera, vehicle)?.0);
        };
        let (frame_from_vehicle, _) = tied(transforms, &mount.frame, vehicle)?;
        let frame_from_camera = Pose::from_array(mount.frame_from_camera.to_array()).ok()?;
        Some(frame_from_camera.inverse().compose(&frame_from_vehicle))
    };
    let angle = |camera: &String| {
        let camera_from_vehicle = camera_from_vehicle(camera)?;
        let [_, _, _, qx, qy, ..] = camera_from_vehicle.to_array();
        let up = 1.0 - 2.0 * (qx * qx + qy * qy);
        (up > STEEP).then(|| format!("{camera} {:.0}°", up.min(1.0).acos().to_degrees()))
    };
    let steep: Vec<String> = cameras.iter().filter_map(angle).collect();
    (!steep.is_empty()).then(|| {
        format!(
            "expected optical frames of cameras, z forward (REP 103), found z so far from straight up: {}; images are \
             read as if taken along z: name their optical frames in images and calibrations",
            steep.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use evermap_schemas::{Pose as Placed, Stamp};

    use super::*;

    /// A camera at the mast of a vehicle, turned by this quaternion.
    fn mounted(child: &str, [qx, qy, qz, qw]: [f64; 4]) -> Transform {
        Transform {
            site: String::new(),
            session: String::new(),
            stamp: Stamp(0),
            parent: "base_link".to_owned(),
            child: child.to_owned(),
            parent_from_child: Placed {
                x: 1.0,
                y: 0.0,
                z: 1.5,
                qx,
                qy,
                qz,
                qw,
            },
            fixed: true,
        }
    }

    #[test]
    fn cameras_that_move_are_told_and_those_that_are_fixed_or_nowhere_are_not() {
        let fixed = [mounted("rear", [0.0, 0.0, 0.0, 1.0])];
        let moving = [
            ["base_link", "front"],
            ["base_link", "gimbal"],
            ["odom", "base_link"],
        ];
        let moving = moving.map(|frames| frames.map(str::to_owned));
        let cameras = BTreeSet::from(["/front", "rear", "top", "pair/right"].map(str::to_owned));
        let mount = CameraMount {
            frame: "gimbal".to_owned(),
            frame_from_camera: Placed::IDENTITY,
        };
        let mounts = BTreeMap::from([("pair/right".to_owned(), mount)]);
        let said = unfixed(&fixed, &moving, &cameras, &mounts).unwrap_or_default();
        let found = "move: /front in base_link, pair/right in base_link; their images";
        assert!(said.contains(found), "{said}");
        assert_eq!(
            unfixed(
                &fixed,
                &moving,
                &BTreeSet::from(["rear".to_owned()]),
                &mounts
            ),
            None
        );
    }

    #[test]
    fn cameras_that_look_along_x_are_told_and_those_along_z_are_not() {
        let about_y = |degrees: f64| {
            let half = degrees.to_radians() / 2.0;
            [0.0, half.sin(), 0.0, half.cos()]
        };
        let transforms = [
            mounted("optical", [-0.5, 0.5, -0.5, 0.5]),
            mounted("straight", [0.0, 0.0, 0.0, 1.0]),
            mounted("left", [0.0, 0.0, 0.6, 0.8]),
            mounted("pitched", about_y(25.0)),
            mounted("steep", about_y(35.0)),
            mounted("down", about_y(180.0)),
        ];
        let note = |cameras: &[&str]| {
            let cameras = cameras.iter().map(|name| (*name).to_owned()).collect();
            not_optical(&transforms, &cameras, &BTreeMap::new(), "base_link")
        };
        assert_eq!(note(&["optical", "steep", "down", "nowhere"]), None);
        let said = note(&["left", "optical", "pitched", "straight"]).unwrap_or_default();
        let found = "straight up: left 0°, pitched 25°, straight 0°; images";
        assert!(said.contains(found), "{said}");
        // Mounted in a frame: turned out of what its own would be told for, and into it.
        let [qx, qy, qz, qw] = about_y(20.0);
        let frame_from_camera = Placed {
            qx,
            qy,
            qz,
            qw,
            ..Placed::IDENTITY
        };
        let mount = |frame: &str| CameraMount {
            frame: frame.to_owned(),
            frame_from_camera: frame_from_camera.clone(),
        };
        let mounts = [
            ("pitched", mount("pitched")),
            ("pair/right", mount("straight")),
        ];
        let mounts = mounts.map(|(camera, mount)| (camera.to_owned(), mount));
        let cameras = BTreeSet::from(["pitched", "pair/right"].map(str::to_owned));
        let mounts = BTreeMap::from(mounts);
        let said = not_optical(&transforms, &cameras, &mounts, "base_link").unwrap_or_default();
        assert!(
            said.contains("straight up: pair/right 20°; images"),
            "{said}"
        );
    }
}
