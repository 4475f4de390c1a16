#![doc = include_str!("overhead_tiles.md")]

mod state;

use std::collections::BTreeMap;

use arrow::array::RecordBatch;
use evermap_algorithms::ground::tiles::{TILE_CELLS, TileKey, TileSum};
use evermap_contract::{Emit, Fault, Fold, Grain, Kernel, Operator, Port, Sides, fold};
use evermap_schemas::layers::{GroundPatch, OverheadTile, Sources};
use evermap_schemas::{Bytes, Wkb, rows};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use state::TileState;

/// See the module's page.
pub struct OverheadTiles;

/// Which tiles are made.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OverheadTilesParams {
    /// Number of zoom levels, 1 to 16; each has cells twice as large as the one before.
    pub zooms: u8,
}

impl Default for OverheadTilesParams {
    fn default() -> Self {
        Self { zooms: 5 }
    }
}

impl Operator for OverheadTiles {
    const NAME: &'static str = "overhead_tiles";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("overhead_tiles.md");
    type Params = OverheadTilesParams;
    type Output = OverheadTile;

    fn ports() -> Vec<Port> {
        vec![Port::of::<GroundPatch>("patches", Grain::Row)]
    }

    fn kernel(params: OverheadTilesParams) -> Result<Kernel, Fault> {
        if !(1..=16).contains(&params.zooms) {
            return Err(Fault::user(format!(
                "expected 1 to 16 zooms, found {}",
                params.zooms
            )));
        }
        Ok(fold(Tiles {
            zooms: params.zooms,
        }))
    }
}

struct Tiles {
    zooms: u8,
}

/// A tile's place within its site. The order of fields is the order of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
struct Place {
    zoom: u8,
    x: i32,
    y: i32,
}

impl Place {
    fn key(self) -> TileKey {
        TileKey {
            zoom: self.zoom,
            x: i64::from(self.x),
            y: i64::from(self.y),
        }
    }
}

impl Fold for Tiles {
    type Key = Place;
    type State = TileState;
    type Row = OverheadTile;

    fn lift(
        &self,
        batch: &RecordBatch,
        _: &Sides,
        states: &mut BTreeMap<(String, Place), TileState>,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        for mut patch in rows::<GroundPatch>(batch)? {
            let Some(mut look) = Look::of(&mut patch) else {
                emit.skip("patch does not have the size that it claims", 1);
                continue;
            };
            look.add(0, &patch, states)?;
            for zoom in 1..self.zooms {
                look = look.halved();
                look.add(zoom, &patch, states)?;
            }
        }
        Ok(())
    }

    fn merge(&self, into: &mut TileState, from: TileState) -> Result<(), Fault> {
        same_cells(into.cell_m, from.cell_m)?;
        for (session, first, last) in from.sources.iter() {
            into.sources.add(session, first, last);
        }
        into.sums
            .merge(&from.sums)
            .map_err(|error| Fault::data(error.to_string()))
    }

    fn finish(
        &self,
        site: &str,
        place: &Place,
        TileState {
            cell_m,
            sums,
            sources,
        }: TileState,
    ) -> Result<Option<OverheadTile>, Fault> {
        let weights = sums.cells().iter().enumerate().map(|(at, _)| {
            let (_, weight) = sums.get(at % TILE_CELLS, at / TILE_CELLS);
            u64::from(weight)
        });
        let (covered, weight) = weights
            .filter(|weight| *weight > 0)
            .fold((0_u32, 0_u64), |(covered, sum), weight| {
                (covered + 1, sum + weight)
            });
        if covered == 0 {
            return Ok(None);
        }
        let [west, south, east, north] = place.key().footprint_m(cell_m);
        let corners = [[west, south], [east, south], [east, north], [west, north]];
        Ok(Some(OverheadTile {
            site: site.to_owned(),
            zoom: u32::from(place.zoom),
            tile_x: place.x,
            tile_y: place.y,
            cell_m: place.key().cell_m(cell_m),
            size_m: place.key().cell_m(cell_m) * TILE_CELLS as f64,
            covered,
            mean_weight: weight as f64 / f64::from(covered),
            png: Bytes(picture(&sums)?),
            sources: sources.into_rows(),
            geometry: Wkb::polygon(&corners),
        }))
    }

    fn state_bytes(&self, state: &TileState) -> usize {
        let sources = state.sources.iter();
        let sources = sources.map(|source| size_of_val(&source) + source.0.len());
        size_of_val(state.sums.cells()) + sources.sum::<usize>()
    }
}

fn same_cells(a: f64, b: f64) -> Result<(), Fault> {
    if a == b {
        return Ok(());
    }
    Err(Fault::data(format!(
        "expected patches of one cell size, found {a} m and {b} m"
    ))
    .next("make one mosaic for each"))
}

/// Grey with alpha, the northernmost row first. The encoder's settings are fixed: equal tiles are equal bytes.
fn picture(sums: &TileSum) -> Result<Vec<u8>, Fault> {
    let tile = sums.finish();
    let (grey, coverage) = (
        tile.grey.chunks(TILE_CELLS),
        tile.coverage.chunks(TILE_CELLS),
    );
    let pixels: Vec<u8> = grey
        .zip(coverage)
        .rev()
        .flat_map(|(grey, coverage)| grey.iter().zip(coverage))
        .flat_map(|(grey, coverage)| [*grey, if *coverage > 0 { 255 } else { 0 }])
        .collect();
    encode(&pixels).map_err(|error| Fault::bug(format!("a tile does not encode: {error}")))
}

fn encode(pixels: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, TILE_CELLS as u32, TILE_CELLS as u32);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Balanced);
    encoder.set_filter(png::Filter::Paeth);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(bytes)
}

/// What one image shows, at one zoom: a rectangle of cells.
#[derive(Debug)]
struct Look {
    column: i64,
    row: i64,
    width: usize,
    height: usize,
    values: Vec<u8>,
    weights: Vec<u8>,
}

impl Look {
    /// Takes the patch's bytes; `None` where its numbers contradict each other.
    fn of(patch: &mut GroundPatch) -> Option<Self> {
        let (width, height) = (patch.width as usize, patch.height as usize);
        let cells = width.checked_mul(height)?;
        let sound = patch.values.0.len() == cells
            && patch.weights.0.len() == cells
            && patch.cell_m.is_finite()
            && patch.cell_m > 0.0;
        sound.then(|| Self {
            column: i64::from(patch.column),
            row: i64::from(patch.row),
            width,
            height,
            values: std::mem::take(&mut patch.values.0),
            weights: std::mem::take(&mut patch.weights.0),
        })
    }

    /// The same at the next zoom. A cell gets the weighted mean of the (up to) four that it covers, and a quarter of
    /// their weight, rounded up. So an image adds one look of at most full weight to a cell at every zoom, and
    /// coarse tiles can hold as many images as fine ones.
    fn halved(&self) -> Self {
        let (column, row) = (self.column.div_euclid(2), self.row.div_euclid(2));
        let shift = [self.column - 2 * column, self.row - 2 * row].map(|odd| odd as usize);
        let (width, height) = (
            (self.width + shift[0]).div_ceil(2),
            (self.height + shift[1]).div_ceil(2),
        );
        let mut sums = vec![(0_u32, 0_u32); width * height];
        for fine in 0..self.height {
            let cells = fine * self.width..(fine + 1) * self.width;
            let coarse = &mut sums[(fine + shift[1]) / 2 * width..][..width];
            let looks = self.values[cells.clone()].iter().zip(&self.weights[cells]);
            for (at, (value, weight)) in looks.enumerate() {
                let (value, weight) = (u32::from(*value), u32::from(*weight));
                let sum = &mut coarse[(at + shift[0]) / 2];
                *sum = (sum.0 + value * weight, sum.1 + weight);
            }
        }
        let mean = |(sum, weight): &(u32, u32)| {
            ((sum + weight / 2).checked_div(*weight)).unwrap_or(0) as u8
        };
        Self {
            column,
            row,
            width,
            height,
            values: sums.iter().map(mean).collect(),
            weights: sums
                .iter()
                .map(|(_, weight)| weight.div_ceil(4) as u8)
                .collect(),
        }
    }

    /// Adds what is seen to the tiles that it falls on.
    fn add(
        &self,
        zoom: u8,
        patch: &GroundPatch,
        states: &mut BTreeMap<(String, Place), TileState>,
    ) -> Result<(), Fault> {
        let (columns, rows) = (
            pieces(self.column, self.width),
            pieces(self.row, self.height),
        );
        for (y, rows) in &rows {
            for (x, columns) in &columns {
                let seen = |row: usize| {
                    self.weights[self.cells(row, columns)]
                        .iter()
                        .any(|w| *w > 0)
                };
                if !rows.clone().any(seen) {
                    continue;
                }
                let place = Place {
                    zoom,
                    x: *x as i32,
                    y: *y as i32,
                };
                let state = states
                    .entry((patch.site.clone(), place))
                    .or_insert_with(|| TileState {
                        cell_m: patch.cell_m,
                        sums: TileSum::new(),
                        sources: Sources::default(),
                    });
                same_cells(state.cell_m, patch.cell_m)?;
                state.sources.add(&patch.session, patch.stamp, patch.stamp);
                self.add_piece(columns, rows.clone(), &mut state.sums)?;
            }
        }
        Ok(())
    }

    fn cells(&self, row: usize, columns: &std::ops::Range<usize>) -> std::ops::Range<usize> {
        row * self.width + columns.start..row * self.width + columns.end
    }

    fn add_piece(
        &self,
        columns: &std::ops::Range<usize>,
        rows: std::ops::Range<usize>,
        sums: &mut TileSum,
    ) -> Result<(), Fault> {
        let within =
            |first: i64, at: usize| (first + at as i64).rem_euclid(TILE_CELLS as i64) as usize;
        let column = within(self.column, columns.start);
        for row in rows {
            let cells = self.cells(row, columns);
            let (values, weights) = (&self.values[cells.clone()], &self.weights[cells]);
            sums.add_row(column, within(self.row, row), values, weights)
                .map_err(|error| Fault::data(error.to_string()))?;
        }
        Ok(())
    }
}

/// Cuts `length` cells from `first` on at the borders of tiles: the tile, and which of the cells are on it.
fn pieces(first: i64, length: usize) -> Vec<(i64, std::ops::Range<usize>)> {
    let side = TILE_CELLS as i64;
    let end = first + length as i64;
    (first.div_euclid(side)..end.div_euclid(side) + 1)
        .map(|tile| {
            let (from, to) = ((tile * side).max(first), ((tile + 1) * side).min(end));
            (tile, (from - first) as usize..(to - first) as usize)
        })
        .filter(|(_, cells)| !cells.is_empty())
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    fn look(column: i64, row: i64, width: usize, height: usize) -> impl Strategy<Value = Look> {
        let cells = || prop::collection::vec(any::<u8>(), width * height);
        (cells(), cells()).prop_map(move |(values, weights)| Look {
            column,
            row,
            width,
            height,
            values,
            weights,
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn halving_is_the_weighted_mean_of_the_cells_below(
            look in (-5..5_i64, -5..5_i64, 1..9_usize, 1..9_usize)
                .prop_flat_map(|(column, row, width, height)| look(column, row, width, height))
        ) {
            let half = look.halved();
            for j in -4..8_i64 {
                for i in -4..8_i64 {
                    let cell = |look: &Look, i: i64, j: i64| {
                        let (c, r) = (i - look.column, j - look.row);
                        let inside = c >= 0 && r >= 0 && c < look.width as i64 && r < look.height as i64;
                        let at = r * look.width as i64 + c;
                        if inside { (look.values[at as usize], look.weights[at as usize]) } else { (0, 0) }
                    };
                    let below = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(a, b)| cell(&look, 2 * i + a, 2 * j + b));
                    let weight: f64 = below.iter().map(|(_, w)| f64::from(*w)).sum();
                    let sum: f64 = below.iter().map(|(v, w)| f64::from(*v) * f64::from(*w)).sum();
                    let (value, found) = cell(&half, i, j);
                    prop_assert_eq!(f64::from(found), (weight / 4.0).ceil());
                    prop_assert!(weight == 0.0 || (f64::from(value) - sum / weight).abs() <= 0.5);
                }
            }
        }

    }

    #[test]
    fn rows_are_cut_at_tiles() {
        assert_eq!(pieces(-3, 5), [(-1, 0..3), (0, 3..5)]);
        assert_eq!(pieces(256, 256), [(1, 0..256)]);
        assert_eq!(pieces(7, 0), []);
    }
}
