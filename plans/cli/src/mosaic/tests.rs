#![allow(clippy::unwrap_used)]
use super::*;
use evermap_schemas::Bytes;

/// A tile of 4 by 4 cells of 0.5 m whose grey values come from a function of column and row.
pub(crate) fn tile(
    zoom: u32,
    x: i32,
    y: i32,
    side: usize,
    grey: impl Fn(usize, usize) -> [u8; 2],
) -> Tile {
    let cell_m = 0.5 * f64::from(1_u32 << zoom);
    let cells = (0..side * side)
        .map(|index| grey(index % side, index / side))
        .collect();
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
    assert_eq!(
        mosaic.cells[4],
        [0, 255],
        "the north-western cell of tile 0/0/1"
    );
    assert_eq!(mosaic.cells[7 + 3 * 8], [15, 255], "its south-eastern one");
    assert_eq!(mosaic.cells[4 * 8], [10, 255]);
    assert_eq!(mosaic.cells[0], [0, 0], "nothing was seen there");
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
    assert_eq!(mosaic.cells[0], [0, 0]);
    assert_eq!(mosaic.cells[16][0], 30);
    assert!(mosaic.cells[31][0] > 215);
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
