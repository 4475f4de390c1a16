#![doc = include_str!("space_occupancy.md")]

use std::collections::{BTreeMap, BTreeSet};

use evermap_algorithms::ground::boxes::occupancy::{
    Obstacles, Occupancy, OccupancyParams, Space, occupancy,
};
use evermap_algorithms::ground::boxes::rows::{LaneLine, entered_at};
use evermap_algorithms::ground::cells::{Cell, cell_of};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{Exposure, Lane, ParkingSpace, SpaceOccupancy, SurfacePoint};

use crate::inputs::boxes::{ground_box, lane_line};

/// See the module's page.
pub struct SpacesOccupied;

impl Operator for SpacesOccupied {
    const NAME: &'static str = "space_occupancy";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("space_occupancy.md");
    type Params = OccupancyParams;
    type Output = SpaceOccupancy;

    fn work() -> Work<Self::Params> {
        let exposure = Port::session::<Exposure>("exposure");
        let sides = vec![
            Port::session::<SurfacePoint>("points"),
            Port::site::<ParkingSpace>("spaces"),
            Port::site::<Lane>("lanes").optional(),
        ];
        Work::group(exposure, Key::SESSION, sides, occupied)
    }
}

fn occupied(
    params: &OccupancyParams,
    exposure: Vec<Exposure>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let first = &exposure[0];
    let (site, session, cell_m) = (first.site.clone(), first.session.clone(), first.cell_m);
    if !(cell_m > 0.0 && cell_m.is_finite()) {
        emit.skip("cell has no size", exposure.len() as u64);
        return Ok(());
    }
    let seen = exposure.iter().filter(|cell| cell.looks > 0);
    let seen: BTreeSet<Cell> = seen.map(|cell| [cell.column, cell.row]).collect();
    let looked = |point| cell_of(point, cell_m).is_some_and(|cell| seen.contains(&cell));
    let points: Vec<SurfacePoint> = sides.rows("points")?;
    let points = points
        .iter()
        .map(|point| ([point.x, point.y], point.height_m));
    let obstacles = Obstacles::new(points, params);
    let lanes: Vec<Lane> = sides.rows("lanes")?;
    let lanes = lanes.iter().map(|lane| (lane.lane, lane_line(lane)));
    let lanes: BTreeMap<u32, LaneLine> = lanes.collect();
    let mut numbers = Vec::new();
    let mut places = Vec::new();
    for space in sides.rows::<ParkingSpace>("spaces")? {
        let place = ground_box(&space.map_from_space, space.length_m, space.width_m);
        match place {
            Some(place) => {
                let lane = space.lane.and_then(|lane| lanes.get(&lane));
                let entry = lane.and_then(|lane| entered_at(&place, lane));
                numbers.push(space.space);
                places.push(Space::new(&place, entry));
            }
            None => emit.skip("parking space is not a box", 1),
        }
    }
    let found = occupancy(&places, &obstacles, cell_m, looked);
    let row = |(space, found): (u32, Occupancy)| SpaceOccupancy {
        site: site.clone(),
        session: session.clone(),
        space,
        state: state(&found).to_owned(),
        taken: found.taken,
        standing: found.standing,
        looked: found.looked,
    };
    emit.rows(numbers.into_iter().zip(found).map(row).collect())
}

fn state(found: &Occupancy) -> &'static str {
    match found.taken {
        None => "unseen",
        Some(taken) if taken < 0.5 => "free",
        Some(_) => "taken",
    }
}
