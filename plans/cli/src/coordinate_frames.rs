//! The coordinate frames of logs: what moves in what, and what each camera is mounted on.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use arrow::array::RecordBatch;
use arrow::util::display::array_value_to_string;
use datafusion::prelude::SessionContext;
use evermap_catalog::USUAL_VEHICLE;
use evermap_engine::quoted;
use evermap_schemas::Fault;
use evermap_schemas::roles::robots::Robots;
use evermap_schemas::roles::{CameraMount, frame_names};
use serde::Serialize;

use crate::reader::answered;

/// Frames are known after so many transforms, and cameras after so many images.
pub(crate) const TRANSFORMS: usize = 20_000;
pub(crate) const IMAGES: usize = 2_000;

/// The coordinate frames of logs, from their first transforms and images.
#[derive(Debug, Serialize)]
pub struct CoordinateFrames {
    /// Fixed ones first.
    pub transforms: Vec<Transform>,
    /// Cameras, by name.
    pub cameras: Vec<Camera>,
    /// Robots that share the logs, a frame of each, where nothing tells which one is the vehicle; else none.
    pub robots: Vec<String>,
}

/// One frame in another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Transform {
    /// Frame that points come out in.
    pub parent: String,
    /// Frame that points are given in.
    pub child: String,
    /// Whether it holds for all time.
    pub fixed: bool,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Camera {
    /// Its name.
    pub camera: String,
    /// Topic of its images.
    pub topic: String,
    /// The frame that fixed transforms lead to from the camera; null where none begins at it.
    pub mounted_on: Option<String>,
    /// The frame that the camera moves in, where no fixed transform begins at it; null where none has it either.
    pub moves_in: Option<String>,
}

impl CoordinateFrames {
    /// Reads them from the tables of the sessions that are registered with a context; `mounts` are those of their cameras
    /// that are not at the frame of their name.
    ///
    /// # Errors
    /// A resource fault when a log cannot be read.
    pub async fn read(
        context: &SessionContext,
        mounts: &BTreeMap<String, CameraMount>,
    ) -> Result<Self, Fault> {
        let transforms = format!(
            "SELECT DISTINCT parent, child, fixed FROM (SELECT parent, child, fixed FROM transforms LIMIT {TRANSFORMS}) \
             ORDER BY fixed DESC, parent, child"
        );
        let frame = |name: &str| frame_names::plain(name).to_owned();
        let transforms = texts_of(context, &transforms).await?.into_iter();
        let transforms: Vec<Transform> = transforms
            .map(|[parent, child, fixed]| Transform {
                parent: frame(&parent),
                child: frame(&child),
                fixed: fixed == "true",
            })
            .collect();
        let cameras = format!(
            "SELECT DISTINCT camera, topic FROM (SELECT camera, topic FROM frames LIMIT {IMAGES}) ORDER BY camera, topic"
        );
        let cameras = texts_of(context, &cameras).await?.into_iter();
        let cameras = cameras.map(|[camera, topic]| {
            let of_camera = mounts.get(&camera).map_or(&camera, |mount| &mount.frame);
            let of_camera = frame(of_camera);
            Camera {
                mounted_on: mounted_on(&transforms, &of_camera),
                moves_in: moves_in(&transforms, &of_camera),
                camera,
                topic,
            }
        });
        Ok(Self {
            cameras: cameras.collect(),
            robots: robots(&transforms),
            transforms,
        })
    }

    /// How a person says which robot is the vehicle; `None` where that is no question.
    pub fn choice(&self) -> Option<String> {
        let first = self.robots.first()?;
        Some(Robots::choice(first))
    }

    /// The frame that poses are of, as far as the transforms say: what most cameras are mounted on, else what moves and
    /// has nothing moving in it. `base_link` where that is a frame on the way, with a prefix or without; none where it
    /// may be one of several robots.
    pub fn vehicle(&self) -> Option<&str> {
        if !self.robots.is_empty() {
            return None;
        }
        if let Some(usual) = frame_names::meant(USUAL_VEHICLE, self.names()) {
            return Some(usual);
        }
        let mut mounts = BTreeMap::<&str, usize>::new();
        for mount in self
            .cameras
            .iter()
            .filter_map(|camera| camera.mounted_on.as_deref())
        {
            *mounts.entry(mount).or_default() += 1;
        }
        let most = mounts.into_iter().rev().max_by_key(|(_, cameras)| *cameras);
        most.map(|(frame, _)| frame).or_else(|| {
            let moving = || self.transforms.iter().filter(|transform| !transform.fixed);
            let mut ends = moving().filter(|end| moving().all(|other| other.parent != end.child));
            ends.next().map(|transform| transform.child.as_str())
        })
    }

    /// Whether there are cameras, and no transform says of any where it is mounted: nothing becomes of their images.
    pub fn no_camera_is_mounted(&self) -> bool {
        let mut cameras = self.cameras.iter();
        !self.cameras.is_empty() && cameras.all(|camera| camera.mounted_on.is_none())
    }

    /// All names of frames.
    pub fn names(&self) -> BTreeSet<&str> {
        let transforms = self.transforms.iter();
        transforms
            .flat_map(|transform| [transform.parent.as_str(), transform.child.as_str()])
            .collect()
    }
}

impl fmt::Display for Transform {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = if self.fixed { "fixed" } else { "moving" };
        write!(f, "{} -> {} ({state})", self.parent, self.child)
    }
}

impl fmt::Display for Camera {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}): ", self.camera, self.topic)?;
        match (&self.mounted_on, &self.moves_in) {
            (Some(frame), _) => write!(f, "mounted on {frame}"),
            (None, Some(frame)) => {
                write!(
                    f,
                    "no fixed transform says where it is mounted: it moves in {frame}"
                )
            }
            (None, None) => f.write_str("no fixed transform says where it is mounted"),
        }
    }
}

/// Robots that share the logs, if nothing tells which one is meant.
fn robots(transforms: &[Transform]) -> Vec<String> {
    let mut robots = Robots::default();
    let moving = transforms.iter().filter(|transform| !transform.fixed);
    moving.for_each(|found| robots.add(&found.parent, &found.child));
    robots.several().into_iter().map(str::to_owned).collect()
}

/// Where fixed transforms lead from a frame.
fn mounted_on(transforms: &[Transform], frame: &str) -> Option<String> {
    let parent = |child: &str| {
        let mut fixed = transforms.iter().filter(|transform| transform.fixed);
        fixed.find(|transform| transform.child == child)
    };
    let mut seen = BTreeSet::from([frame]);
    let mut at = parent(frame)?;
    // Forged transforms may go round in circles.
    while seen.insert(&at.parent)
        && let Some(next) = parent(&at.parent)
    {
        at = next;
    }
    Some(at.parent.clone())
}

/// The frame that another one, which no fixed transform begins at, moves in.
fn moves_in(transforms: &[Transform], frame: &str) -> Option<String> {
    // Fixed ones come first.
    let first = transforms.iter().find(|found| found.child == frame)?;
    (!first.fixed).then(|| first.parent.clone())
}

/// The cameras of a session, by name, of its first so many images.
///
/// # Errors
/// A resource fault when a log cannot be read.
pub(crate) async fn cameras_of(
    context: &SessionContext,
    session: &str,
    images: usize,
) -> Result<BTreeSet<String>, Fault> {
    let session = quoted::text(session);
    let cameras = format!(
        "SELECT DISTINCT camera FROM (SELECT camera FROM frames WHERE session = {session} LIMIT {images})"
    );
    let cameras = texts_of(context, &cameras).await?.into_iter();
    Ok(cameras.map(|[camera]: [String; 1]| camera).collect())
}

/// Width and height (px) of a camera's images, as the first calibration on one of these topics says; `None` where none
/// is of the camera.
pub(crate) async fn image_size(
    context: &SessionContext,
    camera: &str,
    calibrations: impl IntoIterator<Item = &String>,
) -> Option<[u32; 2]> {
    for topic in calibrations {
        let topic = quoted::name(topic);
        for frame in ["header['frame_id']", "frame_id"] {
            let first = format!("SELECT {frame}, width, height FROM {topic} LIMIT 1");
            // Messages have the frame in the one place or the other.
            let found = texts_of::<3>(context, &first).await.unwrap_or_default();
            if let Some([of, width, height]) = found.first()
                && frame_names::plain(of) == frame_names::plain(camera)
                && let (Ok(width), Ok(height)) = (width.parse(), height.parse())
            {
                return Some([width, height]);
            }
        }
    }
    None
}

/// The rows of a query, as text.
pub(crate) async fn texts_of<const N: usize>(
    context: &SessionContext,
    query: &str,
) -> Result<Vec<[String; N]>, Fault> {
    let mut rows = Vec::new();
    for batch in answered(context, query).await? {
        for row in 0..batch.num_rows() {
            rows.push(texts(&batch, row)?);
        }
    }
    Ok(rows)
}

fn texts<const N: usize>(batch: &RecordBatch, row: usize) -> Result<[String; N], Fault> {
    let columns = batch.columns().iter();
    let texts = columns.map(|column| array_value_to_string(column, row));
    let texts = texts.collect::<Result<Vec<String>, _>>();
    let texts = texts.map_err(|error| Fault::bug(error.to_string()))?;
    let found = texts.len();
    texts
        .try_into()
        .map_err(|_| Fault::bug(format!("expected {N} columns, found {found}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transform(parent: &str, child: &str, fixed: bool) -> Transform {
        let (parent, child) = (parent.to_owned(), child.to_owned());
        Transform {
            parent,
            child,
            fixed,
        }
    }

    fn frames(transforms: Vec<Transform>, cameras: &[&str]) -> CoordinateFrames {
        let cameras = cameras.iter().map(|camera| Camera {
            camera: (*camera).to_owned(),
            topic: String::new(),
            mounted_on: mounted_on(&transforms, camera),
            moves_in: moves_in(&transforms, camera),
        });
        CoordinateFrames {
            cameras: cameras.collect(),
            robots: robots(&transforms),
            transforms,
        }
    }

    #[test]
    fn the_vehicle_is_what_cameras_are_mounted_on() {
        let fixed = vec![
            transform("chassis", "bumper", true),
            transform("bumper", "front", true),
            transform("chassis", "rear", true),
            transform("gimbal", "up", true),
            transform("odom", "chassis", false),
        ];
        let rig = frames(fixed, &["front", "rear", "up", "free"]);
        let mounts = rig
            .cameras
            .iter()
            .map(|camera| camera.mounted_on.as_deref());
        let expected = [Some("chassis"), Some("chassis"), Some("gimbal"), None];
        assert_eq!(mounts.collect::<Vec<_>>(), expected);
        assert_eq!(rig.vehicle(), Some("chassis"));
        assert!(!rig.no_camera_is_mounted());
    }

    #[test]
    fn a_camera_that_moves_on_the_vehicle_is_mounted_nowhere() {
        let steered = vec![
            transform("chassis", "rear", true),
            transform("chassis", "front", false),
            transform("mast", "rear", false),
        ];
        let rig = frames(steered, &["front", "rear", "up"]);
        let said: Vec<String> = rig.cameras.iter().map(ToString::to_string).collect();
        let expected = [
            "front (): no fixed transform says where it is mounted: it moves in chassis",
            "rear (): mounted on chassis",
            "up (): no fixed transform says where it is mounted",
        ];
        assert_eq!(said, expected);
        let alone = frames(vec![transform("chassis", "front", false)], &["front"]);
        assert!(alone.no_camera_is_mounted());
        assert!(!frames(Vec::new(), &[]).no_camera_is_mounted());
    }

    #[test]
    fn the_vehicle_of_one_robot_has_its_prefix_and_of_several_none_is_taken() {
        let one = vec![
            transform("a/base_link", "a/front", true),
            transform("a/odom", "a/base_link", false),
        ];
        let alone = frames(one.clone(), &["a/front"]);
        assert_eq!(alone.vehicle(), Some("a/base_link"));
        assert_eq!(alone.choice(), None);
        let mut both = one;
        both.push(transform("b/odom", "b/base_link", false));
        let both = frames(both, &["a/front"]);
        assert_eq!(both.vehicle(), None);
        assert_eq!(both.robots, ["a/base_link", "b/base_link"]);
        assert!(
            both.choice()
                .is_some_and(|said| said.contains("vehicle_frame: a/base_link"))
        );
    }

    #[test]
    fn without_cameras_it_is_what_moves_last_and_circles_end() {
        let moving = vec![
            transform("map", "odom", false),
            transform("odom", "footprint", false),
        ];
        assert_eq!(frames(moving, &[]).vehicle(), Some("footprint"));
        let named = vec![transform("base_link", "wheel", false)];
        assert_eq!(frames(named, &[]).vehicle(), Some("base_link"));
        let circle = vec![transform("a", "b", true), transform("b", "a", true)];
        assert!(frames(circle, &["a"]).vehicle().is_some());
        assert_eq!(frames(Vec::new(), &["a"]).vehicle(), None);
    }
}
