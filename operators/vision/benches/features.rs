//! What features cost beside the OpenCV calls that they rest on, on one thread and the same pixels.
//!
//! * `features/evermap`: from pixels to spread features with descriptors.
//! * `features/opencv`: BRISK's `detectAndCompute` at the threshold that gives as many key points as ours chooses from.
//! * `features/bf_matcher`: OpenCV's brute-force matcher with cross-check, 500 descriptors against 500: what
//!   `tracks/evermap` of the catalog's bench is held against, per pair of images.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use evermap_vision::{Blind, Detectors, FeatureParams, Grey};
use opencv::core::{KeyPoint, Mat, NORM_HAMMING, Vector, no_array, set_num_threads};
use opencv::features2d::{BFMatcher, BRISK, DescriptorMatcherTraitConst, Feature2DTrait};

/// Grey rectangles of all sizes over noise, from a seed.
fn scene(width: u32, height: u32) -> Grey {
    let mut seed = 7_u32;
    let mut random = |below: u32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((u64::from(seed >> 8) * u64::from(below)) >> 24) as u32
    };
    let mut data = vec![90_u8; (width * height) as usize];
    for _ in 0..600 {
        let (u, v) = (random(width), random(height));
        let (w, h) = (4 + random(width / 12), 4 + random(height / 12));
        let level = 40 + random(160) as u8;
        for row in v..(v + h).min(height) {
            let end = (row * width + (u + w).min(width)) as usize;
            data[(row * width + u) as usize..end].fill(level);
        }
    }
    data.iter_mut().for_each(|pixel| *pixel += random(8) as u8);
    Grey {
        width,
        height,
        data,
    }
}

fn benches(criterion: &mut Criterion) {
    set_num_threads(1).unwrap();
    let image = scene(640, 480);
    let params = FeatureParams {
        scale: 1.0,
        ..FeatureParams::default()
    };
    let mat = Mat::new_rows_cols_with_data(480, 640, image.data.as_slice()).unwrap();
    let (threshold, found) = (1..=60)
        .map(|step| {
            let mut brisk = BRISK::create(4 * step, params.octaves as i32, 1.0).unwrap();
            let mut points: Vector<KeyPoint> = Vector::new();
            brisk.detect_def(&mat, &mut points).unwrap();
            (4 * step, points.len())
        })
        .min_by_key(|(_, found)| found.abs_diff(5 * params.count as usize / 2))
        .unwrap();
    let mut brisk = BRISK::create(threshold, params.octaves as i32, 1.0).unwrap();
    let detectors = Detectors::default();
    let own = |image: &Grey| {
        detectors
            .features(image, &params, &Blind::default())
            .unwrap()
    };
    let mut group = criterion.benchmark_group("features");
    group.sample_size(20);
    group.bench_function("evermap", |bench| {
        bench.iter(|| own(black_box(&image)));
    });
    group.bench_function(format!("opencv, {found} key points"), |bench| {
        bench.iter(|| {
            let (mut points, mut descriptors) = (Vector::new(), Mat::default());
            brisk
                .detect_and_compute_def(&mat, &no_array(), &mut points, &mut descriptors)
                .unwrap();
            (points.len(), descriptors)
        });
    });
    let own = own(&image);
    let rows = own.len() as i32;
    let set = Mat::new_rows_cols_with_data(rows, 64, own.descriptors.as_slice()).unwrap();
    let matcher = BFMatcher::new(NORM_HAMMING, true).unwrap();
    group.bench_function(format!("bf_matcher, {rows} by {rows}"), |bench| {
        bench.iter(|| {
            let mut matches = Vector::new();
            matcher
                .train_match_def(black_box(&set), &set, &mut matches)
                .unwrap();
            matches.len()
        });
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
