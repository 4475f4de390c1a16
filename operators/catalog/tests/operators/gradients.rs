//! Gradients of the overhead image: made once for what a tile and its rim show, whatever was known before.

use evermap_catalog::tile_gradients;
use evermap_contract::laws::inputs_of;
use evermap_schemas::layers::{OverheadGradients, OverheadTile};
use evermap_schemas::{Bytes, Wkb};
use serde_json::json;

use crate::yields;

/// Cells of a tile's side.
const SIDE: usize = 256;

/// Grey values of a tile, row by row from the north: grain that differs from tile to tile.
fn grain([x, y]: [i32; 2]) -> Vec<u8> {
    let mut state = (x * 31 + y) as u32 + 1;
    let mut grey = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        90 + (state >> 28) as u8
    };
    (0..SIDE * SIDE).map(|_| grey()).collect()
}

fn tile([tile_x, tile_y]: [i32; 2], grey: &[u8]) -> OverheadTile {
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, SIDE as u32, SIDE as u32);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    let pixels: Vec<u8> = grey.iter().flat_map(|grey| [*grey, 255]).collect();
    writer.write_image_data(&pixels).unwrap();
    writer.finish().unwrap();
    OverheadTile {
        site: "lot".into(),
        zoom: 0,
        tile_x,
        tile_y,
        cell_m: 0.05,
        size_m: 12.8,
        covered: (SIDE * SIDE) as u32,
        mean_weight: 1.0,
        png: Bytes(png),
        sources: vec![],
        geometry: Wkb::point([0.0; 3]),
    }
}

/// The same tile recorded in colour.
fn in_colour(tile: &OverheadTile, colours: &[[u8; 3]]) -> OverheadTile {
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, SIDE as u32, SIDE as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    let pixels = colours
        .iter()
        .flat_map(|[red, green, blue]| [*red, *green, *blue, 255]);
    writer
        .write_image_data(&pixels.collect::<Vec<_>>())
        .unwrap();
    writer.finish().unwrap();
    OverheadTile {
        png: Bytes(png),
        ..tile.clone()
    }
}

#[test]
fn a_tile_in_colour_is_described_anew_where_it_shows_a_colour() {
    let at = [1, 1];
    let (before, _) = made(&floor(), &[]);
    let with = |paint: &dyn Fn(usize, u8) -> [u8; 3]| {
        let mut floor = floor();
        let is_it = |tile: &&mut OverheadTile| [tile.tile_x, tile.tile_y] == at;
        let tile = floor.iter_mut().find(is_it).unwrap();
        let colours = grain(at).into_iter().enumerate();
        let colours: Vec<_> = colours.map(|(cell, grey)| paint(cell, grey)).collect();
        *tile = in_colour(tile, &colours);
        floor
    };
    // Three equal values are grey.
    assert_eq!(
        made(&with(&|_, grey| [grey; 3]), &before),
        (before.clone(), 0)
    );
    // A yellow spot in the middle of the tile, as bright as the floor.
    let spot = |cell: usize, grey: u8| match [cell % SIDE, cell / SIDE] {
        [126..130, 126..130] => [grey + 16, grey + 5, 5],
        _ => [grey; 3],
    };
    let (rows, anew) = made(&with(&spot), &before);
    assert_eq!((rows.len(), anew), (6, 1));
    let changed = rows.iter().zip(&before).filter(|(now, then)| now != then);
    let changed: Vec<_> = changed.map(|(now, _)| [now.tile_x, now.tile_y]).collect();
    assert_eq!(changed, [at]);
}

/// The floor of a first drive, three tiles wide and two high.
fn floor() -> Vec<OverheadTile> {
    let at = (-1..2).flat_map(|x| (0..2).map(move |y| [x, y]));
    at.map(|at| tile(at, &grain(at))).collect()
}

/// The floor after a drive that changed one cell of one tile.
fn changed(at: [i32; 2], column: usize, row: usize) -> Vec<OverheadTile> {
    let mut grey = grain(at);
    grey[row * SIDE + column] = 255;
    let mut floor = floor();
    let is_it = |tile: &&mut OverheadTile| [tile.tile_x, tile.tile_y] == at;
    *floor.iter_mut().find(is_it).unwrap() = tile(at, &grey);
    floor
}

/// Gradients, and how many of them were made.
fn made(tiles: &[OverheadTile], known: &[OverheadGradients]) -> (Vec<OverheadGradients>, usize) {
    tile_gradients(tiles.to_vec(), known.to_vec(), &mut |_, _| {}).unwrap()
}

#[test]
fn a_drive_describes_the_tiles_that_it_changed_and_an_answer_none() {
    let (before, first) = made(&floor(), &[]);
    assert_eq!((before.len(), first), (6, 6));
    assert_eq!(made(&floor(), &before), (before.clone(), 0));
    // In a tile's middle, at its western border, and in its north-western corner: who has it in the rim.
    let expected = [([128, 128], 1), ([3, 128], 2), ([3, 3], 2), ([3, 252], 4)];
    for ([column, row], count) in expected {
        let now = changed([1, 1], column, row);
        let (rows, anew) = made(&now, &before);
        assert_eq!(anew, count, "column {column}, row {row}");
        // What is kept is what would be made.
        assert_eq!(rows, made(&now, &[]).0);
    }
    // A tile that nobody had seen, and one that is gone.
    let mut grown = floor();
    grown.push(tile([2, 0], &grain([2, 0])));
    assert_eq!(made(&grown, &before).1, 3);
    let (rows, anew) = made(&floor()[..5], &before);
    assert_eq!((rows.len(), anew), (5, 3));
}

#[test]
fn gradients_that_are_known_are_believed_for_their_content_alone() {
    let (sound, _) = made(&floor(), &[]);
    let mut known = sound.clone();
    known[0].content = "another".into();
    known[1].png = Bytes(vec![1, 2, 3]);
    known[2].tile_x += 100;
    known.push(known[3].clone());
    let (rows, anew) = made(&floor(), &known);
    assert_eq!((rows, anew), (sound, 3));
}

#[test]
fn the_operator_takes_what_the_version_before_knew() {
    let tiles = |tiles| inputs_of("tiles", tiles).unwrap();
    let gradients = |inputs: Vec<_>| {
        let (rows, losses) = yields::<OverheadGradients>("overhead_gradients", json!({}), inputs);
        assert!(losses.is_empty(), "{losses:?}");
        rows
    };
    let before = gradients(vec![tiles(floor())]);
    assert_eq!(before, made(&floor(), &[]).0);
    let now = changed([1, 1], 128, 128);
    let previous = inputs_of("previous", before).unwrap();
    let rows = gradients(vec![tiles(now.clone()), previous]);
    assert_eq!(rows, made(&now, &[]).0);
    let torn = OverheadTile {
        png: Bytes(vec![]),
        ..floor().remove(0)
    };
    let inputs = [tiles(vec![torn])];
    let (rows, losses) = yields::<OverheadGradients>("overhead_gradients", json!({}), inputs);
    assert!(rows.is_empty());
    assert_eq!(losses.0["tile is not as overhead_tiles makes them"], 1);
}
