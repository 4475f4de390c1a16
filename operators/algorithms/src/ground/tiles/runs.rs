//! A tile's sums on their way from one machine to another: only the cells that were seen.

use std::fmt;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::TileSum;
use super::sum::CELLS;
use crate::ground::channels::Channels;

/// As bytes: the number of channels; then for each run of sums that are not 0 the number of those before it that are, its own
/// length, and the sums.
impl Serialize for TileSum {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = vec![self.channels().count() as u8];
        let mut at = 0;
        while let Some(skip) = self.cells[at..].iter().position(|cell| *cell != 0) {
            let run = &self.cells[at + skip..];
            let run = &run[..run.iter().position(|cell| *cell == 0).unwrap_or(run.len())];
            bytes.extend((skip as u32).to_le_bytes());
            bytes.extend((run.len() as u32).to_le_bytes());
            bytes.extend(run.iter().flat_map(|cell| cell.to_le_bytes()));
            at += skip + run.len();
        }
        serializer.serialize_bytes(&bytes)
    }
}

impl<'de> Deserialize<'de> for TileSum {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Packed;
        impl Visitor<'_> for Packed {
            type Value = TileSum;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the runs of cells of one tile")
            }
            fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<TileSum, E> {
                unpack(bytes).ok_or_else(|| E::custom("damaged runs of cells"))
            }
        }
        deserializer.deserialize_bytes(Packed)
    }
}

pub(super) fn unpack(bytes: &[u8]) -> Option<TileSum> {
    let (channels, mut rest) = bytes.split_first()?;
    let known = [Channels::Grey, Channels::Colour].map(Channels::count);
    let count = known.into_iter().find(|it| *it == usize::from(*channels))?;
    let all = CELLS * count;
    let mut cells = Vec::with_capacity(all);
    while !rest.is_empty() {
        let (skip, after) = rest.split_first_chunk::<4>()?;
        let (length, after) = after.split_first_chunk::<4>()?;
        let skip = u32::from_le_bytes(*skip) as usize;
        let length = u32::from_le_bytes(*length) as usize;
        if skip.checked_add(length)? > all - cells.len() {
            return None;
        }
        cells.resize(cells.len() + skip, 0);
        let (run, after) = after.split_at_checked(8 * length)?;
        let sums = run.as_chunks::<8>().0;
        cells.extend(sums.iter().map(|sum| u64::from_le_bytes(*sum)));
        rest = after;
    }
    cells.resize(all, 0);
    Some(TileSum { cells })
}
