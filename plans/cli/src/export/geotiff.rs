//! Overhead tiles as one Cloud Optimized GeoTIFF that says itself where it is: tiled, with an overview for each halving, grey
//! or in colour, with alpha.
//!
//! ```text
//!                 on earth                                      in the map's metres
//! CRS             transverse Mercator, as keys of its own       local, metres
//! place           ModelTransformation (the map may be turned)   ModelTiepoint and ModelPixelScale
//! ```
//! Format: OGC GeoTIFF 1.1 (19-008r4), TIFF 6.0.

mod layout;

use evermap_algorithms::ground::channels::{Channels, Pixels};
use evermap_algorithms::ground::patch::Patch;
use evermap_schemas::Fault;
use rayon::prelude::*;
use tiff::TiffError;
use tiff::encoder::compression::{CompressionAlgorithm, Deflate};
use tiff::tags::Tag;

use crate::earth::SiteOnEarth;
use crate::export::geotiff::layout::{Directory, Level};
use crate::mosaic::Mosaic;

/// Cells along the side of a block of the file; TIFF wants a multiple of 16.
const BLOCK: usize = 256;
/// What the coordinates are where nobody knows where on earth they lie.
const LOCAL: &str = "local metres in the map frame";
/// GeoTIFF's number for what the file itself defines.
const USER_DEFINED: u16 = 32_767;

/// The file of a picture; in the map's metres where its place on earth is not given.
///
/// # Errors
/// A resource fault for a picture too large for the format.
pub fn bytes(picture: &Mosaic, place: Option<&SiteOnEarth>) -> Result<Vec<u8>, Fault> {
    let levels = levels(picture, place)
        .map_err(|error| Fault::resource(format!("cannot encode the GeoTIFF: {error}")))?;
    layout::file(levels).ok_or_else(|| Fault::resource("the GeoTIFF would be larger than 4 GiB"))
}

fn levels(picture: &Mosaic, place: Option<&SiteOnEarth>) -> Result<Vec<Level>, TiffError> {
    let mut level = cells(picture);
    let mut first = Directory::default();
    locate(&mut first, picture, place)?;
    let mut levels = vec![image(first, &level)?];
    while level.width.max(level.height) > BLOCK {
        level = level.halved();
        let mut overview = Directory::default();
        overview.longs(Tag::NewSubfileType, &[1]);
        levels.push(image(overview, &level)?);
    }
    Ok(levels)
}

/// The cells of a picture. Its rows come from the north, as TIFF's do, so that halving keeps the north-western corner.
fn cells(picture: &Mosaic) -> Patch {
    let (values, weights): (Vec<u8>, Vec<u8>) = match &picture.cells {
        Pixels::Grey(cells) => cells.iter().map(|[grey, alpha]| (*grey, *alpha)).unzip(),
        Pixels::Colour(cells) => {
            let colours = cells.iter().flat_map(|cell| &cell[..3]).copied();
            (
                colours.collect(),
                cells.iter().map(|cell| cell[3]).collect(),
            )
        }
    };
    Patch {
        column: 0,
        row: 0,
        width: picture.width,
        height: picture.height,
        values,
        weights,
    }
}

/// One resolution, with what it takes to decode it.
fn image(mut directory: Directory, level: &Patch) -> Result<Level, TiffError> {
    let (columns, rows) = (level.width.div_ceil(BLOCK), level.height.div_ceil(BLOCK));
    let blocks: Vec<Vec<u8>> = (0..columns * rows)
        .into_par_iter()
        .map(|at| compressed(&block(level, at % columns, at / columns)))
        .collect::<Result<_, _>>()?;
    directory.longs(Tag::ImageWidth, &[u32::try_from(level.width)?]);
    directory.longs(Tag::ImageLength, &[u32::try_from(level.height)?]);
    let samples = level.channels().count() + 1;
    directory.shorts(Tag::BitsPerSample, &vec![8; samples]);
    // Deflate, as zlib has it.
    directory.shorts(Tag::Compression, &[8]);
    let interpretation = match level.channels() {
        // Black is zero.
        Channels::Grey => 1,
        // Red, green and blue.
        Channels::Colour => 2,
    };
    directory.shorts(Tag::PhotometricInterpretation, &[interpretation]);
    directory.shorts(Tag::SamplesPerPixel, &[samples as u16]);
    // Values and alpha cell by cell; the values are not multiplied by alpha.
    directory.shorts(Tag::PlanarConfiguration, &[1]);
    directory.shorts(Tag::ExtraSamples, &[2]);
    directory.longs(Tag::TileWidth, &[BLOCK as u32]);
    directory.longs(Tag::TileLength, &[BLOCK as u32]);
    Ok(Level { directory, blocks })
}

/// Values and alpha of a block; unseen beyond the edge of the picture.
fn block(level: &Patch, column: usize, row: usize) -> Vec<u8> {
    let count = level.channels().count();
    let samples = count + 1;
    let mut bytes = vec![0; samples * BLOCK * BLOCK];
    let (left, top) = (column * BLOCK, row * BLOCK);
    let width = BLOCK.min(level.width - left);
    for line in 0..BLOCK.min(level.height - top) {
        let from = (top + line) * level.width + left;
        let values = level.values[count * from..].chunks_exact(count);
        let cells = values.zip(&level.weights[from..]);
        let into = bytes[samples * BLOCK * line..].chunks_exact_mut(samples);
        for (cell, (values, alpha)) in into.zip(cells).take(width) {
            cell[..count].copy_from_slice(values);
            cell[count] = *alpha;
        }
    }
    bytes
}

/// A block as the file has it: of an even length, since TIFF's directories begin at even offsets. What follows the end of
/// the stream is ignored.
fn compressed(block: &[u8]) -> Result<Vec<u8>, TiffError> {
    let mut bytes = Vec::new();
    Deflate::default().write_to(&mut bytes, block)?;
    if !bytes.len().is_multiple_of(2) {
        bytes.push(0);
    }
    Ok(bytes)
}

/// Says where the picture is.
fn locate(
    directory: &mut Directory,
    picture: &Mosaic,
    place: Option<&SiteOnEarth>,
) -> Result<(), TiffError> {
    let (west, north, cell_m) = (picture.west, picture.north, picture.cell_m);
    let Some(place) = place else {
        directory.doubles(Tag::ModelPixelScaleTag, &[cell_m, cell_m, 0.0]);
        directory.doubles(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, west, north, 0.0]);
        // GTModelType, of this file's own; LinearUnits: metre.
        let keys = [(1024, USER_DEFINED), (3076, 9001)];
        return describe(directory, LOCAL, &keys, &[]);
    };
    let [right, down] = [[cell_m, 0.0], [0.0, -cell_m]].map(|[x, y]| place.turned(x, y));
    let first = place.turned(west, north);
    let east_north = |k: usize| [right[k], down[k], 0.0, first[k]];
    let rest = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let matrix = [&east_north(0)[..], &east_north(1), &rest].concat();
    directory.doubles(Tag::ModelTransformationTag, &matrix);
    let [latitude_deg, longitude_deg, scale] = place.transverse_mercator();
    let keys = [
        // GTModelType: projected.
        (1024, 1),
        // GeodeticCRS: WGS 84.
        (2048, 4326),
        // ProjectedCRS and Projection, by what follows.
        (3072, USER_DEFINED),
        (3074, USER_DEFINED),
        // ProjMethod: transverse Mercator.
        (3075, 1),
        // LinearUnits: metre.
        (3076, 9001),
    ];
    let parameters = [
        // ProjNatOriginLong, ProjNatOriginLat.
        (3080, longitude_deg),
        (3081, latitude_deg),
        // ProjFalseEasting, ProjFalseNorthing.
        (3082, 0.0),
        (3083, 0.0),
        // ProjScaleAtNatOrigin.
        (3092, scale),
    ];
    describe(directory, &place.name(), &keys, &parameters)
}

/// Writes GeoTIFF's keys: the citation, those that are a number of its tables, and those that are a measure.
fn describe(
    directory: &mut Directory,
    citation: &str,
    numbers: &[(u16, u16)],
    measures: &[(u16, f64)],
) -> Result<(), TiffError> {
    let mut text: String = citation
        .chars()
        .map(|letter| match letter {
            ' '..='{' | '}' | '~' => letter,
            _ => '_',
        })
        .collect();
    // The end of a text among several, and of an even length with its zero.
    text.push('|');
    let length = u16::try_from(text.len())?;
    if text.len().is_multiple_of(2) {
        text.push(' ');
    }
    // Key, tag that has the value (0: this one), how many, value or where it is.
    let mut entries: Vec<[u16; 4]> = vec![
        // GTRasterType: a cell is an area.
        [1025, 0, 1, 1],
        // GTCitation.
        [1026, Tag::GeoAsciiParamsTag.to_u16(), length, 0],
    ];
    entries.extend(numbers.iter().map(|(key, number)| [*key, 0, 1, *number]));
    let doubles = Tag::GeoDoubleParamsTag.to_u16();
    entries.extend(
        (0..)
            .zip(measures)
            .map(|(at, (key, _))| [*key, doubles, 1, at]),
    );
    entries.sort_unstable();
    // Version 1, revision 1.1.
    let head = [1, 1, 1, u16::try_from(entries.len())?];
    let all: Vec<u16> = head.into_iter().chain(entries.into_flattened()).collect();
    directory.shorts(Tag::GeoKeyDirectoryTag, &all);
    directory.text(Tag::GeoAsciiParamsTag, &text);
    if !measures.is_empty() {
        let values: Vec<f64> = measures.iter().map(|(_, value)| *value).collect();
        directory.doubles(Tag::GeoDoubleParamsTag, &values);
    }
    Ok(())
}

#[cfg(test)]
mod tests;
