//! Roll and pitch from an IMU: odometry that knows where up is.
//!
//! ```text
//! IMU ──► Motion between odometry messages ──► Gravity, smoothed over the drive ──┐
//! odometry ──► how fast, along the vehicle's own axes ──────┘                      ├──► odometry, upright
//! odometry ──► steps along the vehicle's own axes ────────────────────────────────┘
//! ```
//!
//! Wheels count a way and a turn in the plane that the vehicle stands on; of how that plane lies they know nothing. An IMU
//! at rest measures up. In motion it measures acceleration too, and that is known from the odometry: what is left is
//! gravity. Rates of turn carry it from one instant to the next, and so average what wheels and springs add.
//!
//! Heading and steps remain those of the odometry: its steps, which are along the vehicle's own axes, are laid end to end
//! again, each turned as little as it takes for gravity to point down.

mod gravity;
mod motion;
#[cfg(test)]
mod tests;

use nalgebra::{UnitQuaternion, Vector3};

use super::drive::MotionLimits;
use super::drive::continuity::Continuity;
use crate::geometry::lie::so3;
use crate::geometry::pose::Pose;
use gravity::Leg;
use motion::Motion;

/// One measurement of an IMU, in its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// When, ns.
    pub stamp: i64,
    /// Rate of turn, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Acceleration without gravity's, as it is felt: at rest it points up, m/s².
    pub specific_force: Vector3<f64>,
}

/// Why an IMU says nothing of up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InertialError {
    /// It was silent for most of the drive.
    Silent,
    /// What it feels is not gravity: another unit, or gravity taken out.
    NoGravity,
    /// On the vehicle as it is said to be mounted, up is not above.
    NotUpright,
    /// It turns otherwise than the odometry does, or adds to it what no gyroscope does at rest.
    TurnsOtherwise,
}

/// Gravity is that of the earth to a twentieth (m/s²): its own range is half a per cent, the scale of an uncalibrated
/// sensor a few.
const GRAVITY_MPS2: f64 = 9.81;
const GRAVITY_SHARE: f64 = 0.05;

/// A vehicle on wheels leans by less than this (cosine of 45°).
const UPRIGHT: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A leg's time (s) in which speeds are told apart well: at 50 Hz, ticks of 4 mm are then 0.03 m/s².
const LEG_S: f64 = 0.5;

/// How far rates of turn of IMU and odometry may be apart, as a share of the odometry's: ten times what wheels are off by.
const TURN_SHARE: f64 = 0.3;

/// Gyroscopes are right at rest to this (rad/s): a thousandth of a radian in ten legs.
const UNBIASED: f64 = 2e-4;
const MOST_ROUNDS: usize = 8;

/// No gyroscope says more than this at rest (rad/s): 20 °/s, the worst of data sheets of MEMS sensors (InvenSense MPU-6050).
/// On a drive of one long turn, degrees for radians look like a bias.
const MOST_BIAS: f64 = 0.35;

/// Turns slower than this (rad/s, root mean square) tell nothing of a mount.
const TURNS: f64 = 0.05;

/// The odometry (stamp in ns, ascending, and the vehicle in the odometry's frame) with roll and pitch of the IMU (its
/// samples in order of time) that sits at `vehicle_from_imu`: as many poses, in a frame whose z axis points up. The first
/// pose keeps its place and its heading.
///
/// # Errors
/// [`InertialError`] where the IMU cannot be believed.
pub fn upright(
    odometry: &[(i64, Pose)],
    imu: &[ImuSample],
    vehicle_from_imu: &Pose,
) -> Result<Vec<Pose>, InertialError> {
    let path = Path::new(odometry);
    let samples = motion::on_vehicle(imu, &vehicle_from_imu.rotation);
    let motions = motion::between(&path.stamps, &samples, &Vector3::zeros());
    let covered = motions.iter().flatten().count();
    if covered == 0 || 2 * covered < motions.len() {
        return Err(InertialError::Silent);
    }
    let turns = path.turns(&motions);
    if turns.differ() {
        return Err(InertialError::TurnsOtherwise);
    }
    // Legs are short, and made as if gyroscopes were right: what they say at rest is taken off until nothing is left.
    let mut bias = Vector3::z() * turns.bias();
    let mut rounds = 0;
    let (legs, gravities, motions) = loop {
        let motions = motion::between(&path.stamps, &samples, &bias);
        let legs = path.legs(&motions, &vehicle_from_imu.translation);
        let gravities = gravity::smoothed(&legs).ok_or(InertialError::Silent)?;
        let left: Vector3<f64> = gravities.iter().map(|(_, bias)| bias).sum();
        let left = left / gravities.len() as f64;
        rounds += 1;
        if left.norm() < UNBIASED || rounds == MOST_ROUNDS {
            break (legs, gravities, motions);
        }
        bias += left;
    };
    if bias.norm() > MOST_BIAS {
        return Err(InertialError::TurnsOtherwise);
    }
    let strength = gravities.iter().map(|(gravity, _)| gravity.norm());
    let strength = strength.sum::<f64>() / gravities.len() as f64;
    if (strength / GRAVITY_MPS2 - 1.0).abs() > GRAVITY_SHARE {
        return Err(InertialError::NoGravity);
    }
    let ups = path.ups(&legs, &gravities, &motions);
    let upright = ups.iter().filter(|up| up.z > UPRIGHT).count();
    if 2 * upright < ups.len() {
        return Err(InertialError::NotUpright);
    }
    Ok(laid(odometry, &ups))
}

/// The steps laid end to end again, each turned as little as it takes for its `up` to be above.
fn laid(odometry: &[(i64, Pose)], ups: &[Vector3<f64>]) -> Vec<Pose> {
    let turned = |pose: &Pose, up: &Vector3<f64>| {
        let thought = pose.rotation.inverse() * Vector3::z();
        // Half a turn apart, any axis would do; no step does that.
        let least = UnitQuaternion::rotation_between(up, &thought).unwrap_or_default();
        Pose::new(pose.translation, pose.rotation * least)
    };
    let mut laid: Vec<Pose> = Vec::with_capacity(odometry.len());
    for (here, up) in ups.iter().enumerate() {
        let thought = match laid.last() {
            Some(last) => last.compose(&step(&odometry[here - 1].1, &odometry[here].1)),
            None => odometry[here].1,
        };
        laid.push(turned(&thought, up));
    }
    laid
}

/// The second pose, seen from the first.
fn step(from: &Pose, to: &Pose) -> Pose {
    from.inverse().compose(to)
}

/// The odometry, made continuous.
struct Path {
    stamps: Vec<i64>,
    poses: Vec<Pose>,
    /// Stretches of unbroken odometry.
    stretches: Vec<u32>,
}

impl Path {
    fn new(odometry: &[(i64, Pose)]) -> Self {
        let mut continuity = Continuity::new(MotionLimits::default());
        let mut path = Self {
            stamps: odometry.iter().map(|(stamp, _)| *stamp).collect(),
            poses: Vec::with_capacity(odometry.len()),
            stretches: Vec::with_capacity(odometry.len()),
        };
        let mut stretch = 0;
        for (stamp, pose) in odometry {
            // What is left out stands where it stood before: its stamp repeats.
            let continued = continuity.push(*stamp, pose);
            stretch += u32::from(continued.is_some_and(|continued| continued.anew));
            let before = path.poses.last().copied();
            let pose = continued.map(|continued| continued.pose).or(before);
            path.poses.push(pose.unwrap_or(Pose::identity()));
            path.stretches.push(stretch);
        }
        path
    }

    fn seconds(&self, from: usize, to: usize) -> f64 {
        self.stamps[to].saturating_sub(self.stamps[from]) as f64 * 1e-9
    }

    /// How fast the vehicle moves along its own axes (m/s), over half a leg before and after a message; `None` where the
    /// odometry is broken there.
    fn velocity(&self, here: usize) -> Option<Vector3<f64>> {
        let from = self.farthest(here, |at| at.checked_sub(1));
        let to = self.farthest(here, |at| at.checked_add(1));
        let seconds = self.seconds(from, to);
        let moved = self.poses[to].translation - self.poses[from].translation;
        (seconds > 0.0).then(|| self.poses[here].rotation.inverse() * moved / seconds)
    }

    /// The first message of the same stretch, in this direction, that is half a leg away, or else the last one.
    fn farthest(&self, here: usize, next: impl Fn(usize) -> Option<usize>) -> usize {
        let whole = |at: &usize| self.stretches.get(*at) == Some(&self.stretches[here]);
        let near = |at: usize| self.seconds(at.min(here), at.max(here)) < LEG_S / 2.0;
        let mut found = here;
        while near(found)
            && let Some(at) = next(found).filter(whole)
        {
            found = at;
        }
        found
    }

    /// How both turn about the vehicle's own z axis, each between two messages.
    fn turns(&self, motions: &[Option<Motion>]) -> Turns {
        let turn = |(here, motion): (usize, &Option<Motion>)| {
            let motion = motion.as_ref()?;
            let wheels = step(&self.poses[here], &self.poses[here + 1]).rotation;
            let of = |rotation: &UnitQuaternion<f64>| so3::log(rotation).z / motion.seconds;
            Some(([of(&wheels), of(&motion.rotation)], motion.seconds))
        };
        Turns(motions.iter().enumerate().filter_map(turn).collect())
    }

    /// The drive in legs of half a second or more.
    fn legs(&self, motions: &[Option<Motion>], lever: &Vector3<f64>) -> Vec<Leg> {
        let mut legs = Vec::new();
        let mut open: Option<Leg> = None;
        for (here, motion) in motions.iter().enumerate() {
            match motion {
                Some(motion) => {
                    let leg = open.get_or_insert_with(|| Leg::new(here));
                    leg.extend(motion);
                    if leg.motion.seconds >= LEG_S {
                        legs.extend(open.take());
                    }
                }
                None => {
                    legs.extend(open.take());
                    let turned = step(&self.poses[here], &self.poses[here + 1]).rotation;
                    legs.push(Leg::unknown(here, turned, self.seconds(here, here + 1)));
                }
            }
        }
        legs.extend(open.take());
        let at = |here: usize| Some(self.velocity(here)? + spin(motions, here)?.cross(lever));
        for leg in &mut legs {
            leg.measure(at(leg.from), at(leg.to));
        }
        legs
    }

    /// Up at each message, along the vehicle's own axes.
    fn ups(
        &self,
        legs: &[Leg],
        gravities: &[(Vector3<f64>, Vector3<f64>)],
        motions: &[Option<Motion>],
    ) -> Vec<Vector3<f64>> {
        let mut ups = Vec::with_capacity(self.stamps.len());
        for (leg, pair) in legs.iter().zip(gravities.windows(2)) {
            let [(start, bias), (end, _)] = [pair[0], pair[1]];
            let off = end - leg.carried(&start, &bias);
            let (mut turned, mut seconds) = (UnitQuaternion::identity(), 0.0);
            for motion in &motions[leg.from..leg.to] {
                let end_from_here = leg.motion.rotation.inverse() * turned;
                let share = seconds / leg.motion.seconds.max(f64::MIN_POSITIVE);
                let carried = so3::exp(&(seconds * bias)) * (turned.inverse() * start);
                ups.push(carried + share * (end_from_here.inverse() * off));
                if let Some(motion) = motion {
                    turned *= motion.rotation;
                    seconds += motion.seconds;
                }
            }
        }
        ups.extend(gravities.last().map(|(gravity, _)| *gravity));
        let above = |up: &Vector3<f64>| up.try_normalize(f64::MIN_POSITIVE).unwrap_or(Vector3::z());
        ups.iter().map(above).collect()
    }
}

/// Rates of turn by the odometry and by the IMU (rad/s), and for how long (s).
struct Turns(Vec<([f64; 2], f64)>);

impl Turns {
    fn mean(&self, value: impl Fn([f64; 2]) -> f64) -> f64 {
        let seconds: f64 = self.0.iter().map(|(_, seconds)| seconds).sum();
        let sum: f64 = self
            .0
            .iter()
            .map(|(turn, seconds)| value(*turn) * seconds)
            .sum();
        sum / seconds
    }

    /// What the IMU says more than the odometry, on the whole, rad/s.
    fn bias(&self) -> f64 {
        self.mean(|[wheels, imu]| imu - wheels)
    }

    /// Whether the IMU turns otherwise, whatever constant it adds: the slope of the line through both, by least squares, is
    /// 1 where they agree; the IMU's noise leaves it there.
    fn differ(&self) -> bool {
        let [wheels, imu] = [0, 1].map(|who| self.mean(|turn| turn[who]));
        let variance = self.mean(|turn| (turn[0] - wheels).powi(2));
        let together = self.mean(|turn| (turn[0] - wheels) * (turn[1] - imu));
        variance > TURNS.powi(2) && (together / variance - 1.0).abs() > TURN_SHARE
    }
}

/// The rate of turn at a message, from the IMU before and after it.
fn spin(motions: &[Option<Motion>], here: usize) -> Option<Vector3<f64>> {
    let around = here.saturating_sub(1)..(here + 1).min(motions.len());
    let known: Vec<&Motion> = motions[around].iter().flatten().collect();
    let seconds: f64 = known.iter().map(|motion| motion.seconds).sum();
    let turned: Vector3<f64> = known.iter().map(|motion| so3::log(&motion.rotation)).sum();
    (seconds > 0.0).then(|| turned / seconds)
}
