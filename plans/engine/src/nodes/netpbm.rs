//! Raw images as files that any decoder reads.

use std::borrow::Cow;

use evermap_schemas::ImageRef;

/// A raw image as a netpbm file, which any decoder reads; an encoded one as it is.
///
/// `mono8`, `8UC1`, `rgb8`, `bgr8`, `rgba8`, `bgra8`, `mono16` and `16UC1` are known; colour is made RGB, 16-bit
/// values big endian, as the format wants. Anything else is passed on untouched, for the decoder to refuse.
pub fn netpbm<'a>(image: &ImageRef, bytes: &'a [u8]) -> Cow<'a, [u8]> {
    let (Some(width), Some(height), Some(step)) = (image.width, image.height, image.step) else {
        return bytes.into();
    };
    let (magic, maximum, pixel, order): (&str, u32, usize, &[usize]) = match image.format.as_str() {
        "mono8" | "8UC1" => ("P5", 255, 1, &[0]),
        "rgb8" | "8UC3" => ("P6", 255, 3, &[0, 1, 2]),
        "bgr8" => ("P6", 255, 3, &[2, 1, 0]),
        "rgba8" => ("P6", 255, 4, &[0, 1, 2]),
        "bgra8" => ("P6", 255, 4, &[2, 1, 0]),
        "mono16" | "16UC1" => ("P5", 65535, 2, &[1, 0]),
        _ => return bytes.into(),
    };
    let (row, step) = (width as usize * pixel, step as usize);
    if step < row || bytes.len() < step.saturating_mul(height as usize) {
        return bytes.into();
    }
    let mut file = format!("{magic}\n{width} {height}\n{maximum}\n").into_bytes();
    for line in bytes.chunks(step.max(1)).take(height as usize) {
        for pixel in line[..row].chunks_exact(pixel) {
            file.extend(order.iter().map(|&channel| pixel[channel]));
        }
    }
    file.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(format: &str, width: u32, height: u32, step: u32) -> ImageRef {
        ImageRef {
            session: String::new(),
            part: 0,
            chunk: None,
            chunk_length: 0,
            chunk_size: 0,
            compression: String::new(),
            offset: 0,
            length: 0,
            format: format.into(),
            width: Some(width),
            height: Some(height),
            step: Some(step),
        }
    }

    #[test]
    fn raw_images_become_netpbm_without_padding() {
        let padded = [1, 2, 0, 3, 4, 0];
        assert_eq!(
            netpbm(&raw("mono8", 2, 2, 3), &padded).as_ref(),
            b"P5\n2 2\n255\n\x01\x02\x03\x04"
        );
        assert_eq!(
            netpbm(&raw("bgr8", 1, 1, 3), &[1, 2, 3]).as_ref(),
            b"P6\n1 1\n255\n\x03\x02\x01"
        );
        assert_eq!(
            netpbm(&raw("mono16", 1, 1, 2), &[1, 2]).as_ref(),
            b"P5\n1 1\n65535\n\x02\x01"
        );
    }

    #[test]
    fn a_raw_image_that_is_too_short_is_left_for_the_decoder_to_refuse() {
        assert_eq!(netpbm(&raw("mono8", 9, 9, 9), &[1, 2]).as_ref(), &[1, 2]);
    }
}
