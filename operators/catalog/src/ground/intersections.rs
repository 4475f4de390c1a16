#![doc = include_str!("intersections.md")]

use std::collections::BTreeMap;

use evermap_contract::{Emit, Fault, Grain, Kernel, Operator, Port, group_whole};
use evermap_schemas::Wkb;
use evermap_schemas::layers::{Intersection, Lane, Sources};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// See the module's page.
pub struct Intersections;

/// There is nothing to choose.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct IntersectionsParams {}

impl Operator for Intersections {
    const NAME: &'static str = "intersections";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("intersections.md");
    type Params = IntersectionsParams;
    type Output = Intersection;

    fn ports() -> Vec<Port> {
        vec![Port::of::<Lane>("lanes", Grain::Whole)]
    }

    fn kernel(_: IntersectionsParams) -> Result<Kernel, Fault> {
        Ok(group_whole(|lanes: Vec<Lane>, _, emit| {
            intersections(&lanes, emit)
        }))
    }
}

/// Lane ends that share a node.
struct Meeting {
    degree: u32,
    point: [f64; 3],
    sources: Sources,
}

impl Meeting {
    fn at(point: [f64; 3]) -> Self {
        Self {
            degree: 0,
            point,
            sources: Sources::default(),
        }
    }
}

fn intersections(lanes: &[Lane], emit: &mut Emit<'_>) -> Result<(), Fault> {
    let mut nodes: BTreeMap<u32, Meeting> = BTreeMap::new();
    for lane in lanes {
        let (Some(first), Some(last)) = (lane.points.first(), lane.points.last()) else {
            emit.skip("lane has no points", 1);
            continue;
        };
        let ends = [
            (lane.start_node, &lane.start_kind, first),
            (lane.end_node, &lane.end_kind, last),
        ];
        for (node, _, point) in ends
            .into_iter()
            .filter(|(_, kind, _)| *kind == "intersection")
        {
            let meeting = nodes.entry(node).or_insert_with(|| Meeting::at(*point));
            meeting.degree += 1;
            for source in &lane.sources {
                let (first, last) = (source.first_stamp, source.last_stamp);
                meeting.sources.add(&source.session, first, last);
            }
        }
    }
    let site = lanes
        .first()
        .map(|lane| lane.site.clone())
        .unwrap_or_default();
    let found = nodes.into_iter().map(|(node, meeting)| Intersection {
        site: site.clone(),
        node,
        degree: meeting.degree,
        x: meeting.point[0],
        y: meeting.point[1],
        z: meeting.point[2],
        sources: meeting.sources.into_rows(),
        geometry: Wkb::point(meeting.point),
    });
    emit.rows(found.collect())
}
