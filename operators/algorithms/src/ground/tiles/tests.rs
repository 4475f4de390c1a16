#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::ground::channels::Channels;
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
                prop_assert_eq!(tile.map_or(([0; 3], 0), |t| t.get(column, row)), ([sum; 3], weight));
                if let (Some(tile), true) = (tile, weight > 0) {
                    let mean = (sum as f64 / f64::from(weight) + 0.5).floor() as u8;
                    prop_assert_eq!(tile.finish().values[row * 256 + column], mean);
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
        in_colour in any::<bool>(),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut sums = TileSum::new();
        for (column, row, value, weight) in looks {
            let values = [value; 3];
            let count = if in_colour { 3 } else { 1 };
            sums.add_row(column, row, &values[..count], &[weight]).unwrap();
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

/// A look at eight cells of a row: whether it is in colour, the cells' colours, and their weights.
type ColouredLook = (bool, Vec<[u8; 3]>, Vec<u8>);

fn rows_of_looks() -> impl Strategy<Value = Vec<ColouredLook>> {
    let colours = prop::collection::vec(any::<[u8; 3]>(), 8);
    let weights = prop::collection::vec(any::<u8>(), 8);
    prop::collection::vec((any::<bool>(), colours, weights), 0..6)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn a_grey_look_is_one_of_three_equal_values_in_any_order(
        rows in rows_of_looks(), turn in any::<prop::sample::Index>()
    ) {
        let sums = |rows: &[ColouredLook]| {
            let mut sums = TileSum::new();
            for (in_colour, colours, weights) in rows {
                let grey: Vec<u8> = colours.iter().map(|colour| colour[1]).collect();
                let values = if *in_colour { colours.as_flattened() } else { &grey };
                sums.add_row(3, 5, values, weights).unwrap();
            }
            sums
        };
        let all = sums(&rows);
        for (at, column) in (3..11).enumerate() {
            let mut expected = ([0; 3], 0);
            for (in_colour, colours, weights) in &rows {
                let [red, green, blue] = colours[at];
                let colour = if *in_colour { [red, green, blue] } else { [green; 3] };
                for (sum, value) in expected.0.iter_mut().zip(colour) {
                    *sum += u64::from(value) * u64::from(weights[at]);
                }
                expected.1 += u32::from(weights[at]);
            }
            prop_assert_eq!(all.get(column, 5), expected);
        }
        let any_in_colour = rows.iter().any(|(in_colour, ..)| *in_colour);
        prop_assert_eq!(all.channels() == Channels::Colour, any_in_colour);
        let seen = all.weights().count();
        prop_assert_eq!(seen, all.finish().coverage.iter().filter(|weight| **weight > 0).count());
        let mut turned = rows.clone();
        turned.rotate_left(turn.index(rows.len() + 1).min(rows.len()));
        prop_assert_eq!(&sums(&turned), &all);
        let (some, others) = rows.split_at(turn.index(rows.len() + 1));
        let (mut merged, mut the_other_way) = (sums(some), sums(others));
        merged.merge(&sums(others)).unwrap();
        the_other_way.merge(&sums(some)).unwrap();
        prop_assert_eq!(&merged, &all);
        prop_assert_eq!(&the_other_way, &all);
    }
}

#[test]
fn a_tile_of_equal_values_is_the_grey_tile() {
    let (mut grey, mut colour) = (TileSum::new(), TileSum::new());
    grey.add_row(0, 0, &[10, 20], &[3, 4]).unwrap();
    colour
        .add_row(0, 0, &[10, 10, 10, 20, 20, 20], &[3, 4])
        .unwrap();
    assert_eq!(colour.finish(), grey.finish());
    colour.add_row(1, 0, &[0, 0, 200], &[4]).unwrap();
    let tile = colour.finish();
    assert_eq!(tile.channels, Channels::Colour);
    assert_eq!(tile.values[..6], [10, 10, 10, 10, 10, 110]);
    assert_eq!(tile.coverage[..3], [3, 8, 0]);
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
    assert_eq!(tile.get(255, 255), ([65_025 << 20; 3], 255 << 20));
    assert_eq!(tile.weights().collect::<Vec<_>>(), [255 << 20]);
    assert_eq!(tile.finish().values[65_535], 255);
    let same = tile.clone();
    assert_eq!(tile.merge(&same), Err(TileOverflow));
    // In colour just as many.
    let mut tile = same.clone();
    let mut colour = TileSum::new();
    colour.add_row(0, 0, &[1, 2, 3], &[4]).unwrap();
    tile.merge(&colour).unwrap();
    assert_eq!(tile.get(255, 255), ([65_025 << 20; 3], 255 << 20));
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
    assert_eq!(parents[&tile(-1, -1)].get(255, 255), ([1750; 3], 10));
    assert_eq!(parents[&tile(0, 0)].get(0, 0), ([7; 3], 1));
    assert_eq!(parents.len(), 2, "nothing was seen elsewhere");
    assert_eq!(tile(-1, -1).footprint_m(0.05), [-25.6, -25.6, 0.0, 0.0]);
}
