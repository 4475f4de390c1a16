//! Decoding: exact where the format is, refused where the bytes are not an image, and never a panic.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use evermap_vision::{Grey, ImageError, decode_depth, decode_grey, holds_colour, image_size};
use png::{BitDepth, ColorType};
use proptest::prelude::*;

fn sample(width: u32, height: u32) -> Grey {
    let data = (0..height)
        .flat_map(|v| (0..width).map(move |u| ((u * 3 + v * 5) % 251) as u8))
        .collect();
    Grey {
        width,
        height,
        data,
    }
}

fn png_of(width: u32, height: u32, colour: ColorType, depth: BitDepth, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(data).unwrap();
    writer.finish().unwrap();
    bytes
}

fn grey_png(grey: &Grey) -> Vec<u8> {
    png_of(
        grey.width,
        grey.height,
        ColorType::Grayscale,
        BitDepth::Eight,
        &grey.data,
    )
}

fn pnm(header: &str, data: &[u8]) -> Vec<u8> {
    [header.as_bytes(), data].concat()
}

fn jpeg_of(grey: &Grey) -> Vec<u8> {
    let mut bytes = Vec::new();
    jpeg_encoder::Encoder::new(&mut bytes, 95)
        .encode(
            &grey.data,
            grey.width as u16,
            grey.height as u16,
            jpeg_encoder::ColorType::Luma,
        )
        .unwrap();
    bytes
}

fn decode(bytes: &[u8]) -> Result<Grey, ImageError> {
    let mut grey = Grey::default();
    decode_grey(bytes, &mut grey)?;
    Ok(grey)
}

#[test]
fn what_has_room_for_colours_is_told_by_its_header() {
    let png = |colour: ColorType| {
        let data = vec![7; 4 * colour.samples()];
        png_of(2, 2, colour, BitDepth::Eight, &data)
    };
    let jpeg = |colour: jpeg_encoder::ColorType| {
        let mut bytes = Vec::new();
        let samples = if colour == jpeg_encoder::ColorType::Luma {
            1
        } else {
            3
        };
        jpeg_encoder::Encoder::new(&mut bytes, 90)
            .encode(&vec![7; 64 * samples], 8, 8, colour)
            .unwrap();
        bytes
    };
    let expected = [
        (png(ColorType::Grayscale), false),
        (png(ColorType::GrayscaleAlpha), false),
        (png(ColorType::Rgb), true),
        (png(ColorType::Rgba), true),
        (pnm("P5\n2 1\n255\n", &[1, 2]), false),
        (pnm("P6\n1 1\n255\n", &[1, 2, 3]), true),
        (jpeg(jpeg_encoder::ColorType::Luma), false),
        // Grey, but recorded in colour.
        (jpeg(jpeg_encoder::ColorType::Rgb), true),
    ];
    for (bytes, in_colour) in expected {
        let head = bytes[..bytes.len().min(4)].to_vec();
        assert_eq!(holds_colour(&bytes), Ok(in_colour), "{head:02x?}");
    }
    assert!(holds_colour(b"").is_err() && holds_colour(&[0xff, 0xd8, 0xff]).is_err());
}

#[test]
fn png_and_pgm_round_trip_exactly_and_jpeg_closely() {
    let truth = sample(61, 37);
    assert_eq!(decode(&grey_png(&truth)).unwrap(), truth);
    assert_eq!(image_size(&jpeg_of(&truth)).unwrap(), [61, 37]);
    assert_eq!(
        decode(&pnm("P5\n61 37\n255\n", &truth.data)).unwrap(),
        truth
    );
    let jpeg = decode(&jpeg_of(&truth)).unwrap();
    assert_eq!((jpeg.width, jpeg.height), (61, 37));
    let differences: Vec<u8> = jpeg
        .data
        .iter()
        .zip(&truth.data)
        .map(|(a, b)| a.abs_diff(*b))
        .collect();
    let mean = differences.iter().copied().map(f64::from).sum::<f64>() / differences.len() as f64;
    assert!(mean < 4.0, "{mean}");
}

#[test]
fn colour_becomes_luma_and_sixteen_bits_their_upper_eight() {
    let primaries = [255, 0, 0, 0, 255, 0, 0, 0, 255];
    for bytes in [
        png_of(3, 1, ColorType::Rgb, BitDepth::Eight, &primaries),
        pnm("P6\n3 1\n255\n", &primaries),
    ] {
        let found = decode(&bytes).unwrap().data;
        let close = found
            .iter()
            .zip([76_u8, 150, 29])
            .all(|(a, b)| a.abs_diff(b) <= 1);
        assert!(close, "{found:?}");
    }
    let deep = [0x12, 0x34, 0xab, 0xcd];
    for bytes in [
        png_of(2, 1, ColorType::Grayscale, BitDepth::Sixteen, &deep),
        pnm("P5\n2 1\n65535\n", &deep),
    ] {
        assert_eq!(decode(&bytes).unwrap().data, [0x12, 0xab]);
    }
}

#[test]
fn values_of_fewer_bits_in_samples_of_sixteen_are_refused_with_the_most_that_they_hold() {
    let most = |values: [u16; 2]| {
        let deep = values.map(u16::to_be_bytes).concat();
        let alpha = [&deep[..2], b"\xff\xff", &deep[2..], b"\xff\xff"].concat();
        let found = [
            png_of(2, 1, ColorType::Grayscale, BitDepth::Sixteen, &deep),
            png_of(2, 1, ColorType::GrayscaleAlpha, BitDepth::Sixteen, &alpha),
            pnm("P5\n2 1\n65535\n", &deep),
        ]
        .map(|bytes| match decode(&bytes) {
            Ok(_) => None,
            Err(ImageError::Faint { most }) => Some(most),
            Err(other) => panic!("{other}"),
        });
        assert!(found.iter().all(|most| *most == found[0]), "{found:?}");
        found[0]
    };
    assert_eq!(most([7, 1000]), Some(1023));
    assert_eq!(most([4095, 0]), Some(4095));
    assert_eq!(most([0, 4096]), None);
    // A black image is black in any number of bits.
    assert_eq!(most([0, 0]), None);
}

#[test]
fn a_buffer_is_used_again() {
    let (large, small) = (sample(64, 64), sample(8, 4));
    let mut grey = Grey::default();
    for truth in [&large, &small, &large] {
        decode_grey(&grey_png(truth), &mut grey).unwrap();
        assert_eq!(&grey, truth);
    }
}

#[test]
fn a_truncated_image_is_an_error() {
    let truth = sample(200, 120);
    for bytes in [
        jpeg_of(&truth),
        grey_png(&truth),
        pnm("P5\n200 120\n255\n", &truth.data),
    ] {
        let length = bytes.len();
        for cut in [0, 1, 10, length / 4, length / 2, length * 3 / 4] {
            assert!(decode(&bytes[..cut]).is_err(), "cut at {cut} of {length}");
        }
    }
}

#[test]
fn padding_after_a_jpeg_is_not_damage() {
    let jpeg = jpeg_of(&sample(64, 48));
    for padding in [&[0; 7][..], &[0xff; 3], b"\0\0padpadpad", b"\n", &jpeg[..2]] {
        let padded = [&jpeg[..], padding].concat();
        assert_eq!(decode(&padded).unwrap(), decode(&jpeg).unwrap());
        let cut = [&jpeg[..jpeg.len() - 2], padding].concat();
        assert!(decode(&cut).is_err(), "{padding:?}");
    }
}

#[test]
fn absurd_sizes_are_refused_before_they_are_allocated() {
    let pgm = pnm("P5\n1000000 1000000\n255\n", &[0; 64]);
    assert!(matches!(decode(&pgm), Err(ImageError::Size { .. })));
    let mut png = grey_png(&sample(4, 4));
    png[16..20].copy_from_slice(&60_000_u32.to_be_bytes());
    png[20..24].copy_from_slice(&60_000_u32.to_be_bytes());
    assert!(matches!(decode(&png), Err(ImageError::Size { .. })));
    let unknown = decode(b"hello, world").unwrap_err().to_string();
    assert!(unknown.contains("expected a jpeg"), "{unknown}");
}

/// A grey BMP of 4 × 2 pixels, as any program writes it.
fn bmp() -> Vec<u8> {
    let palette: Vec<u8> = (0..=255_u8)
        .flat_map(|grey| [grey, grey, grey, 0])
        .collect();
    let start = 14 + 40 + palette.len() as u32;
    let file = [start + 8, 0, start].map(u32::to_le_bytes).concat();
    let size = [40_u32, 4, 2].map(u32::to_le_bytes).concat();
    let depth = [1_u16, 8].map(u16::to_le_bytes).concat();
    let rest = [0_u32, 8, 2835, 2835, 256, 0]
        .map(u32::to_le_bytes)
        .concat();
    let parts = [b"BM".to_vec(), file, size, depth, rest, palette, vec![7; 8]];
    parts.concat()
}

/// OpenCV would decode them.
#[test]
fn formats_whose_decoders_nobody_fuzzes_are_refused() {
    let begins = |start: &[u8]| [start, &[0; 64]].concat();
    for bytes in [
        bmp(),
        begins(b"RIFF\x48\0\0\0WEBPVP8L"),
        begins(b"II*\0\x08\0\0\0"),
        begins(b"MM\0*\0\0\0\x08"),
        begins(b"GIF89a"),
        begins(b"\0\0\0\x0cjP  \r\n\x87\n"),
        begins(b"\x76\x2f\x31\x01"),
        begins(b"#?RADIANCE\n"),
    ] {
        let [grey, depth] = [decode(&bytes).err(), decode_depth(&bytes).err()];
        for refused in [grey, depth, image_size(&bytes).err()] {
            let format = matches!(refused, Some(ImageError::Format { .. }));
            assert!(format, "{:?}: {refused:?}", &bytes[..8]);
        }
    }
}

/// A log's losses are counted by these sentences: they must be few, whatever the bytes are.
#[test]
fn why_an_image_is_refused_is_told_in_words_that_are_the_same_for_its_kind() {
    let floats = |values: [f32; 2]| {
        let values = values.map(f32::to_le_bytes).concat();
        [&b"Pf\n2 1\n-1.0\n"[..], &values].concat()
    };
    let cut = |bytes: usize| jpeg_of(&sample(64, 48))[..bytes].to_vec();
    let said = |bytes: &[u8]| decode(bytes).unwrap_err().kind();
    for (one, other, expected) in [
        (floats([0.5, 1.0]), floats([2.0, 3.0]), "`depth_frames`"),
        (bmp(), vec![1, 2, 3], "expected a jpeg, png or pnm image"),
        (cut(300), cut(301), "jpeg image is truncated"),
    ] {
        assert_eq!(said(&one), said(&other));
        assert!(said(&one).contains(expected), "{}", said(&one));
    }
    let floats = floats([0.5, 1.0]);
    assert!(matches!(image_size(&floats), Err(ImageError::Float)));
    assert_eq!(decode_depth(&floats).unwrap().data, [500, 1000]);
}

/// A few bytes claim 128 megapixels.
#[test]
fn a_jpeg_that_cannot_hold_its_pixels_is_refused() {
    let mut jpeg = jpeg_of(&sample(64, 48));
    let frame = jpeg.windows(2).position(|pair| pair == [0xff, 0xc0]);
    let size = frame.unwrap() + 5;
    jpeg[size..size + 2].copy_from_slice(&8000_u16.to_be_bytes());
    jpeg[size + 2..size + 4].copy_from_slice(&16_000_u16.to_be_bytes());
    assert_eq!(image_size(&jpeg).unwrap(), [16_000, 8000]);
    assert!(matches!(decode(&jpeg), Err(ImageError::Damaged { .. })));
}

/// A few bytes claim a hundred megapixels of four values; what deflate makes of rows that are all alike is read.
#[test]
fn a_png_that_cannot_hold_its_pixels_is_refused() {
    let mut png = grey_png(&sample(4, 4));
    png[16..20].copy_from_slice(&10_000_u32.to_be_bytes());
    png[20..24].copy_from_slice(&10_000_u32.to_be_bytes());
    png[24..26].copy_from_slice(&[16, 6]);
    assert_eq!(image_size(&png).unwrap(), [10_000, 10_000]);
    let damaged = |error: ImageError| matches!(error, ImageError::Damaged { format: "png", .. });
    assert!(damaged(decode(&png).unwrap_err()));
    assert!(damaged(decode_depth(&png).unwrap_err()));
    for (colour, values) in [
        (ColorType::Grayscale, 1),
        (ColorType::Rgb, 3),
        (ColorType::Rgba, 4),
    ] {
        let black = vec![0; 2000 * 2000 * values];
        let png = png_of(2000, 2000, colour, BitDepth::Eight, &black);
        assert!(png.len() < black.len() / 100, "{} B", png.len());
        assert!(decode(&png).unwrap().data.iter().all(|value| *value == 0));
    }
}

/// A small scan, again and again: each goes through the whole image.
#[test]
fn a_jpeg_of_more_scans_than_anybody_writes_is_refused() {
    let truth = sample(64, 48);
    for progressive in [false, true] {
        let mut jpeg = Vec::new();
        let mut encoder = jpeg_encoder::Encoder::new(&mut jpeg, 95);
        encoder.set_progressive(progressive);
        encoder
            .encode(&truth.data, 64, 48, jpeg_encoder::ColorType::Luma)
            .unwrap();
        assert!(decode(&jpeg).is_ok());
        let scan = jpeg.windows(2).rposition(|pair| pair == [0xff, 0xda]);
        let (end, scan) = (jpeg.len() - 2, scan.unwrap());
        let again = jpeg[scan..end].repeat(200);
        let many = [&jpeg[..end], &again, &jpeg[end..]].concat();
        let refused = decode(&many).unwrap_err();
        assert!(
            matches!(refused, ImageError::Scans { found } if found > 200),
            "{refused}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn damage_never_panics_and_gives_the_same_answer_twice(
        kind in 0..3_usize,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let truth = sample(40, 30);
        let whole = [jpeg_of(&truth), grey_png(&truth), pnm("P5\n40 30\n255\n", &truth.data)];
        let mut bytes = whole[kind].clone();
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let once = decode(&bytes);
        if let Ok(grey) = &once {
            prop_assert_eq!(grey.data.len() as u64, u64::from(grey.width) * u64::from(grey.height));
        }
        prop_assert_eq!(once, decode(&bytes));
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = decode(&bytes);
    }
}
