#![doc = include_str!("placed_labels.md")]

use evermap_contract::{Emit, Fault, Key, Operator, Port, Sides, Work};
use evermap_schemas::layers::{LabelAnchor, MapFrame, PlacedLabel, VehiclePose};

use crate::inputs::labels::{Placer, PlacingParams};

/// See the module's page.
pub struct PlacedLabels;

impl Operator for PlacedLabels {
    const NAME: &'static str = "placed_labels";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("placed_labels.md");
    type Params = PlacingParams;
    type Output = PlacedLabel;

    fn work() -> Work<Self::Params> {
        let labels = Port::site::<LabelAnchor>("labels");
        let sides = vec![
            Port::site::<VehiclePose>("poses"),
            Port::site::<MapFrame>("frames").optional(),
            Port::site::<PlacedLabel>("previous").optional(),
        ];
        Work::group(labels, Key::SITE, sides, place)
    }
}

fn place(
    params: &PlacingParams,
    labels: Vec<LabelAnchor>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let (poses, frames) = (sides.rows("poses")?, sides.rows("frames")?);
    let placer = Placer::new(poses, frames, sides.rows("previous")?, params);
    let mut placed = Vec::with_capacity(labels.len());
    for label in labels {
        let found = placer.placed(label, &mut |reason, count| emit.skip(reason, count));
        match found {
            // It is told, and stays in `labels`, so that a person can remove it.
            Some(label) if placer.is_far(&label.points) => {}
            Some(label) => placed.push(label),
            None => emit.skip("label whose pose is not a rigid transform", 1),
        }
    }
    emit.rows(placed)
}
