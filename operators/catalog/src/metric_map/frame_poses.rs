#![doc = include_str!("frame_poses.md")]

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reason, Sides, Work};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{FramePose, MapFrame, VehiclePose};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::frames::Frames;

/// See the module's page.
pub struct FramePoses;

/// When poses stay.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct FramePosesParams {
    /// A session of the version before whose poses have all moved by less than this (m), what they turned by at a range of
    /// 5 m included, stays where it was, so that nothing that was made of its poses is made again. A tenth of a pixel of an
    /// overhead image.
    #[schemars(range(min = 0.0))]
    pub settled_m: f64,
}

impl Default for FramePosesParams {
    fn default() -> Self {
        Self { settled_m: 0.005 }
    }
}

/// Range at which a turn counts as a motion, metres: that of the floor and the landmarks that a vehicle sees best.
const RANGE_M: f64 = 5.0;

impl Operator for FramePoses {
    const NAME: &'static str = "frame_poses";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("frame_poses.md");
    type Params = FramePosesParams;
    type Output = FramePose;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<VehiclePose>("poses");
        let sides = vec![
            Port::site::<MapFrame>("frames"),
            Port::site::<FramePose>("previous").optional(),
        ];
        Work::group(poses, Key::SITE, sides, hang)
    }
}

/// Each pose on its nearest frame; then the poses of the version before that are not among them, where their frames
/// are now; of sessions that have hardly moved, all where they were.
fn hang(
    params: &FramePosesParams,
    poses: Vec<VehiclePose>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let frames: Vec<MapFrame> = sides.rows("frames")?;
    // A frame that is new may have the number of one that went with its session.
    let kept = frames.iter().filter(|frame| frame.moved_m.is_some());
    let kept: BTreeMap<u32, Pose> = kept
        .filter_map(|frame| Some((frame.frame, pose(&frame.map_from_frame)?)))
        .collect();
    let frames: Frames = frames.into_iter().collect();
    let previous = by_session(sides.rows("previous")?);
    let mut now: Sessions = BTreeMap::new();
    for (session, rows) in &previous {
        let rows = rows
            .iter()
            .map(|(stamp, row)| (*stamp, carried(row, &kept, &frames)));
        now.insert(session.clone(), rows.collect());
    }
    for row in poses {
        match hung(&frames, row) {
            Ok(row) => {
                let of_session = now.entry(row.session.clone()).or_default();
                of_session.insert(row.stamp, row);
            }
            Err(reason) => emit.skip(reason, 1),
        }
    }
    for (session, mut rows) in now {
        if let Some(before) = previous.get(&session) {
            settle(&mut rows, before, params.settled_m);
        }
        emit.rows(rows.into_values().collect())?;
    }
    Ok(())
}

/// Poses by session and stamp.
type Sessions = BTreeMap<String, BTreeMap<Stamp, FramePose>>;

fn by_session(rows: Vec<FramePose>) -> Sessions {
    let mut sessions: Sessions = BTreeMap::new();
    for row in rows {
        let of_session = sessions.entry(row.session.clone()).or_default();
        of_session.insert(row.stamp, row);
    }
    sessions
}

/// The pose where its frame is now; where it was, on the frame nearest to it, if its own is not among those that were kept.
fn carried(row: &FramePose, kept: &BTreeMap<u32, Pose>, frames: &Frames) -> FramePose {
    let found = kept.get(&row.frame).zip(pose(&row.frame_from_vehicle));
    let Some((frame, vehicle)) = found else {
        let stays = VehiclePose {
            site: row.site.clone(),
            session: row.session.clone(),
            stamp: row.stamp,
            map_from_vehicle: row.map_from_vehicle.clone(),
        };
        return hung(frames, stays).unwrap_or_else(|_| row.clone());
    };
    FramePose {
        map_from_vehicle: evermap_schemas::Pose::from_array(frame.compose(&vehicle).to_array()),
        ..row.clone()
    }
}

/// Puts the poses of a session back where they were, if none has moved by more than `settled_m`.
fn settle(
    rows: &mut BTreeMap<Stamp, FramePose>,
    before: &BTreeMap<Stamp, FramePose>,
    settled_m: f64,
) {
    let still = |(stamp, row): (&Stamp, &FramePose)| {
        let before = before
            .get(stamp)
            .and_then(|row| pose(&row.map_from_vehicle));
        let both = before.zip(pose(&row.map_from_vehicle));
        both.is_some_and(|(before, now)| {
            let motion = before.inverse().compose(&now);
            motion.translation.norm() + RANGE_M * motion.rotation.angle() < settled_m
        })
    };
    if rows.iter().all(still) {
        for (stamp, row) in rows {
            row.map_from_vehicle = before[stamp].map_from_vehicle.clone();
        }
    }
}

fn pose(of_row: &evermap_schemas::Pose) -> Option<Pose> {
    Pose::from_array(of_row.to_array()).ok()
}

fn hung(frames: &Frames, row: VehiclePose) -> Result<FramePose, Reason> {
    let map_from_vehicle = pose(&row.map_from_vehicle).ok_or("pose is not a rigid transform")?;
    let position = map_from_vehicle.translation.into();
    let (frame, map_from_frame) = frames
        .nearest(position)
        .and_then(|(frame, _)| Some((frame.frame, pose(&frame.map_from_frame)?)))
        .ok_or("site has no map frame")?;
    let frame_from_vehicle = map_from_frame.inverse().compose(&map_from_vehicle);
    Ok(FramePose {
        site: row.site,
        session: row.session,
        stamp: row.stamp,
        frame,
        frame_from_vehicle: evermap_schemas::Pose::from_array(frame_from_vehicle.to_array()),
        map_from_vehicle: row.map_from_vehicle,
    })
}
