//! One drive, and how its log is written.

use super::{LIBRARY, Recorded, SessionSummary, Stopped, Waits};
use crate::WorldError;
use crate::random::{nanoseconds, normal, stream};
use crate::vehicle::{ANTENNA, Imu, OdometrySample, Receiver, SENSOR, Trajectory, Wheels};
use evermap_algorithms::geometry::pose::Pose;
use evermap_messages::ros2::{
    self, Calibration, CameraInfo, CompressedImage, Header, Message, NavSatFix, Odometry,
    StaticTransforms,
};
use evermap_recording::{LogWriter, RecordingError, Times};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Shots rendered before any of them is written; bounds memory to some 30 MB of images.
const BATCH: usize = 24;

/// One drive through a world, before anything is rendered.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedSession {
    /// Everything random in its world is drawn from this number.
    pub seed: u64,
    /// Counted from 0.
    pub index: usize,
    /// Name of the session and of its log.
    pub name: String,
    /// When it starts, ns since the epoch.
    pub start_ns: u64,
    /// How the vehicle moves.
    pub drive: Trajectory,
    /// The shots: when all cameras take an image, ns since the epoch.
    pub stamps: Vec<u64>,
    /// Who counts the way.
    pub wheels: Wheels,
    /// Who listens to satellites, if anybody does.
    pub receiver: Option<Receiver>,
    /// What feels gravity and turns, if anything does.
    pub imu: Option<Imu>,
}

/// What is on the vehicle besides its wheels.
pub struct Sensors {
    /// Cameras.
    pub cameras: Vec<CameraTopics>,
    /// What each camera makes of a shot: the rest of the image's topic, and its format.
    pub images: &'static [(&'static str, &'static str)],
    /// How long after a shot's stamp the recorder gets a camera's images, ns.
    pub delay_ns: Range<u64>,
    /// How much later than that it gets each image of the same camera, ns; empty: at once.
    pub spread_ns: Range<u64>,
    /// Names of the values of label images, if there are such.
    pub label_classes: BTreeMap<String, String>,
}

/// A camera as the log describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraTopics {
    /// Its topics begin with this.
    pub namespace: String,
    /// Its optical frame.
    pub frame_id: String,
    /// Where it sits.
    pub vehicle_from_camera: Pose,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// `distortion_model`.
    pub model: &'static str,
    /// D.
    pub distortion: Vec<f64>,
    /// Focal lengths, pixels; of a panorama, pixels per radian.
    pub focal: [f64; 2],
    /// Principal point, pixels.
    pub centre: [f64; 2],
}

/// The images, encoded, of a shot and a camera (their indices), in the order of [`Sensors::images`].
pub type Take<'a> = dyn Fn(usize, usize) -> Result<Vec<Vec<u8>>, WorldError> + Sync + 'a;

/// A message of the log.
struct Due {
    channel: u16,
    times: Times,
    content: Content,
}

enum Content {
    /// The payload.
    Ready(Vec<u8>),
    /// An image of a shot, a camera and a kind (their indices), rendered when it is due.
    Image([usize; 3]),
}

impl Due {
    fn ready(channel: u16, times: Times, message: &impl Message) -> Self {
        let content = Content::Ready(message.encode());
        Self {
            channel,
            times,
            content,
        }
    }
}

/// When a shot wanted `seconds` after the start is taken, ns since the epoch: shutters are not exact.
pub fn shutter(start_ns: u64, seconds: f64, rng: &mut ChaCha8Rng) -> u64 {
    let late = 3e-4 * normal(rng).clamp(-3.0, 3.0);
    start_ns + nanoseconds(seconds + late)
}

impl SimulatedSession {
    /// Seconds since the session's start.
    pub fn seconds(&self, stamp_ns: u64) -> f64 {
        stamp_ns.saturating_sub(self.start_ns) as f64 * 1e-9
    }

    /// `map_from_vehicle` at a stamp, ns since the epoch.
    pub fn map_from_vehicle(&self, stamp_ns: u64) -> Pose {
        self.drive.map_from_vehicle(self.seconds(stamp_ns))
    }

    /// What the wheels report.
    pub fn odometry(&self) -> Vec<OdometrySample> {
        let rng = stream(self.seed, "ticks", self.index as u64);
        self.wheels.odometry(&self.drive, self.start_ns, rng)
    }

    /// Its log in a folder.
    pub fn log_in(&self, folder: &Path) -> PathBuf {
        folder.join(format!("{}.mcap", self.name))
    }

    /// Renders the session and writes its log into `folder`, for who waits for it.
    pub fn record(
        &self,
        folder: &Path,
        sensors: &Sensors,
        take: &Take<'_>,
        waits: &mut Waits<'_>,
    ) -> Recorded {
        let path = self.log_in(folder);
        let mut log = LogWriter::create(&path, LIBRARY, "ros2")?;
        let schedule = self.schedule(sensors, &mut log)?;
        log.label_classes(sensors.label_classes.clone())?;
        let mut darkroom = Darkroom {
            shots: self.stamps.len(),
            cameras: sensors.cameras.len(),
            take,
            is_stopped: waits.is_stopped,
            rendered: 0,
            images: BTreeMap::new(),
        };
        let mut written = 0;
        for due in schedule {
            let payload = match due.content {
                Content::Ready(payload) => payload,
                Content::Image(wanted @ [shot, camera, image]) => {
                    written += 1;
                    if usize::is_multiple_of(written, sensors.images.len()) {
                        (waits.tell)(written / sensors.images.len());
                    }
                    let message = CompressedImage {
                        header: sensors.cameras[camera].header(self.stamps[shot]),
                        format: sensors.images[image].1,
                        data: &darkroom.image(wanted)?,
                    };
                    message.encode()
                }
            };
            log.send(due.channel, due.times, &payload)?;
        }
        let (messages, bytes) = log.finish()?;
        Ok(SessionSummary {
            name: self.name.clone(),
            path,
            shots: self.stamps.len(),
            messages,
            bytes,
            driven_m: self.drive.length_m(),
            duration_s: self.drive.duration_s(),
        })
    }

    /// Declares the topics and gives all messages in the order of their log times.
    fn schedule(&self, sensors: &Sensors, log: &mut LogWriter) -> Result<Vec<Due>, WorldError> {
        let mut rng = stream(self.seed, "recorder", self.index as u64);
        let transforms = log.topic::<StaticTransforms>("/tf_static", true)?;
        let odometry = log.topic::<Odometry>("/odom", false)?;
        let (log_ns, stamp_ns) = (self.start_ns, self.start_ns);
        let cameras = sensors.cameras.iter().map(CameraTopics::place);
        let antenna = self
            .receiver
            .map(|_| (ANTENNA, Receiver::mount().to_array()));
        let imu = self.imu.map(|_| (SENSOR, Imu::mount().to_array()));
        let placed = StaticTransforms {
            stamp_ns,
            frames: cameras.chain(antenna).chain(imu).collect(),
        };
        let mut schedule = vec![Due::ready(transforms, Times { log_ns, stamp_ns }, &placed)];
        for sample in self.odometry() {
            schedule.push(Due::ready(odometry, sample.times, &sample.message()));
        }
        if let Some(receiver) = &self.receiver {
            let topic = log.topic::<NavSatFix<'_>>("/fix", false)?;
            let fixes = receiver.fixes(&self.drive, self.start_ns, self.seed, self.index);
            schedule.extend((fixes.iter()).map(|(times, fix)| Due::ready(topic, *times, fix)));
        }
        if let Some(imu) = &self.imu {
            let topic = log.topic::<ros2::Imu<'_>>("/imu", false)?;
            let felt = imu.samples(&self.drive, self.start_ns, self.seed, self.index);
            schedule.extend((felt.iter()).map(|(times, felt)| Due::ready(topic, *times, felt)));
        }
        let channels = sensors.cameras.iter().map(|camera| {
            let topic = |leaf: &str| format!("{}/{leaf}", camera.namespace);
            let info = log.topic::<CameraInfo>(&topic("camera_info"), false)?;
            let images = sensors.images.iter();
            let images = images.map(|(leaf, _)| log.topic::<CompressedImage>(&topic(leaf), false));
            Ok((info, images.collect::<Result<Vec<u16>, RecordingError>>()?))
        });
        let channels: Vec<(u16, Vec<u16>)> = channels.collect::<Result<_, RecordingError>>()?;
        for (shot, stamp_ns) in self.stamps.iter().copied().enumerate() {
            for (camera, (info, images)) in channels.iter().enumerate() {
                let first = stamp_ns + rng.random_range(sensors.delay_ns.clone());
                let at = |log_ns| Times { log_ns, stamp_ns };
                let message = sensors.cameras[camera].info(stamp_ns);
                schedule.push(Due::ready(*info, at(first - 200_000), &message));
                for (image, channel) in images.iter().enumerate() {
                    let later = match &sensors.spread_ns {
                        spread if spread.is_empty() => 0,
                        spread => rng.random_range(spread.clone()),
                    };
                    schedule.push(Due {
                        channel: *channel,
                        times: at(first + later),
                        content: Content::Image([shot, camera, image]),
                    });
                }
            }
        }
        schedule.sort_by_key(|due| due.times.log_ns);
        Ok(schedule)
    }
}

impl CameraTopics {
    fn place(&self) -> (&str, evermap_messages::ros2::Pose) {
        (&self.frame_id, self.vehicle_from_camera.to_array())
    }

    fn header(&self, stamp_ns: u64) -> Header<'_> {
        Header {
            stamp_ns,
            frame_id: &self.frame_id,
        }
    }

    fn info(&self, stamp_ns: u64) -> CameraInfo<'_> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        CameraInfo {
            header: self.header(stamp_ns),
            calibration: Calibration {
                size: self.size,
                model: self.model,
                distortion: &self.distortion,
                k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            },
        }
    }
}

/// Images rendered ahead of the log, a batch at a time, on all cores.
struct Darkroom<'a> {
    shots: usize,
    cameras: usize,
    take: &'a Take<'a>,
    is_stopped: &'a Stopped<'a>,
    /// Shots rendered so far.
    rendered: usize,
    /// By shot, camera and image.
    images: BTreeMap<[usize; 3], Vec<u8>>,
}

impl Darkroom<'_> {
    /// One image (shot, camera, image), which nobody asks for again.
    fn image(&mut self, wanted: [usize; 3]) -> Result<Vec<u8>, WorldError> {
        if wanted[0] >= self.rendered {
            self.render((wanted[0] + BATCH).min(self.shots))?;
        }
        Ok(self.images.remove(&wanted).unwrap_or_default())
    }

    /// Renders the shots before `to`; not all of them where somebody stops.
    fn render(&mut self, to: usize) -> Result<(), WorldError> {
        let (cameras, take, is_stopped) = (self.cameras, self.take, self.is_stopped);
        let wanted = self.rendered * cameras..to * cameras;
        let batch: Result<Vec<Vec<Vec<u8>>>, WorldError> = wanted
            .clone()
            .into_par_iter()
            .map(|index| match is_stopped() {
                true => Err(WorldError::Stopped),
                false => take(index / cameras, index % cameras),
            })
            .collect();
        for (index, taken) in wanted.zip(batch?) {
            for (image, encoded) in taken.into_iter().enumerate() {
                self.images
                    .insert([index / cameras, index % cameras, image], encoded);
            }
        }
        self.rendered = to;
        Ok(())
    }
}
