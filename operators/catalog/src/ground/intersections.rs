#![doc = include_str!("intersections.md")]

use std::collections::BTreeMap;

use evermap_contract::{Emit, Fault, Key, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::Wkb;
use evermap_schemas::layers::{Intersection, Lane, Sources};

/// See the module's page.
pub struct Intersections;

impl Operator for Intersections {
    const NAME: &'static str = "intersections";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("intersections.md");
    type Params = NothingToChoose;
    type Output = Intersection;

    fn work() -> Work<Self::Params> {
        let lanes = Port::site::<Lane>("lanes");
        Work::group(lanes, Key::SITE, vec![], intersections)
    }
}

fn intersections(
    _: &NothingToChoose,
    lanes: Vec<Lane>,
    _: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let mut nodes: BTreeMap<u32, Intersection> = BTreeMap::new();
    let mut sources: BTreeMap<u32, Sources> = BTreeMap::new();
    for lane in &lanes {
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
            let meeting = nodes
                .entry(node)
                .or_insert_with(|| unmet(&lane.site, node, *point));
            meeting.degree += 1;
            let sources = sources.entry(node).or_default();
            for source in &lane.sources {
                let (first, last) = (source.first_stamp, source.last_stamp);
                sources.add(&source.session, first, last);
            }
        }
    }
    let met = nodes.into_values().zip(sources.into_values());
    let met = met.map(|(meeting, sources)| Intersection {
        sources: sources.into_rows(),
        ..meeting
    });
    emit.rows(met.collect())
}

/// A place where no lane ends yet.
fn unmet(site: &str, node: u32, point: [f64; 3]) -> Intersection {
    let [x, y, z] = point;
    Intersection {
        site: site.to_owned(),
        node,
        degree: 0,
        x,
        y,
        z,
        sources: Vec::new(),
        geometry: Wkb::point(point),
    }
}
