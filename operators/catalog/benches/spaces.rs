//! What a round of teaching costs on a park of 164 spaces, from labels and gradients to ranked hypotheses, and its parts.
//!
//! The floor is painted, 113 × 32 m in cells of 5 cm: four rows of 41 spaces, lines with gaps on grain and stains. 8 spaces
//! are drawn, 40 accepted, and 40 boxes between them rejected.
//!
//! * `describe`: gradients of all tiles, none of which is known: what a first drive costs.
//! * `compare`: the same where all are known: what a drive costs that changed nothing; an answer does not even do this.
//! * `round`: what `box_models` and `box_hypotheses` do with an answer, each reading the gradients for itself.
//! * `learn`, `search`, `weigh`: its parts. A served map weighs at once and searches behind it.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use evermap_algorithms::ground::boxes::mosaic::Mosaic;
use evermap_algorithms::ground::boxes::teaching::TeachingParams;
use evermap_catalog::labels::box_hypotheses::Kind;
use evermap_catalog::labels::box_models::learnt;
use evermap_catalog::{mosaic, tile_gradients};
use evermap_schemas::layers::{BoxModel, OverheadGradients, OverheadTile, PlacedLabel};
use evermap_schemas::{Bytes, Pose, Stamp, Wkb};

const CELL_M: f64 = 0.05;
/// Cells of a tile's side.
const SIDE: usize = 256;
/// Tiles from west to east, and from south to north.
const TILES: [i32; 2] = [9, 3];
/// Spaces of a row.
const SPACES: usize = 41;
/// Length and width of a space (m).
const SPACE_M: [f64; 2] = [5.0, 2.4];
/// The middles of rows from the south (m), two of them back to back.
const ROWS_M: [f64; 4] = [2.5, 13.5, 18.5, 29.5];
/// Where rows begin (m).
const WEST_M: f64 = 6.0;

/// A number that looks random, 0 to 1.
fn chance(seed: u64) -> f64 {
    let mixed = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((mixed ^ (mixed >> 29)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// The middle of a space (m).
fn middle(space: usize) -> [f64; 2] {
    let along = (space % SPACES) as f64 + 0.5;
    [WEST_M + along * SPACE_M[1], ROWS_M[space / SPACES]]
}

/// Whether a point of the floor (m) is on a line, of which a fifth is worn off.
fn is_painted([x, y]: [f64; 2]) -> bool {
    let along = (x - WEST_M) / SPACE_M[1];
    let is_in_row = |row: &&f64| (y - **row).abs() <= 0.5 * SPACE_M[0];
    let Some(row) = ROWS_M.iter().find(is_in_row) else {
        return false;
    };
    let from_side_m = (along - along.round()).abs() * SPACE_M[1];
    let from_end_m = 0.5 * SPACE_M[0] - (y - row).abs();
    let is_line = from_side_m < 0.06 || from_end_m < 0.06;
    let worn = chance((x * 2.0) as u64 * 1000 + (y * 2.0) as u64) < 0.2;
    (-0.03..=SPACES as f64 + 0.03).contains(&along) && is_line && !worn
}

fn grey([x, y]: [f64; 2]) -> u8 {
    let grain = 30.0 * chance((x * 20.0) as u64 * 10_000 + (y * 20.0) as u64);
    let stains = 12.0 * (0.9 * x).sin() * (1.1 * y).cos();
    let paint = if is_painted([x, y]) { 90.0 } else { 0.0 };
    (80.0 + grain + stains + paint) as u8
}

fn png(pixels: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, SIDE as u32, SIDE as u32);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(pixels).unwrap();
    writer.finish().unwrap();
    bytes
}

fn tile([tile_x, tile_y]: [i32; 2]) -> OverheadTile {
    let size_m = SIDE as f64 * CELL_M;
    let pixel = |at: usize| {
        let column = (at % SIDE) as f64 + 0.5;
        let row = (SIDE - 1 - at / SIDE) as f64 + 0.5;
        let at = [(tile_x, column), (tile_y, row)];
        [
            grey(at.map(|(tile, cell)| f64::from(tile) * size_m + cell * CELL_M)),
            255,
        ]
    };
    let pixels: Vec<u8> = (0..SIDE * SIDE).flat_map(pixel).collect();
    OverheadTile {
        site: "park".into(),
        zoom: 0,
        tile_x,
        tile_y,
        cell_m: CELL_M,
        size_m,
        covered: (SIDE * SIDE) as u32,
        mean_weight: 1.0,
        png: Bytes(png(&pixels)),
        sources: vec![],
        geometry: Wkb::point([0.0; 3]),
    }
}

fn tiles() -> Vec<OverheadTile> {
    let columns = 0..TILES[0];
    let at = columns.flat_map(|x| (0..TILES[1]).map(move |y| [x, y]));
    at.map(tile).collect()
}

fn label(number: usize, standing: &str, [x, y]: [f64; 2]) -> PlacedLabel {
    PlacedLabel {
        site: "park".into(),
        label: format!("label {number:03}"),
        kind: "parking_space".into(),
        standing: standing.into(),
        author: "ada".into(),
        said: Stamp(number as i64),
        placed_by: "drawing".into(),
        anchor: None,
        shape: "box".into(),
        map_from_label: Pose {
            x,
            y,
            qz: std::f64::consts::FRAC_1_SQRT_2,
            qw: std::f64::consts::FRAC_1_SQRT_2,
            ..Pose::IDENTITY
        },
        length_m: Some(SPACE_M[0]),
        width_m: Some(SPACE_M[1]),
        points: vec![],
        geometry: Wkb::point([0.0; 3]),
    }
}

/// What was said in a few rounds: every third space is known, and boxes half a space beside others are none.
fn labels() -> Vec<PlacedLabel> {
    let known = (0..48).map(|at| {
        let standing = if at < 8 { "drawn" } else { "accepted" };
        label(at, standing, middle(3 * at))
    });
    let none = (0..40).map(|at| {
        let [x, y] = middle(4 * at + 1);
        label(100 + at, "rejected", [x + 0.5 * SPACE_M[1], y + 3.0])
    });
    known.chain(none).collect()
}

fn described(
    tiles: &[OverheadTile],
    known: &[OverheadGradients],
) -> (Vec<OverheadGradients>, usize) {
    tile_gradients(tiles.to_vec(), known.to_vec(), &mut |_, _| {}).unwrap()
}

fn read(gradients: &[OverheadGradients]) -> Mosaic {
    mosaic(gradients.to_vec(), &mut |_, _| {})
}

fn model(mosaic: &Mosaic, labels: &[PlacedLabel]) -> BoxModel {
    let models = learnt(&TeachingParams::default(), mosaic, labels, &mut |_, _| {});
    models.unwrap().remove(0)
}

fn benches(criterion: &mut Criterion) {
    let (tiles, labels) = (tiles(), labels());
    let (gradients, anew) = described(&tiles, &[]);
    assert_eq!(anew, tiles.len());
    assert_eq!(described(&tiles, &gradients).1, 0);
    let floor = read(&gradients);
    let learnt = model(&floor, &labels);
    let kind = || Kind::new(learnt.clone(), &labels, &[], CELL_M).unwrap();
    let found = kind().search(&floor);
    let likely = kind().weigh(&found);
    assert!(likely.iter().any(|one| one.probability > 0.5));

    let mut group = criterion.benchmark_group("spaces");
    group.sample_size(10);
    group.bench_function("describe", |bench| {
        bench.iter(|| black_box(described(&tiles, &[])));
    });
    group.bench_function("compare", |bench| {
        bench.iter(|| black_box(described(&tiles, &gradients)));
    });
    group.bench_function("round", |bench| {
        bench.iter(|| {
            let model = model(&read(&gradients), &labels);
            let kind = Kind::new(model, &labels, &[], CELL_M).unwrap();
            black_box(kind.weigh(&kind.search(&read(&gradients))))
        });
    });
    group.bench_function("learn", |bench| {
        bench.iter(|| black_box(model(&floor, &labels)));
    });
    group.bench_function("search", |bench| {
        bench.iter(|| black_box(kind().search(&floor)));
    });
    group.bench_function("weigh", |bench| {
        bench.iter(|| black_box(kind().weigh(&kind().look_again(&found))));
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
