//! Drives of one site, each a chain of odometry, put into one map.
//!
//! ```text
//! place the base ─► relax what is placed ─► attach drives whose sightings agree ─┐
//!                        ▲                                                       │ until none
//!                        └───────────────────────────────────────────────────────┘
//! ─► leave out what too few accepted loops hold, and relax once more
//! ```
//!
//! The base defines the map's frame: keyframes whose poses are known already; else the map that
//! [`FixConstraint`]es refer to; else the first drive given, whose first keyframe becomes the origin.
//!
//! Odometry errors are mostly systematic (a wheel's radius, a gyro's bias), and grow in proportion
//! to the path. A chain of independent steps has errors that grow with its root. The walks are set
//! so that the chain is as uncertain as odometry is after 100 m ([`OdometryScale::walk_m`]).

use nalgebra::Matrix6;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::certificate::Optimality;
use super::consensus::{Agreement, PoseVote, Rules, agree, places};
use super::numbering::Numbering;
use super::options;
use super::robust::{CUTOFF_SPATIAL, relax_robustly};
use crate::geometry::pose::Pose;
use crate::metric_map::odometry::OdometryScale;
use crate::solving::least_squares::SystemError;

/// A keyframe of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrivePose {
    /// The vehicle in the drive's own, drifting frame.
    pub odom_from_vehicle: Pose,
    /// Path from the drive's start (m).
    pub path_m: f64,
    /// Its pose in the map, where it is known and stays.
    pub known: Option<Pose>,
}

/// Which keyframe of which drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct KeyframeRef {
    /// Index of the drive.
    pub drive: usize,
    /// Index of the keyframe within it.
    pub keyframe: usize,
}

/// A loop closure, true or false.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopConstraint {
    /// The later keyframe.
    pub later: KeyframeRef,
    /// The earlier one.
    pub earlier: KeyframeRef,
    /// The vehicle of the later keyframe in that of the earlier one.
    pub earlier_from_later: Pose,
    /// Standard deviation of the relative position (m).
    pub sigma_m: f64,
    /// Standard deviation of the relative orientation (rad).
    pub sigma_rad: f64,
}

/// A keyframe localised in the map, rightly or not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixConstraint {
    /// The keyframe.
    pub at: KeyframeRef,
    /// Its pose in the map.
    pub map_from_vehicle: Pose,
    /// Covariance along the vehicle's own axes: translation (m²), rotation (rad²).
    pub covariance: Matrix6<f64>,
}

/// How odometry and loops are believed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct DriveParams {
    /// What the odometry's position is uncertain by: see [`OdometryScale::walk_m`].
    #[serde(flatten)]
    pub odometry: OdometryScale,
    /// Standard deviation of the odometry's heading after one metre, growing with the root of the path (rad): 6° after
    /// 100 m.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub walk_rad: f64,
    /// Standard deviation of its heading after a turn of one radian, growing with the root of the turn (rad): 4° after a
    /// full turn, for a track width that is one per cent off.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub turn_rad: f64,
    /// Standard deviation of roll, pitch (rad) and height (m) after one metre, growing with its root. Wheels do not
    /// measure them; floors for cars are drained by slopes of one to two per cent.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub slope: f64,
    /// What loop closures and localisations are uncertain by beyond what they say (m): synchronisation and calibration.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub loop_m: f64,
    /// The same for their orientation (rad).
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub loop_rad: f64,
    /// Squared standard deviations beyond which a loop closure or localisation is false: χ² with six degrees of freedom,
    /// once in a thousand.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub cutoff: f64,
    /// Keyframes closer than this along the path (m) are one place.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub place_m: f64,
    /// Places that must agree before a session joins the map. Of false closures anywhere on 1000 m², two agree by chance
    /// about once in 10⁴, three practically never.
    #[schemars(range(min = 1))]
    pub places: usize,
}

impl Default for DriveParams {
    fn default() -> Self {
        Self {
            odometry: OdometryScale::default(),
            walk_rad: 0.01,
            turn_rad: 0.03,
            slope: 0.02,
            loop_m: 0.05,
            loop_rad: 0.01,
            cutoff: CUTOFF_SPATIAL,
            place_m: 1.0,
            places: 3,
        }
    }
}

/// How a loop fits the relaxed poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Distance between where it puts the later keyframe and where that is (m).
    pub residual_m: f64,
    /// Angle between the two (rad).
    pub residual_rad: f64,
    /// 1 when it was believed, 0 when it was found to be false.
    pub weight: f64,
}

/// The map.
#[derive(Debug, Clone, PartialEq)]
pub struct Joined {
    /// By drive: the poses of its keyframes in the map; `None` when nothing sure connects it.
    pub poses: Vec<Option<Vec<Pose>>>,
    /// By loop: `None` when one of its drives is not in the map.
    pub loops: Vec<Option<Fit>>,
    /// By fix: its weight; 0 when its drive is not in the map.
    pub fixes: Vec<f64>,
    /// Whether other poses of the placed drives could fit odometry and what was believed better.
    pub optimality: Optimality,
}

/// Joins drives by loops and fixes. `base` starts the map where no pose is known and nothing is
/// localised; `None` when the map exists already. Loops and fixes that name no keyframe are
/// ignored.
///
/// # Errors
/// [`SystemError`] when the graph is too large for memory.
pub fn join(
    drives: &[Vec<DrivePose>],
    loops: &[LoopConstraint],
    fixes: &[FixConstraint],
    base: Option<usize>,
    params: &DriveParams,
) -> Result<Joined, SystemError> {
    let mut joining = Joining {
        drives,
        loops,
        fixes,
        params,
        poses: drives.iter().map(|drive| known(drive)).collect(),
        start: None,
        is_base: vec![false; drives.len()],
        loop_weights: vec![0.0; loops.len()],
        fix_weights: vec![0.0; fixes.len()],
        optimality: Optimality::Unknown,
    };
    if let Some(base) = base
        && joining.poses.iter().all(Option::is_none)
        && let Some(first) = drives.get(base).and_then(|drive| drive.first())
    {
        joining.hang(base, &first.odom_from_vehicle.inverse());
        joining.start = Some(base);
    }
    for (is_base, poses) in joining.is_base.iter_mut().zip(&joining.poses) {
        *is_base = poses.is_some();
    }
    let mut refused = vec![false; drives.len()];
    loop {
        joining.relax()?;
        if !joining.attach(&refused) && !joining.detach(&mut refused) {
            break;
        }
    }
    Ok(joining.finish())
}

/// The poses of a drive of which some are known: the others hang off the known one before them,
/// or else the first known one.
fn known(drive: &[DrivePose]) -> Option<Vec<Pose>> {
    let map_from_odom = |at: &DrivePose| Some(at.known?.compose(&at.odom_from_vehicle.inverse()));
    let mut frame = drive.iter().find_map(map_from_odom)?;
    let poses = drive.iter().map(|at| {
        frame = map_from_odom(at).unwrap_or(frame);
        at.known
            .unwrap_or_else(|| frame.compose(&at.odom_from_vehicle))
    });
    Some(poses.collect())
}

struct Joining<'a> {
    drives: &'a [Vec<DrivePose>],
    loops: &'a [LoopConstraint],
    fixes: &'a [FixConstraint],
    params: &'a DriveParams,
    poses: Vec<Option<Vec<Pose>>>,
    /// The drive whose first keyframe is the origin.
    start: Option<usize>,
    is_base: Vec<bool>,
    loop_weights: Vec<f64>,
    fix_weights: Vec<f64>,
    optimality: Optimality,
}

impl Joining<'_> {
    /// Puts a drive into the map as odometry has it.
    fn hang(&mut self, drive: usize, map_from_odom: &Pose) {
        let poses = self.drives[drive].iter();
        let poses = poses.map(|at| map_from_odom.compose(&at.odom_from_vehicle));
        self.poses[drive] = Some(poses.collect());
    }

    fn pose(&self, place: KeyframeRef) -> Option<Pose> {
        let poses = self.poses.get(place.drive)?.as_ref()?;
        poses.get(place.keyframe).copied()
    }

    fn drive_pose(&self, place: KeyframeRef) -> Option<&DrivePose> {
        self.drives.get(place.drive)?.get(place.keyframe)
    }

    /// Relaxes all drives that are placed; weights of loops and fixes follow.
    fn relax(&mut self) -> Result<(), SystemError> {
        let numbering = Numbering::new(self.drives, &self.poses);
        let mut graph = numbering.graph(self.drives, &self.poses, self.params);
        let start = self
            .start
            .and_then(|drive| numbering.of(KeyframeRef { drive, keyframe: 0 }));
        if let Some(start) = start {
            graph.fixed[start] = true;
        }
        let chain = graph.edges.len();
        let mut origin = Vec::new();
        for (index, given) in self.loops.iter().enumerate() {
            if let Some(edge) = numbering.loop_edge(given, self.params) {
                graph.edges.push(edge);
                origin.push(Doubted::Loop(index));
            }
        }
        for (index, fix) in self.fixes.iter().enumerate() {
            if let Some(edge) = numbering.fix_edge(fix, self.params) {
                graph.edges.push(edge);
                origin.push(Doubted::Fix(index));
            }
        }
        let doubted: Vec<bool> = (0..graph.edges.len()).map(|edge| edge >= chain).collect();
        let settled = relax_robustly(&mut graph, &doubted, self.params.cutoff, &options())?;
        self.optimality = settled.optimality;
        self.loop_weights.fill(0.0);
        self.fix_weights.fill(0.0);
        for (origin, weight) in origin.iter().zip(&settled.weights[chain..]) {
            match origin {
                Doubted::Loop(index) => self.loop_weights[*index] = *weight,
                Doubted::Fix(index) => self.fix_weights[*index] = *weight,
            }
        }
        numbering.read(&graph, &mut self.poses);
        Ok(())
    }

    /// Places each drive that is not yet, where enough sightings agree. Did any find its place?
    fn attach(&mut self, refused: &[bool]) -> bool {
        let rules = Rules {
            walk_m: self.params.odometry.walk_m(),
            walk_rad: self.params.walk_rad,
            sigmas: self.params.cutoff.sqrt(),
            place_m: self.params.place_m,
            places: self.params.places,
        };
        let free = (0..self.drives.len()).filter(|at| self.poses[*at].is_none() && !refused[*at]);
        let found: Vec<(usize, Agreement)> = free
            .filter_map(|drive| Some((drive, agree(&self.sightings(drive), &rules)?)))
            .collect();
        for (drive, agreement) in &found {
            self.hang(*drive, &agreement.map_from_drive);
        }
        !found.is_empty()
    }

    /// Where loops to what is placed, and fixes, put the keyframes of a drive.
    fn sightings(&self, drive: usize) -> Vec<PoseVote> {
        let mut sightings = Vec::new();
        let params = self.params;
        let mut add = |at: KeyframeRef, map_from_vehicle: Pose, sigma_m: f64, sigma_rad: f64| {
            if let Some(own) = self.drive_pose(at) {
                sightings.push(PoseVote {
                    drive_from_vehicle: own.odom_from_vehicle,
                    map_from_vehicle,
                    path_m: own.path_m,
                    sigma_m: sigma_m.hypot(params.loop_m),
                    sigma_rad: sigma_rad.hypot(params.loop_rad),
                });
            }
        };
        for given in self.loops {
            let [later, earlier] = [given.later, given.earlier];
            if later.drive == drive
                && let Some(other) = self.pose(earlier)
            {
                let map_from_vehicle = other.compose(&given.earlier_from_later);
                add(later, map_from_vehicle, given.sigma_m, given.sigma_rad);
            } else if earlier.drive == drive
                && let Some(other) = self.pose(later)
            {
                let map_from_vehicle = other.compose(&given.earlier_from_later.inverse());
                add(earlier, map_from_vehicle, given.sigma_m, given.sigma_rad);
            }
        }
        for fix in self.fixes.iter().filter(|fix| fix.at.drive == drive) {
            let diagonal = fix.covariance.diagonal();
            let sigma_m = diagonal.fixed_rows::<3>(0).max().max(0.0).sqrt();
            let sigma_rad = diagonal.fixed_rows::<3>(3).max().max(0.0).sqrt();
            add(fix.at, fix.map_from_vehicle, sigma_m, sigma_rad);
        }
        sightings
    }

    /// Takes out drives that too few accepted loops and fixes connect with the base, directly or
    /// over others. Was there one?
    fn detach(&mut self, refused: &mut [bool]) -> bool {
        let mut held = self.is_base.clone();
        loop {
            let more = (0..held.len())
                .filter(|drive| !held[*drive] && self.poses[*drive].is_some())
                .find(|drive| self.support(*drive, &held) >= self.params.places);
            match more {
                Some(drive) => held[drive] = true,
                None => break,
            }
        }
        let mut any = false;
        for drive in 0..held.len() {
            if self.poses[drive].is_some() && !held[drive] {
                self.poses[drive] = None;
                refused[drive] = true;
                any = true;
            }
        }
        any
    }

    /// Places of a drive that accepted loops to held drives, or accepted fixes, put into the map.
    fn support(&self, drive: usize, held: &[bool]) -> usize {
        let holds = |other: KeyframeRef| held.get(other.drive) == Some(&true);
        let by_loop = self.loops.iter().zip(&self.loop_weights);
        let by_loop = by_loop
            .filter(|(_, weight)| **weight > 0.5)
            .filter_map(|(given, _)| {
                let [later, earlier] = [given.later, given.earlier];
                if later.drive == drive && holds(earlier) {
                    Some(later)
                } else if earlier.drive == drive && holds(later) {
                    Some(earlier)
                } else {
                    None
                }
            });
        let by_fix = self.fixes.iter().zip(&self.fix_weights);
        let by_fix = by_fix
            .filter(|(fix, weight)| **weight > 0.5 && fix.at.drive == drive)
            .map(|(fix, _)| fix.at);
        let path = by_loop.chain(by_fix);
        let path = path.filter_map(|place| Some(self.drive_pose(place)?.path_m));
        places(path, self.params.place_m)
    }

    fn finish(self) -> Joined {
        let loops = self.loops.iter().zip(&self.loop_weights);
        let loops = loops.map(|(given, weight)| {
            let (later, earlier) = (self.pose(given.later)?, self.pose(given.earlier)?);
            let said = earlier.compose(&given.earlier_from_later);
            Some(Fit {
                residual_m: (later.translation - said.translation).norm(),
                residual_rad: later.rotation.angle_to(&said.rotation),
                weight: *weight,
            })
        });
        Joined {
            loops: loops.collect(),
            fixes: self.fix_weights,
            poses: self.poses,
            optimality: self.optimality,
        }
    }
}

/// What a doubted edge was made of.
enum Doubted {
    Loop(usize),
    Fix(usize),
}
