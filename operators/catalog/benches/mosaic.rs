//! What a mosaic costs beside the decoding that it cannot do without, and beside the same work by OpenCV's remap.
//!
//! All on one thread, 1280 × 960 grey JPEGs of a 180° fisheye one metre above the ground, 8 m of reach, 5 cm cells.
//!
//! * `decode`: the images, nothing else.
//! * `mosaic`: images to patches to tile sums of five zooms, serialised: the operators, as the engine calls them.
//! * `decode_colour`, `mosaic_colour`: the same of JPEGs in colour, 4:2:0.
//! * `remap_fixed`: decode, remap by one map for all images (so the vehicle never turns or moves by part of a cell),
//!   add value × weight and weight in floating point; one zoom.
//! * `remap_posed`: the same with the map that belongs to each pose.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::hint::black_box;

use arrow::array::RecordBatch;
use criterion::{Criterion, criterion_group, criterion_main};
use evermap_algorithms::geometry::camera::Camera;
use evermap_algorithms::geometry::pose::Pose;
use evermap_bench::remap::Remap;
use evermap_contract::{Emit, Job, Losses, Phase, Sides};
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, ImageRef, Stamp, batch, record};
use evermap_vision::{Grey, Rgb, decode_colour, decode_grey};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde_json::json;

const SIZE: [u32; 2] = [1280, 960];
const IMAGES: i64 = 32;
const CELL_M: f64 = 0.05;
const REACH_M: f64 = 8.0;

record! {
    /// A posed image as the kernel sees it.
    #[layer("posed_images", key(site, session, stamp, camera))]
    pub struct Image {
        /// Site.
        site: String,
        /// Session.
        session: String,
        /// Exposure.
        stamp: Stamp,
        /// Camera.
        camera: String,
        /// The vehicle.
        map_from_vehicle: evermap_schemas::Pose,
        /// Where the pixels would be.
        image: ImageRef,
        /// JPEG.
        image_pixels: Option<Bytes>,
    }
}

fn calibration() -> Calibration {
    Calibration {
        site: "s".into(),
        session: "a".into(),
        stamp: Stamp(0),
        camera: "front".into(),
        width: SIZE[0],
        height: SIZE[1],
        model: "equidistant".into(),
        intrinsics: vec![407.0, 0.0, 639.5, 0.0, 407.0, 479.5, 0.0, 0.0, 1.0],
        distortion: vec![],
        mount: None,
    }
}

fn camera() -> Camera {
    let Calibration {
        model,
        width,
        height,
        intrinsics,
        ..
    } = calibration();
    Camera::from_calibration(&model, width, height, &intrinsics, &[]).unwrap()
}

fn vehicle_from_camera() -> Pose {
    let level = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = Rotation3::from_matrix_unchecked(level)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), -0.6);
    Pose::new(
        Vector3::new(3.6, 0.0, 1.0),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

fn pose(index: i64) -> Pose {
    Pose::from_yaw(0.2 * index as f64, 0.1 * index as f64, 0.02 * index as f64)
}

/// A rough floor with squares: about as much for a decoder to do as a real car park.
fn jpeg(channels: jpeg_encoder::ColorType) -> Vec<u8> {
    let mut seed = 1_u32;
    let mut noise = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 28) as u8
    };
    let grey: Vec<u8> = (0..SIZE[1])
        .flat_map(|v| (0..SIZE[0]).map(move |u| (u, v)))
        .map(|(u, v)| if (u / 37 + v / 29) % 2 == 0 { 60 } else { 150 } + noise())
        .collect();
    let pixels = match channels {
        jpeg_encoder::ColorType::Luma => grey,
        // The brighter, the more yellow.
        _ => grey.iter().flat_map(|grey| [*grey, *grey, 60]).collect(),
    };
    let mut bytes = Vec::new();
    jpeg_encoder::Encoder::new(&mut bytes, 85)
        .encode(&pixels, SIZE[0] as u16, SIZE[1] as u16, channels)
        .unwrap();
    bytes
}

fn reference(length: usize) -> ImageRef {
    ImageRef {
        session: "a".into(),
        length: length as u64,
        format: "jpeg".into(),
        ..ImageRef::default()
    }
}

struct Mosaic {
    images: RecordBatch,
    patches: Job,
    tiles: Job,
}

impl Mosaic {
    fn new(jpeg: &[u8]) -> Self {
        let image = |index: i64| Image {
            site: "s".into(),
            session: "a".into(),
            stamp: Stamp(index),
            camera: "front".into(),
            map_from_vehicle: evermap_schemas::Pose::from_array(pose(index).to_array()),
            image: reference(jpeg.len()),
            image_pixels: Some(Bytes(jpeg.to_vec())),
        };
        let transform = Transform {
            site: "s".into(),
            session: "a".into(),
            stamp: Stamp(0),
            parent: "base_link".into(),
            child: "front".into(),
            parent_from_child: evermap_schemas::Pose::from_array(vehicle_from_camera().to_array()),
            fixed: true,
        };
        let registry = evermap_catalog::registry();
        let job = |name: &str, phase: Phase, sides: Sides| {
            let entry = registry.get(name).unwrap();
            Job::new(entry, &json!({}), phase, sides).unwrap()
        };
        let side = |name: &str, rows: RecordBatch| (name.to_owned(), vec![rows]);
        let sides = [
            side("calibration", batch(vec![calibration()]).unwrap()),
            side("transforms", batch(vec![transform]).unwrap()),
        ];
        Self {
            images: batch((0..IMAGES).map(image).collect()).unwrap(),
            patches: job("ground_patches", Phase::Run, Sides::new(sides.into())),
            tiles: job("overhead_tiles", Phase::Lift, Sides::default()),
        }
    }

    fn bench(&self, bench: &mut criterion::Bencher<'_>) {
        let one = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        bench.iter(|| {
            one.install(|| {
                let (mut losses, mut found, mut states) = (Losses::default(), Vec::new(), 0);
                let mut keep = |batch| {
                    found.push(batch);
                    Ok(())
                };
                self.patches
                    .worker()
                    .push(&self.images, &mut Emit::new(&mut keep, &mut losses))
                    .unwrap();
                let mut count = |batch: RecordBatch| {
                    states += batch.num_rows();
                    Ok(())
                };
                let mut emit = Emit::new(&mut count, &mut losses);
                let mut lift = self.tiles.worker();
                found
                    .iter()
                    .for_each(|batch| lift.push(batch, &mut emit).unwrap());
                lift.close(&mut emit).unwrap();
                assert!(losses.is_empty() && states > 0);
            });
        });
    }
}

/// Cells from `[column, row]` on, as many as there are in reach.
struct Area {
    first: [i64; 2],
    side: usize,
}

impl Area {
    fn around(pose: &Pose) -> Self {
        let foot = pose.transform(&vehicle_from_camera().translation);
        let first = [foot.x, foot.y].map(|at| ((at - REACH_M) / CELL_M).floor() as i64);
        Self {
            first,
            side: (2.0 * REACH_M / CELL_M) as usize,
        }
    }

    /// Where each cell is in the image, and its weight.
    fn maps(&self, pose: &Pose) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
        let (camera, mount) = (camera(), vehicle_from_camera());
        let map_from_camera = pose.compose(&mount);
        let (eye, camera_from_map) = (map_from_camera.translation, map_from_camera.inverse());
        let look = |at: usize| {
            let (i, j) = ((at % self.side) as i64, (at / self.side) as i64);
            let x = ((self.first[0] + i) as f64 + 0.5) * CELL_M;
            let y = ((self.first[1] + j) as f64 + 0.5) * CELL_M;
            let ground = Vector3::new(x, y, 0.0);
            let distance = (ground - eye).norm();
            let in_reach = (ground - eye).xy().norm() < REACH_M;
            let seen = camera.project(&camera_from_map.transform(&ground));
            match seen.filter(|pixel| in_reach && camera.contains(*pixel)) {
                Some([u, v]) => (
                    u as f32,
                    v as f32,
                    255.0 * (eye.z / distance).powi(2) as f32,
                ),
                None => (-10.0, -10.0, 0.0),
            }
        };
        let looks: Vec<_> = (0..self.side * self.side).map(look).collect();
        let column = |pick: fn(&(f32, f32, f32)) -> f32| looks.iter().map(pick).collect();
        (
            column(|look| look.0),
            column(|look| look.1),
            column(|look| look.2),
        )
    }

    fn remap(&self, pose: &Pose) -> (Remap, Vec<f32>) {
        let (x, y, weights) = self.maps(pose);
        let side = self.side as u32;
        (Remap::new(side, side, &x, &y).unwrap(), weights)
    }
}

/// One floating-point sheet for the whole drive.
struct Sheet {
    sums: Vec<[f32; 2]>,
}

const SHEET: i64 = 1024;

impl Sheet {
    fn new() -> Self {
        Self {
            sums: vec![[0.0; 2]; (SHEET * SHEET) as usize],
        }
    }

    fn add(&mut self, area: &Area, values: &[u8], weights: &[f32]) {
        let rows = values
            .chunks(area.side)
            .zip(weights.chunks(area.side))
            .zip(0_i64..);
        for ((values, weights), row) in rows {
            let at = (area.first[1] + row + SHEET / 2) * SHEET + area.first[0] + SHEET / 2;
            let sums = &mut self.sums[at as usize..][..area.side];
            for ((sum, value), weight) in sums.iter_mut().zip(values).zip(weights) {
                sum[0] += f32::from(*value) * weight;
                sum[1] += weight;
            }
        }
    }
}

fn mosaics(criterion: &mut Criterion) {
    let [jpeg, in_colour] = [jpeg_encoder::ColorType::Luma, jpeg_encoder::ColorType::Rgb].map(jpeg);
    let mut group = criterion.benchmark_group("mosaic");
    group
        .sample_size(10)
        .throughput(criterion::Throughput::Elements(IMAGES as u64));
    let (mut grey, mut seen) = (Grey::default(), Grey::default());
    group.bench_function("decode", |bench| {
        bench.iter(|| (0..IMAGES).for_each(|_| decode_grey(black_box(&jpeg), &mut grey).unwrap()));
    });
    let mut rgb = Rgb::default();
    group.bench_function("decode_colour", |bench| {
        bench.iter(|| {
            (0..IMAGES).for_each(|_| decode_colour(black_box(&in_colour), &mut rgb).unwrap());
        });
    });
    let mosaic = Mosaic::new(&in_colour);
    group.bench_function("mosaic_colour", |bench| mosaic.bench(bench));
    let mosaic = Mosaic::new(&jpeg);
    group.bench_function("mosaic", |bench| mosaic.bench(bench));
    let (fixed, weights) = Area::around(&pose(0)).remap(&pose(0));
    group.bench_function("remap_fixed", |bench| {
        bench.iter(|| {
            let mut sheet = Sheet::new();
            for index in 0..IMAGES {
                decode_grey(black_box(&jpeg), &mut grey).unwrap();
                fixed.apply(&grey, &mut seen).unwrap();
                sheet.add(&Area::around(&pose(index)), &seen.data, &weights);
            }
            sheet.sums
        });
    });
    group.bench_function("remap_posed", |bench| {
        bench.iter(|| {
            let mut sheet = Sheet::new();
            for index in 0..IMAGES {
                decode_grey(black_box(&jpeg), &mut grey).unwrap();
                let area = Area::around(&pose(index));
                let (remap, weights) = area.remap(&pose(index));
                remap.apply(&grey, &mut seen).unwrap();
                sheet.add(&area, &seen.data, &weights);
            }
            sheet.sums
        });
    });
    group.finish();
}

criterion_group!(benches, mosaics);
criterion_main!(benches);
