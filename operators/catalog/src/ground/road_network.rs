#![doc = include_str!("road_network.md")]

use evermap_algorithms::ground::road_network::{
    EndKind, Passage, RoadNetworkParams, Trace, Travel, road_network,
};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{Lane, Source, Sources, VehiclePose};
use evermap_schemas::{Stamp, Wkb};

/// See the module's page.
pub struct RoadNetwork;

impl Operator for RoadNetwork {
    const NAME: &'static str = "road_network";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("road_network.md");
    type Params = RoadNetworkParams;
    type Output = Lane;

    fn work() -> Work<Self::Params> {
        let poses = Port::site::<VehiclePose>("poses");
        Work::group(poses, Key::SITE, vec![], lanes)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let checked = params.check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

fn lanes(
    params: &RoadNetworkParams,
    poses: Vec<VehiclePose>,
    _: &Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let Some(site) = poses.first().map(|pose| pose.site.clone()) else {
        return Ok(());
    };
    let drives = drives(poses, emit);
    let driven: Vec<Trace<'_>> = drives.iter().map(Session::drive).collect();
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
                sources: sources(&lane.passages, &drives),
                geometry: Wkb::line_string(&lane.points),
                points: lane.points,
            })
            .collect(),
    )
}

/// A session's positions in the order driven, each with its stamp.
struct Session {
    name: String,
    positions: Vec<[f64; 3]>,
    stamps: Vec<Stamp>,
}

impl Session {
    fn drive(&self) -> Trace<'_> {
        Trace {
            key: &self.name,
            positions: &self.positions,
        }
    }
}

/// The sessions, ordered by name as the poses are.
fn drives(poses: Vec<VehiclePose>, emit: &mut Emit<'_>) -> Vec<Session> {
    let mut drives: Vec<Session> = Vec::new();
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
        match drives.last_mut() {
            Some(last) if last.name == session => {
                last.positions.push(position);
                last.stamps.push(stamp);
            }
            _ => drives.push(Session {
                name: session,
                positions: vec![position],
                stamps: vec![stamp],
            }),
        }
    }
    drives
}

/// Passages by stamp instead of by pose.
fn sources(passages: &[Passage], drives: &[Session]) -> Vec<Source> {
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
