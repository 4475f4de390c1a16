#![doc = include_str!("pose_graph.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::lie::se3;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::pose_graph::drives::{
    DriveParams, DrivePose, Fix, Joined, Loop, Place, join,
};
use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, Sides, group_whole};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{
    AdjustedPose, GraphPose, Keyframe, Localisation, LoopClosure, LoopEdge,
};
use nalgebra::{Matrix6, Vector6};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct PoseGraph;

/// How odometry and loops are believed.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PoseGraphParams {
    /// Standard deviation of the odometry's position after one metre, growing with the root of the path (m).
    pub walk_m: f64,
    /// Standard deviation of its heading after one metre, growing with the root of the path (rad).
    pub walk_rad: f64,
    /// Standard deviation of its heading after a turn of one radian, growing with the root of the turn (rad).
    pub turn_rad: f64,
    /// Standard deviation of roll, pitch (rad) and height (m) after one metre.
    pub slope: f64,
    /// What loop closures and localisations are uncertain by beyond what they say (m).
    pub loop_m: f64,
    /// The same for their orientation (rad).
    pub loop_rad: f64,
    /// Squared standard deviations beyond which a loop closure or localisation is false.
    pub cutoff: f64,
    /// Keyframes closer than this along the path (m) are one place.
    pub place_m: f64,
    /// Places that must agree before a session joins the map.
    pub places: u32,
    /// Keyframes farther apart than this (m) are not connected by odometry.
    pub gap_m: f64,
}

impl Default for PoseGraphParams {
    fn default() -> Self {
        let DriveParams {
            walk_m,
            walk_rad,
            turn_rad,
            slope,
            loop_m,
            loop_rad,
            cutoff,
            place_m,
            places,
        } = DriveParams::default();
        Self {
            walk_m,
            walk_rad,
            turn_rad,
            slope,
            loop_m,
            loop_rad,
            cutoff,
            place_m,
            places: places as u32,
            gap_m: 5.0,
        }
    }
}

impl PoseGraphParams {
    fn checked(&self) -> Result<DriveParams, Fault> {
        let positive = [
            ("walk_m", self.walk_m),
            ("walk_rad", self.walk_rad),
            ("turn_rad", self.turn_rad),
            ("slope", self.slope),
            ("loop_m", self.loop_m),
            ("loop_rad", self.loop_rad),
            ("cutoff", self.cutoff),
            ("place_m", self.place_m),
            ("places", f64::from(self.places)),
            ("gap_m", self.gap_m),
        ];
        for (name, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Fault::user(format!(
                    "expected {name} above 0, found {value}"
                )));
            }
        }
        Ok(DriveParams {
            walk_m: self.walk_m,
            walk_rad: self.walk_rad,
            turn_rad: self.turn_rad,
            slope: self.slope,
            loop_m: self.loop_m,
            loop_rad: self.loop_rad,
            cutoff: self.cutoff,
            place_m: self.place_m,
            places: self.places as usize,
        })
    }
}

impl Operator for PoseGraph {
    const NAME: &'static str = "pose_graph";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("pose_graph.md");
    type Params = PoseGraphParams;
    type Output = GraphPose;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<Keyframe>("keyframes", Grain::Whole),
            Port::of::<LoopClosure>("loop_closures", Grain::Whole),
            Port::of::<Localisation>("localisations", Grain::Whole).optional(),
            Port::of::<AdjustedPose>("previous", Grain::Whole).optional(),
        ]
    }

    fn kernel(params: PoseGraphParams) -> Result<Kernel, Fault> {
        let checked = params.checked()?;
        Ok(group_whole(
            move |keyframes: Vec<Keyframe>, sides: &Sides, emit: &mut Emit<'_>| {
                relax(keyframes, sides, &checked, params.gap_m, emit)
            },
        ))
    }
}

/// A keyframe's session, instant and number.
struct Name {
    session: String,
    stamp: Stamp,
    number: u32,
}

/// Sessions cut into stretches of unbroken odometry.
#[derive(Default)]
struct Stretches {
    names: Vec<Vec<Name>>,
    drives: Vec<Vec<DrivePose>>,
    by_number: BTreeMap<(String, u32), Place>,
}

impl Stretches {
    /// Of rows by session and stamp.
    fn new(rows: Vec<Keyframe>, known: &Known, gap_m: f64, emit: &mut Emit<'_>) -> Self {
        let mut stretches = Self::default();
        let mut before: Option<(String, Pose)> = None;
        for row in rows {
            let Ok(odom_from_vehicle) = Pose::from_array(row.odom_from_vehicle.to_array()) else {
                emit.skip("keyframe's pose is no rigid transform", 1);
                continue;
            };
            let follows = before.as_ref().is_some_and(|(session, pose)| {
                let apart = (pose.translation - odom_from_vehicle.translation).norm();
                *session == row.session && apart <= gap_m
            });
            before = Some((row.session.clone(), odom_from_vehicle));
            let key = (row.session.clone(), row.stamp);
            let at = DrivePose {
                odom_from_vehicle,
                path_m: if row.distance_m.is_finite() {
                    row.distance_m
                } else {
                    0.0
                },
                known: known.get(&key).copied(),
            };
            let name = Name {
                session: row.session,
                stamp: row.stamp,
                number: row.keyframe,
            };
            stretches.push(follows, name, at);
        }
        stretches
    }

    fn push(&mut self, follows: bool, name: Name, at: DrivePose) {
        if !follows || self.drives.is_empty() {
            self.names.push(Vec::new());
            self.drives.push(Vec::new());
        }
        let drive = self.drives.len() - 1;
        let place = Place {
            drive,
            keyframe: self.drives[drive].len(),
        };
        self.by_number
            .insert((name.session.clone(), name.number), place);
        self.names[drive].push(name);
        self.drives[drive].push(at);
    }

    fn place(&self, session: &str, number: u32) -> Option<Place> {
        self.by_number.get(&(session.to_owned(), number)).copied()
    }

    /// The stretch that was driven first; of several, the first by name.
    fn first(&self) -> Option<usize> {
        let starts = self.names.iter().enumerate();
        let starts = starts.filter_map(|(drive, names)| {
            let first = names.first()?;
            Some((first.stamp, first.session.as_str(), drive))
        });
        starts.min().map(|(_, _, drive)| drive)
    }
}

/// Poses that stay, by session and stamp.
type Known = BTreeMap<(String, Stamp), Pose>;

fn relax(
    mut keyframes: Vec<Keyframe>,
    sides: &Sides,
    params: &DriveParams,
    gap_m: f64,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let Some(site) = keyframes.first().map(|row| row.site.clone()) else {
        return Ok(());
    };
    keyframes.sort_by(|a, b| (&a.session, a.stamp).cmp(&(&b.session, b.stamp)));
    let known = known(&site, sides)?;
    let stretches = Stretches::new(keyframes, &known, gap_m, emit);
    let (rows, loops) = loops(&site, sides, &stretches, emit)?;
    let (localised, fixes) = fixes(&site, sides, &stretches, emit)?;
    let begins = known.is_empty() && !localised;
    let base = stretches.first().filter(|_| begins);
    let joined = join(&stretches.drives, &loops, &fixes, base, params)
        .map_err(|error| Fault::resource(format!("pose graph of site {site}: {error}")))?;
    let edges = edges(&rows, &loops, &joined, emit);
    let rows = poses(&site, &stretches, &joined, edges, emit);
    emit.rows(rows)
}

fn known(site: &str, sides: &Sides) -> Result<Known, Fault> {
    let rows = sides.rows::<AdjustedPose>("previous")?;
    let of_site = rows.into_iter().filter(|row| row.site == site);
    Ok(of_site
        .filter_map(|row| {
            let pose = Pose::from_array(row.map_from_vehicle.to_array()).ok()?;
            Some(((row.session, row.stamp), pose))
        })
        .collect())
}

/// The loop closures between keyframes that are there.
fn loops(
    site: &str,
    sides: &Sides,
    stretches: &Stretches,
    emit: &mut Emit<'_>,
) -> Result<(Vec<LoopClosure>, Vec<Loop>), Fault> {
    let (mut rows, mut loops) = (Vec::new(), Vec::new());
    for row in sides.rows::<LoopClosure>("loop_closures")? {
        if row.site != site {
            continue;
        }
        let places = stretches
            .place(&row.session, row.keyframe)
            .zip(stretches.place(&row.other_session, row.other_keyframe));
        let Some((later, earlier)) = places.filter(|(later, earlier)| later != earlier) else {
            emit.skip("loop closure of a keyframe that is not there", 1);
            continue;
        };
        let pose = Pose::from_array(row.other_from_vehicle.to_array());
        let sigmas = [row.sigma_m, row.sigma_rad];
        let (Ok(earlier_from_later), true) = (pose, sigmas.iter().all(|s| s.is_finite())) else {
            emit.skip(
                "loop closure without a rigid transform or its uncertainty",
                1,
            );
            continue;
        };
        loops.push(Loop {
            later,
            earlier,
            earlier_from_later,
            sigma_m: row.sigma_m,
            sigma_rad: row.sigma_rad,
        });
        rows.push(row);
    }
    Ok((rows, loops))
}

/// Is there anything localised, and where.
fn fixes(
    site: &str,
    sides: &Sides,
    stretches: &Stretches,
    emit: &mut Emit<'_>,
) -> Result<(bool, Vec<Fix>), Fault> {
    let mut fixes = Vec::new();
    let mut rows = sides.rows::<Localisation>("localisations")?;
    rows.retain(|row| row.site == site && row.state != "lost");
    let localised = !rows.is_empty();
    for row in rows {
        let Some(at) = stretches.place(&row.session, row.keyframe) else {
            emit.skip("localisation of a keyframe that is not there", 1);
            continue;
        };
        match fix(&row, at) {
            Some(fix) => fixes.push(fix),
            None => emit.skip(
                "localisation without a rigid transform or its uncertainty",
                1,
            ),
        }
    }
    Ok((localised, fixes))
}

fn fix(row: &Localisation, at: Place) -> Option<Fix> {
    let map_from_vehicle = Pose::from_array(row.map_from_vehicle.as_ref()?.to_array()).ok()?;
    let along_map = if row.covariance.len() == 36 {
        Matrix6::from_row_slice(&row.covariance)
    } else {
        let (m, rad) = (row.sigma_m?.powi(2), row.sigma_rad?.powi(2));
        Matrix6::from_diagonal(&Vector6::new(m, m, m, rad, rad, rad))
    };
    along_map
        .iter()
        .all(|value| value.is_finite())
        .then(|| Fix {
            at,
            map_from_vehicle,
            covariance: se3::covariance_along_right(&map_from_vehicle, &along_map),
        })
}

/// How loop closures fit, by the later keyframe's session and number.
fn edges(
    rows: &[LoopClosure],
    loops: &[Loop],
    joined: &Joined,
    emit: &mut Emit<'_>,
) -> BTreeMap<Place, Vec<LoopEdge>> {
    let mut edges: BTreeMap<Place, Vec<LoopEdge>> = BTreeMap::new();
    for ((row, given), fit) in rows.iter().zip(loops).zip(&joined.loops) {
        match fit {
            Some(fit) => edges.entry(given.later).or_default().push(LoopEdge {
                session: row.other_session.clone(),
                keyframe: row.other_keyframe,
                residual_m: fit.residual_m,
                residual_rad: fit.residual_rad,
                weight: fit.weight,
            }),
            None => emit.skip("loop closure of a session that is not in the map", 1),
        }
    }
    edges
}

fn poses(
    site: &str,
    stretches: &Stretches,
    joined: &Joined,
    mut edges: BTreeMap<Place, Vec<LoopEdge>>,
    emit: &mut Emit<'_>,
) -> Vec<GraphPose> {
    let mut rows = Vec::new();
    for (drive, (names, poses)) in stretches.names.iter().zip(&joined.poses).enumerate() {
        let Some(poses) = poses else {
            emit.skip(
                "keyframe of a session that nothing sure connects with the map",
                names.len() as u64,
            );
            continue;
        };
        for (keyframe, (name, pose)) in names.iter().zip(poses).enumerate() {
            let mut loops = edges.remove(&Place { drive, keyframe }).unwrap_or_default();
            loops.sort_by(|a, b| (&a.session, a.keyframe).cmp(&(&b.session, b.keyframe)));
            rows.push(GraphPose {
                site: site.to_owned(),
                session: name.session.clone(),
                stamp: name.stamp,
                keyframe: name.number,
                map_from_vehicle: evermap_schemas::Pose::from_array(pose.to_array()),
                loops,
            });
        }
    }
    rows
}
