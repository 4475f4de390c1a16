//! What was driven: poses, mounts, calibrations, images and people in them.

use std::collections::BTreeMap;

use bytes::Bytes;
use evermap_algorithms::geometry::pose::{Pose as Rigid, PoseError};
use evermap_catalog::{Footing, footing};
use evermap_schemas::layers::{Keyframe, Person, VehiclePose};
use evermap_schemas::roles::{Calibration, Transform, frame_names};
use evermap_schemas::{Fault, ImageRef, Pose};
use foxglove::messages::points_annotation::Type as Outline;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, ImageAnnotations, LocationFix, Point2,
    PointsAnnotation, PosesInFrame,
};

use super::messages::{MAP, VERMILION, color, pose, rotation, time, vector};
use super::{TopicMessage, What};
use crate::earth::{Earth, SiteOnEarth};
use crate::reader::MapReader;

/// What an image is recorded as.
pub(super) type Picture = CompressedImage;

/// An image of a keyframe.
pub(super) struct Image {
    /// Session that it was taken in.
    pub(super) session: String,
    /// The frame along which it looks.
    frame_id: String,
    /// Where its bytes are.
    pub(super) reference: ImageRef,
}

impl Image {
    /// The message, with the image's bytes.
    pub(super) fn message(&self, stamp: i64, bytes: Vec<u8>) -> Picture {
        let format = match bytes.get(..4) {
            Some(b"\x89PNG") => "png",
            Some(b"RIFF") => "webp",
            _ => "jpeg",
        };
        CompressedImage {
            timestamp: time(stamp),
            frame_id: self.frame_id.clone(),
            data: Bytes::from(bytes),
            format: format.to_owned(),
        }
    }
}

/// All of it.
pub(super) async fn said(
    reader: &MapReader,
    site: &str,
    poses: Vec<VehiclePose>,
) -> Result<Vec<TopicMessage>, Fault> {
    let mut sessions: BTreeMap<String, Vec<VehiclePose>> = BTreeMap::new();
    for row in poses {
        sessions.entry(row.session.clone()).or_default().push(row);
    }
    let mounts: Vec<Transform> = reader.rows_in("mounts", site).await?;
    let cameras: Vec<Calibration> = reader.rows_in("cameras", site).await?;
    let earth = Earth::of(reader).await?;
    let vehicle = reader.vehicle(site).await?;
    let mut all = Vec::new();
    let mut firsts = BTreeMap::new();
    for (session, poses) in &mut sessions {
        poses.sort_by_key(|row| row.stamp);
        let first = poses.first().map_or(0, |row| row.stamp.0);
        firsts.insert(session.clone(), first);
        let mounts = mounts
            .iter()
            .filter(|row| row.session == *session && row.fixed);
        let mounts: Vec<&Transform> = mounts.collect();
        let footing = footing(mounts.iter().copied().cloned().collect(), &vehicle);
        all.extend(driven(session, poses, &footing)?);
        if let Some(place) = earth.place(site) {
            all.extend(locations(session, poses, &footing.vehicle, place)?);
        }
        for mount in mounts {
            let message = transform(
                first,
                frame(session, &mount.parent),
                frame(session, &mount.child),
                &mount.parent_from_child,
            );
            all.push(TopicMessage::new(first, "/tf", &message)?.for_good());
        }
    }
    let mut frames = BTreeMap::new();
    for row in first_of_each(cameras) {
        let Some(first) = firsts.get(&row.session) else {
            continue;
        };
        let frame_id = frame_of(&row);
        if let Some(mount) = &row.mount {
            let parent = frame(&row.session, &mount.frame);
            let message = transform(*first, parent, frame_id.clone(), &mount.frame_from_camera);
            all.push(TopicMessage::new(*first, "/tf", &message)?.for_good());
        }
        if let Some(message) = calibration(&row, frame_id.clone(), *first) {
            let topic = format!("{}/calibration", topic(&row.session, &row.camera));
            all.push(TopicMessage::new(*first, topic, &message)?.for_good());
        }
        frames.insert((row.session, row.camera), frame_id);
    }
    let is_driven = |session: &String| firsts.contains_key(session);
    all.extend(images(reader.rows(Some(site)).await?, &frames, is_driven));
    let people: Vec<Person> = reader.rows(Some(site)).await?;
    all.extend(annotations(people, is_driven)?);
    Ok(all)
}

/// A frame of a session's vehicle.
fn frame(session: &str, name: &str) -> String {
    format!("{session}/{}", frame_names::plain(name))
}

fn topic(session: &str, camera: &str) -> String {
    format!("/camera/{}", frame(session, camera))
}

fn transform(stamp: i64, parent: String, child: String, of: &Pose) -> FrameTransform {
    FrameTransform {
        timestamp: time(stamp),
        parent_frame_id: parent,
        child_frame_id: child,
        translation: vector(of.x, of.y, of.z),
        rotation: rotation(of),
    }
}

/// What was driven. A frame has one parent, so what moves in the map is what carries the vehicle.
fn driven(
    session: &str,
    poses: &[VehiclePose],
    footing: &Footing,
) -> Result<Vec<TopicMessage>, Fault> {
    let moved = |row: &VehiclePose| {
        let child = frame(session, &footing.root);
        let map_from_root = carried(&row.map_from_vehicle, footing)
            .map_err(|error| Fault::data(error.to_string()).at(session))?;
        let message = transform(row.stamp.0, MAP.to_owned(), child, &map_from_root);
        TopicMessage::new(row.stamp.0, "/tf", &message)
    };
    let mut all = poses.iter().map(moved).collect::<Result<Vec<_>, _>>()?;
    let first = poses.first().map_or(0, |row| row.stamp.0);
    let trajectory = PosesInFrame {
        timestamp: time(first),
        frame_id: MAP.to_owned(),
        poses: poses
            .iter()
            .map(|row| pose(&row.map_from_vehicle))
            .collect(),
    };
    let topic = format!("/trajectory/{session}");
    all.push(TopicMessage::new(first, topic, &trajectory)?.for_good());
    Ok(all)
}

/// Where in the map the frame is that carries a vehicle at a pose.
fn carried(map_from_vehicle: &Pose, footing: &Footing) -> Result<Pose, PoseError> {
    let Some(vehicle_from_root) = &footing.vehicle_from_root else {
        return Ok(map_from_vehicle.clone());
    };
    let map_from_vehicle = Rigid::from_array(map_from_vehicle.to_array())?;
    let map_from_root = map_from_vehicle.compose(vehicle_from_root);
    Ok(Pose::from_array(map_from_root.to_array()))
}

/// Where on earth the vehicle was.
fn locations(
    session: &str,
    poses: &[VehiclePose],
    vehicle: &str,
    place: &SiteOnEarth,
) -> Result<Vec<TopicMessage>, Fault> {
    let located = |row: &VehiclePose| {
        let at = &row.map_from_vehicle;
        let found = place.geodetic([at.x, at.y, at.z]);
        let message = LocationFix {
            timestamp: time(row.stamp.0),
            frame_id: frame(session, vehicle),
            latitude: found.latitude_deg,
            longitude: found.longitude_deg,
            altitude: found.height_m,
            ..LocationFix::default()
        };
        TopicMessage::new(row.stamp.0, format!("/location/{session}"), &message)
    };
    poses.iter().map(located).collect()
}

fn first_of_each(mut cameras: Vec<Calibration>) -> Vec<Calibration> {
    cameras.sort_by(|a, b| (&a.session, &a.camera, a.stamp).cmp(&(&b.session, &b.camera, b.stamp)));
    cameras.dedup_by(|next, kept| (&next.session, &next.camera) == (&kept.session, &kept.camera));
    cameras
}

/// The frame along which a camera's images look: that of its name, but for rectified images, which are turned against it.
fn frame_of(row: &Calibration) -> String {
    let own = frame(&row.session, &row.camera);
    match &row.mount {
        Some(mount) if frame(&row.session, &mount.frame) == own => format!("{own}_rectified"),
        _ => own,
    }
}

/// A camera's calibration; `None` for models that Foxglove does not know.
fn calibration(row: &Calibration, frame_id: String, stamp: i64) -> Option<CameraCalibration> {
    let model = match row.model.as_str() {
        "equidistant" => "kannala_brandt",
        known @ ("plumb_bob" | "rational_polynomial") => known,
        _ => return None,
    };
    let &[fx, skew, cx, _, fy, cy, _, _, one] = row.intrinsics.as_slice() else {
        return None;
    };
    Some(CameraCalibration {
        timestamp: time(stamp),
        frame_id,
        width: row.width,
        height: row.height,
        distortion_model: model.to_owned(),
        d: row.distortion.clone(),
        k: row.intrinsics.clone(),
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, skew, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, one, 0.0],
    })
}

/// The images of keyframes, in the frames of their sessions' cameras; one without a calibration is in that of its name.
fn images(
    keyframes: Vec<Keyframe>,
    frames: &BTreeMap<(String, String), String>,
    is_driven: impl Fn(&String) -> bool,
) -> Vec<TopicMessage> {
    let of_session = keyframes.into_iter().filter(|row| is_driven(&row.session));
    let images = of_session.flat_map(|row| {
        let session = row.session;
        row.images.into_iter().map(move |image| {
            let topic = topic(&session, &image.camera);
            let known = frames.get(&(session.clone(), image.camera.clone()));
            let picture = Image {
                session: session.clone(),
                frame_id: known
                    .cloned()
                    .unwrap_or_else(|| frame(&session, &image.camera)),
                reference: image.image,
            };
            TopicMessage::of(image.stamp.0, topic, What::Image(Box::new(picture)))
        })
    });
    images.collect()
}

/// People by image, as rectangles on it.
fn annotations(
    people: Vec<Person>,
    is_driven: impl Fn(&String) -> bool,
) -> Result<Vec<TopicMessage>, Fault> {
    let mut images: BTreeMap<(String, String, i64), Vec<PointsAnnotation>> = BTreeMap::new();
    for row in people.into_iter().filter(|row| is_driven(&row.session)) {
        let key = (row.session, row.camera, row.stamp.0);
        let &[left, top, right, bottom] = row.rectangle.as_slice() else {
            continue;
        };
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
        images.entry(key).or_default().push(PointsAnnotation {
            timestamp: time(row.stamp.0),
            r#type: Outline::LineLoop as i32,
            points: corners.map(|[x, y]| Point2 { x, y }).to_vec(),
            outline_color: color(VERMILION, row.probability.clamp(0.3, 1.0)),
            thickness: 3.0,
            ..PointsAnnotation::default()
        });
    }
    let said = images
        .into_iter()
        .map(|((session, camera, stamp), points)| {
            let message = ImageAnnotations {
                timestamp: time(stamp),
                points,
                ..ImageAnnotations::default()
            };
            TopicMessage::new(
                stamp,
                format!("{}/people", topic(&session, &camera)),
                &message,
            )
        });
    said.collect()
}

#[cfg(test)]
mod tests {
    use evermap_schemas::Stamp;
    use evermap_schemas::roles::CameraMount;

    use super::*;

    #[test]
    fn images_that_are_turned_against_the_frame_of_their_camera_have_a_frame_of_their_own() {
        let row = |camera: &str, frame: Option<&str>| Calibration {
            site: String::new(),
            session: "a".to_owned(),
            stamp: Stamp(0),
            camera: camera.to_owned(),
            width: 200,
            height: 150,
            model: "plumb_bob".to_owned(),
            intrinsics: vec![100.0, 0.0, 99.5, 0.0, 100.0, 74.5, 0.0, 0.0, 1.0],
            distortion: Vec::new(),
            mount: frame.map(|frame| CameraMount {
                frame: frame.to_owned(),
                frame_from_camera: Pose::IDENTITY,
            }),
        };
        for (camera, mounted_on, expected) in [
            ("left", None, "a/left"),
            ("left", Some("/left"), "a/left_rectified"),
            ("stereo/right", Some("left"), "a/stereo/right"),
        ] {
            let row = row(camera, mounted_on);
            assert_eq!(frame_of(&row), expected);
            let said = calibration(&row, frame_of(&row), 5).map(|said| said.frame_id);
            assert_eq!(said.as_deref(), Some(expected));
        }
    }
}
