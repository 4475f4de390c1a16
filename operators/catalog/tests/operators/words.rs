//! Places found again by their words.

use std::collections::BTreeMap;

use evermap_contract::laws::{Split, run};
use evermap_schemas::layers::{Features, Relocation};
use evermap_schemas::{Bytes, Stamp, batch};
use serde_json::json;

use crate::yields;

/// Steele, Lea, Flood: SplitMix, 2014.
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.next() as u8).collect()
    }

    /// Some bits of each descriptor differ.
    fn again(&mut self, descriptors: &[u8]) -> Vec<u8> {
        let mut bytes = descriptors.to_vec();
        for descriptor in bytes.chunks_exact_mut(64) {
            for _ in 0..25 {
                let bit = self.next() as usize % 512;
                descriptor[bit / 8] ^= 1 << (bit % 8);
            }
        }
        bytes
    }
}

fn view(session: &str, stamp: i64, descriptors: Vec<u8>) -> Features {
    let count = descriptors.len() / 64;
    Features {
        site: "town".to_owned(),
        session: session.to_owned(),
        stamp: Stamp(stamp),
        keyframe: stamp as u32,
        camera: "panorama".to_owned(),
        width: 1024,
        height: 333,
        u: vec![0.0; count],
        v: vec![0.0; count],
        size_px: vec![12.0; count],
        descriptors: Bytes(descriptors),
    }
}

/// Thirty places along a street, each with forty features and twenty of its neighbour's; driven twice.
fn street() -> [Vec<Features>; 2] {
    let mut chance = Chance(3);
    let own: Vec<Vec<u8>> = (0..31).map(|_| chance.bytes(40 * 64)).collect();
    ["first", "second"].map(|session| {
        let places = own.windows(2).enumerate();
        let seen = places.map(|(place, both)| {
            let all = [both[0].as_slice(), &both[1][..20 * 64]].concat();
            view(session, place as i64, chance.again(&all))
        });
        seen.collect()
    })
}

fn found(
    params: serde_json::Value,
    queries: &[Features],
    map: &[Features],
) -> (Vec<Relocation>, evermap_contract::Losses) {
    let inputs = [("queries", queries), ("map", map)];
    let inputs = inputs.map(|(port, rows)| (port.to_owned(), batch(rows.to_vec()).unwrap()));
    yields("word_relocations", params, inputs)
}

#[test]
fn places_of_another_drive_are_found_again() {
    let [first, second] = street();
    for params in [json!({}), json!({"branching": 8, "depth": 4})] {
        let (rows, losses) = found(params, &second, &first);
        assert!(losses.0.is_empty(), "{losses:?}");
        let best: Vec<_> = rows.iter().filter(|row| row.rank == 0).collect();
        assert_eq!(best.len(), 30);
        let right = best.iter().filter(|row| row.stamp == row.map_stamp).count();
        assert!(right >= 29, "{right} of 30");
        assert!(
            rows.iter()
                .all(|row| row.rank < 10 && (0.0..=1.0).contains(&row.score))
        );
        assert_eq!(best[7].view, "second/panorama/7");
        assert_eq!(best[7].map_view, "first/panorama/7");
    }
}

#[test]
fn no_view_is_found_as_itself() {
    let [first, _] = street();
    let (rows, _) = found(json!({}), &first, &first);
    assert!(rows.is_empty());
    // Few features are shared by neighbours: words must be coarse enough for both sightings to fall into one.
    let params = json!({"within_session": true, "top": 2, "branching": 8, "depth": 3});
    let (rows, _) = found(params, &first, &first);
    assert!(
        rows.iter()
            .all(|row| row.map_stamp != row.stamp && row.rank < 2)
    );
    let beside = |row: &&Relocation| row.rank == 0 && (row.stamp.0 - row.map_stamp.0).abs() == 1;
    let right = rows.iter().filter(beside).count();
    assert!(right >= 28, "{right} of 30");
}

#[test]
fn what_cannot_be_looked_for_is_counted() {
    let [mut first, mut second] = street();
    second[3].descriptors.0.clear();
    second[4].descriptors.0.truncate(63);
    second[5].site = "elsewhere".to_owned();
    first[9].descriptors.0.truncate(100);
    first[10].descriptors.0.clear();
    let (rows, losses) = found(json!({}), &second, &first);
    let losses = losses.0;
    assert_eq!(losses.len(), 2, "{losses:?}");
    assert_eq!(losses.get("view has no features"), Some(&2));
    assert_eq!(losses.get("site has no map"), Some(&1));
    let asked = rows.iter().filter(|row| row.rank == 0).count();
    assert!((25..=27).contains(&asked), "{asked}");
    let (rows, _) = found(json!({}), &second, &[]);
    assert!(rows.is_empty());
}

#[test]
fn senseless_parameters_are_refused() {
    let registry = evermap_catalog::registry();
    let entry = registry.get("word_relocations").unwrap();
    for params in [
        json!({"branching": 1}),
        json!({"depth": 0}),
        json!({"top": 0}),
        json!({"max_training": 0}),
    ] {
        let inputs = BTreeMap::new();
        let fault = run(entry, &params, &inputs, Split::default()).unwrap_err();
        assert!(fault.to_string().contains("expected"), "{fault}");
    }
}
