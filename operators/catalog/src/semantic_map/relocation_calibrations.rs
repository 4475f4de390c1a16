#![doc = include_str!("relocation_calibrations.md")]

use evermap_algorithms::semantic_map::relocation::{CalibrationOptions, ViewMap, self_search};
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
    _: &Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let classes = ClassNames::of(&views);
    let (mut graphs, mut positions) = (Vec::new(), Vec::new());
    for view in &views {
        let taken = position(view).ok_or("nothing says where the view was taken");
        match taken.and_then(|taken| Ok((taken, classes.graph(&view.graph)?))) {
            Ok((taken, graph)) => {
                positions.push(taken);
                graphs.push(graph);
            }
            Err(reason) => emit.skip(reason, 1),
        }
    }
    let map = ViewMap::new(graphs.iter(), params.comparison.options(&classes));
    let Some(first) = views.first() else {
        return Ok(());
    };
    let Some(found) = self_search(&map, &graphs, &positions, &params.learning) else {
        emit.skip(
            "no view of the drive has one of its place and one of another to be compared with",
            graphs.len() as u64,
        );
        return Ok(());
    };
    emit.rows(vec![RelocationCalibration {
        site: first.site.clone(),
        session: first.session.clone(),
        camera: first.camera.clone(),
        within_m: params.learning.within_m,
        queries: found.queries,
        recall: found.recall,
        middle: found.calibration.map(|learnt| learnt.middle),
        slope: found.calibration.map(|learnt| learnt.slope),
    }])
}
