//! Records a world: its sessions as logs, and the truth beside them.
//!
//! A world describes itself: its sessions, its cameras, what they see, and what is true. How messages get their times,
//! in what order they are written, and how much is rendered at once is the same for all worlds.

mod folder;
mod picture;
mod session;

pub use folder::Folder;
pub use picture::{deep_png, grey_png, jpeg};
pub use session::{CameraTopics, Sensors, SimulatedSession, shutter};

use crate::WorldError;
use evermap_recording::LogWriter;
use std::path::{Path, PathBuf};

/// What logs of worlds name as their writer.
pub const LIBRARY: &str = "evermap-worlds";

/// How far the simulation has come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Progress {
    /// The session being driven.
    pub session: String,
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
    /// The log of what somebody says of the world, where one was asked for.
    pub annotations: Option<PathBuf>,
}

/// A world, built and ready to be driven through.
pub trait World {
    /// A session, and what the world knows about it besides.
    type Visit: AsRef<SimulatedSession>;

    /// The sessions to be written, in order.
    fn visits(&self) -> &[Self::Visit];

    /// What is on the vehicle.
    fn sensors(&self) -> Sensors;

    /// Writes what is true of all sessions into a folder in `out`, and gives its path.
    fn write_truth(&self, out: &Path) -> Result<PathBuf, WorldError>;

    /// Writes one session into `out`, for who waits for it.
    fn record(&self, visit: &Self::Visit, out: &Path, waits: &mut Waits<'_>) -> Recorded;
}

/// Whether nobody wants a simulation any more.
pub type Stopped<'a> = dyn Fn() -> bool + Sync + 'a;

/// Who waits for a session.
pub struct Waits<'a> {
    /// Learns how many images are written.
    pub tell: &'a mut dyn FnMut(usize),
    /// Is asked before each image.
    pub is_stopped: &'a Stopped<'a>,
}

/// A session as written, or why it was not.
pub type Recorded = Result<SessionSummary, WorldError>;

/// Writes a world's truth and sessions into `out`, as long as `is_stopped` does not say that nobody wants them.
pub fn simulate(
    world: &impl World,
    out: &Path,
    progress: &mut dyn FnMut(Progress),
    is_stopped: &Stopped<'_>,
) -> Result<Summary, WorldError> {
    for visit in world.visits() {
        LogWriter::may_replace(&visit.as_ref().log_in(out), LIBRARY)?;
    }
    // Building the world took its time, too.
    if is_stopped() {
        return Err(WorldError::Stopped);
    }
    std::fs::create_dir_all(out).map_err(|error| WorldError::io(out, error))?;
    let truth = world.write_truth(out)?;
    let cameras = world.sensors().cameras.len();
    let images = |session: &SimulatedSession| session.stamps.len() * cameras;
    let visits = world.visits();
    let all_images_total = visits.iter().map(|visit| images(visit.as_ref())).sum();
    let mut sessions = Vec::with_capacity(visits.len());
    let mut before = 0;
    for visit in visits {
        let session = visit.as_ref();
        let tell = &mut |written: usize| {
            progress(Progress {
                session: session.name.clone(),
                all_images: before + written,
                all_images_total,
            });
        };
        let written = world.record(visit, out, &mut Waits { tell, is_stopped })?;
        before += images(session);
        sessions.push(written);
    }
    Ok(Summary {
        sessions,
        truth,
        annotations: None,
    })
}
