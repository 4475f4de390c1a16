#![doc = include_str!("overhead_gradients.md")]

use evermap_contract::{Emit, Fault, Key, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::layers::{OverheadGradients, OverheadTile};

use crate::inputs::boxes::tile_gradients;

/// See the module's page.
pub struct GradientsOfTiles;

impl Operator for GradientsOfTiles {
    const NAME: &'static str = "overhead_gradients";
    const VERSION: u32 = 3;
    const PAGE: &'static str = include_str!("overhead_gradients.md");
    type Params = NothingToChoose;
    type Output = OverheadGradients;

    fn work() -> Work<Self::Params> {
        let tiles = Port::site::<OverheadTile>("tiles");
        let previous = Port::site::<OverheadGradients>("previous").optional();
        Work::group(tiles, Key::SITE, vec![previous], gradients)
    }
}

fn gradients(
    _: &NothingToChoose,
    tiles: Vec<OverheadTile>,
    mut sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let known = sides.take("previous")?;
    let (rows, _) = tile_gradients(tiles, known, &mut |reason, count| emit.skip(reason, count))?;
    emit.rows(rows)
}
