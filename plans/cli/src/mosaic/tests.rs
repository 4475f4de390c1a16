#![allow(clippy::unwrap_used, clippy::panic)]
use super::*;
use evermap_schemas::Bytes;

/// A tile of cells of 0.5 m whose grey values and alpha come from a function of column and row.
pub(crate) fn tile(
    zoom: u32,
    x: i32,
    y: i32,
    side: usize,
    grey: impl Fn(usize, usize) -> [u8; 2],
) -> Tile {
    let cells = (0..side * side).map(|index| grey(index % side, index / side));
    of_pixels(zoom, [x, y], side, Pixels::Grey(cells.collect()))
}

/// The same in colour.
pub(crate) fn colour_tile(
    [x, y]: [i32; 2],
    side: usize,
    colour: impl Fn(usize, usize) -> [u8; 4],
) -> Tile {
    let cells = (0..side * side).map(|index| colour(index % side, index / side));
    of_pixels(0, [x, y], side, Pixels::Colour(cells.collect()))
}

fn of_pixels(zoom: u32, [x, y]: [i32; 2], side: usize, cells: Pixels) -> Tile {
    let cell_m = 0.5 * f64::from(1_u32 << zoom);
    let mosaic = Mosaic {
        cell_m,
        west: 0.0,
        north: 0.0,
        width: side,
        height: side,
        cells,
    };
    Tile {
        site: "lot".into(),
        zoom,
        tile_x: x,
        tile_y: y,
        cell_m,
        size_m: cell_m * side as f64,
        png: Bytes(mosaic.png().unwrap()),
    }
}

#[test]
fn tiles_lie_where_they_belong() {
    let tiles = [
        tile(0, -1, 0, 4, |_, _| [10, 255]),
        tile(0, 0, 1, 4, |c, r| [(c + 4 * r) as u8, 255]),
    ];
    let mosaic = Mosaic::of(&level(&tiles, 0)).unwrap();
    assert_eq!((mosaic.width, mosaic.height), (8, 8));
    assert_eq!((mosaic.west, mosaic.north), (-2.0, 4.0));
    let Pixels::Grey(cells) = &mosaic.cells else {
        panic!("grey tiles make a grey picture");
    };
    assert_eq!(cells[4], [0, 255], "the north-western cell of tile 0/0/1");
    assert_eq!(cells[7 + 3 * 8], [15, 255], "its south-eastern one");
    assert_eq!(cells[4 * 8], [10, 255]);
    assert_eq!(cells[0], [0, 0], "nothing was seen there");
    assert_eq!(mosaic.seen(), Some([-2.0, 0.0, 2.0, 4.0]));
    assert_eq!(mosaic.world_file(None), "0.5\n0\n0\n-0.5\n-1.75\n3.75\n");
}

#[test]
fn the_coarsest_level_that_is_fine_enough_is_chosen() {
    let tiles: Vec<_> = (0..4)
        .map(|zoom| tile(zoom, 0, 0, 4, |_, _| [0, 255]))
        .collect();
    let chosen = [0.1, 0.5, 0.9, 1.0, 2.0, 100.0].map(|m_per_px| zoom_for(&tiles, m_per_px));
    assert_eq!(chosen, [0, 0, 0, 1, 2, 3].map(Some));
    assert_eq!(zoom_for(&[], 1.0), None);
}

#[test]
fn a_level_that_is_not_there_is_answered_with_those_that_are() {
    let tiles = [1, 0, 2].map(|zoom| tile(zoom, 0, 0, 4, |_, _| [0, 255]));
    assert_eq!(at(&tiles, 1).unwrap().len(), 1);
    assert_eq!(
        at(&tiles, 9).unwrap_err().message,
        "expected one of the zoom levels 0, 1, 2, found 9"
    );
}

#[test]
fn stretching_uses_the_range_and_leaves_unseen_cells() {
    let tiles = [tile(0, 0, 0, 16, |c, r| {
        if r == 0 { [0, 0] } else { [100 + c as u8, 255] }
    })];
    let mut mosaic = Mosaic::of(&level(&tiles, 0)).unwrap();
    mosaic.stretch();
    assert_eq!(mosaic.colour(0), [0; 4]);
    assert_eq!(mosaic.colour(16)[0], 30);
    assert!(mosaic.colour(31)[0] > 215);
}

#[test]
fn a_grey_tile_beside_one_in_colour_has_three_equal_values() {
    let tiles = [
        tile(0, -1, 0, 4, |_, _| [10, 255]),
        colour_tile([0, 1], 4, |c, r| {
            [c as u8, 0, 200, if r == 0 { 0 } else { 255 }]
        }),
    ];
    let mosaic = Mosaic::of(&level(&tiles, 0)).unwrap();
    assert!(matches!(mosaic.cells, Pixels::Colour(_)));
    assert_eq!(mosaic.colour(4 * 8), [10, 10, 10, 255]);
    assert_eq!(mosaic.colour(7 + 3 * 8), [3, 0, 200, 255]);
    assert_eq!(mosaic.colour(0), [0; 4], "nothing was seen there");
    assert_eq!(mosaic.seen(), Some([-2.0, 0.0, 2.0, 3.5]));
    let (width, height, values) = decoded(&mosaic.png().unwrap(), ColorType::Rgba).unwrap();
    assert_eq!((width, height), (8, 8));
    assert_eq!(values[4 * (7 + 3 * 8)..][..4], [3, 0, 200, 255]);
}

#[test]
fn stretching_keeps_equal_channels_equal_and_their_order() {
    let tiles = [colour_tile([0, 0], 16, |c, r| {
        let grey = 100 + c as u8;
        [
            grey,
            grey,
            if r == 3 { grey / 2 } else { grey },
            if r == 0 { 0 } else { 255 },
        ]
    })];
    let mut mosaic = Mosaic::of(&level(&tiles, 0)).unwrap();
    mosaic.stretch();
    assert_eq!(mosaic.colour(0)[3], 0);
    let [red, green, blue, _] = mosaic.colour(4 * 16 + 15);
    assert!(red > 200 && red == green && green == blue);
    let [red, green, blue, _] = mosaic.colour(3 * 16 + 15);
    assert!(red == green && blue == 30, "{red} {blue}");
}

#[test]
fn a_picture_in_colour_may_have_half_as_many_cells() {
    let side = 1_u32 << 12;
    let wide = |tile: Tile| Tile {
        size_m: f64::from(side) * tile.cell_m,
        ..tile
    };
    // Two by four tiles of 2²⁴ cells; nobody reads them, as they would be too large or a coarser level is there.
    let corners = [[0, 0], [1, 3]];
    let grey = corners.map(|[x, y]| wide(tile(0, x, y, 4, |_, _| [0, 255])));
    assert_eq!(zoom_for(&grey, 0.1), Some(0));
    let colour = corners.map(|at| wide(colour_tile(at, 4, |_, _| [0, 0, 9, 255])));
    assert_eq!(zoom_for(&colour, 0.1), None);
    let fault = Mosaic::of(&level(&colour, 0)).unwrap_err();
    assert!(fault.to_string().contains("too large"), "{fault}");
}

#[test]
fn a_damaged_or_wrong_tile_is_named() {
    let mut broken = tile(2, 3, 4, 4, |_, _| [0, 255]);
    broken.png.0.truncate(20);
    let text = Mosaic::of(&[&broken]).unwrap_err().to_string();
    assert!(
        text.contains("tile 2/3/4") && text.contains("damaged"),
        "{text}"
    );
    let mut small = tile(0, 0, 0, 4, |_, _| [0, 255]);
    small.size_m = 4.0;
    assert!(
        Mosaic::of(&[&small])
            .unwrap_err()
            .to_string()
            .contains("expected a picture")
    );
    let far = [
        tile(0, i32::MIN, 0, 4, |_, _| [0, 0]),
        tile(0, i32::MAX, i32::MAX, 4, |_, _| [0, 0]),
    ];
    assert!(
        Mosaic::of(&level(&far, 0))
            .unwrap_err()
            .to_string()
            .contains("--zoom")
    );
}
