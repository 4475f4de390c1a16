//! What danger maps are made from: looks at cells, people found, kinds of ground.

use std::collections::BTreeMap;

use evermap_algorithms::ground::cells::{Cell, along, in_polygon};
use evermap_algorithms::ground::danger::DangerField;
use evermap_algorithms::ground::danger::exposure::look_ns;
use evermap_algorithms::ground::danger::field::LookCounts;
use evermap_algorithms::ground::danger::foretelling::{Ground, Visit};
use evermap_algorithms::ground::danger::presence::{FoundPerson, presence};
use evermap_algorithms::solving::least_squares::SystemError;
use evermap_contract::{Emit, Fault, Port, Sides};
use evermap_schemas::Stamp;
use evermap_schemas::layers::{Exposure, Lane, PersonOnGround, PlacedLabel};

/// Ground on which vehicles drove.
pub(crate) const LANE: &str = "lane";
/// Ground of which nothing is known.
pub(crate) const OTHER: &str = "other";

/// The sides beside `exposure`, which drives.
pub(crate) fn ports() -> Vec<Port> {
    vec![
        Port::site::<PersonOnGround>("people_on_ground").optional(),
        Port::site::<PlacedLabel>("labels").optional(),
        Port::site::<Lane>("lanes").optional(),
    ]
}

/// A site's ground, and what columns of layers say of it.
pub(crate) struct SiteGround {
    pub(crate) site: String,
    pub(crate) cell_m: f64,
    /// Names of the kinds, as [`Ground::kinds`] counts them.
    pub(crate) names: Vec<String>,
    pub(crate) ground: Ground,
}

/// The ground that `exposure` looked at, and that labels and lanes lie on. `expected` is the probability of a person by kind
/// of ground; kinds that it does not name are no kinds.
///
/// # Errors
/// A data fault for exposure with several sizes of cells or looks, or for more cells than fit.
pub(crate) fn site_ground(
    expected: &BTreeMap<String, f64>,
    exposure: Vec<Exposure>,
    sides: &Sides,
    emit: &mut Emit<'_>,
) -> Result<SiteGround, Fault> {
    let first = &exposure[0];
    let (site, cell_m, look_s) = (first.site.clone(), first.cell_m, first.look_s);
    let alike = |row: &Exposure| row.cell_m == cell_m && row.look_s == look_s;
    if !(exposure.iter().all(alike) && cell_m > 0.0 && look_s > 0.0) {
        let found = "exposure whose cells or looks differ";
        return Err(Fault::data(format!(
            "expected exposure of one cell_m and one look_s, found {found}"
        )));
    }
    let named = kinds_of_cells(expected, sides, cell_m, emit)?;
    let mut found = found_people(sides)?;
    let mut cells: Vec<Cell> = exposure.iter().map(|row| [row.column, row.row]).collect();
    cells.extend(named.keys());
    cells.sort_unstable();
    cells.dedup();
    let mut visits = Vec::new();
    for (session, looks) in by_visit(exposure) {
        let of_session = found.remove(&session).unwrap_or_default();
        let (people, senseless) = presence(&of_session, cell_m, look_ns(look_s));
        emit.skip("person without a finite position", senseless);
        visits.push(visit(&cells, &looks, &people));
    }
    let unseen = found.values().map(Vec::len).sum::<usize>();
    emit.skip("person in a session that looked at nothing", unseen as u64);
    let names: Vec<String> = expected.keys().cloned().collect();
    let other = names.iter().position(|name| name == OTHER).unwrap_or(0);
    let kinds = cells.iter().map(|cell| *named.get(cell).unwrap_or(&other));
    let ground = Ground {
        kinds: kinds.collect(),
        field: DangerField::new(cells).map_err(too_large)?,
        expected: expected.values().copied().collect(),
        visits,
    };
    Ok(SiteGround {
        site,
        cell_m,
        names,
        ground,
    })
}

/// A fault for a system that cannot be solved.
pub(crate) fn too_large(error: SystemError) -> Fault {
    Fault::resource(error.to_string()).next("make cells larger: cell_m of exposure")
}

type Looks = BTreeMap<Cell, u32>;

/// Looks by session, in the order of the sessions' first images.
fn by_visit(exposure: Vec<Exposure>) -> Vec<(String, Looks)> {
    let mut sessions: BTreeMap<String, (Stamp, Looks)> = BTreeMap::new();
    for row in exposure {
        let first = (row.first_stamp, Looks::new());
        let of_session = sessions.entry(row.session).or_insert(first);
        of_session.0 = of_session.0.min(row.first_stamp);
        of_session.1.insert([row.column, row.row], row.looks);
    }
    let mut visits: Vec<_> = sessions.into_iter().collect();
    visits.sort_by_key(|(_, (stamp, _))| *stamp);
    let visit = |(session, (_, looks))| (session, looks);
    visits.into_iter().map(visit).collect()
}

/// What a visit saw. Where it did not look, nobody is held to have been: that is the rim of a position's uncertainty.
fn visit(cells: &[Cell], looks: &Looks, people: &BTreeMap<Cell, f64>) -> Visit {
    let seen = |(cell, looks): (&Cell, &u32)| {
        let people = people.get(cell).copied().unwrap_or(0.0);
        let seen = LookCounts {
            looks: f64::from(*looks).max(people),
            people,
        };
        Some((cells.binary_search(cell).ok()?, seen))
    };
    looks.iter().filter_map(seen).collect()
}

fn found_people(sides: &Sides) -> Result<BTreeMap<String, Vec<FoundPerson>>, Fault> {
    let mut by_session: BTreeMap<String, Vec<FoundPerson>> = BTreeMap::new();
    for row in sides.rows::<PersonOnGround>("people_on_ground")? {
        let person = FoundPerson {
            stamp: row.stamp.0,
            position: [row.x, row.y],
            covariance: [row.var_x_m2, row.cov_xy_m2, row.var_y_m2],
            probability: row.probability,
        };
        by_session.entry(row.session).or_default().push(person);
    }
    Ok(by_session)
}

/// Cells that labels cover at most, all together: so many are solved in seconds (BENCHMARKS.md). Of half a metre they are
/// 26 hectares.
const MOST_CELLS_OF_LABELS: usize = 1 << 20;

/// The kind of each cell that a label or a lane is on; where several are, the one where people are expected most, and of equal
/// ones the first by name.
fn kinds_of_cells(
    expected: &BTreeMap<String, f64>,
    sides: &Sides,
    cell_m: f64,
    emit: &mut Emit<'_>,
) -> Result<BTreeMap<Cell, usize>, Fault> {
    let kinds: BTreeMap<&str, (usize, f64)> = expected
        .iter()
        .enumerate()
        .map(|(index, (name, expected))| (name.as_str(), (index, *expected)))
        .collect();
    let rates: Vec<f64> = expected.values().copied().collect();
    let mut named: BTreeMap<Cell, usize> = BTreeMap::new();
    let mut lay = |cells: Vec<Cell>, (kind, rate): (usize, f64)| {
        for cell in cells {
            let known = named.entry(cell).or_insert(kind);
            if (rate, *known) > (rates[*known], kind) {
                *known = kind;
            }
        }
    };
    let mut room = MOST_CELLS_OF_LABELS;
    for label in sides.rows::<PlacedLabel>("labels")? {
        let area = label.shape != "polyline" && label.standing != "rejected";
        if let (Some(kind), true) = (kinds.get(label.kind.as_str()), area) {
            let corners: Vec<[f64; 2]> = label.points.iter().map(|[x, y, _]| [*x, *y]).collect();
            match in_polygon(&corners, cell_m) {
                Some(cells) if cells.len() <= room => {
                    room -= cells.len();
                    lay(cells, *kind);
                }
                Some(_) => emit.skip("label of more ground than a map has room for", 1),
                None => emit.skip("label larger than a map", 1),
            }
        }
    }
    if let Some(kind) = kinds.get(LANE) {
        for lane in sides.rows::<Lane>("lanes")? {
            let points: Vec<[f64; 2]> = lane.points.iter().map(|[x, y, _]| [*x, *y]).collect();
            match along(&points, lane.width_m / 2.0, cell_m) {
                Some(cells) => lay(cells, *kind),
                None => emit.skip("lane larger than a map", 1),
            }
        }
    }
    Ok(named)
}
