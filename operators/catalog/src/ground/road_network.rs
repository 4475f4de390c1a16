#![doc = include_str!("road_network.md")]

use std::collections::BTreeMap;

use evermap_algorithms::ground::road_network::{
    EndKind, Passage, RoadNetworkParams, Trace, Travel, road_network,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{Keyframe, Lane, Source, Sources, VehiclePose};
use evermap_schemas::{Stamp, Wkb};

/// See the module's page.
pub struct RoadNetwork;

impl Operator for RoadNetwork {
    const NAME: &'static str = "road_network";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("road_network.md");
    type Params = RoadNetworkParams;
    type Output = Lane;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<VehiclePose>("poses");
        let keyframes = Port::site::<Keyframe>("keyframes").optional();
        Work::group(poses, Key::SITE, vec![keyframes], lanes)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let checked = params.check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

fn lanes(
    params: &RoadNetworkParams,
    poses: Vec<VehiclePose>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = poses[0].site.clone();
    let keyframes = sides.rows::<Keyframe>("keyframes")?;
    let drives = drives(poses, &keyframes, emit);
    let driven: Vec<Trace<'_>> = drives.iter().map(StampedTrace::trace).collect();
    let network = road_network(&driven, params).map_err(|error| Fault::data(error.to_string()))?;
    let lanes = network.lanes.into_iter().zip(0_u32..);
    emit.rows(
        lanes
            .map(|(lane, number)| Lane {
                site: site.clone(),
                lane: number,
                start_node: lane.start.node,
                end_node: lane.end.node,
                start_kind: kind(lane.start.kind).to_owned(),
                end_kind: kind(lane.end.kind).to_owned(),
                direction: direction(lane.travel).to_owned(),
                forward_passes: lane.forward_passes,
                backward_passes: lane.reverse_passes,
                length_m: lane.length_m,
                width_m: lane.width_m,
                next_lanes: lane.next,
                next_lanes_backward: lane.next_backward,
                sources: sources(&lane.passages, &drives),
                geometry: Wkb::line_string(&lane.points),
                points: lane.points,
            })
            .collect(),
    )
}

/// A session's positions in the order driven, each with its stamp.
#[derive(Default)]
struct StampedTrace {
    name: String,
    positions: Vec<[f64; 3]>,
    stamps: Vec<Stamp>,
    /// Positions that the way to is not known.
    breaks: Vec<usize>,
    /// The stretch of the last keyframe.
    stretch: Option<u32>,
}

impl StampedTrace {
    fn add(&mut self, position: [f64; 3], stamp: Stamp, stretch: Option<u32>) {
        let before = self.stretch;
        self.stretch = stretch.or(before);
        if before.is_some() && self.stretch != before {
            self.breaks.push(self.positions.len());
        }
        self.positions.push(position);
        self.stamps.push(stamp);
    }

    fn trace(&self) -> Trace<'_> {
        Trace {
            key: &self.name,
            positions: &self.positions,
            breaks: &self.breaks,
        }
    }
}

/// The sessions, ordered by name as the poses are; broken where the stretch of the keyframes that poses are of changes.
fn drives(
    poses: Vec<VehiclePose>,
    keyframes: &[Keyframe],
    emit: &mut Emit<'_>,
) -> Vec<StampedTrace> {
    let stretches: BTreeMap<(&str, Stamp), u32> = keyframes
        .iter()
        .map(|row| ((row.session.as_str(), row.stamp), row.stretch))
        .collect();
    let mut drives: Vec<StampedTrace> = Vec::new();
    for VehiclePose {
        session,
        stamp,
        map_from_vehicle: pose,
        ..
    } in poses
    {
        let position = [pose.x, pose.y, pose.z];
        if position.iter().any(|coordinate| !coordinate.is_finite()) {
            emit.skip("position is not finite", 1);
            continue;
        }
        let stretch = stretches.get(&(session.as_str(), stamp)).copied();
        if drives.last().is_none_or(|last| last.name != session) {
            drives.push(StampedTrace {
                name: session,
                ..StampedTrace::default()
            });
        }
        if let Some(drive) = drives.last_mut() {
            drive.add(position, stamp, stretch);
        }
    }
    drives
}

/// Passages by stamp instead of by pose.
fn sources(passages: &[Passage], drives: &[StampedTrace]) -> Vec<Source> {
    let mut sources = Sources::default();
    for passage in passages {
        let at = drives.binary_search_by(|drive| drive.name.cmp(&passage.drive));
        let stamps = at.map_or(&[][..], |at| &drives[at].stamps);
        if let (Some(first), Some(last)) = (stamps.get(passage.first), stamps.get(passage.last)) {
            sources.add(&passage.drive, *first, *last);
        }
    }
    sources.into_rows()
}

fn kind(kind: EndKind) -> &'static str {
    match kind {
        EndKind::Intersection => "intersection",
        EndKind::DeadEnd => "dead_end",
        EndKind::Ring => "loop",
    }
}

fn direction(travel: Travel) -> &'static str {
    match travel {
        Travel::Forward => "forward",
        Travel::Reverse => "backward",
        Travel::Both => "both",
        Travel::Unknown => "unknown",
    }
}
