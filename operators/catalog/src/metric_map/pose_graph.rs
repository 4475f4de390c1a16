#![doc = include_str!("pose_graph.md")]

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::geometry::lie::se3;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::pose_graph::drives::{
    DriveParams, DrivePose, FixConstraint, Joined, KeyframeRef, LoopConstraint, join,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{
    GraphPose, Keyframe, Localisation, LoopClosure, LoopEdge, VehiclePose,
};
use nalgebra::{Matrix6, Vector6};

/// Sessions without a place in the map that are named; the rest are counted together.
const NAMED: usize = 16;

/// See the module's page.
pub struct PoseGraph;

impl Operator for PoseGraph {
    const NAME: &'static str = "pose_graph";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("pose_graph.md");
    type Params = DriveParams;
    type Output = GraphPose;

    fn work() -> Work<Self::Params> {
        let keyframes = Port::site::<Keyframe>("keyframes");
        let sides = vec![
            Port::site::<LoopClosure>("loop_closures"),
            Port::site::<Localisation>("localisations").optional(),
            Port::site::<VehiclePose>("previous").optional(),
        ];
        Work::group(keyframes, Key::SITE, sides, relax)
    }
}

/// Sessions cut into stretches of unbroken odometry.
#[derive(Default)]
struct Stretches {
    keyframes: Vec<Vec<Keyframe>>,
    drives: Vec<Vec<DrivePose>>,
    by_number: BTreeMap<(String, u32), KeyframeRef>,
}

impl Stretches {
    /// Of rows by session and stamp.
    fn new(rows: Vec<Keyframe>, known: &FixedPoses, emit: &mut Emit<'_>) -> Self {
        let posed = rows.into_iter().filter_map(|row| {
            let Ok(odom_from_vehicle) = Pose::from_array(row.odom_from_vehicle.to_array()) else {
                emit.skip("keyframe's pose is not a rigid transform", 1);
                return None;
            };
            let path_m = Some(row.distance_m).filter(|path_m| path_m.is_finite());
            let at = DrivePose {
                odom_from_vehicle,
                path_m: path_m.unwrap_or(0.0),
                known: known.get(&(row.session.clone(), row.stamp)).copied(),
            };
            Some((row, at))
        });
        let posed: Vec<(Keyframe, DrivePose)> = posed.collect();
        let goes_on = |(before, _): &(Keyframe, _), (row, _): &(Keyframe, _)| {
            (&before.session, before.stretch) == (&row.session, row.stretch)
        };
        let mut stretches = Self::default();
        for (drive, stretch) in posed.chunk_by(goes_on).enumerate() {
            for (keyframe, (row, _)) in stretch.iter().enumerate() {
                let key = (row.session.clone(), row.keyframe);
                let place = KeyframeRef { drive, keyframe };
                stretches.by_number.insert(key, place);
            }
            let (rows, poses) = stretch.iter().cloned().unzip();
            stretches.keyframes.push(rows);
            stretches.drives.push(poses);
        }
        stretches
    }

    fn place(&self, session: &str, number: u32) -> Option<KeyframeRef> {
        self.by_number.get(&(session.to_owned(), number)).copied()
    }

    /// The stretch that was driven first; of several, the first by name.
    fn first(&self) -> Option<usize> {
        let starts = self.keyframes.iter().enumerate();
        let starts = starts.filter_map(|(drive, rows)| {
            let first = rows.first()?;
            Some((first.stamp, first.session.as_str(), drive))
        });
        starts.min().map(|(_, _, drive)| drive)
    }
}

/// Poses that stay, by session and stamp.
type FixedPoses = BTreeMap<(String, Stamp), Pose>;

fn relax(
    params: &DriveParams,
    keyframes: Vec<Keyframe>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = keyframes[0].site.clone();
    let known = known(sides.rows("previous")?);
    let stretches = Stretches::new(keyframes, &known, emit);
    let (rows, loops) = loops(sides.rows("loop_closures")?, &stretches, emit);
    let (localised, fixes) = fixes(sides.rows("localisations")?, &stretches, emit);
    let begins = known.is_empty() && !localised;
    let base = stretches.first().filter(|_| begins);
    let joined = join(&stretches.drives, &loops, &fixes, base, params)
        .map_err(|error| Fault::resource(format!("pose graph of site {site}: {error}")))?;
    let edges = edges(&rows, &loops, &joined, emit);
    let rows = poses(&site, &stretches, &joined, edges, emit);
    emit.rows(rows)
}

fn known(rows: Vec<VehiclePose>) -> FixedPoses {
    rows.into_iter()
        .filter_map(|row| {
            let pose = Pose::from_array(row.map_from_vehicle.to_array()).ok()?;
            Some(((row.session, row.stamp), pose))
        })
        .collect()
}

/// The loop closures between keyframes that are there.
fn loops(
    given: Vec<LoopClosure>,
    stretches: &Stretches,
    emit: &mut Emit<'_>,
) -> (Vec<LoopClosure>, Vec<LoopConstraint>) {
    let (mut rows, mut loops) = (Vec::new(), Vec::new());
    for row in given {
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
        loops.push(LoopConstraint {
            later,
            earlier,
            earlier_from_later,
            sigma_m: row.sigma_m,
            sigma_rad: row.sigma_rad,
        });
        rows.push(row);
    }
    (rows, loops)
}

/// Is there anything localised, and where.
fn fixes(
    mut rows: Vec<Localisation>,
    stretches: &Stretches,
    emit: &mut Emit<'_>,
) -> (bool, Vec<FixConstraint>) {
    rows.retain(|row| row.state != "lost");
    let localised = !rows.is_empty();
    let mut fixes = Vec::new();
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
    (localised, fixes)
}

fn fix(row: &Localisation, at: KeyframeRef) -> Option<FixConstraint> {
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
        .then(|| FixConstraint {
            at,
            map_from_vehicle,
            covariance: se3::covariance_along_right(&map_from_vehicle, &along_map),
        })
}

/// How loop closures fit, by the later keyframe's session and number.
fn edges(
    rows: &[LoopClosure],
    loops: &[LoopConstraint],
    joined: &Joined,
    emit: &mut Emit<'_>,
) -> BTreeMap<KeyframeRef, Vec<LoopEdge>> {
    let mut edges: BTreeMap<KeyframeRef, Vec<LoopEdge>> = BTreeMap::new();
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
    mut edges: BTreeMap<KeyframeRef, Vec<LoopEdge>>,
    emit: &mut Emit<'_>,
) -> Vec<GraphPose> {
    let (mut rows, mut named) = (Vec::new(), BTreeSet::new());
    for (drive, (keyframes, poses)) in stretches.keyframes.iter().zip(&joined.poses).enumerate() {
        let Some(poses) = poses else {
            let session = keyframes.first().map_or("", |row| row.session.as_str());
            if named.len() < NAMED {
                named.insert(session);
            }
            let reason = match named.contains(session) {
                true => format!(
                    "keyframe of session {session}, which nothing sure connects with the map"
                ),
                false => "keyframe of a session that nothing sure connects with the map".to_owned(),
            };
            emit.skip(reason, keyframes.len() as u64);
            continue;
        };
        for (keyframe, (row, pose)) in keyframes.iter().zip(poses).enumerate() {
            let mut loops = edges
                .remove(&KeyframeRef { drive, keyframe })
                .unwrap_or_default();
            loops.sort_by(|a, b| (&a.session, a.keyframe).cmp(&(&b.session, b.keyframe)));
            rows.push(GraphPose {
                site: site.to_owned(),
                session: row.session.clone(),
                stamp: row.stamp,
                keyframe: row.keyframe,
                map_from_vehicle: evermap_schemas::Pose::from_array(pose.to_array()),
                loops,
                optimality: joined.optimality.name().to_owned(),
            });
        }
    }
    rows
}
