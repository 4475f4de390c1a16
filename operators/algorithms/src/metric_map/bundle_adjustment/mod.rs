//! Bundle adjustment: poses and landmarks from all observations at once.
//!
//! ```text
//!  SessionState ── odometry scale, yaw per metre Rig ── cameras, fixed on the vehicle
//!     │                                           │
//!  Keyframe ──Odometry── Keyframe        Observation ── pixel of a Landmark
//!     └────────────────────── Problem ────────────┘ ──solve──► Report
//! ```
//!
//! Minimised is `½ Σ ρ(‖r‖²)` over
//! - reprojection: the observed pixel against the landmark, seen through the session's rig, in
//!   units of the pixel's standard deviation;
//! - odometry: the motion between two keyframes against what the wheels said, corrected by the
//!   session's unknown scale and yaw drift, in units of its standard deviations per axis (so z,
//!   roll and pitch can be held weakly, and an inclined floor shows).
//!
//! The metric scale thus comes from the rig, whose cameras stand a known distance apart, as much
//! as from odometry. Without a fixed pose the whole may drift; fix one.
//!
//! A problem of many poses can be adjusted by regions ([`Options::region_poses`]). In one piece,
//! the landmarks are eliminated first ([`schur`]). What is left, the reduced system of poses and sessions, is formed and
//! factorised where drives hardly overlap or see nothing (`reduced`), and solved by preconditioned conjugate gradients
//! without being formed where they overlap (`iterative`): cost per iteration is then linear in the observations, however many
//! drives go through a place. The loop is [`crate::solving::least_squares::minimise`]. Results are the same to the bit on
//! any number of threads.

mod blocks;
mod clusters;
mod coarse;
mod decomposition;
mod elimination;
mod equations;
mod factor;
mod iterative;
mod odometry;
mod reduced;
mod regions;
pub mod schur;
mod system;
mod vehicle;

#[cfg(test)]
pub(crate) mod tests;

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use crate::geometry::pose::Pose;
use crate::geometry::rig::Rig;
use crate::solving::least_squares::{self, Loss, Summary, SystemError};

pub use regions::Cut;
pub use schur::LinearSolver;
pub(crate) use vehicle::SEEN_M;

/// What is to be known of a drive beside its poses: its odometry, and by which rig it was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SessionState {
    /// Index of its rig.
    pub rig: usize,
    /// Driven metres per metre of odometry; unknown, kept near 1 by [`Options`].
    pub odometry_scale: f64,
    /// What odometry's yaw misses per metre driven (rad/m, counter-clockwise); unknown, kept near
    /// 0 by [`Options`].
    pub odometry_yaw_rad_per_m: f64,
}

impl SessionState {
    /// With odometry taken as it is.
    pub fn new(rig: usize) -> Self {
        Self {
            rig,
            odometry_scale: 1.0,
            odometry_yaw_rad_per_m: 0.0,
        }
    }
}

/// A pose to be found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keyframe {
    /// Index of its session.
    pub session: usize,
    /// Where the vehicle is.
    pub map_from_vehicle: Pose,
    /// Does it stay where it is?
    pub fixed: bool,
}

/// A landmark in an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index of the keyframe.
    pub pose: usize,
    /// Index of the camera in the rig of the keyframe's session.
    pub camera: usize,
    /// Index of the landmark.
    pub landmark: usize,
    /// Where it was seen, pixels.
    pub pixel: [f64; 2],
    /// Standard deviation of either coordinate, pixels.
    pub sigma_px: f64,
}

/// What the wheels said between two keyframes of one session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Odometry {
    /// Index of the earlier keyframe; its session's scale and yaw drift are used.
    pub from: usize,
    /// Index of the later keyframe.
    pub to: usize,
    /// The later vehicle frame in the earlier one, as odometry has it.
    pub from_from_to: Pose,
    /// Driven path between them, metres of odometry.
    pub length_m: f64,
    /// Standard deviations along and about the axes of the earlier vehicle frame: x, y, z (m),
    /// roll, pitch, yaw (rad).
    pub sigma: [f64; 6],
}

/// Everything that is known, and the present estimate of what is not.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Problem {
    /// The rigs that sessions name.
    pub rigs: Vec<Rig>,
    /// The sessions that keyframes name. Adjusted.
    pub sessions: Vec<SessionState>,
    /// The poses. Adjusted unless fixed.
    pub poses: Vec<Keyframe>,
    /// Positions of the landmarks in the map, metres. Adjusted.
    pub landmarks: Vec<Vector3<f64>>,
    /// Landmarks in images.
    pub observations: Vec<Observation>,
    /// Motions between keyframes.
    pub odometry: Vec<Odometry>,
}

/// How to weigh, and when to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Loss of an observation.
    pub observation_loss: Loss,
    /// Loss of an odometry step.
    pub odometry_loss: Loss,
    /// Standard deviation of a session's odometry scale about 1.
    pub scale_sigma: f64,
    /// Standard deviation of a session's yaw drift about 0, rad/m.
    pub yaw_sigma_rad_per_m: f64,
    /// How steps are found, in one piece.
    pub linear_solver: LinearSolver,
    /// Poses of a region at most, where there are more of them: the problem is then adjusted by regions, to the same
    /// answer in the memory of a few of them and of what they share. In one piece where `None`.
    pub region_poses: Option<usize>,
    /// Iterations and tolerances.
    pub least_squares: least_squares::Options,
}

impl Default for Options {
    /// Observations beyond two standard deviations grow linearly (95 % of the efficiency of
    /// least squares is at 1.345, but corners have heavier tails than the centre is narrow);
    /// odometry counts fully. A wheel's radius is known to some per cent with its tyre's wear; a
    /// difference of 0.5 % between wheels 1.5 m apart turns by 0.0033 rad/m.
    fn default() -> Self {
        Self {
            observation_loss: Loss::Huber(2.0),
            odometry_loss: Loss::Quadratic,
            scale_sigma: 0.03,
            yaw_sigma_rad_per_m: 0.003,
            linear_solver: LinearSolver::Cheaper,
            region_poses: None,
            least_squares: least_squares::Options {
                max_iterations: 50,
                ..least_squares::Options::default()
            },
        }
    }
}

/// An observation after adjustment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Projected minus observed, pixels; `None` where the camera cannot see the landmark.
    pub error_px: Option<Vector2<f64>>,
    /// How much it counted: 1 fully, near 0 an outlier, 0 unseen.
    pub weight: f64,
}

/// What adjustment did.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Costs, iterations, reason of the end.
    pub summary: Summary,
    /// One for each observation.
    pub observations: Vec<Residual>,
    /// How it was cut, where it was adjusted by regions.
    pub cut: Option<Cut>,
}

/// Why a problem cannot be solved.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ProblemError {
    /// An index points at nothing.
    #[error("{what} {index}: expected the index of a {of} below {count}, found {found}")]
    Index {
        /// What names it.
        what: &'static str,
        /// Which of them.
        index: usize,
        /// What is named.
        of: &'static str,
        /// How many there are.
        count: usize,
        /// The index found.
        found: usize,
    },
    /// A number is NaN, infinite, or a standard deviation that is not positive.
    #[error("{what} {index}: expected finite numbers and standard deviations above 0")]
    Value {
        /// What has it.
        what: &'static str,
        /// Which of them.
        index: usize,
    },
    /// The system does not fit.
    #[error(transparent)]
    System(#[from] SystemError),
}

/// Adjusts poses, landmarks and sessions in place.
///
/// # Errors
/// [`ProblemError`]; the problem is then as it was.
pub fn solve(problem: &mut Problem, options: &Options) -> Result<Report, ProblemError> {
    check(problem)?;
    let regions = options.region_poses;
    let (summary, cut) = match regions.filter(|poses| problem.poses.len() > *poses) {
        Some(poses) => {
            let (summary, cut) = regions::solve(problem, options, poses)?;
            (summary, Some(cut))
        }
        None => (in_one_piece(problem, options)?, None),
    };
    Ok(Report {
        summary,
        observations: residuals(problem, options.observation_loss),
        cut,
    })
}

fn in_one_piece(problem: &mut Problem, options: &Options) -> Result<Summary, SystemError> {
    let mut schur = decomposition::schur(problem, options)?;
    let summary = least_squares::minimise(&mut schur, &options.least_squares);
    let (vehicles, landmarks) = schur.into_estimate();
    let (poses, sessions) = vehicles.into_estimate();
    problem.poses = poses;
    problem.sessions = sessions;
    problem.landmarks = landmarks.into_iter().map(Vector3::from).collect();
    Ok(summary)
}

/// Residuals and weights of all observations as the problem stands.
pub fn residuals(problem: &Problem, loss: Loss) -> Vec<Residual> {
    let observations = problem.observations.par_iter();
    observations
        .map(|observation| {
            residual(problem, observation, loss).unwrap_or(Residual {
                error_px: None,
                weight: 0.0,
            })
        })
        .collect()
}

fn residual(problem: &Problem, observation: &Observation, loss: Loss) -> Option<Residual> {
    let keyframe = problem.poses.get(observation.pose)?;
    let rig = problem
        .rigs
        .get(problem.sessions.get(keyframe.session)?.rig)?;
    let camera = rig.cameras.get(observation.camera)?;
    let landmark = problem.landmarks.get(observation.landmark)?;
    let vehicle = keyframe.map_from_vehicle.inverse().transform(landmark);
    let point = camera.vehicle_from_camera.inverse().transform(&vehicle);
    let error = Vector2::from(camera.camera.project(&point)?) - Vector2::from(observation.pixel);
    let squared = error.norm_squared() / observation.sigma_px.powi(2);
    Some(Residual {
        error_px: Some(error),
        weight: loss.weight(squared),
    })
}

/// Are all indices in range and all numbers finite?
fn check(problem: &Problem) -> Result<(), ProblemError> {
    let Problem {
        rigs,
        sessions,
        poses,
        landmarks,
        observations,
        odometry,
    } = problem;
    for (index, session) in sessions.iter().enumerate() {
        within("session", index, "rig", rigs.len(), session.rig)?;
        let numbers = [session.odometry_scale, session.odometry_yaw_rad_per_m];
        finite("session", index, &numbers, &[])?;
    }
    for (index, pose) in poses.iter().enumerate() {
        within("pose", index, "session", sessions.len(), pose.session)?;
        finite("pose", index, &pose.map_from_vehicle.to_array(), &[])?;
    }
    for (index, landmark) in landmarks.iter().enumerate() {
        finite("landmark", index, landmark.as_slice(), &[])?;
    }
    let is_wrong = |(index, seen): (usize, &Observation)| {
        let check = || {
            let within = |of, count, found| within("observation", index, of, count, found);
            within("pose", poses.len(), seen.pose)?;
            let rig = &rigs[sessions[poses[seen.pose].session].rig];
            within("camera", rig.cameras.len(), seen.camera)?;
            within("landmark", landmarks.len(), seen.landmark)?;
            finite("observation", index, &seen.pixel, &[seen.sigma_px])
        };
        check().err()
    };
    let observations = observations.par_iter().enumerate();
    if let Some(error) = observations.find_map_first(is_wrong) {
        return Err(error);
    }
    for (index, step) in odometry.iter().enumerate() {
        within("odometry", index, "pose", poses.len(), step.from)?;
        within("odometry", index, "pose", poses.len(), step.to)?;
        finite(
            "odometry",
            index,
            &step.from_from_to.to_array(),
            &step.sigma,
        )?;
        finite("odometry", index, &[step.length_m], &[])?;
    }
    Ok(())
}

fn within(
    what: &'static str,
    index: usize,
    of: &'static str,
    count: usize,
    found: usize,
) -> Result<(), ProblemError> {
    if found < count {
        return Ok(());
    }
    Err(ProblemError::Index {
        what,
        index,
        of,
        count,
        found,
    })
}

fn finite(
    what: &'static str,
    index: usize,
    numbers: &[f64],
    sigmas: &[f64],
) -> Result<(), ProblemError> {
    let good =
        numbers.iter().all(|x| x.is_finite()) && sigmas.iter().all(|x| x.is_finite() && *x > 0.0);
    if good {
        Ok(())
    } else {
        Err(ProblemError::Value { what, index })
    }
}
