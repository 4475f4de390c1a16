//! Raw images as files that any decoder reads.

mod bayer;
mod yuv;

use std::borrow::Cow;

use evermap_schemas::ImageRef;
use evermap_schemas::roles::{RawFormat, SampleBits};
use evermap_video::Codec;

use bayer::Mosaic;
use yuv::Packing;

/// How a raw encoding lays pixels out.
enum Layout {
    /// Each pixel has its samples side by side: bytes of a pixel, and the bytes of the file's sample in order.
    Plain(usize, &'static [usize]),
    /// One colour a pixel, in a mosaic of two by two; one or two bytes each.
    Bayer(Mosaic, usize),
    /// Luma and chroma.
    Yuv(Packing),
    /// Numbers of 32 bits, one a pixel: depth in metres.
    Float,
}

/// The layout of an encoding as ROS (`sensor_msgs/image_encodings.hpp`) and Foxglove name it, and its largest value; 0 where
/// values have none.
fn layout(encoding: &str) -> Option<(Layout, u32)> {
    use Layout::{Bayer, Float, Plain, Yuv};
    let eight = |layout| Some((layout, 255));
    // Samples of two bytes are little endian here; the file wants them big endian.
    let sixteen = |layout| Some((layout, 65_535));
    if let Some((mosaic, bytes)) = Mosaic::named(encoding) {
        return match bytes {
            1 => eight(Bayer(mosaic, 1)),
            _ => sixteen(Bayer(mosaic, 2)),
        };
    }
    match encoding {
        "mono8" | "8UC1" => eight(Plain(1, &[0])),
        "rgb8" | "8UC3" => eight(Plain(3, &[0, 1, 2])),
        "bgr8" => eight(Plain(3, &[2, 1, 0])),
        "rgba8" => eight(Plain(4, &[0, 1, 2])),
        "bgra8" | "8UC4" => eight(Plain(4, &[2, 1, 0])),
        "mono16" | "16UC1" => sixteen(Plain(2, &[1, 0])),
        "rgb16" | "16UC3" => sixteen(Plain(6, &[1, 0, 3, 2, 5, 4])),
        "bgr16" => sixteen(Plain(6, &[5, 4, 3, 2, 1, 0])),
        "rgba16" => sixteen(Plain(8, &[1, 0, 3, 2, 5, 4])),
        "bgra16" | "16UC4" => sixteen(Plain(8, &[5, 4, 3, 2, 1, 0])),
        "uyvy" | "yuv422" => eight(Yuv(Packing::Uyvy)),
        "yuyv" | "yuv422_yuy2" => eight(Yuv(Packing::Yuyv)),
        "nv12" => eight(Yuv(Packing::Nv12)),
        "nv21" => eight(Yuv(Packing::Nv21)),
        "nv24" => eight(Yuv(Packing::Nv24)),
        "32FC1" => Some((Float, 0)),
        _ => None,
    }
}

/// An image as a file that any decoder reads: a raw one as netpbm (colour RGB, rows without padding, 8 bits where samples of
/// 16 have fewer), JPEG and PNG as they are, as a frame of video, which the reader of images has decoded. `compressedDepth`
/// is a PNG behind a header, which only metres need, to be read by `decode_depth`.
///
/// # Errors
/// In words: for an encoding that nobody here reads, fewer bytes than the size asks for, or samples of more bits than they are
/// said to have.
pub fn as_file<'a>(image: &ImageRef, bytes: &'a [u8]) -> Result<Cow<'a, [u8]>, String> {
    let RawFormat {
        encoding,
        bits,
        is_big_endian,
    } = RawFormat::parse(&image.format);
    match encoding {
        "jpeg" | "png" | "compressedDepth 32FC1" => return Ok(bytes.into()),
        "compressedDepth 16UC1" => return Ok(bytes.get(12..).unwrap_or_default().into()),
        _ if Codec::named(encoding).is_some() => return Ok(bytes.into()),
        _ => {}
    }
    let Some((layout, maximum)) = layout(encoding) else {
        return Err(format!(
            "expected jpeg, png, h264, h265 or a raw encoding of ROS or Foxglove, found {encoding:?}"
        ));
    };
    let sample = sample(&layout, maximum);
    if bits.is_some() && sample != 2 {
        return Err(format!(
            "expected samples of 16 bits, of which fewer are used, found {encoding}"
        ));
    }
    let (Some(width), Some(height), Some(step)) = (image.width, image.height, image.step) else {
        return Err(format!("{encoding} without width, height and step"));
    };
    let (width, height, step) = (width as usize, height as usize, step as usize);
    let (row, lines, samples) = match &layout {
        Layout::Plain(pixel, order) => (width.saturating_mul(*pixel), height, order.len()),
        Layout::Bayer(_, bytes) => (width.saturating_mul(*bytes), height, 3 * bytes),
        Layout::Yuv(packing) => (packing.row(width), packing.lines(height), 3),
        Layout::Float => (width.saturating_mul(4), height, 4),
    };
    let expected = step.saturating_mul(lines);
    if row == 0 || step < row || bytes.len() < expected {
        return Err(format!(
            "{encoding} of {width} × {height}: expected rows of {row} B and {expected} B in all, found rows of {step} B and {} B",
            bytes.len()
        ));
    }
    let bytes: Cow<'_, [u8]> = match is_big_endian {
        true => turned(&bytes[..expected], step, row, sample).into(),
        false => bytes.into(),
    };
    let maximum = bits.map_or(maximum, |_| 255);
    let mut file = match &layout {
        // Little endian, which a scale below zero says.
        Layout::Float => format!("Pf\n{width} {height}\n-1.0\n"),
        _ if samples < 3 => format!("P5\n{width} {height}\n{maximum}\n"),
        _ => format!("P6\n{width} {height}\n{maximum}\n"),
    }
    .into_bytes();
    let header = file.len();
    file.reserve(width * height * samples);
    match layout {
        Layout::Plain(pixel, order) => {
            for line in bytes.chunks(step).take(height) {
                for pixel in line[..row].chunks_exact(pixel) {
                    file.extend(order.iter().map(|&sample| pixel[sample]));
                }
            }
        }
        Layout::Bayer(mosaic, bytes_each) => {
            mosaic.write(&bytes, [width, height], step, bytes_each, &mut file);
        }
        Layout::Yuv(packing) => packing.write(&bytes, [width, height], step, &mut file),
        // From the lowest row to the highest.
        Layout::Float => {
            let lines = bytes.chunks(step).take(height).rev();
            lines.for_each(|line| file.extend_from_slice(&line[..row]));
        }
    }
    if let Some(bits) = bits {
        keep_upper_eight(&mut file, header, bits)?;
    }
    Ok(file.into())
}

/// Of samples of 16 bits, the highest byte first, from a place on: the upper eight of those that are used.
fn keep_upper_eight(file: &mut Vec<u8>, header: usize, bits: SampleBits) -> Result<(), String> {
    let samples = (file.len() - header) / 2;
    for index in 0..samples {
        let at = header + 2 * index;
        let sample = u16::from_be_bytes([file[at], file[at + 1]]);
        file[header + index] = bits.upper_eight(sample).ok_or_else(|| {
            format!(
                "expected samples of {bits} bits, as the session manifest says in `bits`, found one of {sample}"
            )
        })?;
    }
    file.truncate(header + samples);
    Ok(())
}

/// Bytes of a sample.
fn sample(layout: &Layout, maximum: u32) -> usize {
    match layout {
        Layout::Float => 4,
        _ if maximum > 255 => 2,
        _ => 1,
    }
}

/// Rows with the bytes of each sample in the other order; what follows a row within its step stays.
fn turned(bytes: &[u8], step: usize, row: usize, sample: usize) -> Vec<u8> {
    let mut turned = bytes.to_vec();
    for line in turned.chunks_mut(step) {
        let samples = line[..row].chunks_exact_mut(sample);
        samples.for_each(<[u8]>::reverse);
    }
    turned
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use evermap_schemas::roles::BIG_ENDIAN;

    use super::*;

    pub fn raw(format: &str, width: u32, height: u32, step: u32) -> ImageRef {
        ImageRef {
            format: format.into(),
            width: Some(width),
            height: Some(height),
            step: Some(step),
            ..ImageRef::default()
        }
    }

    #[test]
    fn raw_images_become_netpbm_without_padding() {
        let padded = [1, 2, 0, 3, 4, 0];
        for (image, bytes, file) in [
            (
                raw("mono8", 2, 2, 3),
                &padded[..],
                &b"P5\n2 2\n255\n\x01\x02\x03\x04"[..],
            ),
            (
                raw("bgr8", 1, 1, 3),
                &[1, 2, 3],
                b"P6\n1 1\n255\n\x03\x02\x01",
            ),
            (raw("mono16", 1, 1, 2), &[1, 2], b"P5\n1 1\n65535\n\x02\x01"),
            (
                raw("32FC1", 1, 2, 5),
                &[1, 2, 3, 4, 0, 5, 6, 7, 8, 0],
                b"Pf\n1 2\n-1.0\n\x05\x06\x07\x08\x01\x02\x03\x04",
            ),
            (
                raw("bgr16", 1, 1, 6),
                &[1, 2, 3, 4, 5, 6],
                b"P6\n1 1\n65535\n\x06\x05\x04\x03\x02\x01",
            ),
        ] {
            assert_eq!(
                as_file(&image, bytes).unwrap().as_ref(),
                file,
                "{}",
                image.format
            );
        }
    }

    #[test]
    fn samples_that_begin_with_the_highest_byte_make_the_same_files() {
        for (encoding, sample, width) in [
            ("mono16", 2, 12),
            ("16UC1", 2, 12),
            ("bgr16", 2, 4),
            ("rgba16", 2, 3),
            ("bayer_grbg16", 2, 12),
            ("32FC1", 4, 6),
            ("mono8", 1, 24),
        ] {
            // Rows of 24 bytes and 5 of padding, which no sample reaches into.
            let little: Vec<u8> = (0..58).map(|byte| byte * 4 + 1).collect();
            let mut big = little.clone();
            for line in big.chunks_mut(29) {
                for sample in line[..24].chunks_mut(sample) {
                    sample.reverse();
                }
            }
            let image = raw(encoding, width, 2, 29);
            let expected = as_file(&image, &little).unwrap();
            let told = raw(&format!("{encoding}{BIG_ENDIAN}"), width, 2, 29);
            assert_eq!(as_file(&told, &big).unwrap(), expected, "{encoding}");
            let untold = as_file(&image, &big).unwrap();
            assert_eq!(untold == expected, sample == 1, "{encoding}");
        }
        let unread = as_file(&raw("64FC1 big-endian", 1, 1, 8), &[0; 8]).unwrap_err();
        assert!(unread.contains("\"64FC1\""), "{unread}");
    }

    #[test]
    fn samples_of_fewer_bits_become_files_of_their_upper_eight() {
        let samples = |values: [u16; 4]| values.map(u16::to_le_bytes).concat();
        for (format, values, file) in [
            ("mono16 10-bit", [0, 1023, 4, 512], [0, 255, 1, 128]),
            ("mono16 12-bit", [0, 4095, 16, 2048], [0, 255, 1, 128]),
            ("16UC1 14-bit", [0, 16383, 64, 8192], [0, 255, 1, 128]),
        ] {
            let expected = [&b"P5\n2 2\n255\n"[..], &file].concat();
            let bytes = samples(values);
            let image = raw(format, 2, 2, 4);
            assert_eq!(*as_file(&image, &bytes).unwrap(), *expected, "{format}");
            let big: Vec<u8> = bytes.chunks(2).flat_map(|two| [two[1], two[0]]).collect();
            let image = raw(&format!("{format}{BIG_ENDIAN}"), 2, 2, 4);
            assert_eq!(*as_file(&image, &big).unwrap(), *expected, "{format}");
        }
        // A mosaic of one grey: 12 bits of it in every colour.
        let bayer = raw("bayer_grbg16 12-bit", 2, 2, 4);
        let expected = [&b"P6\n2 2\n255\n"[..], &[0x12; 12]].concat();
        assert_eq!(*as_file(&bayer, &samples([0x123; 4])).unwrap(), *expected);
        let bytes = samples([0, 1023, 1024, 5]);
        let more = as_file(&raw("mono16 10-bit", 2, 2, 4), &bytes);
        let more = more.unwrap_err();
        assert!(
            more.contains("of 10 bits") && more.contains("one of 1024"),
            "{more}"
        );
        let narrow = as_file(&raw("mono8 12-bit", 2, 2, 2), &[0; 4]).unwrap_err();
        assert!(narrow.contains("samples of 16 bits"), "{narrow}");
    }

    #[test]
    fn what_is_not_read_is_named() {
        let unknown = as_file(&raw("av1", 9, 9, 9), &[1, 2]).unwrap_err();
        assert!(unknown.contains("av1"), "{unknown}");
        let short = as_file(&raw("mono8", 9, 9, 9), &[1, 2]).unwrap_err();
        assert!(
            short.contains("81 B in all") && short.contains("2 B"),
            "{short}"
        );
        for (width, height, step) in [(u32::MAX, u32::MAX, u32::MAX), (0, 1, 1), (2, 2, 1)] {
            for encoding in ["rgba16", "nv12", "bayer_rggb16", "yuyv", "32FC1"] {
                as_file(&raw(encoding, width, height, step), &[0; 64]).unwrap_err();
            }
        }
    }
}
