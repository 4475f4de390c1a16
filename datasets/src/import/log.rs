//! Writing the log of an import.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use evermap_schemas::Fault;
use mcap::records::MessageHeader;
use nalgebra::Isometry3;

use crate::import::Imported;
use crate::import::calibration::Intrinsics;
use crate::import::ros2::{self, MessageType};

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
    let mut log = Log::create(&partial, cameras)?;
    let start = events.first().map_or(0, |(stamp, _)| *stamp);
    log.start(start, cameras)?;
    log.classes(classes)?;
    for (stamp, event) in &events {
        match event {
            Event::Pose(i) => log.send(ODOM, *stamp, &ros2::odometry(*stamp, &poses[*i].1))?,
            Event::Image(c, i) => {
                let camera = &cameras[*c];
                log.image(IMAGE + CHANNELS * c, *stamp, camera, &camera.images[*i].1)?;
            }
            Event::Labels(c, i) => {
                let camera = &cameras[*c];
                log.image(LABELS + CHANNELS * c, *stamp, camera, &camera.labels[*i].1)?;
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

const TF_STATIC: usize = 0;
const ODOM: usize = 1;
/// The first camera's channels; the next one's are so many further.
const IMAGE: usize = 2;
const CAMERA_INFO: usize = 3;
const LABELS: usize = 4;
const CHANNELS: usize = 3;

struct Log {
    writer: mcap::Writer<BufWriter<File>>,
    /// Number, and messages so far; `None` where nothing will be sent.
    channels: Vec<Option<(u16, u32)>>,
    path: PathBuf,
}

impl Log {
    fn create(path: &Path, cameras: &[Camera]) -> Result<Self, Fault> {
        let place = |error: std::io::Error| Fault::resource(error.to_string()).at(path.display());
        let file = BufWriter::new(File::create(path).map_err(place)?);
        let options = mcap::WriteOptions::new()
            .profile("ros2")
            .library("evermap import");
        let writer = options
            .create(file)
            .map_err(|error| Fault::resource(error.to_string()).at(path.display()))?;
        let mut log = Self {
            writer,
            channels: Vec::new(),
            path: path.to_owned(),
        };
        log.add(true, "/tf_static", &ros2::TF_MESSAGE)?;
        log.add(true, "/odom", &ros2::ODOMETRY)?;
        for camera in cameras {
            let topic = |leaf: &str| format!("/{}/{leaf}", camera.name);
            let (calibrated, labelled) = (camera.intrinsics.is_some(), !camera.labels.is_empty());
            log.add(true, &topic("image/compressed"), &ros2::COMPRESSED_IMAGE)?;
            log.add(calibrated, &topic("camera_info"), &ros2::CAMERA_INFO)?;
            log.add(labelled, &topic("labels"), &ros2::COMPRESSED_IMAGE)?;
        }
        Ok(log)
    }

    fn fault(&self, error: &mcap::McapError) -> Fault {
        Fault::resource(error.to_string()).at(self.path.display())
    }

    fn add(&mut self, used: bool, topic: &str, message: &MessageType) -> Result<(), Fault> {
        if !used {
            self.channels.push(None);
            return Ok(());
        }
        let definition = message.definition.as_bytes();
        let schema = self.writer.add_schema(message.name, "ros2msg", definition);
        let schema = schema.map_err(|error| self.fault(&error))?;
        let channel = self
            .writer
            .add_channel(schema, topic, "cdr", &BTreeMap::new());
        let channel = channel.map_err(|error| self.fault(&error))?;
        self.channels.push(Some((channel, 0)));
        Ok(())
    }

    /// What holds for the whole log: where the cameras are, and what their lenses do.
    fn start(&mut self, stamp: u64, cameras: &[Camera]) -> Result<(), Fault> {
        let placed: Vec<(&str, Isometry3<f64>)> = cameras
            .iter()
            .filter_map(|camera| Some((camera.name.as_str(), camera.vehicle_from_camera?)))
            .collect();
        self.send(TF_STATIC, stamp, &ros2::transforms(stamp, &placed))?;
        for (c, camera) in cameras.iter().enumerate() {
            if let Some(intrinsics) = &camera.intrinsics {
                let size = (camera.width, camera.height);
                let info = ros2::camera_info(stamp, &camera.name, size, intrinsics);
                self.send(CAMERA_INFO + CHANNELS * c, stamp, &info)?;
            }
        }
        Ok(())
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

    fn image(
        &mut self,
        channel: usize,
        stamp: u64,
        camera: &Camera,
        path: &Path,
    ) -> Result<(), Fault> {
        let (format, bytes) = encoded(path)?;
        let message = ros2::compressed_image(stamp, &camera.name, format, &bytes);
        self.send(channel, stamp, &message)
    }

    fn send(&mut self, channel: usize, stamp: u64, message: &[u8]) -> Result<(), Fault> {
        let Some((channel_id, sent)) = &mut self.channels[channel] else {
            return Err(Fault::bug("a message on a channel that was not declared"));
        };
        let (channel_id, sequence) = (*channel_id, *sent);
        *sent += 1;
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: stamp,
            publish_time: stamp,
        };
        let written = self.writer.write_to_known_channel(&header, message);
        written.map_err(|error| self.fault(&error))
    }

    fn finish(mut self) -> Result<(), Fault> {
        let finished = self.writer.finish();
        finished.map(|_| ()).map_err(|error| self.fault(&error))
    }
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
