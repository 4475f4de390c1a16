//! Pictures, encoded.

use crate::WorldError;
use jpeg_encoder::ColorType as JpegColour;
use png::{BitDepth, ColorType, Compression, Encoder};

/// A grey picture as PNG, row by row, 8 bits a pixel.
pub fn grey_png(size: [u32; 2], pixels: &[u8]) -> Result<Vec<u8>, WorldError> {
    png(size, BitDepth::Eight, Compression::Balanced, pixels)
}

/// A grey picture as PNG, row by row, 16 bits a pixel.
pub fn deep_png(size: [u32; 2], pixels: &[u16]) -> Result<Vec<u8>, WorldError> {
    let bytes: Vec<u8> = pixels.iter().flat_map(|grey| grey.to_be_bytes()).collect();
    png(size, BitDepth::Sixteen, Compression::Fast, &bytes)
}

fn png(
    [width, height]: [u32; 2],
    depth: BitDepth,
    compression: Compression,
    bytes: &[u8],
) -> Result<Vec<u8>, WorldError> {
    let mut png = Vec::new();
    let mut encoder = Encoder::new(&mut png, width, height);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(depth);
    encoder.set_compression(compression);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bytes)?;
    writer.finish()?;
    Ok(png)
}

/// A picture as JPEG, row by row, 8 bits a channel; `quality` from 1 to 100.
pub fn jpeg(
    size: [u32; 2],
    colour: JpegColour,
    quality: u8,
    pixels: &[u8],
) -> Result<Vec<u8>, WorldError> {
    let [width, height] = size.map(|side| side as u16);
    let mut jpeg = Vec::with_capacity(pixels.len() / 4);
    jpeg_encoder::Encoder::new(&mut jpeg, quality).encode(pixels, width, height, colour)?;
    Ok(jpeg)
}
