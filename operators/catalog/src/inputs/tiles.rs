//! Tiles of the overhead image as pictures of two channels.

use evermap_algorithms::ground::tiles::TILE_CELLS;
use evermap_contract::Fault;

/// A tile as a PNG of two channels, the northernmost row first. The encoder's settings are fixed: equal tiles are equal
/// bytes.
pub(crate) fn encoded(cells: &[u8]) -> Result<Vec<u8>, Fault> {
    let written = written(cells);
    written.map_err(|error| Fault::bug(format!("a tile does not encode: {error}")))
}

fn written(cells: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, TILE_CELLS as u32, TILE_CELLS as u32);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Balanced);
    encoder.set_filter(png::Filter::Paeth);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(cells)?;
    writer.finish()?;
    Ok(bytes)
}

/// The cells of a tile, the northernmost row first; `None` where it is no PNG of two channels and of a tile's size.
pub(crate) fn decoded(bytes: &[u8]) -> Option<Vec<[u8; 2]>> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .ok()?;
    let info = reader.info();
    let side = TILE_CELLS as u32;
    let is_tile = [info.width, info.height] == [side, side]
        && info.color_type == png::ColorType::GrayscaleAlpha
        && info.bit_depth == png::BitDepth::Eight;
    if !is_tile {
        return None;
    }
    let mut cells = vec![0; TILE_CELLS * TILE_CELLS * 2];
    reader.next_frame(&mut cells).ok()?;
    let (cells, _) = cells.as_chunks();
    Some(cells.to_vec())
}
