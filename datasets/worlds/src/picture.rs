//! Pictures as PNG.

use crate::WorldError;
use png::{BitDepth, ColorType, Compression, Encoder};

/// A grey picture, row by row, 8 bits a pixel.
///
/// # Errors
/// [`WorldError::Png`] when the numbers do not fit (a bug).
pub fn grey_png(size: [u32; 2], pixels: &[u8]) -> Result<Vec<u8>, WorldError> {
    encoded(size, BitDepth::Eight, Compression::Balanced, pixels)
}

/// A grey picture, row by row, 16 bits a pixel.
///
/// # Errors
/// [`WorldError::Png`] when the numbers do not fit (a bug).
pub fn deep_png(size: [u32; 2], pixels: &[u16]) -> Result<Vec<u8>, WorldError> {
    let bytes: Vec<u8> = pixels
        .iter()
        .flat_map(|pixel| pixel.to_be_bytes())
        .collect();
    encoded(size, BitDepth::Sixteen, Compression::Fast, &bytes)
}

fn encoded(
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
