//! Tiles of the ground as pictures.

use evermap_algorithms::ground::channels::Pixels;
use evermap_algorithms::ground::tiles::TILE_CELLS;
use evermap_contract::Fault;
use png::ColorType;

/// A tile as a PNG with these channels, the northernmost row first. The encoder's settings are fixed: equal tiles are equal
/// bytes.
pub(crate) fn encoded(channels: ColorType, cells: &[u8]) -> Result<Vec<u8>, Fault> {
    let written = written(channels, cells);
    written.map_err(|error| Fault::bug(format!("a tile does not encode: {error}")))
}

fn written(channels: ColorType, cells: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, TILE_CELLS as u32, TILE_CELLS as u32);
    encoder.set_color(channels);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Balanced);
    encoder.set_filter(png::Filter::Paeth);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(cells)?;
    writer.finish()?;
    Ok(bytes)
}

/// The cells of a tile of gradients, the northernmost row first; `None` where it is no PNG of two channels and of a tile's
/// size.
pub(crate) fn gradient_cells(bytes: &[u8]) -> Option<Vec<[u8; 2]>> {
    match decoded(bytes)? {
        Pixels::Grey(cells) => Some(cells),
        Pixels::Colour(_) => None,
    }
}

/// The cells of a tile of the overhead image; `None` where it is no PNG of a tile's size, grey or in colour with alpha.
pub(crate) fn decoded(bytes: &[u8]) -> Option<Pixels> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .ok()?;
    let info = reader.info();
    let side = TILE_CELLS as u32;
    let channels = info.color_type;
    let is_tile = [info.width, info.height] == [side, side]
        && matches!(channels, ColorType::GrayscaleAlpha | ColorType::Rgba)
        && info.bit_depth == png::BitDepth::Eight;
    if !is_tile {
        return None;
    }
    let mut values = vec![0; TILE_CELLS * TILE_CELLS * channels.samples()];
    reader.next_frame(&mut values).ok()?;
    Some(match channels {
        ColorType::Rgba => Pixels::Colour(values.as_chunks().0.to_vec()),
        _ => Pixels::Grey(values.as_chunks().0.to_vec()),
    })
}
