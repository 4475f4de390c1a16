//! What is accumulated for one tile, and its way from one phase to the next.

use std::fmt;

use evermap_algorithms::ground::tiles::{TILE_CELLS, TileSum};
use evermap_schemas::Stamp;
use evermap_schemas::layers::Sources;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The sums of one tile, with the cell size of the finest zoom that they are in.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TileState {
    /// Side of a cell at zoom 0 (m).
    pub cell_m: f64,
    /// The sums, at the tile's own zoom.
    pub sums: TileSum,
    /// The images that added to them.
    pub sources: Sources,
}

/// As bytes: the cell size; the number of sources, then of each the length of the session's name, the name, the first
/// and the last stamp; then for each run of cells that were seen the number of unseen ones before it, its own length,
/// and its sums.
impl Serialize for TileState {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = self.cell_m.to_le_bytes().to_vec();
        pack_sources(&self.sources, &mut bytes);
        let cells = self.sums.cells();
        let mut at = 0;
        while let Some(skip) = cells[at..].iter().position(|cell| *cell != 0) {
            let run = &cells[at + skip..];
            let run = &run[..run.iter().position(|cell| *cell == 0).unwrap_or(run.len())];
            bytes.extend((skip as u32).to_le_bytes());
            bytes.extend((run.len() as u32).to_le_bytes());
            bytes.extend(run.iter().flat_map(|cell| cell.to_le_bytes()));
            at += skip + run.len();
        }
        serializer.serialize_bytes(&bytes)
    }
}

impl<'de> Deserialize<'de> for TileState {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Packed;
        impl Visitor<'_> for Packed {
            type Value = TileState;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the runs of cells of one tile")
            }
            fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<TileState, E> {
                unpack(bytes).ok_or_else(|| E::custom("damaged runs of cells"))
            }
        }
        deserializer.deserialize_bytes(Packed)
    }
}

fn pack_sources(sources: &Sources, bytes: &mut Vec<u8>) {
    let sources = sources.iter();
    bytes.extend((sources.len() as u32).to_le_bytes());
    for (session, first, last) in sources {
        bytes.extend((session.len() as u32).to_le_bytes());
        bytes.extend(session.as_bytes());
        bytes.extend(first.0.to_le_bytes());
        bytes.extend(last.0.to_le_bytes());
    }
}

/// The sources, and the bytes behind them.
fn unpack_sources(bytes: &[u8]) -> Option<(Sources, &[u8])> {
    let (count, mut rest) = bytes.split_first_chunk::<4>()?;
    let mut sources = Sources::default();
    for _ in 0..u32::from_le_bytes(*count) {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (session, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        let (first, after) = after.split_first_chunk::<8>()?;
        let (last, after) = after.split_first_chunk::<8>()?;
        let [first, last] = [first, last].map(|stamp| Stamp(i64::from_le_bytes(*stamp)));
        sources.add(std::str::from_utf8(session).ok()?, first, last);
        rest = after;
    }
    Some((sources, rest))
}

fn unpack(bytes: &[u8]) -> Option<TileState> {
    let (cell_m, rest) = bytes.split_first_chunk::<8>()?;
    let (sources, mut rest) = unpack_sources(rest)?;
    let mut cells = Vec::with_capacity(TILE_CELLS * TILE_CELLS);
    let room = |cells: &Vec<u64>| TILE_CELLS * TILE_CELLS - cells.len();
    while !rest.is_empty() {
        let (skip, after) = rest.split_first_chunk::<4>()?;
        let (length, after) = after.split_first_chunk::<4>()?;
        let skip = u32::from_le_bytes(*skip) as usize;
        let length = u32::from_le_bytes(*length) as usize;
        if skip.checked_add(length)? > room(&cells) {
            return None;
        }
        cells.resize(cells.len() + skip, 0);
        let (run, after) = after.split_at_checked(8 * length)?;
        let sums = run.as_chunks::<8>().0;
        cells.extend(sums.iter().map(|sum| u64::from_le_bytes(*sum)));
        rest = after;
    }
    cells.resize(TILE_CELLS * TILE_CELLS, 0);
    Some(TileState {
        cell_m: f64::from_le_bytes(*cell_m),
        sums: TileSum::from_cells(cells)?,
        sources,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn states_survive_a_round_trip_and_damage_is_refused_not_fatal(
            looks in prop::collection::vec((0..256_usize, 0..256_usize, any::<u8>(), 1..=255_u8), 0..40),
            looked in prop::collection::vec(("[a-cé]{0,3}", any::<i64>(), any::<i64>()), 0..6),
            cut in any::<prop::sample::Index>(),
        ) {
            let mut sums = TileSum::new();
            for (column, row, value, weight) in looks {
                sums.add_row(column, row, &[value], &[weight]).unwrap();
            }
            let mut sources = Sources::default();
            for (session, one, other) in looked {
                sources.add(&session, Stamp(one), Stamp(other));
            }
            let state = TileState { cell_m: 0.05, sums, sources };
            let text = serde_json::to_value(&state).unwrap();
            let bytes: Vec<u8> = serde_json::from_value(text).unwrap();
            prop_assert_eq!(unpack(&bytes).unwrap(), state);
            let _ = unpack(&bytes[..cut.index(bytes.len())]);
        }

        #[test]
        fn any_bytes_are_a_state_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
            let _ = unpack(&bytes);
        }
    }
}
