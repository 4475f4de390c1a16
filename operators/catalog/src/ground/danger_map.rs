#![doc = include_str!("danger_map.md")]

use std::collections::BTreeMap;

use evermap_algorithms::ground::cells::middle;
use evermap_algorithms::ground::danger::field::Weights;
use evermap_algorithms::solving::least_squares::SystemError;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{Danger, DangerSetting, Exposure, GroundPrior};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::danger::{OTHER, ports, site_ground, too_large};

/// See the module's page.
pub struct DangerMap;

/// There is nothing to choose: `danger_settings` does.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
pub struct DangerMapParams {}

impl Operator for DangerMap {
    const NAME: &'static str = "danger_map";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("danger_map.md");
    type Params = DangerMapParams;
    type Output = Danger;

    fn work() -> Work<Self::Params> {
        let exposure = Port::site::<Exposure>("exposure");
        let mut sides = ports();
        sides.push(Port::site::<DangerSetting>("settings"));
        Work::group(exposure, Key::SITE, sides, danger)
    }
}

fn danger(
    _: &DangerMapParams,
    exposure: Vec<Exposure>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let settings = sides.rows::<DangerSetting>("settings")?.into_iter().next();
    let settings = settings.ok_or_else(|| {
        Fault::data("expected the site's settings, found none").next("connect danger_settings")
    })?;
    let weights = Weights {
        prior_looks: settings.prior_looks,
        tie_looks: settings.tie_looks,
    };
    let by_kind = settings.priors.into_iter();
    let by_kind: BTreeMap<String, GroundPrior> =
        by_kind.map(|prior| (prior.kind.clone(), prior)).collect();
    if !by_kind.contains_key(OTHER) {
        let fault = format!("expected settings with a prior of {OTHER}, found none");
        return Err(Fault::data(fault).next("connect danger_settings"));
    }
    let priors: Vec<f64> = by_kind.values().map(|prior| prior.probability).collect();
    let expected = by_kind.into_iter();
    let expected: BTreeMap<String, f64> = expected
        .map(|(kind, prior)| (kind, prior.expected))
        .collect();
    let mut of_site = site_ground(&expected, exposure, &sides, emit)?;
    let all = of_site.ground.all();
    let danger = of_site.ground.danger(&all, &priors, weights);
    let danger = danger.ok_or_else(|| too_large(SystemError::TooLarge))?;
    let (ground, cell_m) = (&of_site.ground, of_site.cell_m);
    let seen = ground.seen(&all);
    let cells = ground.field.cells().iter().zip(danger).enumerate();
    let row = |(index, ([column, row], danger)): (usize, (&[i32; 2], f64))| {
        let kind = ground.kinds[index];
        let [x, y] = middle([*column, *row], cell_m);
        Danger {
            site: of_site.site.clone(),
            column: *column,
            row: *row,
            cell_m,
            x,
            y,
            ground: of_site.names[kind].clone(),
            looks: seen[index].looks,
            people: seen[index].people,
            prior: priors[kind],
            danger,
        }
    };
    emit.rows(cells.map(row).collect())
}
