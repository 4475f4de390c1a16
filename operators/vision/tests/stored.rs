//! Labels and depth: the values as they are stored; and colour.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use evermap_vision::{
    Grey, ImageError, Rgb, decode_colour, decode_depth, decode_grey, decode_labels, decode_values,
    encode_png,
};
use png::{BitDepth, ColorType};
use proptest::prelude::*;

fn png_of(size: [u32; 2], colour: ColorType, depth: BitDepth, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    if colour == ColorType::Indexed {
        encoder.set_palette([200, 10, 10, 20, 250, 20, 30, 30, 240, 0, 0, 0].as_slice());
    }
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(data).unwrap();
    writer.finish().unwrap();
    bytes
}

fn colour(bytes: &[u8]) -> Result<Rgb, ImageError> {
    let mut rgb = Rgb::default();
    decode_colour(bytes, &mut rgb)?;
    Ok(rgb)
}

#[test]
fn colour_comes_in_the_order_red_green_blue() {
    let pixels = [255, 0, 0, 0, 255, 0, 0, 0, 255, 1, 2, 3];
    for bytes in [
        png_of([2, 2], ColorType::Rgb, BitDepth::Eight, &pixels),
        [b"P6\n2 2\n255\n".as_slice(), &pixels].concat(),
    ] {
        let rgb = colour(&bytes).unwrap();
        assert_eq!((rgb.width, rgb.height), (2, 2));
        assert_eq!(rgb.data, pixels);
    }
    let grey = png_of([2, 1], ColorType::Grayscale, BitDepth::Eight, &[7, 9]);
    let rgb = colour(&grey).unwrap();
    assert_eq!(rgb.data, [7, 7, 7, 9, 9, 9]);
}

#[test]
fn a_colour_jpeg_is_close_to_what_was_encoded() {
    let [width, height] = [64_u16, 48];
    let pixels: Vec<u8> = (0..height)
        .flat_map(|v| (0..width).flat_map(move |u| [4 * u as u8, 5 * v as u8, 90]))
        .collect();
    let mut bytes = Vec::new();
    jpeg_encoder::Encoder::new(&mut bytes, 95)
        .encode(&pixels, width, height, jpeg_encoder::ColorType::Rgb)
        .unwrap();
    let rgb = colour(&bytes).unwrap();
    let worst = rgb
        .data
        .iter()
        .zip(&pixels)
        .map(|(a, b)| a.abs_diff(*b))
        .max();
    assert!(worst.unwrap() < 24, "{worst:?}");
    assert!(colour(&bytes[..bytes.len() / 2]).is_err());
    assert!(matches!(
        decode_labels(&bytes),
        Err(ImageError::Values { .. })
    ));
}

#[test]
fn depth_keeps_all_sixteen_bits() {
    let stored = [0x12, 0x34, 0xab, 0xcd, 0x00, 0x01];
    for bytes in [
        png_of([3, 1], ColorType::Grayscale, BitDepth::Sixteen, &stored),
        [b"P5 # made by hand\n3\t1\n65535\n".as_slice(), &stored].concat(),
    ] {
        assert_eq!(decode_depth(&bytes).unwrap().data, [0x1234, 0xabcd, 1]);
        assert_eq!(decode_values(&bytes).unwrap().data, [0x1234, 0xabcd, 1]);
        assert_eq!(decode_labels(&bytes).unwrap().data, [255, 255, 1]);
    }
    let shallow = png_of([2, 1], ColorType::Grayscale, BitDepth::Eight, &[7, 255]);
    assert_eq!(decode_depth(&shallow).unwrap().data, [7, 255]);
}

#[test]
fn metres_become_millimetres_and_what_is_not_measured_stays_so() {
    let metres = [
        1.5,
        0.0005,
        70.0,
        f32::INFINITY,
        f32::NAN,
        f32::NEG_INFINITY,
    ];
    let expected = [1500, 1, 65_535, 65_535, 0, 0];
    // Rows come from the lowest to the highest.
    let (upper, lower) = metres.split_at(3);
    let little = [lower, upper].concat();
    let little = little.iter().flat_map(|metres| metres.to_le_bytes());
    let pfm: Vec<u8> = b"Pf\n3 2\n-1.0\n".iter().copied().chain(little).collect();
    let depth = decode_depth(&pfm).unwrap();
    assert_eq!((depth.width, depth.height), (3, 2));
    assert_eq!(depth.data, expected);
    for length in 0..pfm.len() {
        assert!(decode_depth(&pfm[..length]).is_err(), "{length}");
    }
    assert!(decode_depth(b"Pf\n4000000000 4000000000\n-1.0\n").is_err());

    // The encoder's quantisation of 2 m, with its parameters as they come by default (z₀ = 100, at most 10 m).
    let a = 100.0 * 101.0_f32;
    let b = 1.0 - a / 10.0;
    let value = (a / 2.0 + b) as u16;
    let stored = [0_u16, value].map(u16::to_be_bytes).concat();
    let png = png_of([2, 1], ColorType::Grayscale, BitDepth::Sixteen, &stored);
    let header = [[0; 4], a.to_le_bytes(), b.to_le_bytes()].concat();
    let depth = decode_depth(&[&header[..], &png].concat()).unwrap();
    assert_eq!(depth.data[0], 0);
    assert!(depth.data[1].abs_diff(2000) <= 1, "{:?}", depth.data);
    // The same header stands before millimetres, with nothing in it.
    let depth = decode_depth(&[&[0; 12][..], &png].concat()).unwrap();
    assert_eq!(depth.data, [0, value]);
}

#[test]
fn labels_are_indices_whatever_colours_stand_for_them() {
    let packed = png_of(
        [5, 2],
        ColorType::Indexed,
        BitDepth::Two,
        &[0b0001_1011, 0b0100_0000, 0b1110_0100, 0b1000_0000],
    );
    assert_eq!(
        decode_labels(&packed).unwrap().data,
        [0, 1, 2, 3, 1, 3, 2, 1, 0, 2]
    );
    let bits = png_of(
        [9, 1],
        ColorType::Grayscale,
        BitDepth::One,
        &[0b1010_0001, 0b1000_0000],
    );
    assert_eq!(
        decode_labels(&bits).unwrap().data,
        [1, 0, 1, 0, 0, 0, 0, 1, 1]
    );
    let whole = png_of([2, 1], ColorType::Indexed, BitDepth::Eight, &[3, 0]);
    assert_eq!(decode_labels(&whole).unwrap().data, [3, 0]);
    assert_eq!(decode_values(&whole).unwrap().data, [3, 0]);
    let colour = png_of([1, 1], ColorType::Rgb, BitDepth::Eight, &[1, 1, 1]);
    assert!(matches!(
        decode_labels(&colour),
        Err(ImageError::Values { .. })
    ));
}

#[test]
fn an_image_that_is_not_its_size_is_not_encoded() {
    for (width, height, data) in [(0, 0, vec![]), (2, 2, vec![0; 3])] {
        let grey = Grey {
            width,
            height,
            data,
        };
        assert!(matches!(encode_png(&grey), Err(ImageError::Size { .. })));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    #[test]
    fn labels_round_trip(width in 1_u32..70, height in 1_u32..40, seed in any::<u32>()) {
        let data = (0..width * height).map(|i| (i.wrapping_mul(seed) >> 13) as u8).collect();
        let grey = Grey { width, height, data };
        let bytes = encode_png(&grey).unwrap();
        prop_assert_eq!(&decode_labels(&bytes).unwrap(), &grey);
        let mut decoded = Grey::default();
        decode_grey(&bytes, &mut decoded).unwrap();
        prop_assert_eq!(decoded, grey);
    }

    #[test]
    fn damage_never_panics(
        kind in 0..3_usize,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let values: Vec<u8> = (0..=255).cycle().take(40 * 30).collect();
        let whole = [
            png_of([20, 30], ColorType::Grayscale, BitDepth::Sixteen, &values),
            png_of([80, 30], ColorType::Indexed, BitDepth::Four, &values),
            [b"P5\n40 30\n255\n".as_slice(), &values].concat(),
        ];
        let mut bytes = whole[kind].clone();
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            let cut = cut.index(bytes.len());
            bytes.truncate(cut);
            prop_assert!(cut + 12 > whole[kind].len() || decode_depth(&bytes).is_err());
        }
        if let Ok(labels) = decode_labels(&bytes) {
            prop_assert_eq!(labels.data.len() as u64, u64::from(labels.width) * u64::from(labels.height));
        }
        prop_assert_eq!(colour(&bytes), colour(&bytes));
    }
}
