#![doc = include_str!("lane_speeds.md")]

use std::collections::BTreeMap;

use evermap_algorithms::ground::cells::along;
use evermap_contract::{Emit, Fault, Key, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::layers::{Lane, LaneSpeed, SpeedCell};

/// See the module's page.
pub struct LaneSpeeds;

impl Operator for LaneSpeeds {
    const NAME: &'static str = "lane_speeds";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("lane_speeds.md");
    type Params = NothingToChoose;
    type Output = LaneSpeed;

    fn work() -> Work<Self::Params> {
        let lanes = Port::site::<Lane>("lanes");
        let cells = Port::site::<SpeedCell>("speed_map");
        Work::group(lanes, Key::SITE, vec![cells], speeds)
    }
}

fn speeds(
    _: &NothingToChoose,
    lanes: Vec<Lane>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let cells = sides.rows::<SpeedCell>("speed_map")?;
    let cell_m = cells.first().map_or(1.0, |cell| cell.cell_m);
    let cells: BTreeMap<[i32; 2], SpeedCell> = cells
        .into_iter()
        .map(|cell| ([cell.column, cell.row], cell))
        .collect();
    let mut rows = Vec::with_capacity(lanes.len());
    for lane in lanes {
        let points: Vec<[f64; 2]> = lane.points.iter().map(|[x, y, _]| [*x, *y]).collect();
        let Some(places) = along(&points, lane.width_m / 2.0, cell_m) else {
            emit.skip("lane larger than a map", 1);
            continue;
        };
        let on_lane: Vec<&SpeedCell> = places.iter().filter_map(|at| cells.get(at)).collect();
        let mean = |value: fn(&SpeedCell) -> f64| {
            let sum: f64 = on_lane.iter().map(|cell| value(cell)).sum();
            (!on_lane.is_empty()).then(|| sum / on_lane.len() as f64)
        };
        rows.push(LaneSpeed {
            cells: on_lane.len() as u32,
            danger: mean(|cell| cell.danger),
            speed_mps: on_lane.iter().map(|cell| cell.speed_mps).reduce(f64::min),
            mean_mps: mean(|cell| cell.speed_mps),
            site: lane.site,
            lane: lane.lane,
            direction: lane.direction,
            length_m: lane.length_m,
            width_m: lane.width_m,
            geometry: lane.geometry,
        });
    }
    emit.rows(rows)
}
