//! What following features costs, per pair of images: to be held against `features/bf_matcher` of evermap-vision's
//! bench, OpenCV's brute-force matcher on as many descriptors. One thread; 20 views of 500 features each.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::features::{
    DESCRIPTOR_BYTES, Descriptor, Feature, ImageFeatures,
};
use evermap_algorithms::metric_map::tracking::{CameraFrame, TrackParams, tracks};
use nalgebra::Vector3;

const VIEWS: u32 = 20;
const FEATURES: usize = 500;

fn random(seed: &mut u64) -> u64 {
    *seed = seed
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    *seed >> 33
}

fn fraction(seed: &mut u64) -> f64 {
    random(seed) as f64 / f64::from(1_u32 << 31)
}

/// Views of points all around a camera that drives along its axis.
fn drive(camera: &Camera) -> Vec<(Pose, ImageFeatures)> {
    let mut seed = 1;
    let points: Vec<(Vector3<f64>, [u8; DESCRIPTOR_BYTES])> = (0..4 * FEATURES)
        .map(|_| {
            let axis = |span: f64, seed: &mut u64| (fraction(seed) - 0.5) * span;
            let at = Vector3::new(
                axis(20.0, &mut seed),
                axis(5.0, &mut seed),
                15.0 + axis(40.0, &mut seed),
            );
            (at, std::array::from_fn(|_| random(&mut seed) as u8))
        })
        .collect();
    (0..VIEWS)
        .map(|view| {
            let pose = Pose::new(
                Vector3::new(0.0, 0.0, 0.3 * f64::from(view)),
                Pose::identity().rotation,
            );
            let mut image = ImageFeatures::default();
            for (point, descriptor) in &points {
                let seen = camera.project(&pose.inverse().transform(point));
                let Some(pixel) = seen.filter(|at| camera.contains(*at)) else {
                    continue;
                };
                let mut descriptor = *descriptor;
                for _ in 0..50 {
                    let bit = random(&mut seed) as usize % 512;
                    descriptor[bit / 8] ^= 1 << (bit % 8);
                }
                image.features.push(Feature {
                    pixel: pixel.map(|at| at + fraction(&mut seed) - 0.5),
                    size_px: 12.0,
                    descriptor: Descriptor(descriptor),
                });
            }
            image.features.truncate(FEATURES);
            (pose, image)
        })
        .collect()
}

fn benches(criterion: &mut Criterion) {
    let intrinsics = [128.0, 0.0, 199.5, 0.0, 128.0, 149.5, 0.0, 0.0, 1.0];
    let camera = Camera::from_calibration("equidistant", 400, 300, &intrinsics, &[0.0; 4]).unwrap();
    let drive = drive(&camera);
    let views: Vec<CameraFrame<'_>> = drive
        .iter()
        .map(|(pose, features)| CameraFrame {
            stretch: 0,
            odom_from_camera: *pose,
            features,
        })
        .collect();
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let mut group = criterion.benchmark_group("tracks");
    group
        .sample_size(20)
        .throughput(Throughput::Elements(u64::from(VIEWS) - 1));
    group.bench_function("evermap", |bench| {
        bench.iter(|| one.install(|| tracks(&camera, &views, &TrackParams::default())));
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
