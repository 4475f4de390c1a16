//! Writes a street: sessions with what the sensors report, and the truth beside them.

use crate::WorldError;
use crate::cast::Scratch;
use crate::folder::Folder;
use crate::messages::{
    CAMERA_INFO, COMPRESSED_IMAGE, Calibration, ODOMETRY, TF_MESSAGE, camera_info,
    compressed_image, odometry, static_transforms,
};
use crate::odometry::{OdometrySample, normal};
use crate::picture::{deep_png, grey_png};
use crate::random::stream;
use crate::recording::{Ready, Recording};
use crate::session::{Progress, SessionSummary, Summary};
use crate::street::classes::{Class, STREET_CLASSES};
use crate::street::labels::{classes, depth, each_pixel};
use crate::street::paint::{Light, colour};
use crate::street::params::Street;
use crate::street::sight::{PANORAMA_FRAME, Sight};
use crate::street::truth;
use crate::street::views::{StreetLabels, street_labels, values};
use crate::street::visit::Visit;
use jpeg_encoder::{ColorType, Encoder};
use rand::Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// Shots rendered before any of them is written.
const BATCH: usize = 24;

/// Simulates a street and writes into `out`: for each visit a folder with its session
/// (`visit_a/visit_a.mcap`) and the truth about it, and the folder `truth` with what is true of
/// all. Each folder appears under its name only when it is complete.
///
/// # Errors
/// [`WorldError::Parameters`] before anything is written; otherwise when a file cannot be.
pub fn street(
    world: &Street,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, WorldError> {
    let labels = street_labels(world)?;
    std::fs::create_dir_all(out).map_err(|error| WorldError::io(out, error))?;
    let truth = truth::write_world(world, &labels, out)?;
    let total = labels.visits.len() * labels.len();
    let mut sessions = Vec::with_capacity(labels.visits.len());
    for visit in &labels.visits {
        let studio = Studio {
            world,
            labels: &labels,
            visit,
            light: Light::new(world, visit.index),
            folder: Folder::create(out, &visit.name)?,
        };
        let done = visit.index * labels.len();
        let written = studio.write(&mut |images| {
            progress(Progress {
                session: visit.name.clone(),
                images,
                images_total: labels.len(),
                all_images: done + images,
                all_images_total: total,
            });
        })?;
        sessions.push(written);
    }
    Ok(Summary { sessions, truth })
}

/// The images of a shot, in the order of their topics.
const LEAVES: [&str; 4] = ["labels", "labels_noisy", "image/compressed", "depth"];
const FORMATS: [&str; 4] = ["png", "png", "jpeg", "png"];

/// One shot, encoded.
struct Shot {
    /// As [`LEAVES`] names them; colour and depth only if they are wanted.
    images: Vec<Vec<u8>>,
    without_cars: Vec<u8>,
}

/// What happens at one log time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Transforms,
    Odometry(usize),
    CameraInfo(usize),
    Image { shot: usize, leaf: usize },
}

struct Studio<'a> {
    world: &'a Street,
    labels: &'a StreetLabels,
    visit: &'a Visit,
    light: Light,
    folder: Folder,
}

impl Studio<'_> {
    fn size(&self) -> [u32; 2] {
        [self.world.width_px, self.world.height_px]
    }

    fn leaves(&self) -> usize {
        if self.world.colour { 4 } else { 2 }
    }

    fn shot(&self, shot: usize, scratch: &mut Scratch) -> Result<Shot, WorldError> {
        let (labels, index) = (self.labels, self.visit.index);
        let sight = labels.sight(index, shot, true, scratch);
        let lens = &labels.camera.lens;
        let exact = classes(&labels.scenery, lens, &sight, false);
        let bare = classes(&labels.scenery, lens, &sight, true);
        let noisy = labels.noisy(&sight, &exact, index, shot);
        let size = self.size();
        let mut images = vec![
            grey_png(size, &values(&exact))?,
            grey_png(size, &values(&noisy))?,
        ];
        if self.world.colour {
            images.push(self.jpeg(&sight, &exact, shot)?);
            let mut rng = stream(self.world.seed ^ index as u64, "depth", shot as u64);
            let range = depth(&sight, || normal(&mut rng) as f32);
            images.push(deep_png(size, &range)?);
        }
        Ok(Shot {
            images,
            without_cars: grey_png(size, &values(&bare))?,
        })
    }

    fn jpeg(&self, sight: &Sight, exact: &[Class], shot: usize) -> Result<Vec<u8>, WorldError> {
        let mut rgb = exposed(self.labels, &self.light, sight, exact);
        let mut rng = stream(
            self.world.seed ^ self.visit.index as u64,
            "sensor",
            shot as u64,
        );
        for value in &mut rgb {
            let noise = f64::from(self.light.noise) * normal(&mut rng);
            *value = (f64::from(*value) + noise).clamp(0.0, 255.0) as u8;
        }
        let mut jpeg = Vec::new();
        let [width, height] = self.size();
        Encoder::new(&mut jpeg, self.world.jpeg_quality).encode(
            &rgb,
            width as u16,
            height as u16,
            ColorType::Rgb,
        )?;
        Ok(jpeg)
    }

    /// All events of the session in the order of their log times.
    fn schedule(&self, samples: &[OdometrySample]) -> Vec<(u64, Event)> {
        let mut rng = stream(self.world.seed, "recorder", self.visit.index as u64);
        let mut schedule = vec![(self.visit.start_ns, Event::Transforms)];
        for (index, sample) in samples.iter().enumerate() {
            schedule.push((sample.log_ns, Event::Odometry(index)));
        }
        for (shot, stamp) in self.visit.stamps.iter().enumerate() {
            let first = stamp + rng.random_range(8_000_000..12_000_000);
            schedule.push((first - 200_000, Event::CameraInfo(shot)));
            for leaf in 0..self.leaves() {
                let log = first + rng.random_range(0..6_000_000);
                schedule.push((log, Event::Image { shot, leaf }));
            }
        }
        schedule.sort_unstable();
        schedule
    }

    fn write(self, progress: &mut dyn FnMut(usize)) -> Result<SessionSummary, WorldError> {
        let visit = self.visit;
        let samples = visit.wheels.odometry(&visit.drive, visit.start_ns);
        truth::write_visit(
            self.world,
            &self.labels.scenery,
            visit,
            &samples,
            &self.folder,
        )?;
        let file = format!("{}.mcap", visit.name);
        let mut recording = Recording::create(&self.folder.path().join(&file))?;
        let channels = Channels::declare(&mut recording, self.leaves())?;
        recording.metadata("label_classes", label_classes())?;
        let mut shots: BTreeMap<usize, Shot> = BTreeMap::new();
        let (mut rendered, mut written) = (0, 0);
        for (log_ns, event) in self.schedule(&samples) {
            if let Event::Image { shot, .. } = event
                && shot >= rendered
            {
                rendered = self.develop(rendered, shot, &mut shots)?;
            }
            recording.write(&self.ready(log_ns, event, &samples, &channels, &shots))?;
            if let Event::Image { shot, .. } = event {
                written += 1;
                // The last image of this shot may still come: those a little older are done.
                shots = shots.split_off(&shot.saturating_sub(2));
                if written % self.leaves() == 0 {
                    progress(written / self.leaves());
                }
            }
        }
        let (messages, bytes) = recording.finish()?;
        Ok(SessionSummary {
            name: visit.name.clone(),
            path: self.folder.finish()?.join(file),
            shots: visit.stamps.len(),
            messages,
            bytes,
            driven_m: visit.drive.length_m(),
            duration_s: visit.drive.duration_s(),
        })
    }

    fn ready(
        &self,
        log_ns: u64,
        event: Event,
        samples: &[OdometrySample],
        channels: &Channels,
        shots: &BTreeMap<usize, Shot>,
    ) -> Ready {
        let camera = &self.labels.camera;
        let (channel, stamp_ns, payload) = match event {
            Event::Transforms => {
                let stamp = self.visit.start_ns;
                let placed = [(PANORAMA_FRAME, &camera.lens.vehicle_from_camera)];
                (
                    channels.transforms,
                    stamp,
                    static_transforms(stamp, &placed),
                )
            }
            Event::Odometry(index) => {
                let sample = &samples[index];
                (channels.odometry, sample.stamp_ns, odometry(sample))
            }
            Event::CameraInfo(shot) => {
                let stamp = self.visit.stamps[shot];
                let info = Calibration {
                    frame_id: PANORAMA_FRAME,
                    size: self.size(),
                    model: "equirectangular",
                    focal: [camera.focal; 2],
                    centre: camera.centre,
                    distortion: &[],
                };
                (channels.info, stamp, camera_info(stamp, &info))
            }
            Event::Image { shot, leaf } => {
                let stamp = self.visit.stamps[shot];
                let image = shots.get(&shot).and_then(|shot| shot.images.get(leaf));
                let image = image.map_or(&[][..], Vec::as_slice);
                let payload = compressed_image(stamp, PANORAMA_FRAME, FORMATS[leaf], image);
                (channels.images[leaf], stamp, payload)
            }
        };
        Ready {
            log_ns,
            stamp_ns,
            channel,
            payload,
        }
    }

    /// Renders the shots from `from` up to `needed` and a batch beyond; says where it stopped.
    fn develop(
        &self,
        from: usize,
        needed: usize,
        shots: &mut BTreeMap<usize, Shot>,
    ) -> Result<usize, WorldError> {
        let to = (needed + BATCH).min(self.visit.stamps.len());
        let batch: Result<Vec<Shot>, WorldError> = (from..to)
            .into_par_iter()
            .map_init(Scratch::default, |scratch, shot| self.shot(shot, scratch))
            .collect();
        for (shot, made) in (from..to).zip(batch?) {
            let name = format!("static_labels/{shot:06}.png");
            self.folder.save(&name, &made.without_cars)?;
            shots.insert(shot, made);
        }
        Ok(to)
    }
}

/// The colours of a panorama, row by row, before the sensor's noise.
pub fn exposed(labels: &StreetLabels, light: &Light, sight: &Sight, exact: &[Class]) -> Vec<u8> {
    let mut rgb = vec![0; 3 * exact.len()];
    each_pixel(&labels.camera.lens, |pixel, own| {
        let met = (sight.range_m[pixel], sight.face[pixel], sight.turned(own));
        let lit = colour(&labels.scenery, light, sight, exact[pixel], met);
        for (channel, value) in lit.into_iter().enumerate() {
            rgb[3 * pixel + channel] = value.clamp(0.0, 255.0) as u8;
        }
    });
    rgb
}

/// Channels of a session.
struct Channels {
    transforms: u16,
    odometry: u16,
    info: u16,
    images: Vec<u16>,
}

impl Channels {
    fn declare(recording: &mut Recording, leaves: usize) -> Result<Self, WorldError> {
        let topics = LEAVES.iter().take(leaves);
        Ok(Self {
            transforms: recording.latched_topic("/tf_static", TF_MESSAGE)?,
            odometry: recording.topic("/odom", ODOMETRY)?,
            info: recording.topic("/panorama/camera_info", CAMERA_INFO)?,
            images: topics
                .map(|leaf| recording.topic(&format!("/panorama/{leaf}"), COMPRESSED_IMAGE))
                .collect::<Result<_, _>>()?,
        })
    }
}

/// What the values of label images mean.
fn label_classes() -> BTreeMap<String, String> {
    let names = STREET_CLASSES.iter().enumerate();
    names
        .map(|(value, name)| (value.to_string(), (*name).to_owned()))
        .collect()
}
