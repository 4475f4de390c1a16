//! One drive, and how its log is written.

use super::SessionSummary;
use super::log::{LogWriter, Times};
use crate::WorldError;
use crate::random::{nanoseconds, normal, stream};
use crate::render::Scratch;
use crate::vehicle::{OdometrySample, Trajectory, Wheels};
use evermap_algorithms::geometry::pose::Pose;
use evermap_messages::ros2::{
    Calibration, CameraInfo, CompressedImage, Header, Odometry, StaticTransforms,
};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

/// Shots rendered before any of them is written; bounds memory to some 30 MB of images.
const BATCH: usize = 24;

/// One drive through a world, before anything is rendered.
#[derive(Debug, Clone, PartialEq)]
pub struct Session {
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
}

/// What is on the vehicle besides its wheels.
pub struct Sensors<'a> {
    /// Cameras.
    pub cameras: Vec<CameraTopics<'a>>,
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
pub struct CameraTopics<'a> {
    /// Its topics begin with this.
    pub namespace: String,
    /// Its optical frame.
    pub frame_id: &'a str,
    /// Where it sits.
    pub vehicle_from_camera: &'a Pose,
    /// What is published of its lens.
    pub calibration: Calibration<'a>,
}

/// The images, encoded, of a shot and a camera (their indices), in the order of [`Sensors::images`].
pub type Take<'a> =
    dyn Fn(usize, usize, &mut Scratch) -> Result<Vec<Vec<u8>>, WorldError> + Sync + 'a;

/// What happens at one log time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Transforms,
    Odometry(usize),
    CameraInfo {
        shot: usize,
        camera: usize,
    },
    Image {
        shot: usize,
        camera: usize,
        image: usize,
    },
}

/// Channels of a log.
struct Channels {
    transforms: u16,
    odometry: u16,
    /// For each camera: calibration and images.
    cameras: Vec<(u16, Vec<u16>)>,
}

impl Channels {
    fn declare(log: &mut LogWriter, sensors: &Sensors<'_>) -> Result<Self, WorldError> {
        let transforms = log.topic::<StaticTransforms>("/tf_static", true)?;
        let odometry = log.topic::<Odometry>("/odom", false)?;
        let mut cameras = Vec::with_capacity(sensors.cameras.len());
        for camera in &sensors.cameras {
            let topic = |leaf: &str| format!("{}/{leaf}", camera.namespace);
            let info = log.topic::<CameraInfo>(&topic("camera_info"), false)?;
            let images: Result<Vec<u16>, WorldError> = sensors
                .images
                .iter()
                .map(|(leaf, _)| log.topic::<CompressedImage>(&topic(leaf), false))
                .collect();
            cameras.push((info, images?));
        }
        Ok(Self {
            transforms,
            odometry,
            cameras,
        })
    }
}

/// K, row by row, of focal lengths and a principal point, pixels.
pub fn camera_matrix([fx, fy]: [f64; 2], [cx, cy]: [f64; 2]) -> [f64; 9] {
    [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
}

/// When a shot wanted `seconds` after the start is taken, ns since the epoch: shutters are not exact.
pub fn shutter(start_ns: u64, seconds: f64, rng: &mut ChaCha8Rng) -> u64 {
    let late = 3e-4 * normal(rng).clamp(-3.0, 3.0);
    start_ns + nanoseconds(seconds + late)
}

impl Session {
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

    /// Renders the session and writes its log into `folder`; `tell` learns how many images are written.
    pub fn record(
        &self,
        folder: &Path,
        sensors: &Sensors<'_>,
        take: &Take<'_>,
        tell: &mut dyn FnMut(usize),
    ) -> Result<SessionSummary, WorldError> {
        let path = folder.join(format!("{}.mcap", self.name));
        let samples = self.odometry();
        let mut log = LogWriter::create(&path)?;
        let channels = Channels::declare(&mut log, sensors)?;
        if !sensors.label_classes.is_empty() {
            log.metadata("label_classes", sensors.label_classes.clone())?;
        }
        let mut darkroom = Darkroom {
            session: self,
            cameras: sensors.cameras.len(),
            take,
            rendered: 0,
            images: BTreeMap::new(),
        };
        let mut written = 0;
        for (log_ns, event) in self.schedule(sensors, &samples) {
            let at = |stamp_ns| Times { log_ns, stamp_ns };
            match event {
                Event::Transforms => {
                    let message = sensors.transforms(self.start_ns);
                    log.send(channels.transforms, at(self.start_ns), &message)?;
                }
                Event::Odometry(index) => {
                    let sample = &samples[index];
                    log.send(channels.odometry, at(sample.stamp_ns), &sample.message())?;
                }
                Event::CameraInfo { shot, camera } => {
                    let stamp_ns = self.stamps[shot];
                    let message = sensors.cameras[camera].info(stamp_ns);
                    log.send(channels.cameras[camera].0, at(stamp_ns), &message)?;
                }
                Event::Image {
                    shot,
                    camera,
                    image,
                } => {
                    let stamp_ns = self.stamps[shot];
                    let message = CompressedImage {
                        header: sensors.cameras[camera].header(stamp_ns),
                        format: sensors.images[image].1,
                        data: &darkroom.image(shot, camera, image)?,
                    };
                    log.send(channels.cameras[camera].1[image], at(stamp_ns), &message)?;
                    written += 1;
                    if usize::is_multiple_of(written, sensors.images.len()) {
                        tell(written / sensors.images.len());
                    }
                }
            }
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

    /// All events of the session in the order of their log times.
    fn schedule(&self, sensors: &Sensors<'_>, samples: &[OdometrySample]) -> Vec<(u64, Event)> {
        let mut rng = stream(self.seed, "recorder", self.index as u64);
        let mut schedule = vec![(self.start_ns, Event::Transforms)];
        for (index, sample) in samples.iter().enumerate() {
            schedule.push((sample.log_ns, Event::Odometry(index)));
        }
        for (shot, stamp) in self.stamps.iter().enumerate() {
            for camera in 0..sensors.cameras.len() {
                let first = stamp + rng.random_range(sensors.delay_ns.clone());
                schedule.push((first - 200_000, Event::CameraInfo { shot, camera }));
                for image in 0..sensors.images.len() {
                    let later = match &sensors.spread_ns {
                        spread if spread.is_empty() => 0,
                        spread => rng.random_range(spread.clone()),
                    };
                    let event = Event::Image {
                        shot,
                        camera,
                        image,
                    };
                    schedule.push((first + later, event));
                }
            }
        }
        schedule.sort_unstable();
        schedule
    }
}

impl Sensors<'_> {
    /// Where the cameras sit.
    fn transforms(&self, stamp_ns: u64) -> StaticTransforms<'_> {
        let placed = |camera: &CameraTopics<'_>| camera.vehicle_from_camera.to_array();
        StaticTransforms {
            stamp_ns,
            cameras: self
                .cameras
                .iter()
                .map(|camera| (camera.frame_id, placed(camera)))
                .collect(),
        }
    }
}

impl CameraTopics<'_> {
    fn header(&self, stamp_ns: u64) -> Header<'_> {
        Header {
            stamp_ns,
            frame_id: self.frame_id,
        }
    }

    fn info(&self, stamp_ns: u64) -> CameraInfo<'_> {
        CameraInfo {
            header: self.header(stamp_ns),
            calibration: self.calibration,
        }
    }
}

/// Images rendered ahead of the log, a batch at a time, on all cores.
struct Darkroom<'a> {
    session: &'a Session,
    cameras: usize,
    take: &'a Take<'a>,
    /// Shots rendered so far.
    rendered: usize,
    /// By shot, camera and image.
    images: BTreeMap<(usize, usize, usize), Vec<u8>>,
}

impl Darkroom<'_> {
    /// One image, which nobody asks for again.
    fn image(&mut self, shot: usize, camera: usize, image: usize) -> Result<Vec<u8>, WorldError> {
        if shot >= self.rendered {
            self.render((shot + BATCH).min(self.session.stamps.len()))?;
        }
        Ok(self
            .images
            .remove(&(shot, camera, image))
            .unwrap_or_default())
    }

    /// Renders the shots before `to`.
    fn render(&mut self, to: usize) -> Result<(), WorldError> {
        let (cameras, take) = (self.cameras, self.take);
        let wanted = self.rendered * cameras..to * cameras;
        let batch: Result<Vec<Vec<Vec<u8>>>, WorldError> = wanted
            .clone()
            .into_par_iter()
            .map_init(Scratch::default, |scratch, index| {
                take(index / cameras, index % cameras, scratch)
            })
            .collect();
        for (index, taken) in wanted.zip(batch?) {
            for (image, encoded) in taken.into_iter().enumerate() {
                let key = (index / cameras, index % cameras, image);
                self.images.insert(key, encoded);
            }
        }
        self.rendered = to;
        Ok(())
    }
}
