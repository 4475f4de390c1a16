#![doc = include_str!("box_models.md")]

use evermap_algorithms::ground::boxes::mosaic::Mosaic;
use evermap_algorithms::ground::boxes::teaching::{Taught, TeachingParams};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{BoxModel, OverheadGradients, PlacedLabel};

use crate::inputs::boxes::{boxes, taught_mosaic};
use crate::inputs::labels::Tell;

/// See the module's page.
pub struct BoxModels;

impl Operator for BoxModels {
    const NAME: &'static str = "box_models";
    const VERSION: u32 = 10;
    const PAGE: &'static str = include_str!("box_models.md");
    type Params = TeachingParams;
    type Output = BoxModel;

    fn work() -> Work<Self::Params> {
        let labels = Port::site::<PlacedLabel>("labels");
        let gradients = Port::site::<OverheadGradients>("gradients");
        Work::group(labels, Key::SITE, vec![gradients], models)
    }
}

fn models(
    params: &TeachingParams,
    labels: Vec<PlacedLabel>,
    mut sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let mut skip = |reason, count| emit.skip(reason, count);
    let mosaic = taught_mosaic(sides.take("gradients")?, &labels, &mut skip);
    let models = learnt(params, &mosaic, &labels, &mut skip)?;
    emit.rows(models)
}

/// What the labels of a site teach about its overhead image: a model of each kind.
///
/// # Errors
/// A data fault for descriptions that nothing can be learnt from.
pub fn learnt(
    params: &TeachingParams,
    mosaic: &Mosaic,
    labels: &[PlacedLabel],
    mut skip: Tell<'_>,
) -> Result<Vec<BoxModel>, Fault> {
    let Some(site) = labels.first().map(|label| label.site.clone()) else {
        return Ok(Vec::new());
    };
    let kinds = boxes(labels, mosaic.cell_m(), &mut skip);
    let mut models = Vec::new();
    for (kind, said) in kinds {
        let taught = Taught::learn(mosaic, &said.examples, params);
        let taught = taught.map_err(|error| Fault::data(error.to_string()))?;
        let ones = said.examples.iter().filter(|one| one.is_one()).count();
        let Some(taught) = taught else {
            skip(
                "drawn box that the overhead image does not show".into(),
                ones as u64,
            );
            continue;
        };
        models.push(BoxModel {
            site: site.clone(),
            kind,
            accepted: taught.accepted,
            rejected: taught.rejected,
            sizes_m: taught.sizes_m,
            height_m: said.height_sum_m / ones.max(1) as f64,
            weights: taught.process.weights().to_vec(),
            scale: taught.process.scale(),
            noise: taught.process.noise(),
            spread: taught.process.spread(),
            middle: taught.calibration.middle,
            slope: taught.calibration.slope,
            template: taught.template.values().to_vec(),
        });
    }
    Ok(models)
}
