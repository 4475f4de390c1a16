#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use nalgebra::DMatrix;
use proptest::prelude::*;

use super::sampling::{SampledPixels, sample_pixels};
use super::smooth::tent;
use super::*;
use crate::solving::random::SplitMix64;

/// Blobs of colour, so that there are gradients of all directions.
fn picture(width: usize, height: usize, seed: u64) -> Vec<u8> {
    let mut random = SplitMix64(seed);
    let coarse: Vec<u8> = (0..8 * 8 * 3).map(|_| random.below(256) as u8).collect();
    let mut data = Vec::with_capacity(3 * width * height);
    for v in 0..height {
        for u in 0..width {
            let cell = (v * 8 / height) * 8 + u * 8 / width;
            for channel in 0..3 {
                let noise = random.below(24) as u8;
                data.push((coarse[3 * cell + channel] / 2).saturating_add(noise));
            }
        }
    }
    data
}

fn view(width: usize, height: usize, data: &[u8]) -> ColourView<'_> {
    ColourView::new(width as u32, height as u32, data).unwrap()
}

fn values(features: &PixelFeatures, what: &FeatureDescription, u: usize, v: usize) -> Vec<u8> {
    let mut out = vec![0; what.dimensions()];
    features.write(u, v, &mut out);
    out
}

#[test]
fn a_panorama_that_is_turned_has_its_features_turned() {
    let (width, height, turn) = (64, 24, 23);
    let data = picture(width, height, 3);
    let turned: Vec<u8> = data
        .chunks_exact(3 * width)
        .flat_map(|row| [&row[3 * turn..], &row[..3 * turn]].concat())
        .collect();
    let what = FeatureDescription {
        wraps: true,
        ..FeatureDescription::default()
    };
    let one = PixelFeatures::new(&what, &view(width, height, &data), NO_BACKBONE).unwrap();
    let other = PixelFeatures::new(&what, &view(width, height, &turned), NO_BACKBONE).unwrap();
    for (u, v) in [(0, 0), (5, 3), (30, 11), (63, 23), (41, 20)] {
        let there = (u + width - turn) % width;
        assert_eq!(
            values(&one, &what, u, v),
            values(&other, &what, there, v),
            "at {u}, {v}"
        );
    }
}

#[test]
fn a_flat_image_has_its_colour_and_no_texture() {
    let data = [200_u8, 200, 200].repeat(40 * 30);
    let what = FeatureDescription::default();
    let features = PixelFeatures::new(&what, &view(40, 30, &data), NO_BACKBONE).unwrap();
    let found = values(&features, &what, 17, 12);
    let sift = what.options.sift_bins_px.len() * sift::DIMENSIONS;
    assert!(found[..sift].iter().all(|value| *value == 0));
    for window in found[sift..]
        .chunks_exact(CHANNELS)
        .take(what.options.windows_px.len())
    {
        // L* of grey 200 is 80.6 of 100; a*, b* are in the middle; a third of the light each.
        assert_eq!(window, [206, 128, 128, 170, 170, 0, 0, 0]);
    }
    assert_eq!(
        found[found.len() - 2..],
        [(12 * 256 / 30) as u8, (17 * 256 / 40) as u8]
    );
}

#[test]
fn descriptors_keep_their_values_in_other_light() {
    let dim = picture(48, 48, 9);
    let bright: Vec<u8> = dim.iter().map(|value| value + 90).collect();
    let what = FeatureDescription {
        options: FeatureOptions {
            sift_bins_px: vec![4],
            windows_px: Vec::new(),
            backbone_areas_px: Vec::new(),
        },
        wraps: false,
    };
    let [dim, bright] = [&dim, &bright].map(|data| {
        let features = PixelFeatures::new(&what, &view(48, 48, data), NO_BACKBONE).unwrap();
        values(&features, &what, 24, 24)
    });
    let worst = dim.iter().zip(&bright).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst <= Some(3), "{worst:?}");
    assert!(dim.iter().any(|value| *value > 60));
}

/// Sees the area, as a number, in every second cell.
fn stripes(image: &ColourView<'_>, area_px: u32) -> Result<Vec<FeatureMap>, String> {
    let size = [image.width() / 2, image.height() / 2];
    let value = |at: usize| (at.is_multiple_of(2) as u32 * area_px) as f32 / 4096.0;
    let values = (0..size[0] * size[1]).map(value);
    Ok(vec![FeatureMap {
        channels: BACKBONE_CHANNELS,
        size,
        cells_per_px: [0.5; 2],
        values: values
            .flat_map(|value| [value; BACKBONE_CHANNELS])
            .collect(),
    }])
}

#[test]
fn what_a_network_sees_stands_behind_windows_at_each_size() {
    let data = picture(16, 8, 3);
    let what = FeatureDescription {
        options: FeatureOptions {
            sift_bins_px: Vec::new(),
            windows_px: Vec::new(),
            backbone_areas_px: vec![4096, 8192],
        },
        wraps: true,
    };
    assert_eq!(what.dimensions(), 2 * BACKBONE_CHANNELS + 1);
    let features = PixelFeatures::new(&what, &view(16, 8, &data), stripes).unwrap();
    let found = values(&features, &what, 8, 4);
    // A quarter of a cell before the middle of a striped one, whose neighbours see nothing.
    assert!(
        found[..BACKBONE_CHANNELS].iter().all(|byte| *byte == 131),
        "{found:?}"
    );
    assert!(
        found[BACKBONE_CHANNELS..][..BACKBONE_CHANNELS]
            .iter()
            .all(|byte| *byte == 134)
    );
    assert_eq!(found[2 * BACKBONE_CHANNELS], 128);
    let refused = |backbone: Backbone| {
        let features = PixelFeatures::new(&what, &view(16, 8, &data), backbone);
        features.err().map(|error| error.to_string())
    };
    let said = "features: expected a network, found none";
    assert_eq!(refused(NO_BACKBONE).as_deref(), Some(said));
    let said = "features: expected 464 values, found 0";
    assert_eq!(refused(|_, _| Ok(Vec::new())).as_deref(), Some(said));
}

/// A stage of half the sides and one of a quarter of them, all numbers different.
fn two_stages(image: &ColourView<'_>, area_px: u32) -> Result<Vec<FeatureMap>, String> {
    let mut random = SplitMix64(area_px.into());
    let stages = [(64, 2), (400, 4)].map(|(channels, px)| {
        let size = [image.width().div_ceil(px), image.height().div_ceil(px)];
        let count = size[0] * size[1] * channels;
        FeatureMap {
            channels,
            size,
            cells_per_px: [1.0 / px as f32; 2],
            values: (0..count)
                .map(|_| 31.0 * (2.0 * random.unit() - 1.0) as f32)
                .collect(),
        }
    });
    Ok(stages.into())
}

#[test]
fn linear_functions_of_features_are_those_of_their_bytes() {
    let (width, height) = (24, 16);
    let data = picture(width, height, 5);
    let what = FeatureDescription {
        options: FeatureOptions {
            sift_bins_px: vec![3],
            backbone_areas_px: vec![4096, 8192],
            ..FeatureOptions::default()
        },
        wraps: false,
    };
    let mut random = SplitMix64(8);
    let weights = DMatrix::from_fn(3, what.dimensions(), |_, _| random.unit() as f32 - 0.5);
    let features = || PixelFeatures::new(&what, &view(width, height, &data), two_stages).unwrap();
    let bytes = features();
    // Of all pixels, both stages have few cells; of a sixteenth, neither has; of a quarter, the second one alone.
    for (stride, coarse) in [(1, 4), (2, 2), (4, 0)] {
        let us: Vec<usize> = (0..width).step_by(stride).collect();
        let vs = (0..height).step_by(stride);
        let layer = LinearFeatures::new(features(), &weights, us.len() * vs.len());
        assert_eq!(layer.projected(), coarse, "{stride}");
        for v in vs {
            let mut sums = DMatrix::repeat(3, us.len(), 1.0);
            layer.add(&us, v, &mut sums);
            for (u, sums) in us.iter().zip(sums.column_iter()) {
                let values = values(&bytes, &what, *u, v).into_iter().map(f32::from);
                let values = DMatrix::from_iterator(what.dimensions(), 1, values);
                let off = (sums - DMatrix::repeat(3, 1, 1.0) - &weights * values).amax();
                // Weights deviate by 0.29, and so do a thousand numbers from their bytes: five times what that makes.
                assert!(off < 13.0, "{u} {v}: {off}");
            }
        }
    }
}

#[test]
fn an_edge_is_seen_in_its_direction() {
    // Dark on the left: the gradient points to the right, direction 0 of eight.
    let row: Vec<u8> = (0..32)
        .flat_map(|u| [if u < 16 { 20 } else { 180 }; 3])
        .collect();
    let data = row.repeat(32);
    let what = FeatureDescription {
        options: FeatureOptions {
            sift_bins_px: vec![3],
            windows_px: Vec::new(),
            backbone_areas_px: Vec::new(),
        },
        wraps: false,
    };
    let features = PixelFeatures::new(&what, &view(32, 32, &data), NO_BACKBONE).unwrap();
    let found = values(&features, &what, 16, 16);
    let energy = |direction: usize| -> u32 {
        found[..sift::DIMENSIONS]
            .iter()
            .skip(direction)
            .step_by(8)
            .map(|v| u32::from(*v))
            .sum()
    };
    assert!(energy(0) > 500);
    assert!((1..8).all(|direction| energy(direction) == 0));
}

#[test]
fn senseless_descriptions_are_refused() {
    let data = picture(20, 10, 1);
    let refused = |what: &FeatureDescription| {
        PixelFeatures::new(what, &view(20, 10, &data), NO_BACKBONE).is_err()
    };
    let good = FeatureDescription::default();
    assert!(!refused(&good));
    let window = |half, du| Window { du, dv: 0, half };
    let wrong = |change: &dyn Fn(&mut FeatureDescription)| {
        let mut what = good.clone();
        change(&mut what);
        refused(&what)
    };
    assert!(wrong(&|what| what.options.sift_bins_px = vec![0]));
    assert!(wrong(&|what| what.options.sift_bins_px = vec![33]));
    assert!(wrong(&|what| what.options.windows_px = vec![window(121, 0)]));
    assert!(wrong(
        &|what| what.options.windows_px = vec![window(0, i32::MIN)]
    ));
    assert!(wrong(&|what| what.options.sift_bins_px = vec![1; 300]));
}

#[test]
fn a_description_survives_json() {
    let what = FeatureDescription {
        wraps: true,
        ..FeatureDescription::default()
    };
    let text = serde_json::to_string(&what).unwrap();
    assert_eq!(
        serde_json::from_str::<FeatureDescription>(&text).unwrap(),
        what
    );
}

#[test]
fn samples_are_balanced_and_within_their_class() {
    let labels: Vec<u8> = (0..100 * 100_u32)
        .map(|i| match i % 100 {
            0..5 => 1,
            5..10 => 255,
            10..12 => 2,
            _ => 0,
        })
        .collect();
    let mut options = SamplingOptions {
        samples: 300,
        stride_px: 1,
        balance: 1.0,
        mirror: false,
        seed: 7,
    };
    let chosen = sample_pixels(&labels, 100, 3, &options);
    assert_eq!(chosen.class_pixels, [8800, 500, 200]);
    let count = |class: u8| {
        chosen
            .labels
            .iter()
            .filter(|label| **label == class)
            .count()
    };
    assert_eq!([count(0), count(1), count(2)], [100, 100, 100]);
    for (pixel, label) in chosen.pixels.iter().zip(&chosen.labels) {
        assert_eq!(labels[*pixel as usize], *label);
    }
    options.balance = 0.0;
    let fair = sample_pixels(&labels, 100, 3, &options);
    assert!(fair.labels.iter().filter(|label| **label == 0).count() > 270);
    options.stride_px = 200;
    let corner = sample_pixels(&labels, 100, 3, &options);
    assert_eq!((corner.pixels, corner.labels), (vec![0], vec![1]));
    assert_eq!(sample_pixels(&[], 0, 0, &options), SampledPixels::default());
}

#[test]
fn samples_are_also_of_the_mirror_image() {
    let data = picture(24, 10, 2);
    let labels: Vec<u8> = (0..240).map(|i| if i % 24 < 12 { 0 } else { 9 }).collect();
    let what = FeatureDescription::default();
    let of = |options: &SamplingOptions| {
        labelled_features(
            &what,
            &view(24, 10, &data),
            &labels,
            2,
            options,
            NO_BACKBONE,
        )
    };
    let mut options = SamplingOptions {
        samples: 1000,
        ..SamplingOptions::default()
    };
    let both = of(&options).unwrap();
    options.mirror = false;
    let one = of(&options).unwrap();
    assert_eq!(one.class_pixels, [120, 0]);
    assert_eq!(both.class_pixels, one.class_pixels);
    assert_eq!((one.labels.len(), both.labels.len()), (120, 240));
    assert_eq!(both.values[..one.values.len()], one.values);
    // The last feature is the column: of the mirror image, the right half.
    let columns: Vec<u8> = both
        .values
        .chunks_exact(what.dimensions())
        .map(|s| s[s.len() - 1])
        .collect();
    assert!(columns[..120].iter().all(|u| *u < 128) && columns[120..].iter().all(|u| *u >= 128));
    let short = labelled_features(
        &what,
        &view(24, 10, &data),
        &labels[1..],
        2,
        &options,
        NO_BACKBONE,
    );
    assert!(matches!(short, Err(FeatureError::Labels { .. })));
}

proptest! {
    #[test]
    fn window_sums_are_those_of_the_pixels(
        width in 1_usize..20, height in 1_usize..12, seed in any::<u64>(),
        u in -60_isize..80, v in -40_isize..60, half in 0_usize..15, wraps in any::<bool>(),
    ) {
        let mut random = SplitMix64(seed);
        let pixels: Vec<[u32; 2]> =
            (0..width * height).map(|_| [random.below(256) as u32, u32::MAX]).collect();
        let integrals = Integrals::new(pixels.iter().copied(), [width, height], Edge::of(wraps));
        let (found, count) = integrals.around(u, v, half);
        let middle_v = v.clamp(0, height as isize - 1);
        let middle_u = if wraps { u } else { u.clamp(0, width as isize - 1) };
        let mut columns: Vec<isize> = (middle_u - half as isize..=middle_u + half as isize).collect();
        if wraps {
            let most = half.min((width - 1) / 2) as isize;
            columns.retain(|column| (column - middle_u).abs() <= most);
            columns.iter_mut().for_each(|column| *column = column.rem_euclid(width as isize));
        }
        let (mut sum, mut pixels_in) = (0, 0);
        for row in middle_v - half as isize..=middle_v + half as isize {
            for &column in &columns {
                if (0..height as isize).contains(&row) && (0..width as isize).contains(&column) {
                    sum += pixels[row as usize * width + column as usize][0];
                    pixels_in += 1;
                }
            }
        }
        prop_assert_eq!((found[0], count), (sum, pixels_in));
        prop_assert_eq!(found[1], u32::MAX.wrapping_mul(pixels_in));
    }

    #[test]
    fn tents_are_sums_of_sums(
        width in 1_usize..12, height in 1_usize..10, box_px in 1_usize..7, seed in any::<u64>(), wraps in any::<bool>(),
    ) {
        let mut random = SplitMix64(seed);
        let edge = Edge::of(wraps);
        let plane: Vec<[u32; 1]> = (0..width * height).map(|_| [random.below(4000) as u32]).collect();
        let mut expected = plane.clone();
        for before in [box_px / 2, (box_px - 1) / 2] {
            let offsets = || (0..box_px).map(|i| i as isize - before as isize);
            let source = expected.clone();
            for v in 0..height {
                for u in 0..width {
                    expected[v * width + u][0] = offsets()
                        .flat_map(|dv| offsets().map(move |du| (du, dv)))
                        .map(|(du, dv)| {
                            let row = Edge::Repeat.index(v as isize + dv, height);
                            source[row * width + edge.index(u as isize + du, width)][0]
                        })
                        .sum();
                }
            }
        }
        let mut found = plane;
        tent(&mut found, [width, height], box_px, edge);
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn no_size_or_place_panics(
        width in 1_usize..40, height in 1_usize..30, u in any::<usize>(), v in any::<usize>(), wraps in any::<bool>(),
        room in 0_usize..700,
    ) {
        let data = picture(width, height, 5);
        let what = FeatureDescription { wraps, ..FeatureDescription::default() };
        let features = PixelFeatures::new(&what, &view(width, height, &data), NO_BACKBONE).unwrap();
        let mut out = vec![0; room];
        features.write(u, v, &mut out);
        features.write(0, 0, &mut out);
    }
}
