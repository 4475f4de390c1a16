//! Gravity along the vehicle's own axes, smoothed over a drive.
//!
//! With body velocities `v` (from odometry), rotation `R` and felt `Δv` of a leg of `T` seconds (from the IMU), gravity's
//! reaction at its start is what they leave over:
//!
//! ```text
//! g = (Δv + v_start − R v_end) / T          g_next = exp(b T) Rᵀ g          b_next = b
//! ```
//!
//! `b` is what the gyroscopes say at rest. A Kalman filter and the smoother of Rauch, Tung and Striebel (1965) find both.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::GRAVITY_MPS2;
use super::motion::Motion;
use crate::geometry::lie::so3;
use crate::solving::median::median;

type State = SVector<f64, 6>;
type Square = SMatrix<f64, 6, 6>;

/// White noise of gyroscopes (rad/s/√Hz): 0.014 °/s/√Hz, as data sheets of MEMS sensors in cars have it (Bosch BMI088).
const GYRO_NOISE: f64 = 2.4e-4;
/// What they say at rest when nobody calibrated them (rad/s): 1 °/s, from the same sheet.
const BIAS: f64 = 0.0175;
/// How that walks (rad/s/√s): 0.015 °/s for each kelvin, and a kelvin a minute while the car warms up.
const BIAS_WALK: f64 = 3.4e-5;
/// How far a road's slope is another one after a second without an IMU (rad/√s): kerbs and ramps of garages, at a walk.
const UNSEEN: f64 = 0.05;

/// What a leg's gravity is thought to be off by before the drive itself has said it (m/s²): speeds off by 0.1 m/s.
const NOISE_BEFORE: f64 = 0.3;
/// It is never better than this (m/s²): what accelerometers are off by from minute to minute.
const LEAST_NOISE: f64 = 0.01;
/// Standard deviations from which a measurement counts less (Huber): bumps, and wheels that slip.
const HUBER: f64 = 1.345;
/// Median of the absolute values of a normal distribution of variance 1.
const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// A piece of the drive, from one message of the odometry to a later one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Leg {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) motion: Motion,
    /// Gravity's reaction along the axes at the start, where it could be measured.
    measured: Option<Vector3<f64>>,
    /// Whether the IMU was there.
    known: bool,
}

impl Leg {
    pub(super) fn new(from: usize) -> Self {
        Self {
            from,
            to: from,
            motion: Motion::none(),
            measured: None,
            known: true,
        }
    }

    /// A step that only the odometry saw.
    pub(super) fn unknown(from: usize, rotation: UnitQuaternion<f64>, seconds: f64) -> Self {
        Self {
            to: from + 1,
            motion: Motion {
                rotation,
                seconds: seconds.max(0.0),
                ..Motion::none()
            },
            known: false,
            ..Self::new(from)
        }
    }

    pub(super) fn extend(&mut self, motion: &Motion) {
        self.motion = self.motion.then(motion);
        self.to += 1;
    }

    /// Takes the IMU's velocities at both ends, each along the axes there.
    pub(super) fn measure(&mut self, start: Option<Vector3<f64>>, end: Option<Vector3<f64>>) {
        let Motion {
            rotation,
            felt,
            seconds,
        } = self.motion;
        if self.known
            && let (Some(start), Some(end)) = (start, end)
        {
            self.measured = Some((felt + start - rotation * end) / seconds);
        }
    }

    /// Gravity at the end, by what it is at the start.
    pub(super) fn carried(&self, gravity: &Vector3<f64>, bias: &Vector3<f64>) -> Vector3<f64> {
        let turned = self.motion.rotation.inverse() * gravity;
        so3::exp(&(bias * self.gyro_s())) * turned
    }

    /// How long gyroscopes were asked, s.
    fn gyro_s(&self) -> f64 {
        if self.known { self.motion.seconds } else { 0.0 }
    }

    fn transition(&self, state: &State) -> (State, Square) {
        let [gravity, bias] = halves(state);
        let carried = self.carried(&gravity, &bias);
        let turn = so3::exp(&(bias * self.gyro_s())) * self.motion.rotation.inverse();
        let mut slope = Square::identity();
        let of_gravity: Matrix3<f64> = turn.to_rotation_matrix().into_inner();
        slope.fixed_view_mut::<3, 3>(0, 0).copy_from(&of_gravity);
        let of_bias = -so3::hat(&carried) * self.gyro_s();
        slope.fixed_view_mut::<3, 3>(0, 3).copy_from(&of_bias);
        (joined(&carried, &bias), slope)
    }

    /// Variances that a leg adds, of gravity and of the bias.
    fn noise(&self) -> Square {
        let rate = if self.known { GYRO_NOISE } else { UNSEEN };
        let gravity = (GRAVITY_MPS2 * rate).powi(2) * self.motion.seconds;
        let bias = BIAS_WALK.powi(2) * self.motion.seconds;
        Square::from_diagonal(&joined(&Vector3::repeat(gravity), &Vector3::repeat(bias)))
    }
}

fn halves(state: &State) -> [Vector3<f64>; 2] {
    [0, 3].map(|row| state.fixed_rows::<3>(row).into_owned())
}

fn joined(gravity: &Vector3<f64>, bias: &Vector3<f64>) -> State {
    State::from_iterator(gravity.iter().chain(bias.iter()).copied())
}

/// What is believed at an instant.
#[derive(Clone, Copy)]
struct Belief {
    state: State,
    covariance: Square,
}

/// A leg as the filter went through it.
struct Filtered {
    /// At its start, its own measurement included.
    start: Belief,
    /// At its end, before the next measurement.
    end: Belief,
    slope: Square,
    /// The measurement against what was expected, m/s².
    surprise: Option<Vector3<f64>>,
}

/// Gravity's reaction and the gyroscopes' bias, along the vehicle's axes, at the start of each leg and at the end of the
/// last; `None` where no leg was measured.
pub(super) fn smoothed(legs: &[Leg]) -> Option<Vec<(Vector3<f64>, Vector3<f64>)>> {
    let first = legs.iter().find_map(|leg| leg.measured)?;
    // What springs and wheels add is another in each vehicle: the first pass says how much.
    let surprises = filtered(legs, &first, NOISE_BEFORE).into_iter();
    let noise = noise_of(surprises.filter_map(|leg| leg.surprise));
    let legs = filtered(legs, &first, noise);
    let mut later = legs.last()?.end;
    let mut found = vec![later];
    for leg in legs.iter().rev() {
        let factor = leg.end.covariance.cholesky()?;
        let gain = leg.start.covariance * leg.slope.transpose() * factor.inverse();
        later = Belief {
            state: leg.start.state + gain * (later.state - leg.end.state),
            covariance: leg.start.covariance
                + gain * (later.covariance - leg.end.covariance) * gain.transpose(),
        };
        found.push(later);
    }
    let parts = |belief: &Belief| halves(&belief.state).into();
    Some(found.iter().rev().map(parts).collect())
}

fn filtered(legs: &[Leg], first: &Vector3<f64>, noise: f64) -> Vec<Filtered> {
    // Nobody knows how the vehicle stood before; a first leg may have been braked hard.
    let variances = [GRAVITY_MPS2.powi(2), BIAS.powi(2)].map(Vector3::repeat);
    let mut belief = Belief {
        state: joined(first, &Vector3::zeros()),
        covariance: Square::from_diagonal(&joined(&variances[0], &variances[1])),
    };
    let mut through = Vec::with_capacity(legs.len());
    for leg in legs {
        let surprise = leg
            .measured
            .map(|gravity| updated(&mut belief, &gravity, noise));
        let start = belief;
        let (state, slope) = leg.transition(&belief.state);
        belief = Belief {
            state,
            covariance: slope * belief.covariance * slope.transpose() + leg.noise(),
        };
        let end = belief;
        through.push(Filtered {
            start,
            end,
            slope,
            surprise,
        });
    }
    through
}

/// Takes a measurement in; gives what was surprising about it.
fn updated(belief: &mut Belief, gravity: &Vector3<f64>, noise: f64) -> Vector3<f64> {
    let surprise = gravity - halves(&belief.state)[0];
    let known: Matrix3<f64> = belief.covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let expected = (known.trace() / 3.0 + noise * noise).sqrt();
    let far = (surprise.norm() / (3f64.sqrt() * expected) / HUBER).max(1.0);
    let spread = known + Matrix3::identity() * (noise * noise * far);
    let Some(inverse) = spread.try_inverse() else {
        return surprise;
    };
    let gain = belief.covariance.fixed_columns::<3>(0) * inverse;
    belief.state += gain * surprise;
    let less = gain * belief.covariance.fixed_rows::<3>(0);
    belief.covariance -= less;
    belief.covariance = (belief.covariance + belief.covariance.transpose()) * 0.5;
    surprise
}

/// The noise of measurements by their surprises, outliers aside.
fn noise_of(surprises: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let sizes = surprises
        .flat_map(|surprise| [surprise.x, surprise.y, surprise.z])
        .map(f64::abs);
    let middle = median(sizes.collect()).unwrap_or(NOISE_BEFORE);
    (middle / MEDIAN_OF_NORMAL).max(LEAST_NOISE)
}
