//! The overhead image by tiles, and the gradients of each: all that boxes are described by, made once of what a tile and
//! its surroundings show.
//!
//! Contrast is levelled over some metres, so what a tile shows is described with the rim of its neighbours. Their pixels
//! there are part of its *content*: a drive that changes them makes its gradients anew, and one that changes anything
//! farther away does not.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::mosaic::Mosaic;
use super::overhead::{GradientCell, Overhead};
use crate::ground::channels::{Channels, Pixels};
use crate::ground::tiles::TILE_CELLS;

/// Counts the ways in which gradients were made so far: those that were made another way are made anew.
const WAY: u32 = 2;

/// Tiles of one zoom level.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Side of a cell (m).
    cell_m: f64,
    /// By column (east) and row (north), as in [`crate::ground::tiles::TileKey`].
    tiles: BTreeMap<[i64; 2], Pixels>,
}

/// What a tile shows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DescribedTile {
    /// Its column and row.
    pub tile: [i64; 2],
    /// Digest of all that its gradients follow from, 64 hexadecimal digits.
    pub content: String,
    /// Its gradients, the northernmost row first; `None` where they are known.
    pub cells: Option<Vec<GradientCell>>,
}

impl Picture {
    /// Without tiles, of cells of this side (m).
    pub fn new(cell_m: f64) -> Self {
        Self {
            cell_m,
            tiles: BTreeMap::new(),
        }
    }

    /// Side of a cell (m).
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Adds a tile; false, and nothing is added, where there are more or fewer pixels than a tile has. Grey tiles may lie beside
    /// others in colour: grey is three equal values.
    pub fn add(&mut self, tile: [i64; 2], pixels: Pixels) -> bool {
        let is_whole = pixels.count() == TILE_CELLS * TILE_CELLS;
        if is_whole {
            self.tiles.insert(tile, pixels);
        }
        is_whole
    }

    /// What the tiles show, by column and row: those are described of which nobody knows the gradients, by tile and content.
    ///
    /// Takes time with the cells of the tiles that are described; the others are compared alone.
    pub fn described(
        &self,
        is_known: impl Fn([i64; 2], &str) -> bool + Sync,
    ) -> Vec<DescribedTile> {
        let tiles: Vec<[i64; 2]> = self.tiles.keys().copied().collect();
        let described = tiles.into_par_iter().map(|tile| {
            let image = self.around(tile);
            let content = content(&image);
            let cells = (!is_known(tile, &content)).then(|| inner(&image));
            DescribedTile {
                tile,
                content,
                cells,
            }
        });
        described.collect()
    }

    /// The gradients of all tiles, made anew.
    pub fn mosaic(&self) -> Mosaic {
        let mut mosaic = Mosaic::new(self.cell_m);
        for described in self.described(|_, _| false) {
            mosaic.add(described.tile, described.cells.unwrap_or_default());
        }
        mosaic
    }

    /// A tile with as much around it as its gradients depend on.
    fn around(&self, tile: [i64; 2]) -> Overhead {
        let margin = Overhead::margin(self.cell_m);
        let side = TILE_CELLS + 2 * margin;
        let reach = margin.div_ceil(TILE_CELLS) as i64;
        let around = (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| [x, y]));
        let near: Vec<(&Pixels, [i64; 2])> = around
            .filter_map(|[x, y]| {
                let near = [tile[0].saturating_add(x), tile[1].saturating_add(y)];
                let cells = |tiles: i64| margin as i64 + tiles * TILE_CELLS as i64;
                Some((self.tiles.get(&near)?, [cells(x), cells(-y)]))
            })
            .collect();
        let in_colour = near
            .iter()
            .any(|(pixels, _)| matches!(pixels, Pixels::Colour(_)));
        let channels = if in_colour {
            Channels::Colour
        } else {
            Channels::Grey
        };
        let mut image = Overhead::unseen(channels, [side; 2], self.cell_m);
        for (pixels, corner) in near {
            lay(&mut image, pixels, corner);
        }
        image.without_equal_channels()
    }
}

/// Lays the part of a tile that an image has room for on it, with the tile's north-western corner at this column and row.
fn lay(image: &mut Overhead, pixels: &Pixels, corner: [i64; 2]) {
    match pixels {
        Pixels::Grey(pixels) => lay_each(image, pixels, corner, |[grey, alpha]| {
            ([*grey; 3], *alpha > 0)
        }),
        Pixels::Colour(pixels) => lay_each(image, pixels, corner, |[red, green, blue, alpha]| {
            ([*red, *green, *blue], *alpha > 0)
        }),
    }
}

/// [`lay`], of pixels with a colour, and whether anything was seen there. On a grey image all pixels are grey.
fn lay_each<P>(
    image: &mut Overhead,
    pixels: &[P],
    [column, row]: [i64; 2],
    shown: impl Fn(&P) -> ([u8; 3], bool),
) {
    let within = |at: i64, count: usize| usize::try_from(at).ok().filter(|at| *at < count);
    for (down, line) in (0..).zip(pixels.chunks(TILE_CELLS)) {
        let Some(row) = within(row + down, image.rows) else {
            continue;
        };
        for (right, pixel) in (0..).zip(line) {
            if let Some(column) = within(column + right, image.columns) {
                let at = row * image.columns + column;
                let (colour, is_covered) = shown(pixel);
                for (channel, value) in image.channels.iter_mut().zip(colour) {
                    channel[at] = value;
                }
                image.covered[at] = is_covered;
            }
        }
    }
}

fn content(image: &Overhead) -> String {
    let mut digest = blake3::Hasher::new();
    digest.update(&WAY.to_le_bytes());
    digest.update(&image.cell_m.to_le_bytes());
    for channel in &image.channels {
        digest.update(channel);
    }
    let covered = image.covered.iter().map(|seen| u8::from(*seen));
    digest.update(&covered.collect::<Vec<u8>>());
    digest.finalize().to_hex().to_string()
}

/// The gradients of the tile in the middle of an image.
fn inner(image: &Overhead) -> Vec<GradientCell> {
    let margin = (image.columns - TILE_CELLS) / 2;
    let cells = image.gradients();
    let lines = cells.chunks(image.columns).skip(margin).take(TILE_CELLS);
    lines
        .flat_map(|line| &line[margin..margin + TILE_CELLS])
        .copied()
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::solving::random::SplitMix64;

    const CELL_M: f64 = 0.05;

    /// Grain, the same for the same seed, on which somebody has drawn a line from south to north.
    fn tile(seed: u64) -> Vec<[u8; 2]> {
        let mut random = SplitMix64(seed);
        let pixel = |at: usize| {
            let is_line = (100..103).contains(&(at % TILE_CELLS));
            let grain = 20.0 * random.unit();
            [if is_line { 200 } else { 90 + grain as u8 }, 255]
        };
        (0..TILE_CELLS * TILE_CELLS).map(pixel).collect()
    }

    /// Five tiles in a row from west to east.
    fn row() -> Picture {
        let mut picture = Picture::new(CELL_M);
        for x in 0..5 {
            assert!(picture.add([x, 0], Pixels::Grey(tile(x as u64))));
        }
        picture
    }

    /// The columns of the tiles that are described when what a picture showed before is known.
    fn anew(picture: &Picture, before: &[DescribedTile]) -> Vec<i64> {
        let is_known = |tile: [i64; 2], content: &str| {
            let mut before = before.iter();
            before.any(|known| known.tile == tile && known.content == content)
        };
        let described = picture.described(is_known).into_iter();
        let anew = described.filter(|tile| tile.cells.is_some());
        anew.map(|tile| tile.tile[0]).collect()
    }

    #[test]
    fn a_tile_is_described_once_for_what_it_and_its_rim_show() {
        let mut picture = row();
        let before = picture.described(|_, _| false);
        assert!(before.iter().all(|tile| tile.cells.is_some()));
        assert!(anew(&picture, &before).is_empty());
        // In the middle of a tile, farther from its neighbours than contrast is levelled.
        let mut changed = tile(2);
        changed[128 * TILE_CELLS + 128] = [255, 255];
        picture.add([2, 0], Pixels::Grey(changed.clone()));
        assert_eq!(anew(&picture, &before), [2]);
        // Two metres from its western border, in the rim of the neighbour there.
        changed[128 * TILE_CELLS + 40] = [255, 255];
        picture.add([2, 0], Pixels::Grey(changed));
        assert_eq!(anew(&picture, &before), [1, 2]);
        // A tile more: its neighbour has another rim.
        let mut picture = row();
        picture.add([5, 0], Pixels::Grey(tile(5)));
        assert_eq!(anew(&picture, &before), [4, 5]);
        // The same pixels in cells of another size are something else.
        let mut coarser = Picture::new(0.1);
        coarser.add([0, 0], Pixels::Grey(tile(0)));
        assert_eq!(anew(&coarser, &before), [0]);
    }

    #[test]
    fn tiles_are_described_as_one_image_is() {
        let picture = row();
        let (columns, rows) = (5 * TILE_CELLS, TILE_CELLS);
        let mut whole = Overhead::unseen(Channels::Grey, [columns, rows], CELL_M);
        for ([x, _], pixels) in &picture.tiles {
            lay(&mut whole, pixels, [x * TILE_CELLS as i64, 0]);
        }
        let whole = whole.gradients();
        for described in picture.described(|_, _| false) {
            let cells = described.cells.unwrap();
            let west = described.tile[0] as usize * TILE_CELLS;
            let lines = cells.chunks(TILE_CELLS).zip(whole.chunks(columns));
            let differ = lines.flat_map(|(line, whole)| line.iter().zip(&whole[west..]));
            // Sums of whole images are rounded elsewhere: a cell may be a step off.
            let differ = differ.filter(|(one, other)| one[0].abs_diff(other[0]) > 1);
            assert_eq!(differ.count(), 0);
        }
    }

    /// The line of a tile yellow, as bright as a floor of this grey value.
    fn yellow(seed: u64, floor: u8) -> Vec<[u8; 4]> {
        let pixels = tile(seed).into_iter().map(|[grey, alpha]| match grey {
            200 => [floor + 20, floor + 8, floor.saturating_sub(90), alpha],
            grey => [grey, grey, grey, alpha],
        });
        pixels.collect()
    }

    /// The contents and gradients of a picture, without what is known.
    fn all(picture: &Picture) -> Vec<(String, Vec<GradientCell>)> {
        let described = picture.described(|_, _| false).into_iter();
        described
            .map(|tile| (tile.content, tile.cells.unwrap()))
            .collect()
    }

    #[test]
    fn equal_channels_are_described_as_grey_is() {
        let mut colours = Picture::new(CELL_M);
        for x in 0..5 {
            let grey = tile(x as u64);
            let colour = grey
                .iter()
                .map(|[grey, alpha]| [*grey, *grey, *grey, *alpha]);
            // Some tiles are grey all the same.
            let pixels = match x {
                1 | 2 => Pixels::Grey(grey),
                _ => Pixels::Colour(colour.collect()),
            };
            assert!(colours.add([x, 0], pixels));
        }
        assert_eq!(all(&colours), all(&row()));
    }

    #[test]
    fn a_line_that_is_as_bright_as_the_floor_shows_in_colour() {
        let [mut grey, mut colour] = [Picture::new(CELL_M), Picture::new(CELL_M)];
        let pixels = yellow(1, 100);
        let luma = pixels.iter().map(|[red, green, blue, alpha]| {
            let [red, green, blue] = [red, green, blue].map(|it| u32::from(*it));
            [
                ((299 * red + 587 * green + 114 * blue) / 1000) as u8,
                *alpha,
            ]
        });
        grey.add([0, 0], Pixels::Grey(luma.collect()));
        colour.add([0, 0], Pixels::Colour(pixels));
        let of_line = |picture: &Picture| {
            let (_, cells) = all(picture).remove(0);
            let near = cells.chunks(TILE_CELLS).skip(20).take(200);
            near.map(|line| u32::from(line[101][0])).sum::<u32>() / 200
        };
        let [in_grey, in_colour] = [&grey, &colour].map(of_line);
        assert!(in_colour > 3 * in_grey, "{in_colour} {in_grey}");
    }

    #[test]
    fn a_colour_in_the_rim_of_a_neighbour_is_something_else_there_too() {
        let before = row().described(|_, _| false);
        let with = |at: usize| {
            let mut picture = row();
            let grey = tile(2).into_iter();
            let mut colour: Vec<[u8; 4]> = grey
                .map(|[grey, alpha]| [grey, grey, grey, alpha])
                .collect();
            colour[at][2] ^= 64;
            picture.add([2, 0], Pixels::Colour(colour));
            anew(&picture, &before)
        };
        assert_eq!(with(128 * TILE_CELLS + 128), [2]);
        assert_eq!(with(128 * TILE_CELLS + 40), [1, 2]);
    }

    #[test]
    fn cells_of_any_size_are_described() {
        for cell_m in [1e-300, 0.05, 1e300] {
            let mut picture = Picture::new(cell_m);
            picture.add([0, 0], Pixels::Grey(tile(0)));
            assert_eq!(picture.described(|_, _| false).len(), 1);
        }
        let few = [Pixels::Grey(vec![[0; 2]]), Pixels::Colour(vec![[0; 4]])];
        assert!(few.map(|few| Picture::new(CELL_M).add([0, 0], few)) == [false; 2]);
    }
}
