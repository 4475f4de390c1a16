#![doc = include_str!("speed_map.md")]

use evermap_algorithms::ground::danger::speed::SpeedParams;
use evermap_contract::{Fault, Operator, Port, Reason, Work};
use evermap_schemas::layers::{Danger, SpeedCell};

/// See the module's page.
pub struct SpeedMap;

impl Operator for SpeedMap {
    const NAME: &'static str = "speed_map";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("speed_map.md");
    type Params = SpeedParams;
    type Output = SpeedCell;

    fn work() -> Work<Self::Params> {
        let danger = Port::site::<Danger>("danger_map");
        Work::each_row(danger, vec![], |params, _| Ok(*params), speed)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        let checked = params.check();
        checked.map_err(|error| Fault::user(error.to_string()))
    }
}

fn speed(params: &SpeedParams, cell: Danger) -> Result<[SpeedCell; 1], Reason> {
    if !(0.0..=1.0).contains(&cell.danger) {
        return Err("danger outside of 0 to 1".into());
    }
    Ok([SpeedCell {
        speed_mps: params.speed(cell.danger, cell.cell_m),
        max_mps: params.max_mps,
        site: cell.site,
        column: cell.column,
        row: cell.row,
        cell_m: cell.cell_m,
        x: cell.x,
        y: cell.y,
        danger: cell.danger,
    }])
}
