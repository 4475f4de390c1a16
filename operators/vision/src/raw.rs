//! Raw images, as `sensor_msgs/Image` and `foxglove.RawImage` carry them, to grey.

use crate::grey::checked_pixels;
use crate::{Grey, ImageError};

/// The encodings that [`from_raw`] understands.
pub const RAW_ENCODINGS: [&str; 8] = [
    "mono8", "8UC1", "rgb8", "bgr8", "rgba8", "bgra8", "mono16", "16UC1",
];

/// How a pixel's bytes become grey.
#[derive(Clone, Copy)]
enum Pixel {
    Grey8,
    Grey16 { big_endian: bool },
    Colour { bytes: usize, red: usize },
}

impl Pixel {
    fn of(encoding: &str, big_endian: bool) -> Result<Self, ImageError> {
        Ok(match encoding {
            "mono8" | "8UC1" => Self::Grey8,
            "mono16" | "16UC1" => Self::Grey16 { big_endian },
            "rgb8" => Self::Colour { bytes: 3, red: 0 },
            "bgr8" => Self::Colour { bytes: 3, red: 2 },
            "rgba8" => Self::Colour { bytes: 4, red: 0 },
            "bgra8" => Self::Colour { bytes: 4, red: 2 },
            found => {
                return Err(ImageError::Encoding {
                    found: found.to_owned(),
                });
            }
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::Grey8 => 1,
            Self::Grey16 { .. } => 2,
            Self::Colour { bytes, .. } => bytes,
        }
    }

    fn row(self, row: &[u8], grey: &mut [u8]) {
        match self {
            Self::Grey8 => grey.copy_from_slice(row),
            Self::Grey16 { big_endian } => {
                let high = usize::from(!big_endian);
                for (grey, pixel) in grey.iter_mut().zip(row.chunks_exact(2)) {
                    *grey = pixel[high];
                }
            }
            Self::Colour { bytes, red } => {
                for (grey, pixel) in grey.iter_mut().zip(row.chunks_exact(bytes)) {
                    *grey = luma(pixel[red], pixel[1], pixel[2 - red]);
                }
            }
        }
    }
}

/// Rec. 601 luma in 16-bit fixed point, rounded: `0.299 R + 0.587 G + 0.114 B`.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let sum = 19_595 * u32::from(red) + 38_470 * u32::from(green) + 7_471 * u32::from(blue);
    ((sum + (1 << 15)) >> 16) as u8
}

/// The grey image that raw pixels make.
///
/// `step` is the row stride in bytes (0: rows without gaps); bytes after the last pixel of the last row may be
/// missing. Colour becomes Rec. 601 luma; of 16 bits the upper 8 are kept, which is division by 256; alpha is ignored.
///
/// # Errors
/// [`ImageError`] for an unknown encoding (see [`RAW_ENCODINGS`]), no or too many pixels, a step shorter than a row,
/// or too few bytes.
pub fn from_raw(
    encoding: &str,
    width: u32,
    height: u32,
    step: u32,
    big_endian: bool,
    bytes: &[u8],
) -> Result<Grey, ImageError> {
    let pixel = Pixel::of(encoding, big_endian)?;
    checked_pixels(width, height)?;
    let row_bytes = width as usize * pixel.bytes();
    let step = match step as usize {
        0 => row_bytes,
        step => step,
    };
    at_least("step", row_bytes, step)?;
    at_least(
        "data",
        step * (height as usize - 1) + row_bytes,
        bytes.len(),
    )?;
    let mut grey = Grey::default();
    grey.reset(width, height)?;
    for (row, grey) in bytes
        .chunks(step)
        .zip(grey.data.chunks_exact_mut(width as usize))
    {
        pixel.row(&row[..row_bytes], grey);
    }
    Ok(grey)
}

fn at_least(what: &'static str, expected: usize, found: usize) -> Result<(), ImageError> {
    if found >= expected {
        return Ok(());
    }
    Err(ImageError::Length {
        what,
        expected: expected as u64,
        found: found as u64,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use proptest::prelude::*;

    fn grey(encoding: &str, size: [u32; 2], step: u32, bytes: &[u8]) -> Vec<u8> {
        from_raw(encoding, size[0], size[1], step, false, bytes)
            .unwrap()
            .data
    }

    #[test]
    fn every_encoding_gives_the_grey_that_it_shows() {
        assert_eq!(grey("mono8", [2, 2], 3, &[1, 2, 99, 3, 4]), [1, 2, 3, 4]);
        assert_eq!(grey("8UC1", [2, 1], 0, &[7, 8]), [7, 8]);
        assert_eq!(grey("rgb8", [2, 1], 6, &[255, 0, 0, 0, 0, 255]), [76, 29]);
        assert_eq!(grey("bgr8", [2, 1], 6, &[255, 0, 0, 0, 0, 255]), [29, 76]);
        assert_eq!(grey("rgba8", [1, 1], 4, &[0, 255, 0, 5]), [150]);
        assert_eq!(grey("bgra8", [1, 1], 4, &[255, 255, 255, 0]), [255]);
        assert_eq!(grey("mono16", [1, 1], 2, &[0x34, 0x12]), [0x12]);
        let big = from_raw("16UC1", 1, 1, 2, true, &[0x12, 0x34]).unwrap();
        assert_eq!(big.data, [0x12]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let raw = |encoding, width, step, bytes| {
            from_raw(encoding, width, 2, step, false, bytes).unwrap_err()
        };
        assert!(
            raw("yuv422", 2, 0, &[0; 8])
                .to_string()
                .contains("known are mono8")
        );
        assert!(matches!(
            raw("mono8", 2, 1, &[0; 8]),
            ImageError::Length { what: "step", .. }
        ));
        assert!(matches!(
            raw("mono8", 2, 0, &[0; 3]),
            ImageError::Length { what: "data", .. }
        ));
        assert!(matches!(
            raw("rgba8", u32::MAX, 0, &[]),
            ImageError::Size { .. }
        ));
        assert!(matches!(
            raw("mono8", 0, 0, &[]),
            ImageError::Size { width: 0, .. }
        ));
    }

    proptest! {
        #[test]
        fn no_size_step_or_length_panics(
            encoding in prop::sample::select(RAW_ENCODINGS.to_vec()),
            width in prop_oneof![0_u32..40, any::<u32>()],
            height in prop_oneof![0_u32..40, any::<u32>()],
            step in prop_oneof![0_u32..200, any::<u32>()],
            bytes in prop::collection::vec(any::<u8>(), 0..6000),
        ) {
            if let Ok(grey) = from_raw(encoding, width, height, step, true, &bytes) {
                prop_assert_eq!(grey.data.len() as u64, u64::from(width) * u64::from(height));
            }
        }
    }
}
