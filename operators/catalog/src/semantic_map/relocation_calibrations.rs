#![doc = include_str!("relocation_calibrations.md")]

use evermap_algorithms::semantic_map::relocation::{CalibrationOptions, ViewMap, self_search};
use evermap_algorithms::semantic_map::semantic_graph::Graph;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{RelocationCalibration, View};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::graphs::{ClassNames, Comparison, position};

/// See the module's page.
pub struct RelocationCalibrations;

/// How views are compared, as `relocations` does it, and what is learnt from.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct RelocationCalibrationsParams {
    /// How two views are compared.
    #[serde(flatten)]
    pub comparison: Comparison,
    /// What is learnt from.
    #[serde(flatten)]
    pub learning: CalibrationOptions,
}

impl Operator for RelocationCalibrations {
    const NAME: &'static str = "relocation_calibrations";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("relocation_calibrations.md");
    type Params = RelocationCalibrationsParams;
    type Output = RelocationCalibration;

    fn work() -> Work<Self::Params> {
        let views = Port::session::<View>("views");
        Work::group(views, Key::CAMERA, vec![], calibration)
    }
}

fn calibration(
    params: &RelocationCalibrationsParams,
    views: Vec<View>,
    _: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let first = &views[0];
    let classes = ClassNames::of(&views);
    let placed = views
        .iter()
        .filter_map(|view| Some((position(view)?, classes.graph(&view.graph).ok()?)));
    let (positions, graphs): (Vec<_>, Vec<Graph>) = placed.unzip();
    let map = ViewMap::new(graphs.iter(), params.comparison.options(&classes));
    let found = self_search(&map, &graphs, &positions, &params.learning);
    let learnt = found.and_then(|found| found.calibration);
    emit.rows(vec![RelocationCalibration {
        site: first.site.clone(),
        session: first.session.clone(),
        camera: first.camera.clone(),
        within_m: params.learning.within_m,
        views: positions.len() as u32,
        queries: found.map_or(0, |found| found.queries),
        recall: found.map(|found| found.recall),
        middle: learnt.map(|learnt| learnt.middle),
        slope: learnt.map(|learnt| learnt.slope),
    }])
}
