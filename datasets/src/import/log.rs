//! Writing the log of an import.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use evermap_messages::ros2::{
    CameraInfo, CompressedImage, Header, Message, Odometry, Pose, StaticTransforms,
};
use evermap_schemas::Fault;
use mcap::records::MessageHeader;
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
/// appears only once it is complete.
pub(super) fn write(
    out: &Path,
    cameras: &[Camera],
    poses: &[(u64, Isometry3<f64>)],
    classes: &[String],
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
    let partial = out.with_extension("mcap.partial");
    let mut log = Log::create(&partial)?;
    let transforms = log.topic::<StaticTransforms>("/tf_static")?;
    let odometry = log.topic::<Odometry>("/odom")?;
    let channels: Result<Vec<Channels>, Fault> = cameras
        .iter()
        .map(|camera| Channels::declare(&mut log, camera))
        .collect();
    let channels = channels?;
    // What holds for the whole log comes first.
    let start = events.first().map_or(0, |(stamp, _)| *stamp);
    log.send(transforms, start, &placed(start, cameras))?;
    for (camera, channels) in cameras.iter().zip(&channels) {
        if let (Some(channel), Some(intrinsics)) = (channels.info, &camera.intrinsics) {
            let info = CameraInfo {
                header: camera.header(start),
                calibration: intrinsics.published([camera.width, camera.height]),
            };
            log.send(channel, start, &info)?;
        }
    }
    log.classes(classes)?;
    for (stamp, event) in &events {
        let stamp = *stamp;
        match event {
            Event::Pose(i) => log.send(odometry, stamp, &odometry_of(stamp, &poses[*i].1))?,
            Event::Image(c, i) => {
                let (camera, channel) = (&cameras[*c], channels[*c].images);
                log.image(channel, camera.header(stamp), &camera.images[*i].1)?;
            }
            Event::Labels(c, i) => {
                let (camera, channel) = (&cameras[*c], channels[*c].labels);
                let channel = channel.ok_or_else(|| Fault::bug("labels without a channel"))?;
                log.image(channel, camera.header(stamp), &camera.labels[*i].1)?;
            }
        }
    }
    log.finish()?;
    let place = |error: std::io::Error| Fault::resource(error.to_string()).at(out.display());
    std::fs::rename(&partial, out).map_err(place)?;
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
        cameras: placed.collect(),
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
    fn declare(log: &mut Log, camera: &Camera) -> Result<Self, Fault> {
        let topic = |leaf: &str| format!("/{}/{leaf}", camera.name);
        let images = log.topic::<CompressedImage>(&topic("image/compressed"))?;
        let info = match &camera.intrinsics {
            Some(_) => Some(log.topic::<CameraInfo>(&topic("camera_info"))?),
            None => None,
        };
        let labels = match camera.labels.as_slice() {
            [] => None,
            _ => Some(log.topic::<CompressedImage>(&topic("labels"))?),
        };
        Ok(Self {
            images,
            info,
            labels,
        })
    }
}

struct Log {
    writer: mcap::Writer<BufWriter<File>>,
    /// Messages so far, by channel.
    sent: BTreeMap<u16, u32>,
    path: PathBuf,
}

impl Log {
    fn create(path: &Path) -> Result<Self, Fault> {
        let place = |error: String| Fault::resource(error).at(path.display());
        let file = File::create(path).map_err(|error| place(error.to_string()))?;
        let options = mcap::WriteOptions::new()
            .profile("ros2")
            .library("evermap import");
        let writer = options.create(BufWriter::new(file));
        Ok(Self {
            writer: writer.map_err(|error| place(error.to_string()))?,
            sent: BTreeMap::new(),
            path: path.to_owned(),
        })
    }

    fn fault(&self, error: &mcap::McapError) -> Fault {
        Fault::resource(error.to_string()).at(self.path.display())
    }

    fn topic<M: Message>(&mut self, topic: &str) -> Result<u16, Fault> {
        let definition = M::DEFINITION.as_bytes();
        let schema = self.writer.add_schema(M::NAME, "ros2msg", definition);
        let schema = schema.map_err(|error| self.fault(&error))?;
        let channel = self
            .writer
            .add_channel(schema, topic, "cdr", &BTreeMap::new());
        channel.map_err(|error| self.fault(&error))
    }

    /// What the values of label images mean, if anybody says.
    fn classes(&mut self, classes: &[String]) -> Result<(), Fault> {
        let named = classes
            .iter()
            .enumerate()
            .filter(|(_, name)| !name.is_empty());
        let metadata: BTreeMap<String, String> = named
            .map(|(value, name)| (value.to_string(), name.clone()))
            .collect();
        if metadata.is_empty() {
            return Ok(());
        }
        let record = mcap::records::Metadata {
            name: "label_classes".to_owned(),
            metadata,
        };
        let written = self.writer.write_metadata(&record);
        written.map_err(|error| self.fault(&error))
    }

    fn image(&mut self, channel: u16, header: Header<'_>, path: &Path) -> Result<(), Fault> {
        let (format, data) = encoded(path)?;
        let image = CompressedImage {
            header,
            format,
            data: &data,
        };
        self.send(channel, header.stamp_ns, &image)
    }

    fn send(&mut self, channel: u16, stamp: u64, message: &impl Message) -> Result<(), Fault> {
        let sent = self.sent.entry(channel).or_default();
        let header = MessageHeader {
            channel_id: channel,
            sequence: *sent,
            log_time: stamp,
            publish_time: stamp,
        };
        *sent += 1;
        let written = self
            .writer
            .write_to_known_channel(&header, &message.encode());
        written.map_err(|error| self.fault(&error))
    }

    fn finish(mut self) -> Result<(), Fault> {
        let finished = self.writer.finish();
        finished.map(|_| ()).map_err(|error| self.fault(&error))
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
    let bytes = std::fs::read(path).map_err(|error| {
        Fault::user(format!("expected an image, found {error}")).at(path.display())
    })?;
    let format = if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        "png"
    } else if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
        "jpeg"
    } else {
        return Err(Fault::user("expected a PNG or JPEG image").at(path.display()));
    };
    Ok((format, bytes))
}

/// Width and height, from the image's head.
pub(super) fn image_size(path: &Path) -> Result<(u32, u32), Fault> {
    let (format, bytes) = encoded(path)?;
    let size = match format {
        "png" => png_size(&bytes),
        _ => jpeg_size(&bytes),
    };
    size.ok_or_else(|| Fault::user("expected an image with a size").at(path.display()))
}

/// Width and height of what must be a PNG, as label images must: JPEG changes values.
pub(super) fn png_image_size(path: &Path) -> Result<(u32, u32), Fault> {
    let (format, bytes) = encoded(path)?;
    let size = if format == "png" {
        png_size(&bytes)
    } else {
        None
    };
    size.ok_or_else(|| Fault::user("expected labels as PNG").at(path.display()))
}

/// PNG: the IHDR chunk comes first.
fn png_size(bytes: &[u8]) -> Option<(u32, u32)> {
    let number = |at: usize| Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?));
    Some((number(16)?, number(20)?))
}

/// JPEG: the first start-of-frame segment (ITU T.81, B.2.2).
fn jpeg_size(bytes: &[u8]) -> Option<(u32, u32)> {
    let number = |at: usize| Some(u16::from_be_bytes(*bytes.get(at..)?.first_chunk()?));
    let mut at = 2;
    loop {
        let marker = *bytes.get(at + 1)?;
        if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            return Some((number(at + 7)?.into(), number(at + 5)?.into()));
        }
        at += 2 + usize::from(number(at + 2)?);
    }
}
