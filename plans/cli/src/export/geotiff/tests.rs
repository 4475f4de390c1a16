#![allow(clippy::unwrap_used)]
use std::process::Command;

use super::*;
use crate::earth::tests::lot;
use crate::mosaic::level;
use crate::mosaic::tests::{colour_tile, tile};

/// Two tiles of 400 cells with nothing between them, so that blocks end within the picture and beyond it.
fn picture() -> Mosaic {
    let grey = |column: usize, row: usize| [(column + 3 * row) as u8, 255];
    let tiles = [tile(0, -1, 0, 400, grey), tile(0, 0, 1, 400, grey)];
    Mosaic::of(&level(&tiles, 0)).unwrap()
}

/// The same places in colour: red as grey was, green the rest to 255, and a blue of 7.
fn in_colour() -> Mosaic {
    let colour = |column: usize, row: usize| {
        let red = (column + 3 * row) as u8;
        [red, 255 - red, 7, 255]
    };
    let tiles = [[-1, 0], [0, 1]].map(|at| colour_tile(at, 400, colour));
    Mosaic::of(&level(&tiles, 0)).unwrap()
}

/// GDAL's eyes, by rasterio: `tests/exports/geotiff.py`.
#[test]
fn gdal_finds_cells_transparency_and_place() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let python = root.join(".venv/bin/python");
    let Some(python) = evermap_test_data::there(python, "`make test` sets it up") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let files = [
        ("earth", picture(), Some(lot())),
        ("local", picture(), None),
        ("colour", in_colour(), None),
    ];
    for (name, picture, place) in files {
        let file = folder.path().join(name).with_extension("tif");
        std::fs::write(&file, bytes(&picture, place.as_ref()).unwrap()).unwrap();
        let mut reader = Command::new(&python);
        reader.arg(root.join("tests/exports/geotiff.py")).arg(name);
        let read = reader.arg(&file).output().unwrap();
        let said = String::from_utf8_lossy(&read.stderr);
        assert!(read.status.success(), "{name}: {said}");
    }
}

#[test]
fn the_same_picture_is_the_same_file() {
    let written = || bytes(&picture(), None).unwrap();
    assert_eq!(written(), written());
}
