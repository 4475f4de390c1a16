#![doc = include_str!("overhead_tiles.md")]

use std::collections::BTreeMap;

use evermap_algorithms::ground::channels::Channels;
use evermap_algorithms::ground::patch::Patch;
use evermap_algorithms::ground::tiles::{TILE_CELLS, TileKey, TileOverflow, TileSum};
use evermap_contract::{Emit, Fault, Fold, Operator, Port, Sides, Work};
use evermap_schemas::layers::{GroundPatch, OverheadTile, Sources};
use evermap_schemas::{Bytes, Wkb};
use png::ColorType;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::tiles::encoded;

/// See the module's page.
pub struct OverheadTiles;

/// Which tiles are made.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct OverheadTilesParams {
    /// Number of zoom levels; each has cells twice as large as the one before. With cells of 0.05 m, five end at 0.8 m: a
    /// tile of 205 m, a car park on one page.
    #[schemars(range(min = 1, max = 16))]
    pub zooms: u8,
}

impl Default for OverheadTilesParams {
    fn default() -> Self {
        Self { zooms: 5 }
    }
}

impl Operator for OverheadTiles {
    const NAME: &'static str = "overhead_tiles";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("overhead_tiles.md");
    type Params = OverheadTilesParams;
    type Output = OverheadTile;

    fn work() -> Work<Self::Params> {
        Work::fold::<Tiles>(Port::session::<GroundPatch>("patches"), vec![])
    }
}

struct Tiles {
    zooms: u8,
}

/// What is accumulated for one tile.
#[derive(Serialize, Deserialize)]
struct TileState {
    /// Side of a cell at zoom 0 (m).
    cell_m: f64,
    /// The sums, at the tile's own zoom.
    sums: TileSum,
    /// The images that added to them.
    sources: Sources,
}

impl TileState {
    fn new(cell_m: f64) -> Self {
        Self {
            cell_m,
            sums: TileSum::new(),
            sources: Sources::default(),
        }
    }

    /// What cells of this size may be added to.
    fn of_cells(&mut self, cell_m: f64) -> Result<&mut Self, Fault> {
        let known = self.cell_m;
        if known == cell_m {
            return Ok(self);
        }
        let fault = format!("expected patches of one cell size, found {known} m and {cell_m} m");
        Err(Fault::data(fault).next("make one mosaic for each"))
    }

    fn merge(&mut self, other: &Self) -> Result<(), Fault> {
        let Self { sums, sources, .. } = self.of_cells(other.cell_m)?;
        for (session, first, last) in other.sources.iter() {
            sources.add(session, first, last);
        }
        sums.merge(&other.sums).map_err(overflow)
    }
}

fn overflow(error: TileOverflow) -> Fault {
    Fault::data(error.to_string())
}

impl Fold for Tiles {
    type Params = OverheadTilesParams;
    type Row = GroundPatch;
    type Key = TileKey;
    type State = TileState;
    type Output = OverheadTile;

    fn prepare(params: &OverheadTilesParams, _: &Sides) -> Result<Self, Fault> {
        Ok(Self {
            zooms: params.zooms,
        })
    }

    fn lift(
        &self,
        patches: Vec<GroundPatch>,
        states: &mut BTreeMap<TileKey, TileState>,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        for mut row in patches {
            let Some(mut patch) = patch(&mut row) else {
                emit.skip("patch does not have the size that it claims", 1);
                continue;
            };
            for zoom in 0..self.zooms {
                if zoom > 0 {
                    patch = patch.halved();
                }
                for piece in patch.pieces() {
                    let (x, y) = (piece.x, piece.y);
                    let state = states.entry(TileKey { zoom, x, y });
                    let state = state.or_insert_with(|| TileState::new(row.cell_m));
                    let state = state.of_cells(row.cell_m)?;
                    state.sources.add(&row.session, row.stamp, row.stamp);
                    piece.add_to(&mut state.sums).map_err(overflow)?;
                }
            }
        }
        Ok(())
    }

    fn merge(&self, states: Vec<TileState>) -> Result<TileState, Fault> {
        let mut states = states.into_iter();
        let first = states.next();
        let mut merged = first.ok_or_else(|| Fault::bug("merge of no states"))?;
        states.try_for_each(|state| merged.merge(&state))?;
        Ok(merged)
    }

    fn finish(
        &self,
        site: &str,
        key: &TileKey,
        state: TileState,
    ) -> Result<Option<OverheadTile>, Fault> {
        let weights = state.sums.weights();
        let (covered, weight) = weights.fold((0_u32, 0_u64), |(covered, sum), weight| {
            (covered + 1, sum + u64::from(weight))
        });
        if covered == 0 {
            return Ok(None);
        }
        let cell_m = key.cell_m(state.cell_m);
        let [west, south, east, north] = key.footprint_m(state.cell_m);
        let corners = [[west, south], [east, south], [east, north], [west, north]];
        Ok(Some(OverheadTile {
            site: site.to_owned(),
            zoom: u32::from(key.zoom),
            tile_x: key.x as i32,
            tile_y: key.y as i32,
            cell_m,
            size_m: cell_m * TILE_CELLS as f64,
            covered,
            mean_weight: weight as f64 / f64::from(covered),
            png: Bytes(picture(&state.sums)?),
            sources: state.sources.into_rows(),
            geometry: Wkb::polygon(&corners),
        }))
    }

    fn state_bytes(&self, state: &TileState) -> usize {
        let sources = state.sources.iter();
        let sources = sources.map(|source| size_of_val(&source) + source.0.len());
        state.sums.bytes() + sources.sum::<usize>()
    }
}

/// Takes the row's bytes; `None` where its numbers contradict each other.
fn patch(row: &mut GroundPatch) -> Option<Patch> {
    let patch = Patch {
        column: i64::from(row.column),
        row: i64::from(row.row),
        width: row.width as usize,
        height: row.height as usize,
        values: std::mem::take(&mut row.values.0),
        weights: std::mem::take(&mut row.weights.0),
    };
    let sound = patch.is_sound() && row.cell_m.is_finite() && row.cell_m > 0.0;
    sound.then_some(patch)
}

/// Grey or in colour, with alpha, the northernmost row first.
fn picture(sums: &TileSum) -> Result<Vec<u8>, Fault> {
    let tile = sums.finish();
    let count = tile.channels.count();
    let values = tile.values.chunks(count * TILE_CELLS);
    let rows = values.zip(tile.coverage.chunks(TILE_CELLS)).rev();
    let mut pixels = Vec::with_capacity((count + 1) * tile.coverage.len());
    for (values, coverage) in rows {
        for (shown, coverage) in values.chunks(count).zip(coverage) {
            pixels.extend_from_slice(shown);
            pixels.push(if *coverage > 0 { 255 } else { 0 });
        }
    }
    let channels = match tile.channels {
        Channels::Grey => ColorType::GrayscaleAlpha,
        Channels::Colour => ColorType::Rgba,
    };
    encoded(channels, &pixels)
}
