//! What an IMU says of the time between two instants.

use nalgebra::{UnitQuaternion, Vector3};

use super::ImuSample;
use crate::geometry::lie::so3;

/// Between samples farther apart than this (s) the IMU was silent: a vehicle's springs have moved.
const SILENT_S: f64 = 0.25;

/// How a vehicle turned, and what it felt, integrated (Forster et al. 2017, eq. 33, without bias).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    /// Its axes at the end, seen from those at the start.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Specific force along its axes at the start, times time, m/s.
    pub(super) felt: Vector3<f64>,
    /// How long, s.
    pub(super) seconds: f64,
}

impl Motion {
    pub(super) fn none() -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            felt: Vector3::zeros(),
            seconds: 0.0,
        }
    }

    pub(super) fn then(&self, next: &Motion) -> Self {
        Self {
            rotation: UnitQuaternion::new_normalize((self.rotation * next.rotation).into_inner()),
            felt: self.felt + self.rotation * next.felt,
            seconds: self.seconds + next.seconds,
        }
    }

    /// A short time in which rate and force change evenly: `of` are those in its middle.
    fn short(of: &ImuSample, seconds: f64) -> Self {
        let half = so3::exp(&(of.angular_velocity * (seconds / 2.0)));
        Self {
            rotation: so3::exp(&(of.angular_velocity * seconds)),
            felt: half * of.specific_force * seconds,
            seconds,
        }
    }
}

/// Samples along the vehicle's axes, in order of time; those that are no numbers are left out.
pub(super) fn on_vehicle(
    imu: &[ImuSample],
    vehicle_from_imu: &UnitQuaternion<f64>,
) -> Vec<ImuSample> {
    let finite = |sample: &&ImuSample| {
        let numbers = sample
            .angular_velocity
            .iter()
            .chain(sample.specific_force.iter());
        numbers.copied().all(f64::is_finite)
    };
    let turned = |sample: &ImuSample| ImuSample {
        stamp: sample.stamp,
        angular_velocity: vehicle_from_imu * sample.angular_velocity,
        specific_force: vehicle_from_imu * sample.specific_force,
    };
    let mut samples: Vec<ImuSample> = imu.iter().filter(finite).map(turned).collect();
    samples.sort_by_key(|sample| sample.stamp);
    samples.dedup_by_key(|sample| sample.stamp);
    samples
}

/// The motion between each two stamps in a row, by samples along the vehicle's axes; `None` where the IMU was silent
/// meanwhile, or no time passed. `bias` is what its gyroscopes say at rest, rad/s.
pub(super) fn between(
    stamps: &[i64],
    samples: &[ImuSample],
    bias: &Vector3<f64>,
) -> Vec<Option<Motion>> {
    let mut reader = Reader {
        samples,
        bias,
        next: 0,
    };
    stamps
        .windows(2)
        .map(|pair| reader.motion(pair[0], pair[1]))
        .collect()
}

/// Reads samples once, from one interval to the next.
struct Reader<'a> {
    samples: &'a [ImuSample],
    bias: &'a Vector3<f64>,
    /// The first sample that is not before the interval.
    next: usize,
}

impl Reader<'_> {
    fn motion(&mut self, from: i64, to: i64) -> Option<Motion> {
        if to <= from {
            return None;
        }
        let starts = |sample: &ImuSample| sample.stamp < from;
        while self.samples.get(self.next).is_some_and(starts) {
            self.next += 1;
        }
        let mut motion = Motion::none();
        let mut second = self.next;
        let mut at = from;
        while at < to {
            // A sample at the very start has none before it.
            let second_sample = self.samples.get(second)?;
            if second_sample.stamp <= at {
                second += 1;
                continue;
            }
            let first_sample = self.samples.get(second.checked_sub(1)?)?;
            let apart = second_sample.stamp.saturating_sub(first_sample.stamp) as f64;
            if apart * 1e-9 > SILENT_S {
                return None;
            }
            let until = second_sample.stamp.min(to);
            let seconds = until.saturating_sub(at) as f64;
            let middle = at.saturating_sub(first_sample.stamp) as f64 + seconds / 2.0;
            let mut of = mixed(first_sample, second_sample, middle / apart);
            of.angular_velocity -= self.bias;
            motion = motion.then(&Motion::short(&of, seconds * 1e-9));
            at = until;
        }
        Some(motion)
    }
}

fn mixed(first: &ImuSample, second: &ImuSample, share: f64) -> ImuSample {
    ImuSample {
        stamp: first.stamp,
        angular_velocity: first.angular_velocity.lerp(&second.angular_velocity, share),
        specific_force: first.specific_force.lerp(&second.specific_force, share),
    }
}
