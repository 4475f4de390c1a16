//! Drives through the car park, one session after the other, and writes what the sensors report.

use crate::WorldError;
use crate::cars::{ParkedCar, parked_cars};
use crate::cast::Scratch;
use crate::drive::Drive;
use crate::floor::paint_floor;
use crate::layout::Layout;
use crate::lens::Lens;
use crate::look::Look;
use crate::messages::{
    CAMERA_INFO, COMPRESSED_IMAGE, GREY_JPEG, ODOMETRY, TF_MESSAGE, camera_info, compressed_image,
    odometry, static_transforms,
};
use crate::odometry::{OdometrySample, WheelErrors, Wheels, nanoseconds, normal};
use crate::params::CarPark;
use crate::random::{scramble, stream};
use crate::recording::{Ready, Recording};
use crate::render::render;
use crate::rig::{RigCamera, rig};
use crate::route::Route;
use crate::scene::Scene;
use crate::truth::Truth;
use crate::walkers::{Walker, walkers};
use jpeg_encoder::{ColorType, Encoder};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Shots rendered before any of them is written; bounds memory to some 30 MB of JPEG.
const BATCH: usize = 24;
const DAY_NS: u64 = 86_400_000_000_000;

/// How far the simulation has come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Progress {
    /// The session being driven.
    pub session: String,
    /// Images of that session written.
    pub images: usize,
    /// Images that session will have.
    pub images_total: usize,
    /// Images of all sessions written.
    pub all_images: usize,
    /// Images all sessions will have.
    pub all_images_total: usize,
}

/// One session as written.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionSummary {
    /// Its name.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// Images per camera.
    pub shots: usize,
    /// Messages on all topics.
    pub messages: u64,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Distance driven, metres.
    pub driven_m: f64,
    /// Length, seconds.
    pub duration_s: f64,
}

/// What a simulation wrote.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// The sessions, in order.
    pub sessions: Vec<SessionSummary>,
    /// The folder with the truth.
    pub truth: PathBuf,
}

/// One session before its images are rendered.
pub(crate) struct Plan {
    pub(crate) index: usize,
    pub(crate) name: String,
    pub(crate) start_ns: u64,
    pub(crate) route: Route,
    pub(crate) drive: Drive,
    pub(crate) stamps: Vec<u64>,
    pub(crate) parked: Vec<ParkedCar>,
    pub(crate) people: Vec<Walker>,
    pub(crate) wheels: Wheels,
}

impl Plan {
    pub(crate) fn new(world: &CarPark, layout: &Layout, index: usize, name: &str) -> Self {
        let route = Route::of_session(world, index);
        let path = route.path_from(layout, world.start_m, world.loops);
        let drive = Drive::new(path, world.speed_mps, layout.ground);
        let mut jitter = stream(world.seed, "shutter", index as u64);
        let count = (drive.duration_s() * world.rate_hz).floor() as usize;
        let start_ns = world.start_ns + index as u64 * DAY_NS;
        let stamps = (0..=count)
            .map(|k| {
                let late = 3e-4 * normal(&mut jitter).clamp(-3.0, 3.0);
                start_ns + nanoseconds(0.02 / world.rate_hz + k as f64 / world.rate_hz + late)
            })
            .collect();
        Self {
            index,
            name: name.to_owned(),
            start_ns,
            route,
            stamps,
            parked: parked_cars(world, layout, index),
            people: walkers(world, layout, index, &drive),
            drive,
            wheels: Wheels {
                seed: world.seed,
                session: index as u64,
                rate_hz: world.odometry_rate_hz,
                errors: WheelErrors::of_session(
                    world.seed,
                    index as u64,
                    world.odometry_scale_error,
                ),
            },
        }
    }

    /// Seconds since the session's start.
    pub(crate) fn seconds(&self, stamp_ns: u64) -> f64 {
        stamp_ns.saturating_sub(self.start_ns) as f64 * 1e-9
    }
}

/// Simulates a car park and writes into `out`: `initial.mcap`, `revisit_1.mcap`, … and the folder
/// `truth`. Each file appears under its name only when it is complete.
///
/// # Errors
/// [`WorldError::Parameters`] before anything is written; otherwise when a file cannot be.
pub fn car_park(
    world: &CarPark,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
) -> Result<Summary, WorldError> {
    world.check()?;
    std::fs::create_dir_all(out).map_err(|error| WorldError::io(out, error))?;
    let layout = Layout::new(world);
    let rig = rig(world);
    let plans: Vec<Plan> = world
        .session_names()
        .iter()
        .enumerate()
        .map(|(index, name)| Plan::new(world, &layout, index, name))
        .collect();
    // Tyres have left their marks on the whole round trip, however little of it is driven today.
    let worn = Route::of_session(world, 0).path(&layout, 2.0);
    let floor = paint_floor(world, &layout, &[&worn]);
    let truth = Truth {
        world,
        layout: &layout,
        rig: &rig,
        floor: &floor,
        plans: &plans,
    };
    let truth = truth.write(out)?;
    let lenses: Vec<Lens> = rig.par_iter().map(RigCamera::lens).collect();
    let plans = plans.get(world.skip..).unwrap_or_default();
    let total = plans.iter().map(|plan| plan.stamps.len() * rig.len()).sum();
    let mut sessions = Vec::with_capacity(plans.len());
    let mut before = 0;
    for plan in plans {
        let studio = Studio {
            world,
            rig: &rig,
            lenses: &lenses,
            plan,
            scene: Scene::build(
                world,
                &layout,
                plan.index,
                &floor,
                &plan.parked,
                &plan.people,
            ),
            look: Look::of_session(world, plan.index),
        };
        let written = studio.write(out, &mut |images| {
            progress(Progress {
                session: plan.name.clone(),
                images,
                images_total: plan.stamps.len() * rig.len(),
                all_images: before + images,
                all_images_total: total,
            });
        })?;
        before += plan.stamps.len() * rig.len();
        sessions.push(written);
    }
    Ok(Summary { sessions, truth })
}

/// All that is needed to render one session.
pub(crate) struct Studio<'a> {
    pub(crate) world: &'a CarPark,
    pub(crate) rig: &'a [RigCamera],
    pub(crate) lenses: &'a [Lens],
    pub(crate) plan: &'a Plan,
    pub(crate) scene: Scene,
    pub(crate) look: Look,
}

/// Channels of a session.
struct Channels {
    transforms: u16,
    odometry: u16,
    /// For each camera: its image and its calibration topic.
    cameras: Vec<(u16, u16)>,
}

impl Channels {
    fn declare(recording: &mut Recording, rig: &[RigCamera]) -> Result<Self, WorldError> {
        let transforms = recording.latched_topic("/tf_static", TF_MESSAGE)?;
        let odometry = recording.topic("/odom", ODOMETRY)?;
        let mut cameras = Vec::with_capacity(rig.len());
        for camera in rig {
            let topic = |leaf: &str| format!("/camera/{}/{leaf}", camera.name);
            cameras.push((
                recording.topic(&topic("image/compressed"), COMPRESSED_IMAGE)?,
                recording.topic(&topic("camera_info"), CAMERA_INFO)?,
            ));
        }
        Ok(Self {
            transforms,
            odometry,
            cameras,
        })
    }
}

/// What happens at one log time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Transforms,
    Odometry(usize),
    CameraInfo { shot: usize, camera: usize },
    Image { shot: usize, camera: usize },
}

impl Studio<'_> {
    /// The grey image of one camera at one shot, row by row.
    pub(crate) fn image(&self, shot: usize, camera: usize, scratch: &mut Scratch) -> Vec<u8> {
        let t = self.plan.seconds(self.plan.stamps[shot]);
        let moving = self.scene.walkers_at(&self.plan.people, t);
        let pose = self.plan.drive.map_from_vehicle(t);
        let noise = self.noise_seed(shot, camera);
        let lens = &self.lenses[camera];
        render(
            &self.scene,
            &moving,
            lens,
            &pose,
            &self.look,
            noise,
            scratch,
        )
    }

    /// What a camera without light sees: the noise of its sensor.
    fn darkness(&self, shot: usize, camera: usize) -> Vec<u8> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.noise_seed(shot, camera));
        let pixels = self.world.width_px as usize * self.world.height_px as usize;
        let deviation = f64::from(self.look.noise_at(0.0));
        let black = f64::from(self.look.black);
        (0..pixels)
            .map(|_| (black + deviation * normal(&mut rng)).clamp(0.0, 255.0) as u8)
            .collect()
    }

    fn noise_seed(&self, shot: usize, camera: usize) -> u64 {
        let place = (self.plan.index as u64) << 40 | (shot as u64) << 8 | camera as u64;
        scramble(scramble(self.world.seed) ^ place)
    }

    fn jpeg(
        &self,
        shot: usize,
        camera: usize,
        scratch: &mut Scratch,
    ) -> Result<Vec<u8>, WorldError> {
        let grey = if self.world.dark_camera.as_deref() == Some(self.rig[camera].name) {
            self.darkness(shot, camera)
        } else {
            self.image(shot, camera, scratch)
        };
        let mut jpeg = Vec::with_capacity(grey.len() / 4);
        let (width, height) = (self.world.width_px as u16, self.world.height_px as u16);
        Encoder::new(&mut jpeg, self.world.jpeg_quality).encode(
            &grey,
            width,
            height,
            ColorType::Luma,
        )?;
        Ok(jpeg)
    }

    /// All events of the session in the order of their log times.
    fn schedule(&self, samples: &[OdometrySample]) -> Vec<(u64, Event)> {
        let mut rng = stream(self.world.seed, "recorder", self.plan.index as u64);
        let mut schedule = vec![(self.plan.start_ns, Event::Transforms)];
        for (index, sample) in samples.iter().enumerate() {
            schedule.push((sample.log_ns, Event::Odometry(index)));
        }
        for (shot, stamp) in self.plan.stamps.iter().enumerate() {
            for camera in 0..self.rig.len() {
                let log = stamp + rng.random_range(4_000_000..9_000_000);
                schedule.push((log - 200_000, Event::CameraInfo { shot, camera }));
                schedule.push((log, Event::Image { shot, camera }));
            }
        }
        schedule.sort_unstable();
        schedule
    }

    fn write(
        &self,
        out: &Path,
        progress: &mut dyn FnMut(usize),
    ) -> Result<SessionSummary, WorldError> {
        let path = out.join(format!("{}.mcap", self.plan.name));
        let samples = self
            .plan
            .wheels
            .odometry(&self.plan.drive, self.plan.start_ns);
        let mut recording = Recording::create(&path)?;
        let channels = Channels::declare(&mut recording, self.rig)?;
        let mut jpegs: BTreeMap<(usize, usize), Vec<u8>> = BTreeMap::new();
        let (mut rendered, mut images) = (0, 0);
        for (log_ns, event) in self.schedule(&samples) {
            let (channel, stamp_ns, payload) = match event {
                Event::Transforms => {
                    let placed: Vec<_> = self.rig.iter().map(RigCamera::placed).collect();
                    let payload = static_transforms(self.plan.start_ns, &placed);
                    (channels.transforms, self.plan.start_ns, payload)
                }
                Event::Odometry(index) => {
                    let sample = &samples[index];
                    (channels.odometry, sample.stamp_ns, odometry(sample))
                }
                Event::CameraInfo { shot, camera } => {
                    let stamp = self.plan.stamps[shot];
                    let payload = camera_info(stamp, &self.rig[camera].published());
                    (channels.cameras[camera].1, stamp, payload)
                }
                Event::Image { shot, camera } => {
                    if shot >= rendered {
                        rendered = self.develop(rendered, shot, &mut jpegs)?;
                    }
                    let jpeg = jpegs.remove(&(shot, camera)).unwrap_or_default();
                    let stamp = self.plan.stamps[shot];
                    images += 1;
                    let frame = &self.rig[camera].frame_id;
                    let payload = compressed_image(stamp, frame, GREY_JPEG, &jpeg);
                    (channels.cameras[camera].0, stamp, payload)
                }
            };
            recording.write(&Ready {
                log_ns,
                stamp_ns,
                channel,
                payload,
            })?;
            if matches!(event, Event::Image { .. }) {
                progress(images);
            }
        }
        let (messages, bytes) = recording.finish()?;
        Ok(SessionSummary {
            name: self.plan.name.clone(),
            path,
            shots: self.plan.stamps.len(),
            messages,
            bytes,
            driven_m: self.plan.drive.length_m(),
            duration_s: self.plan.drive.duration_s(),
        })
    }

    /// Renders the shots from `from` up to `needed` and a batch beyond; says where it stopped.
    fn develop(
        &self,
        from: usize,
        needed: usize,
        jpegs: &mut BTreeMap<(usize, usize), Vec<u8>>,
    ) -> Result<usize, WorldError> {
        let to = (needed + BATCH).min(self.plan.stamps.len());
        let cameras = self.rig.len();
        let batch: Result<Vec<Vec<u8>>, WorldError> = (from * cameras..to * cameras)
            .into_par_iter()
            .map_init(Scratch::default, |scratch, index| {
                self.jpeg(index / cameras, index % cameras, scratch)
            })
            .collect();
        for (offset, jpeg) in batch?.into_iter().enumerate() {
            let index = from * cameras + offset;
            jpegs.insert((index / cameras, index % cameras), jpeg);
        }
        Ok(to)
    }
}
