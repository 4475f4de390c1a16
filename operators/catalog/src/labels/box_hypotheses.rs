#![doc = include_str!("box_hypotheses.md")]

use evermap_algorithms::ground::boxes::calibration::Calibration;
use evermap_algorithms::ground::boxes::teaching::{Hypothesis, Taught};
use evermap_algorithms::ground::boxes::template::Template;
use evermap_algorithms::learning::gaussian_process::LinearProcess;
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::Wkb;
use evermap_schemas::layers::{BoxHypothesis, BoxModel, OverheadTile, PlacedLabel};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::boxes::{LONGEST_M, boxes, mosaic, pose};

/// See the module's page.
pub struct BoxHypotheses;

/// There is nothing to choose.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
pub struct BoxHypothesesParams {}

impl Operator for BoxHypotheses {
    const NAME: &'static str = "box_hypotheses";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("box_hypotheses.md");
    type Params = BoxHypothesesParams;
    type Output = BoxHypothesis;

    fn work() -> Work<Self::Params> {
        let models = Port::site::<BoxModel>("models");
        let sides = vec![
            Port::site::<OverheadTile>("tiles"),
            Port::site::<PlacedLabel>("labels"),
        ];
        Work::group(models, Key::SITE, sides, hypotheses)
    }
}

fn hypotheses(
    _: &BoxHypothesesParams,
    models: Vec<BoxModel>,
    sides: &Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let mut skip = |reason, count| emit.skip(reason, count);
    let mosaic = mosaic(sides.rows("tiles")?, &mut skip);
    let labels: Vec<PlacedLabel> = sides.rows("labels")?;
    let mut kinds = boxes(&labels, mosaic.cell_m(), &mut |_, _| {});
    for model in models {
        let (site, kind, height_m) = (model.site.clone(), model.kind.clone(), model.height_m);
        let Some(taught) = taught(model) else {
            emit.skip("model does not have the numbers that it claims", 1);
            continue;
        };
        let said = kinds.remove(&kind).unwrap_or_default();
        let found = taught.find(&mosaic, &said.examples);
        let row = |(number, one): (u32, Hypothesis)| BoxHypothesis {
            site: site.clone(),
            kind: kind.clone(),
            hypothesis: number,
            map_from_label: pose(&one.place, height_m),
            length_m: one.place.length_m,
            width_m: one.place.width_m,
            mean: one.mean,
            variance: one.variance,
            probability: one.probability,
            question: one.question.map(|question| question.number as u32),
            gain: one.question.map(|question| question.gain),
            geometry: Wkb::polygon(&one.place.corners()),
        };
        emit.rows((0..).zip(found).map(row).collect())?;
    }
    Ok(())
}

/// What was learnt; `None` where the row's numbers contradict each other.
fn taught(row: BoxModel) -> Option<Taught> {
    let is_size = |[length_m, width_m]: &[f64; 2]| {
        let sides = [*length_m, *width_m];
        sides.iter().all(|side| (0.01..=LONGEST_M).contains(side))
    };
    let is_sound = !row.sizes_m.is_empty()
        && row.sizes_m.iter().all(is_size)
        && row.middle.is_finite()
        && row.slope.is_finite()
        && row.height_m.is_finite();
    let taught = Taught {
        process: LinearProcess::from_parts(row.weights, [row.scale, row.noise], &row.spread)?,
        calibration: Calibration {
            middle: row.middle,
            slope: row.slope,
        },
        template: Template::from_values(row.template)?,
        sizes_m: row.sizes_m,
        accepted: row.accepted,
        rejected: row.rejected,
    };
    (is_sound && taught.is_sound()).then_some(taught)
}
