//! Writing the log of an import.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use evermap_messages::ros2::{
    CameraInfo, CompressedImage, Header, Message, Odometry, Pose, StaticTransforms,
};
use evermap_recording::{LogWriter, RecordingError, Times};
use evermap_schemas::Fault;
use imagesize::{ImageError, ImageType};
use nalgebra::Isometry3;

use crate::import::Imported;
use crate::import::calibration::Intrinsics;

/// A camera, ready to be written.
pub(super) struct Camera {
    pub name: String,
    pub width: u32,
    pub height: u32,
    /// `None` where nobody knows.
    pub intrinsics: Option<Intrinsics>,
    /// `None` where nobody knows.
    pub vehicle_from_camera: Option<Isometry3<f64>>,
    /// Stamps, ns, and files.
    pub images: Vec<(u64, PathBuf)>,
    /// Stamps of their images, ns, and files.
    pub labels: Vec<(u64, PathBuf)>,
}

impl Camera {
    fn header(&self, stamp_ns: u64) -> Header<'_> {
        Header {
            stamp_ns,
            frame_id: &self.name,
        }
    }
}

/// What is written at an instant, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Pose(usize),
    Image(usize, usize),
    Labels(usize, usize),
}

/// Writes cameras, poses (ns, `odom_from_vehicle`) and the classes of label images (by value) in time order. The file
/// appears only once it is complete, and not at all where somebody stops before.
pub(super) fn write(
    out: &Path,
    cameras: &[Camera],
    poses: &[(u64, Isometry3<f64>)],
    classes: &[String],
    is_stopped: &dyn Fn() -> bool,
) -> Result<Imported, Fault> {
    let mut events: Vec<(u64, Event)> = Vec::new();
    let stamps = poses.iter().enumerate();
    events.extend(stamps.map(|(i, (stamp, _))| (*stamp, Event::Pose(i))));
    for (c, camera) in cameras.iter().enumerate() {
        let stamps = camera.images.iter().enumerate();
        events.extend(stamps.map(|(i, (stamp, _))| (*stamp, Event::Image(c, i))));
        let stamps = camera.labels.iter().enumerate();
        events.extend(stamps.map(|(i, (stamp, _))| (*stamp, Event::Labels(c, i))));
    }
    events.sort();
    let mut log = LogWriter::create(out, "evermap import", "ros2").map_err(fault)?;
    let transforms = topic::<StaticTransforms>(&mut log, "/tf_static")?;
    let odometry = topic::<Odometry>(&mut log, "/odom")?;
    let channels: Result<Vec<Channels>, Fault> = cameras
        .iter()
        .map(|camera| Channels::declare(&mut log, camera))
        .collect();
    let channels = channels?;
    // What holds for the whole log comes first.
    let start = events.first().map_or(0, |(stamp, _)| *stamp);
    send(&mut log, transforms, start, &placed(start, cameras))?;
    for (camera, channels) in cameras.iter().zip(&channels) {
        if let (Some(channel), Some(intrinsics)) = (channels.info, &camera.intrinsics) {
            let info = CameraInfo {
                header: camera.header(start),
                calibration: intrinsics.published([camera.width, camera.height]),
            };
            send(&mut log, channel, start, &info)?;
        }
    }
    let named = classes.iter().enumerate();
    let named = named.filter(|(_, name)| !name.is_empty());
    let named = named.map(|(value, name)| (value.to_string(), name.clone()));
    log.label_classes(named.collect()).map_err(fault)?;
    for (stamp, event) in &events {
        if is_stopped() {
            return Err(Fault::user("stopped"));
        }
        let stamp = *stamp;
        match event {
            Event::Pose(i) => {
                send(&mut log, odometry, stamp, &odometry_of(stamp, &poses[*i].1))?;
            }
            Event::Image(c, i) | Event::Labels(c, i) => {
                let (camera, channels) = (&cameras[*c], &channels[*c]);
                let (channel, files) = match event {
                    Event::Labels(..) => (channels.labels, &camera.labels),
                    _ => (Some(channels.images), &camera.images),
                };
                let channel = channel.ok_or_else(|| Fault::bug("labels without a channel"))?;
                send_image(&mut log, channel, camera.header(stamp), &files[*i].1)?;
            }
        }
    }
    log.finish().map_err(fault)?;
    Ok(Imported {
        images: cameras.iter().map(|camera| camera.images.len()).sum(),
        poses: poses.len(),
        labels: cameras.iter().map(|camera| camera.labels.len()).sum(),
    })
}

/// The places of those cameras whose place is known.
fn placed(stamp_ns: u64, cameras: &[Camera]) -> StaticTransforms<'_> {
    let placed = cameras.iter().filter_map(|camera| {
        let vehicle_from_camera = camera.vehicle_from_camera.as_ref()?;
        Some((camera.name.as_str(), pose(vehicle_from_camera)))
    });
    StaticTransforms {
        stamp_ns,
        frames: placed.collect(),
    }
}

/// Variances and speeds are zero: the source does not say them.
fn odometry_of(stamp_ns: u64, odom_from_vehicle: &Isometry3<f64>) -> Odometry {
    Odometry {
        stamp_ns,
        pose: pose(odom_from_vehicle),
        pose_variances: [0.0; 6],
        twist: [0.0; 6],
        twist_variances: [0.0; 6],
    }
}

/// Channels of one camera; `None` where nothing will be sent.
struct Channels {
    images: u16,
    info: Option<u16>,
    labels: Option<u16>,
}

impl Channels {
    fn declare(log: &mut LogWriter, camera: &Camera) -> Result<Self, Fault> {
        let name = |leaf: &str| format!("/{}/{leaf}", camera.name);
        let images = topic::<CompressedImage>(log, &name("image/compressed"))?;
        let info = match &camera.intrinsics {
            Some(_) => Some(topic::<CameraInfo>(log, &name("camera_info"))?),
            None => None,
        };
        let labels = match camera.labels.as_slice() {
            [] => None,
            _ => Some(topic::<CompressedImage>(log, &name("labels"))?),
        };
        Ok(Self {
            images,
            info,
            labels,
        })
    }
}

fn topic<M: Message>(log: &mut LogWriter, name: &str) -> Result<u16, Fault> {
    log.topic::<M>(name, false).map_err(fault)
}

fn send(
    log: &mut LogWriter,
    channel: u16,
    stamp_ns: u64,
    message: &impl Message,
) -> Result<(), Fault> {
    let log_ns = stamp_ns;
    let sent = log.send(channel, Times { log_ns, stamp_ns }, &message.encode());
    sent.map_err(fault)
}

fn send_image(
    log: &mut LogWriter,
    channel: u16,
    header: Header<'_>,
    path: &Path,
) -> Result<(), Fault> {
    let (format, data) = encoded(path)?;
    let image = CompressedImage {
        header,
        format,
        data: &data,
    };
    send(log, channel, header.stamp_ns, &image)
}

fn fault(error: RecordingError) -> Fault {
    match error {
        RecordingError::Kept { .. } | RecordingError::Folder { .. } => {
            Fault::user(error.to_string())
        }
        _ => Fault::resource(error.to_string()),
    }
}

/// Position, then quaternion.
fn pose(pose: &Isometry3<f64>) -> Pose {
    let [x, y, z] = pose.translation.vector.into();
    let [qx, qy, qz, qw] = pose.rotation.coords.into();
    [x, y, z, qx, qy, qz, qw]
}

/// An encoded image, and its format.
fn encoded(path: &Path) -> Result<(&'static str, Vec<u8>), Fault> {
    let bytes = std::fs::read(path).map_err(|error| unread(path, &error))?;
    let (format, _) = format(imagesize::image_type(&bytes), path)?;
    Ok((format, bytes))
}

/// Width and height of a camera's images, from their heads: all have those of the first, as its calibration is for one.
pub(super) fn common_size<'a>(
    images: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(u32, u32), Fault> {
    let mut images = images.into_iter();
    let first = images
        .next()
        .ok_or_else(|| Fault::user("expected at least one image, found none"))?;
    let (_, (width, height)) = image_size(first)?;
    for image in images {
        let (_, found) = image_size(image)?;
        if found != (width, height) {
            return Err(Fault::user(format!(
                "expected an image of {width} x {height} like the camera's first, found {} x {}",
                found.0, found.1
            ))
            .at(image.display())
            .next("bring the images to one size, or give each size a camera of its own"));
        }
    }
    Ok((width, height))
}

/// Format, width and height, from the image's head; no more of it is read.
pub(super) fn image_size(path: &Path) -> Result<(&'static str, (u32, u32)), Fault> {
    let file = File::open(path).map_err(|error| unread(path, &error))?;
    let mut head = BufReader::new(file);
    let (format, kind) = format(imagesize::reader_type(&mut head), path)?;
    let size = kind.reader_size(&mut head).map_err(|error| {
        Fault::user(format!("expected an image with a size, found {error}")).at(path.display())
    })?;
    Ok((format, (size.width as u32, size.height as u32)))
}

/// The format that an image is of, by name.
fn format(
    found: Result<ImageType, ImageError>,
    path: &Path,
) -> Result<(&'static str, ImageType), Fault> {
    match found {
        Ok(kind @ ImageType::Png) => Ok(("png", kind)),
        Ok(kind @ ImageType::Jpeg) => Ok(("jpeg", kind)),
        _ => Err(Fault::user("expected a PNG or JPEG image").at(path.display())),
    }
}

fn unread(path: &Path, error: &std::io::Error) -> Fault {
    Fault::user(format!("expected an image, found {error}")).at(path.display())
}
