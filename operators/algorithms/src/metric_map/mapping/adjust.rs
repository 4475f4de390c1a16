//! Bundle adjustment of a scene.

use nalgebra::Vector3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{MapInput, MapObservation};
use crate::geometry::pose::Pose;
use crate::metric_map::association::{FeatureRef, Landmark, Scene};
use crate::metric_map::bundle_adjustment::{
    Keyframe, Observation, Odometry, Options, Problem, Residual, SessionState, residuals, solve,
};
use crate::metric_map::features::FeatureNoise;
use crate::metric_map::odometry::OdometryScale;
use crate::metric_map::pose_graph::robust::CUTOFF_SPATIAL;
use crate::solving::least_squares::{self, Loss};

/// Weights of adjustment.
///
/// Wheel odometry is planar and a step between keyframes short: what it says is good to about a tick (5 mm) plus a
/// part of the way. It knows nothing of slopes, kerbs and suspension: height, roll and pitch are held only as much
/// as a ramp's beginning (some per cent of slope within a step) allows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct AdjustParams {
    /// How exactly features lie.
    #[serde(flatten)]
    pub features: FeatureNoise,
    /// Residuals beyond this many standard deviations count less and less (Cauchy).
    #[serde(skip)]
    pub robust_sigmas: f64,
    /// Standard deviation of an odometry step along x, y, z (m), roll, pitch, yaw (rad), however short it is.
    #[serde(skip)]
    pub odometry_sigma: [f64; 6],
    /// What is added for each metre.
    #[serde(skip)]
    pub odometry_sigma_per_m: [f64; 6],
    /// What a session's odometry scale is held by.
    #[serde(flatten)]
    pub odometry: OdometryScale,
    /// Squared standard deviations of a step beyond which it counts less and less (dynamic covariance scaling): a wheel
    /// slipped. χ² with six degrees of freedom, once in a thousand; below, a step counts fully.
    #[serde(skip)]
    pub odometry_cutoff: f64,
    /// Keyframes of a region at most. A site that has more is adjusted by regions, to the same poses: what is known of single
    /// features while a step is sought, most of the memory, then follows the size of a region. Null adjusts every site in one
    /// piece, which takes fewer passes.
    #[schemars(range(min = 1))]
    pub region_keyframes: Option<u32>,
    /// When an adjustment between rounds ends. Poses that move by a millimetre move what is a metre away by 0.1 px: less
    /// than features scatter, and much less than the next round's radius.
    #[serde(skip)]
    pub between: Until,
    /// When the last adjustment ends.
    #[serde(skip)]
    pub last: Until,
}

/// When an adjustment ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Until {
    /// Iterations at most.
    pub iterations: usize,
    /// No pose moves what it sees 10 m away by more, metres.
    pub moved_m: f64,
}

impl Default for AdjustParams {
    fn default() -> Self {
        Self {
            features: FeatureNoise::default(),
            robust_sigmas: 2.0,
            odometry_sigma: [0.005, 0.005, 0.01, 0.01, 0.01, 0.003],
            odometry_sigma_per_m: [0.01, 0.01, 0.03, 0.02, 0.02, 0.006],
            odometry: OdometryScale::default(),
            odometry_cutoff: CUTOFF_SPATIAL,
            region_keyframes: None,
            between: Until {
                iterations: 8,
                moved_m: 1e-3,
            },
            last: Until {
                iterations: 30,
                moved_m: 1e-4,
            },
        }
    }
}

/// Poses and points after adjustment.
pub(super) struct Adjusted {
    pub(super) poses: Vec<Pose>,
    pub(super) points: Vec<Vector3<f64>>,
    pub(super) odometry_scales: Vec<f64>,
    /// Of the landmarks' features.
    residuals: Vec<Residual>,
}

impl Adjusted {
    /// The features of the landmarks that were adjusted, as the adjusted map explains them.
    pub(super) fn observations(&self, landmarks: &[Landmark]) -> Vec<MapObservation> {
        let features = landmarks.iter().zip(0_u32..).flat_map(|(landmark, at)| {
            let features = landmark.features.iter();
            features.map(move |feature| (*feature, at))
        });
        let explained = features.zip(&self.residuals);
        let explained = explained.filter_map(|((feature, landmark), residual)| {
            Some(MapObservation {
                feature,
                landmark,
                residual_px: residual.error_px?.norm(),
                weight: residual.weight,
            })
        });
        explained.collect()
    }
}

/// Adjusts poses and landmarks; where that is impossible both stay.
pub(super) fn adjust(
    input: &MapInput<'_>,
    poses: &[Pose],
    landmarks: &[Landmark],
    params: &AdjustParams,
    until: Until,
) -> Adjusted {
    let loss = Loss::Cauchy(params.robust_sigmas);
    let mut problem = problem(input, poses, landmarks, params);
    let options = Options {
        observation_loss: loss,
        odometry_loss: Loss::DynamicCovarianceScaling(params.odometry_cutoff),
        scale_sigma: params.odometry.sigma,
        region_poses: params.region_keyframes.map(|keyframes| keyframes as usize),
        least_squares: least_squares::Options {
            max_iterations: until.iterations,
            // What moves no pose is not waited for, nor is what lowers no cost.
            step_tolerance: until.moved_m,
            cost_tolerance: 1e-5,
            ..least_squares::Options::default()
        },
        ..Options::default()
    };
    let residuals = match solve(&mut problem, &options) {
        Ok(report) => report.observations,
        Err(_) => residuals(&problem, loss),
    };
    let poses = problem.poses.iter().map(|pose| pose.map_from_vehicle);
    let sessions = problem.sessions.iter();
    Adjusted {
        poses: poses.collect(),
        odometry_scales: sessions.map(|session| session.odometry_scale).collect(),
        points: problem.landmarks,
        residuals,
    }
}

fn problem(
    input: &MapInput<'_>,
    poses: &[Pose],
    landmarks: &[Landmark],
    params: &AdjustParams,
) -> Problem {
    let scene = input.scene;
    let keyframe = |(at, (keyframe, pose)): (
        usize,
        (&crate::metric_map::association::SceneKeyframe, &Pose),
    )| Keyframe {
        session: keyframe.session as usize,
        map_from_vehicle: *pose,
        fixed: input.fixed.binary_search(&at).is_ok(),
    };
    let keyframes = scene.keyframes.iter().zip(poses).enumerate();
    Problem {
        rigs: scene.rigs.clone(),
        sessions: (0..scene.rigs.len()).map(SessionState::new).collect(),
        poses: keyframes.map(keyframe).collect(),
        landmarks: landmarks.iter().map(|landmark| landmark.point).collect(),
        observations: observations(scene, landmarks, params),
        odometry: odometry(scene, params),
    }
}

fn observations(scene: &Scene, landmarks: &[Landmark], params: &AdjustParams) -> Vec<Observation> {
    let observation = |landmark: usize, feature: &FeatureRef| {
        let image = &scene.images[feature.image as usize];
        let pose = image.keyframe as usize;
        Observation {
            pose,
            camera: (feature.image - scene.keyframes[pose].images.start) as usize,
            landmark,
            pixel: scene.feature(*feature).pixel(),
            sigma_px: params.features.sigma_px * scene.blur(*feature),
        }
    };
    let landmarks = landmarks.par_iter().enumerate();
    let seen = landmarks.flat_map_iter(|(at, landmark)| {
        let features = landmark.features.iter();
        features.map(move |feature| observation(at, feature))
    });
    seen.collect()
}

/// Standard deviations of an odometry step. A turn that is missed evenly along the way leads aside by half of it times the
/// way, which counts where the keyframes between two have been dropped.
fn odometry_sigma(length_m: f64, params: &AdjustParams) -> [f64; 6] {
    let AdjustParams {
        odometry_sigma,
        odometry_sigma_per_m,
        ..
    } = params;
    let mut sigma: [f64; 6] =
        std::array::from_fn(|axis| odometry_sigma[axis] + odometry_sigma_per_m[axis] * length_m);
    for (axis, turn) in [(1, 5), (2, 4)] {
        sigma[axis] += 0.5 * odometry_sigma_per_m[turn] * length_m * length_m;
    }
    sigma
}

/// From each keyframe to the next of its session.
fn odometry(scene: &Scene, params: &AdjustParams) -> Vec<Odometry> {
    let mut steps = Vec::new();
    for (from, pair) in scene.keyframes.windows(2).enumerate() {
        if pair[0].session != pair[1].session {
            continue;
        }
        let from_from_to = pair[0]
            .odom_from_vehicle
            .inverse()
            .compose(&pair[1].odom_from_vehicle);
        let length_m = from_from_to.translation.norm();
        if !length_m.is_finite() {
            continue;
        }
        steps.push(Odometry {
            from,
            to: from + 1,
            from_from_to,
            length_m,
            sigma: odometry_sigma(length_m, params),
        });
    }
    steps
}
