#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::ground::patch::Patch;

type Look = (i64, i64, u8, u8);
type Tiles = BTreeMap<TileKey, TileSum>;

fn add(tiles: &mut Tiles, zoom: u8, patch: &Patch) {
    for piece in patch.pieces() {
        let (x, y) = (piece.x, piece.y);
        let sums = tiles.entry(TileKey { zoom, x, y }).or_default();
        piece.add_to(sums).unwrap();
    }
}

fn row(column: i64, row: i64, values: Vec<u8>, weights: Vec<u8>) -> Patch {
    Patch {
        column,
        row,
        width: values.len(),
        height: 1,
        values,
        weights,
    }
}

fn mosaic(looks: &[Look]) -> Tiles {
    let mut tiles = Tiles::new();
    for &(i, j, value, weight) in looks {
        add(&mut tiles, 0, &row(i, j, vec![value], vec![weight]));
    }
    tiles
}

fn looks() -> impl Strategy<Value = Vec<Look>> {
    prop::collection::vec((-4..4i64, 254..258i64, any::<u8>(), any::<u8>()), 0..40)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn merging_is_exact_and_in_any_order(a in looks(), b in looks()) {
        let all: Vec<Look> = b.iter().chain(&a).copied().collect();
        let mut merged = mosaic(&a);
        for (key, tile) in &mosaic(&b) {
            merged.entry(*key).or_default().merge(tile).unwrap();
        }
        prop_assert_eq!(&merged, &mosaic(&all));
        for i in -4..4i64 {
            for j in 254..258i64 {
                let here = || all.iter().filter(|look| (look.0, look.1) == (i, j));
                let sum: u64 = here().map(|l| u64::from(l.2) * u64::from(l.3)).sum();
                let weight: u32 = here().map(|l| u32::from(l.3)).sum();
                let (column, row) = (i.rem_euclid(256) as usize, (j % 256) as usize);
                let key = TileKey { zoom: 0, x: i.div_euclid(256), y: j.div_euclid(256) };
                let tile = merged.get(&key);
                prop_assert_eq!(tile.map_or((0, 0), |t| t.get(column, row)), (sum, weight));
                if let (Some(tile), true) = (tile, weight > 0) {
                    let mean = (sum as f64 / f64::from(weight) + 0.5).floor() as u8;
                    prop_assert_eq!(tile.finish().grey[row * 256 + column], mean);
                }
            }
        }
    }

    #[test]
    fn long_rows_are_cut_at_tiles(start in -600..600i64, length in 0..800usize) {
        let values: Vec<u8> = (0..length).map(|i| i as u8).collect();
        let mut whole = Tiles::new();
        add(&mut whole, 0, &row(start, -1, values, vec![3; length]));
        let single: Vec<Look> =
            (0..length).map(|k| (start + k as i64, -1, k as u8, 3)).collect();
        prop_assert_eq!(whole, mosaic(&single));
    }

    #[test]
    fn sums_survive_a_journey_and_damage_is_refused_not_fatal(
        looks in prop::collection::vec((0..256_usize, 0..256_usize, any::<u8>(), 1..=255_u8), 0..40),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut sums = TileSum::new();
        for (column, row, value, weight) in looks {
            sums.add_row(column, row, &[value], &[weight]).unwrap();
        }
        let text = serde_json::to_value(&sums).unwrap();
        let bytes: Vec<u8> = serde_json::from_value(text).unwrap();
        prop_assert_eq!(runs::unpack(&bytes).unwrap(), sums);
        let _ = runs::unpack(&bytes[..cut.index(bytes.len() + 1)]);
    }

    #[test]
    fn any_bytes_are_sums_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
        let _ = runs::unpack(&bytes);
    }
}

#[test]
fn rows_are_cut_at_tiles() {
    assert_eq!(pieces::cut(-3, 5), [(-1, 0..3), (0, 3..5)]);
    assert_eq!(pieces::cut(256, 256), [(1, 0..256)]);
    assert_eq!(pieces::cut(7, 0), []);
}

#[test]
fn a_million_full_looks_fit_and_then_it_says_so() {
    let mut tile = TileSum::new();
    tile.add_row(255, 255, &[255], &[255]).unwrap();
    for _ in 0..20 {
        let same = tile.clone();
        tile.merge(&same).unwrap();
    }
    assert_eq!(tile.get(255, 255), (65_025 << 20, 255 << 20));
    assert_eq!(tile.weights().collect::<Vec<_>>(), [255 << 20]);
    assert_eq!(tile.finish().grey[65_535], 255);
    let same = tile.clone();
    assert_eq!(tile.merge(&same), Err(TileOverflow));
}

#[test]
fn zooming_out_keeps_means_and_places() {
    let patch = Patch {
        column: -2,
        row: -2,
        width: 3,
        height: 3,
        values: vec![100, 200, 0, 0, 0, 0, 0, 0, 7],
        weights: vec![10, 30, 0, 0, 0, 0, 0, 0, 1],
    };
    let mut parents = Tiles::new();
    add(&mut parents, 1, &patch.halved());
    let tile = |x: i64, y: i64| TileKey { zoom: 1, x, y };
    assert_eq!(parents[&tile(-1, -1)].get(255, 255), (1750, 10));
    assert_eq!(parents[&tile(0, 0)].get(0, 0), (7, 1));
    assert_eq!(parents.len(), 2, "nothing was seen elsewhere");
    assert_eq!(tile(-1, -1).footprint_m(0.05), [-25.6, -25.6, 0.0, 0.0]);
}
