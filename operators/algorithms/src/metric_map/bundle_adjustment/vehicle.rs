//! The camera side of the metric map: vehicle poses and sessions, seen through rigs.
//!
//! Unknown blocks have six entries: first the poses that are not fixed, moved as
//! [`crate::geometry::lie`] says, then one block for each session, of which two entries are used (scale, yaw
//! drift) and four are idle.

use nalgebra::{Matrix2x3, Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};

use super::odometry::{self, StepLinear};
use super::schur::{Bundle, FIXED, Linear, Terms};
use super::{Keyframe, Observation, Odometry, Options, Problem, SessionState};
use crate::geometry::camera::Camera;
use crate::geometry::lie::{hat, se3};
use crate::solving::least_squares::absolute_max;

/// An observation that the camera cannot see counts as one of this many standard deviations, and
/// pulls nowhere: steps that make landmarks invisible are refused, and those that begin so stay
/// harmless.
const UNSEEN_SIGMA: f64 = 100.0;

/// Distance at which a turn counts as a move, metres: most of what is seen is nearer.
pub(crate) const SEEN_M: f64 = 10.0;

/// A pose as projections need it.
#[derive(Clone, Copy)]
struct PoseCache {
    /// Rotation of `vehicle_from_map`.
    rotation: Matrix3<f64>,
    /// Position of the vehicle in the map.
    origin: Vector3<f64>,
}

/// A camera as projections need it.
struct CameraCache {
    camera: Camera,
    /// Rotation and translation of `camera_from_vehicle`.
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

#[derive(Clone)]
struct Estimate {
    poses: Vec<Keyframe>,
    placed: Vec<PoseCache>,
    sessions: Vec<SessionState>,
}

/// An observation as projections need it.
struct WeighedPixel {
    pose: u32,
    camera: u32,
    pixel: [f64; 2],
    /// 1 / standard deviation.
    information: f64,
}

pub(super) struct Vehicles<'a> {
    estimate: Estimate,
    trial: Estimate,
    cameras: Vec<CameraCache>,
    seen: Vec<WeighedPixel>,
    odometry: &'a [Odometry],
    /// Block of each pose, or [`FIXED`].
    blocks: Vec<u32>,
    /// Block of the first session.
    first_session: usize,
    /// Sessions that are held, the first ones.
    held: usize,
    options: &'a Options,
}

impl<'a> Vehicles<'a> {
    /// With the block of each pose, that of the first session, and how many sessions are held.
    pub(super) fn new(
        problem: &'a Problem,
        options: &'a Options,
        (blocks, first_session): (Vec<u32>, usize),
        held: usize,
    ) -> Self {
        let mut first_camera = Vec::with_capacity(problem.rigs.len());
        let mut cameras = Vec::new();
        for rig in &problem.rigs {
            first_camera.push(cameras.len());
            cameras.extend(rig.cameras.iter().map(|mounted| {
                let camera_from_vehicle = mounted.vehicle_from_camera.inverse();
                CameraCache {
                    camera: mounted.camera.clone(),
                    rotation: camera_from_vehicle
                        .rotation
                        .to_rotation_matrix()
                        .into_inner(),
                    translation: camera_from_vehicle.translation,
                }
            }));
        }
        let seen = |seen: &Observation| {
            let session = problem.poses[seen.pose].session;
            WeighedPixel {
                pose: seen.pose as u32,
                camera: (first_camera[problem.sessions[session].rig] + seen.camera) as u32,
                pixel: seen.pixel,
                information: 1.0 / seen.sigma_px,
            }
        };
        let estimate = Estimate {
            poses: problem.poses.clone(),
            placed: problem.poses.iter().map(PoseCache::new).collect(),
            sessions: problem.sessions.clone(),
        };
        Self {
            trial: estimate.clone(),
            estimate,
            cameras,
            seen: problem.observations.iter().map(seen).collect(),
            odometry: &problem.odometry,
            blocks,
            first_session,
            held,
            options,
        }
    }

    pub(super) fn into_estimate(self) -> (Vec<Keyframe>, Vec<SessionState>) {
        (self.estimate.poses, self.estimate.sessions)
    }

    fn terms_cost(&self, at: &Estimate) -> f64 {
        let mut cost = 0.0;
        for step in self.odometry {
            let (from, to) = (&at.poses[step.from], &at.poses[step.to]);
            let session = &at.sessions[from.session];
            let residual =
                odometry::residual(step, &from.map_from_vehicle, &to.map_from_vehicle, session);
            cost += 0.5 * self.options.odometry_loss.cost(residual.norm_squared());
        }
        for session in &at.sessions[..self.held] {
            cost += 0.5
                * self
                    .session_residual(session)
                    .iter()
                    .map(|r| r * r)
                    .sum::<f64>();
        }
        cost
    }

    /// Scale and yaw drift in standard deviations.
    fn session_residual(&self, session: &SessionState) -> [f64; 2] {
        [
            (session.odometry_scale - 1.0) / self.options.scale_sigma,
            session.odometry_yaw_rad_per_m / self.options.yaw_sigma_rad_per_m,
        ]
    }

    fn add_step(&self, terms: &mut Terms<'_, 6>, step: &Odometry) -> f64 {
        let at = &self.estimate;
        let (from, to) = (&at.poses[step.from], &at.poses[step.to]);
        let session = &at.sessions[from.session];
        let linear =
            odometry::linearise(step, &from.map_from_vehicle, &to.map_from_vehicle, session);
        let squared = linear.residual.norm_squared();
        let weight = self.options.odometry_loss.weight(squared);
        let StepLinear {
            residual,
            from,
            to,
            session: narrow,
        } = &linear;
        let mut wide = SMatrix::<f64, 6, 6>::zeros();
        wide.fixed_view_mut::<6, 2>(0, 0).copy_from(narrow);
        let session = (self.first_session + at.poses[step.from].session) as u32;
        let sides = [
            (self.blocks[step.from], from),
            (self.blocks[step.to], to),
            (session, &wide),
        ];
        for (index, (block, jacobian)) in sides.iter().enumerate() {
            if *block == FIXED {
                continue;
            }
            add_product(terms, (*block, jacobian), residual, weight);
            for (other, right) in &sides[index + 1..] {
                if *other != FIXED {
                    let product = jacobian.transpose() * *right * weight;
                    let (row, column) = (*block as usize, *other as usize);
                    terms.add(row, column, |r, c| product[(r, c)]);
                }
            }
        }
        0.5 * self.options.odometry_loss.cost(squared)
    }

    fn add_session(&self, terms: &mut Terms<'_, 6>, index: usize, session: &SessionState) -> f64 {
        let residual = self.session_residual(session);
        let scales = [self.options.scale_sigma, self.options.yaw_sigma_rad_per_m];
        let block = self.first_session + index;
        terms.add(block, block, |r, c| match scales.get(r) {
            _ if r != c => 0.0,
            Some(sigma) => sigma.powi(-2),
            None => 1.0,
        });
        terms.add_gradient(block, |c| {
            let both = residual.get(c).zip(scales.get(c));
            both.map_or(0.0, |(residual, sigma)| residual / sigma)
        });
        0.5 * residual.iter().map(|r| r * r).sum::<f64>()
    }
}

/// `H += w JᵀJ`, `g += w Jᵀ r`.
fn add_product(
    terms: &mut Terms<'_, 6>,
    (block, jacobian): (u32, &SMatrix<f64, 6, 6>),
    residual: &Vector6<f64>,
    weight: f64,
) {
    let block = block as usize;
    let hessian = jacobian.transpose() * jacobian * weight;
    let gradient: SVector<f64, 6> = jacobian.transpose() * residual * weight;
    terms.add(block, block, |r, c| hessian[(r, c)]);
    terms.add_gradient(block, |c| gradient[c]);
}

impl Bundle<6> for Vehicles<'_> {
    fn linearise(&self, observation: usize, landmark: &[f64; 3]) -> (f64, Linear<6>) {
        let seen = &self.seen[observation];
        let placed = &self.estimate.placed[seen.pose as usize];
        let camera = &self.cameras[seen.camera as usize];
        let vehicle = placed.point(landmark);
        let point = camera.rotation * vehicle + camera.translation;
        let loss = self.options.observation_loss;
        let Some((pixel, jacobian)) = camera.camera.project_with_jacobian(&point) else {
            return (0.5 * loss.cost(UNSEEN_SIGMA * UNSEEN_SIGMA), Linear::ZERO);
        };
        let error = [0, 1].map(|axis| (pixel[axis] - seen.pixel[axis]) * seen.information);
        let squared = error[0] * error[0] + error[1] * error[1];
        let root = loss.weight(squared).sqrt();
        let by_vehicle = jacobian * camera.rotation * (root * seen.information);
        let by_landmark = by_vehicle * placed.rotation;
        let linear = Linear {
            residual: error.map(|e| e * root),
            camera: [0, 1].map(|row| by_pose(&by_vehicle, row, &vehicle)),
            landmark: [0, 1].map(|row| [0, 1, 2].map(|axis| by_landmark[(row, axis)])),
        };
        (0.5 * loss.cost(squared), linear)
    }

    fn trial_cost(&self, observation: usize, landmark: &[f64; 3]) -> f64 {
        let seen = &self.seen[observation];
        let camera = &self.cameras[seen.camera as usize];
        let vehicle = self.trial.placed[seen.pose as usize].point(landmark);
        let point = camera.rotation * vehicle + camera.translation;
        let squared = camera
            .camera
            .project(&point)
            .map_or(UNSEEN_SIGMA * UNSEEN_SIGMA, |pixel| {
                let error = [0, 1].map(|axis| (pixel[axis] - seen.pixel[axis]) * seen.information);
                error[0] * error[0] + error[1] * error[1]
            });
        0.5 * self.options.observation_loss.cost(squared)
    }

    fn add_terms(&self, terms: &mut Terms<'_, 6>) -> f64 {
        let mut cost = 0.0;
        for step in self.odometry {
            cost += self.add_step(terms, step);
        }
        for (index, session) in self.estimate.sessions[..self.held].iter().enumerate() {
            cost += self.add_session(terms, index, session);
        }
        cost
    }

    fn trial_terms_cost(&self) -> f64 {
        self.terms_cost(&self.trial)
    }

    fn step(&mut self, steps: &[[f64; 6]]) {
        for (index, block) in self.blocks.iter().enumerate() {
            let Some(step) = steps.get(*block as usize) else {
                continue;
            };
            let pose = &mut self.trial.poses[index];
            let before = &self.estimate.poses[index].map_from_vehicle;
            pose.map_from_vehicle = se3::plus(before, &Vector6::from(*step));
            self.trial.placed[index] = PoseCache::new(pose);
        }
        let sessions = self.trial.sessions.iter_mut().zip(&self.estimate.sessions);
        for ((trial, before), step) in sessions.zip(&steps[self.first_session..]) {
            trial.odometry_scale = before.odometry_scale + step[0];
            trial.odometry_yaw_rad_per_m = before.odometry_yaw_rad_per_m + step[1];
        }
    }

    fn accept(&mut self) {
        self.estimate.clone_from(&self.trial);
    }

    /// Metres by which the pose that moves farthest moves what is [`SEEN_M`] away from it.
    fn moved(&self, steps: &[[f64; 6]]) -> f64 {
        let steps = self
            .blocks
            .iter()
            .filter_map(|block| steps.get(*block as usize));
        absolute_max(steps.map(|[x, y, z, roll, pitch, yaw]| {
            Vector3::new(*x, *y, *z).norm() + SEEN_M * Vector3::new(*roll, *pitch, *yaw).norm()
        }))
    }

    /// A group of poses moves as one rigid body, about its middle along the map's axes.
    fn common_motions(&self, groups: &[u32]) -> Vec<[[f64; 6]; 6]> {
        let count = groups.iter().max().map_or(0, |last| *last as usize + 1);
        let mut middles = vec![(Vector3::zeros(), 0.0); count];
        let moving = || {
            let poses = self.blocks.iter().zip(&self.estimate.placed);
            poses.filter(|(block, _)| **block != FIXED)
        };
        for (block, placed) in moving() {
            let (sum, members) = &mut middles[groups[*block as usize] as usize];
            *sum += placed.origin;
            *members += 1.0;
        }
        let mut motions = vec![Matrix6::identity().into(); groups.len()];
        for (block, placed) in moving() {
            let (sum, members) = middles[groups[*block as usize] as usize];
            motions[*block as usize] = rigid_motion(placed, &(sum / members));
        }
        motions
    }

    /// Poses of a session are of one kin; a session's own unknowns are alone.
    fn kin(&self, unknowns: usize) -> Vec<u32> {
        let sessions = self.estimate.sessions.len();
        let alone = |block: usize| (sessions + block.saturating_sub(self.first_session)) as u32;
        let mut kin: Vec<u32> = (0..unknowns).map(alone).collect();
        for (block, pose) in self.blocks.iter().zip(&self.estimate.poses) {
            if let Some(kin) = kin.get_mut(*block as usize) {
                *kin = pose.session as u32;
            }
        }
        kin
    }
}

impl PoseCache {
    fn new(keyframe: &Keyframe) -> Self {
        let pose = &keyframe.map_from_vehicle;
        Self {
            rotation: pose.rotation.inverse().to_rotation_matrix().into_inner(),
            origin: pose.translation,
        }
    }

    /// A point of the map in the vehicle frame.
    fn point(&self, landmark: &[f64; 3]) -> Vector3<f64> {
        self.rotation * (Vector3::from(*landmark) - self.origin)
    }
}

/// What a shift and a turn of the map about `middle` do to a pose, along and about its own axes: `φ = Rᵀ ω`,
/// `ρ = Rᵀ (v + ω × (t - middle))`. Row by row.
fn rigid_motion(placed: &PoseCache, middle: &Vector3<f64>) -> [[f64; 6]; 6] {
    let turned = -placed.rotation * hat(&(placed.origin - middle));
    std::array::from_fn(|row| {
        std::array::from_fn(|column| match (row / 3, column / 3) {
            (0, 0) | (1, 1) => placed.rotation[(row % 3, column % 3)],
            (0, 1) => turned[(row, column - 3)],
            _ => 0.0,
        })
    })
}

/// One row of the derivative by a pose moved along its own axes: the point in the vehicle frame
/// changes by `-ρ + [p]× φ`.
fn by_pose(by_vehicle: &Matrix2x3<f64>, row: usize, p: &Vector3<f64>) -> [f64; 6] {
    let [a, b, c] = [0, 1, 2].map(|axis| by_vehicle[(row, axis)]);
    [
        -a,
        -b,
        -c,
        b * p.z - c * p.y,
        c * p.x - a * p.z,
        a * p.y - b * p.x,
    ]
}
