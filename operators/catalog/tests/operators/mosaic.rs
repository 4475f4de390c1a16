//! Images to patches to tiles, compared with the floor that was photographed.

use std::collections::BTreeMap;

use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::Losses;
use evermap_contract::laws::{Split, inputs_of, run};
use evermap_schemas::layers::{GroundPatch, OverheadTile};
use evermap_schemas::{Bytes, Stamp, batch};
use evermap_vision::{Grey, decode_grey};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::json;

use crate::floor::{Image, Mounted, grey};
use crate::yields;

const CELL_M: f64 = 0.05;

fn patches(rig: &[Mounted], images: Vec<Image>) -> (Vec<GroundPatch>, Losses) {
    let calibration = rig
        .iter()
        .map(|mounted| mounted.calibration.clone())
        .collect();
    let transforms = rig.iter().flat_map(Mounted::transforms).collect();
    let inputs = [
        inputs_of("images", images).unwrap(),
        inputs_of("calibration", calibration).unwrap(),
        inputs_of("transforms", transforms).unwrap(),
    ];
    yields("ground_patches", json!({ "reach_m": 3.0 }), inputs)
}

fn rig() -> Vec<Mounted> {
    vec![
        Mounted::new("front", "equidistant", 127.0, 0.0, 0.7),
        Mounted::new("rear", "plumb_bob", 220.0, std::f64::consts::PI, 0.9),
    ]
}

/// Along a bend, slightly tilted: the ground plane is the vehicle's, so the floor tilts with it.
fn drive() -> Vec<Pose> {
    (0..5_u8)
        .map(|step| Pose::from_yaw(f64::from(step) * 0.4 - 1.0, 0.3, 0.2 * f64::from(step)))
        .collect()
}

fn images() -> Vec<Image> {
    let rig = rig();
    let looks = drive().into_iter().zip(0_i64..);
    let images =
        looks.flat_map(|(pose, stamp)| rig.iter().map(move |mounted| mounted.image(stamp, &pose)));
    images.collect()
}

/// The same image with this colour, or this grey, in the place of each grey value.
fn repainted<const COUNT: usize>(image: &Image, paint: impl Fn(u8) -> [u8; COUNT]) -> Image {
    let pgm = &image.image.as_ref().unwrap().0;
    let pixels = &pgm[pgm.len() - 400 * 300..];
    let kind = if COUNT == 3 { "P6" } else { "P5" };
    let mut bytes = format!("{kind}\n400 300\n255\n").into_bytes();
    bytes.extend(pixels.iter().flat_map(|grey| paint(*grey)));
    Image {
        image: Some(Bytes(bytes)),
        ..image.clone()
    }
}

/// The floor's bright squares are red, its dark ones blue.
fn painted(grey: u8) -> [u8; 3] {
    [grey, 90, 255 - grey]
}

fn luma(colour: &[u8]) -> u8 {
    let sum: u32 = [299, 587, 114]
        .iter()
        .zip(colour)
        .map(|(part, value)| part * u32::from(*value))
        .sum();
    ((sum + 500) / 1000) as u8
}

/// The channels of a tile's picture, and its pixels.
fn pixels(tile: &OverheadTile) -> (png::ColorType, Vec<u8>) {
    let decoder = png::Decoder::new(std::io::Cursor::new(&tile.png.0));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width, info.height), (256, 256));
    (info.color_type, pixels)
}

fn tiles_of(patches: &[GroundPatch]) -> Vec<OverheadTile> {
    let inputs = [inputs_of("patches", patches.to_vec()).unwrap()];
    yields("overhead_tiles", json!({ "zooms": 2 }), inputs).0
}

#[test]
fn the_mosaic_of_images_in_colour_is_the_floor_in_colour() {
    let of = |images: Vec<Image>| {
        let (patches, losses) = patches(&rig(), images);
        assert!(losses.is_empty(), "{losses:?}");
        patches
    };
    let colour = of(images().iter().map(|it| repainted(it, painted)).collect());
    let grey = |it: &Image| repainted(it, |grey| [luma(&painted(grey))]);
    let grey = of(images().iter().map(grey).collect());
    for (colour, grey) in colour.iter().zip(&grey) {
        assert_eq!(colour.weights, grey.weights);
        assert_eq!(colour.values.0.len(), 3 * grey.values.0.len());
    }
    let [colour, grey] = [colour, grey].map(|patches| tiles_of(&patches));
    assert_eq!(colour.len(), grey.len());
    let (mut seen, mut red, mut blue) = (0, 0, 0);
    for (colour, grey) in colour.iter().zip(&grey) {
        let ((in_colour, colours), (in_grey, greys)) = (pixels(colour), pixels(grey));
        assert_eq!(in_colour, png::ColorType::Rgba);
        assert_eq!(in_grey, png::ColorType::GrayscaleAlpha);
        assert_eq!(
            (colour.covered, colour.mean_weight, &colour.sources),
            (grey.covered, grey.mean_weight, &grey.sources)
        );
        for (colour, grey) in colours.chunks(4).zip(greys.chunks(2)) {
            assert_eq!(colour[3], grey[1]);
            assert!(luma(colour).abs_diff(grey[0]) <= 3, "{colour:?} {grey:?}");
            let is_seen = colour[3] > 0;
            // Red and blue are as far apart from each other as the floor is from the middle.
            assert!(
                !is_seen || colour[0].abs_diff(255 - colour[2]) <= 3,
                "{colour:?}"
            );
            seen += usize::from(is_seen);
            red += usize::from(is_seen && colour[0] > 170 && colour[2] < 85);
            blue += usize::from(is_seen && colour[0] < 85 && colour[2] > 170);
        }
    }
    assert!(
        seen > 8_000 && 5 * red > seen && 5 * blue > seen,
        "{seen} {red} {blue}"
    );
}

#[test]
fn images_that_are_grey_make_the_same_bytes_however_they_were_recorded() {
    let recorded = |in_colour: bool| {
        let recorded = |it: &Image| match in_colour {
            true => repainted(it, |grey| [grey; 3]),
            false => repainted(it, |grey| [grey]),
        };
        patches(&rig(), images().iter().map(recorded).collect()).0
    };
    let [grey, in_colour] = [false, true].map(recorded);
    assert_eq!(grey, floor_patches());
    assert_eq!(in_colour, grey);
}

/// Of two drives over one floor, one by grey cameras: the colours are halfway to grey.
#[test]
fn a_grey_drive_fades_the_colours_of_another() {
    let colour = images()
        .iter()
        .map(|it| repainted(it, painted))
        .collect::<Vec<_>>();
    let (mut colour, _) = patches(&rig(), colour);
    for patch in &mut colour {
        patch.session = "b".into();
    }
    let alone = tiles_of(&colour);
    let mut both = colour;
    both.extend(floor_patches());
    let both = tiles_of(&both);
    assert_eq!(both.len(), alone.len());
    for (both, alone) in both.iter().zip(&alone) {
        assert_eq!(both.covered, alone.covered);
        let ((channels, both), (_, alone)) = (pixels(both), pixels(alone));
        assert_eq!(channels, png::ColorType::Rgba);
        for (both, alone) in both.chunks(4).zip(alone.chunks(4)) {
            // Red of the painted floor is the grey of the other one.
            let expected = [0, 1, 2].map(|at| (u16::from(alone[0]) + u16::from(alone[at])) / 2);
            let off = both.iter().zip(expected);
            let off = off.map(|(found, expected)| u16::from(*found).abs_diff(expected));
            assert!(off.max().unwrap() <= 1, "{both:?} {alone:?}");
        }
    }
}

fn floor_patches() -> Vec<GroundPatch> {
    let rig = rig();
    let (patches, losses) = patches(&rig, images());
    assert!(losses.is_empty(), "{losses:?}");
    assert_eq!(patches.len(), 10);
    patches
}

/// Mean difference from the floor over the cells that a tile shows, and how many those are.
fn error(tile: &OverheadTile) -> (f64, usize) {
    let (channels, pixels) = pixels(tile);
    assert_eq!(channels, png::ColorType::GrayscaleAlpha);
    let west = f64::from(tile.tile_x) * tile.size_m;
    let north = f64::from(tile.tile_y + 1) * tile.size_m;
    let shown = pixels
        .as_chunks::<2>()
        .0
        .iter()
        .enumerate()
        .filter(|(_, pixel)| pixel[1] > 0);
    let errors: Vec<f64> = shown
        .map(|(at, pixel)| {
            let x = west + (f64::from(at as u32 % 256) + 0.5) * tile.cell_m;
            let y = north - (f64::from(at as u32 / 256) + 0.5) * tile.cell_m;
            (f64::from(pixel[0]) - grey(x, y)).abs()
        })
        .collect();
    assert_eq!(errors.len() as u32, tile.covered);
    (
        errors.iter().sum::<f64>() / errors.len() as f64,
        errors.len(),
    )
}

#[test]
fn the_mosaic_is_the_floor() {
    let inputs = [inputs_of("patches", floor_patches()).unwrap()];
    let (tiles, _) = yields::<OverheadTile>("overhead_tiles", json!({ "zooms": 2 }), inputs);
    let finest: Vec<_> = tiles.iter().filter(|tile| tile.zoom == 0).collect();
    let (sum, cells) = finest
        .iter()
        .map(|tile| error(tile))
        .fold((0.0, 0), |(sum, cells), (mean, n)| {
            (sum + mean * n as f64, cells + n)
        });
    let mean = sum / cells as f64;
    eprintln!("mean difference {mean:.2} grey values over {cells} cells");
    assert!(cells > 8_000, "{cells} cells");
    // The squares differ by 140; what is left is the blur of their edges.
    assert!(mean < 7.0, "mean difference {mean}");
    assert!(
        tiles
            .iter()
            .any(|tile| tile.zoom == 1 && tile.cell_m == 2.0 * CELL_M)
    );
}

#[test]
fn a_tile_names_the_images_that_it_shows() {
    let mut patches = floor_patches();
    for (patch, session) in patches.iter_mut().zip(["b", "a"].iter().cycle()) {
        patch.session = (*session).into();
    }
    let inputs = [inputs_of("patches", patches.clone()).unwrap()];
    let (tiles, _) = yields::<OverheadTile>("overhead_tiles", json!({ "zooms": 1 }), inputs);
    assert!(tiles.len() > 1);
    let side = 256;
    for tile in tiles {
        let mut expected: BTreeMap<&str, (Stamp, Stamp)> = BTreeMap::new();
        for patch in &patches {
            let shows = |at: usize| {
                let (column, row) = (
                    at as i32 % patch.width as i32,
                    at as i32 / patch.width as i32,
                );
                (patch.column + column).div_euclid(side) == tile.tile_x
                    && (patch.row + row).div_euclid(side) == tile.tile_y
            };
            let weights = patch.weights.0.iter().enumerate();
            if weights
                .filter(|(_, weight)| **weight > 0)
                .any(|(at, _)| shows(at))
            {
                let part = expected
                    .entry(&patch.session)
                    .or_insert((patch.stamp, patch.stamp));
                *part = (part.0.min(patch.stamp), part.1.max(patch.stamp));
            }
        }
        let found = tile.sources.iter();
        let found = found.map(|part| (&*part.session, (part.first_stamp, part.last_stamp)));
        assert_eq!(found.collect::<Vec<_>>(), Vec::from_iter(expected));
    }
}

#[test]
fn each_lens_alone_sees_the_floor_where_it_is() {
    for mounted in rig() {
        let tilted = Pose::new(
            Vector3::new(0.3, -0.2, 0.0),
            UnitQuaternion::from_euler_angles(0.0, 0.0, 1.0),
        );
        let image = mounted.image(0, &tilted);
        let (patches, _) = patches(&[mounted], vec![image]);
        let patch = &patches[0];
        let width = i64::from(patch.width);
        let looks = patch.values.0.iter().zip(&patch.weights.0).enumerate();
        let errors: Vec<f64> = looks
            .filter(|(_, (_, weight))| **weight > 60)
            .map(|(at, (value, _))| {
                let (i, j) = (at as i64 % width, at as i64 / width);
                let x = (i + i64::from(patch.column)) as f64 * CELL_M + 0.5 * CELL_M;
                let y = (j + i64::from(patch.row)) as f64 * CELL_M + 0.5 * CELL_M;
                (f64::from(*value) - grey(x, y)).abs()
            })
            .collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        eprintln!("{}: {mean:.2} over {} cells", patch.camera, errors.len());
        assert!(
            errors.len() > 800 && mean < 7.0,
            "{}: {mean} over {}",
            patch.camera,
            errors.len()
        );
    }
}

#[test]
fn tiles_are_the_same_bytes_however_the_work_is_cut() {
    let registry = evermap_catalog::registry();
    // One drive in colour among grey ones.
    let mut patches = floor_patches();
    for patch in &mut patches[..4] {
        patch.session = "b".into();
        patch.values.0 = patch.values.0.iter().flat_map(|it| painted(*it)).collect();
    }
    let inputs = [inputs_of("patches", patches).unwrap()].into();
    let tiles = |batch_rows, partitions, reverse| {
        let split = Split {
            batch_rows,
            partitions,
            reverse,
        };
        run(
            registry.get("overhead_tiles").unwrap(),
            &json!({}),
            &inputs,
            split,
        )
        .unwrap()
    };
    let whole = tiles(usize::MAX, 1, false);
    assert!(whole.rows.num_rows() > 5);
    for (batch_rows, partitions, reverse) in [(1, 1, true), (3, 2, false), (1, 4, true)] {
        assert_eq!(tiles(batch_rows, partitions, reverse), whole);
    }
}

#[test]
fn an_image_without_what_it_needs_is_counted_by_reason() {
    let rig = rig();
    let pose = Pose::identity();
    let good = || rig[0].image(0, &pose);
    let mut images = vec![good()];
    let mut bad = |stamp: i64, damage: &dyn Fn(&mut Image)| {
        let mut image = Image {
            stamp: evermap_schemas::Stamp(stamp),
            ..good()
        };
        damage(&mut image);
        images.push(image);
    };
    // Whoever could not fetch it has counted it.
    bad(1, &|image| image.image = None);
    bad(2, &|image| image.image.as_mut().unwrap().0.truncate(90));
    bad(3, &|image| image.image = Some(Bytes(vec![1, 2, 3])));
    bad(4, &|image| image.camera = "nobody".into());
    bad(5, &|image| image.session = "another".into());
    bad(6, &|image| image.map_from_vehicle.x = f64::NAN);
    bad(7, &|image| image.map_from_vehicle.x = 1e9);
    bad(8, &|image| {
        image.image = Some(Bytes(b"P5\n2 2\n255\n1234".to_vec()))
    });
    let (found, losses) = patches(&rig, images);
    let expected = [
        (
            "image of camera `front` does not decode: expected a jpeg, png or pnm image; record images as JPEG or PNG",
            1,
        ),
        (
            "image of camera `front` does not decode: pnm image is truncated or damaged",
            1,
        ),
        (
            "image of camera `front` has another shape than its calibration",
            1,
        ),
        ("no calibration of camera `front`", 1),
        ("no calibration of camera `nobody`", 1),
        ("pose is not a rigid transform", 1),
        ("pose is out of the map", 1),
    ];
    assert_eq!(found.len(), 1);
    assert_eq!(
        losses.0,
        expected
            .map(|(reason, count)| (reason.to_owned(), count))
            .into()
    );
}

#[test]
fn cameras_that_are_not_mounted_or_look_from_below_are_counted() {
    let (mut rig, pose) = (rig(), Pose::identity());
    let images = rig
        .iter()
        .map(|mounted| mounted.image(0, &pose))
        .collect::<Vec<_>>();
    rig[0].vehicle_from_camera.translation.z = -1.0;
    let inputs = [
        inputs_of("images", images).unwrap(),
        inputs_of(
            "calibration",
            rig.iter().map(|m| m.calibration.clone()).collect(),
        )
        .unwrap(),
        inputs_of("transforms", rig[0].transforms()).unwrap(),
    ];
    let (found, losses) = yields::<GroundPatch>("ground_patches", json!({}), inputs);
    assert!(found.is_empty());
    assert_eq!(
        losses.0.keys().collect::<Vec<_>>(),
        [
            "camera is not above the ground",
            "no fixed transforms from frame `rear` to `base_link`",
        ]
    );
}

#[test]
fn a_halved_image_gets_its_calibration_halved() {
    let mounted = Mounted::new("front", "equidistant", 127.0, 0.0, 0.7);
    let pose = Pose::identity();
    let mut image = mounted.image(0, &pose);
    let mut full = Grey::default();
    decode_grey(&image.image.as_ref().unwrap().0, &mut full).unwrap();
    let mut half = b"P5\n200 150\n255\n".to_vec();
    for v in 0..150_usize {
        for u in 0..200_usize {
            let at = |du: usize, dv: usize| u16::from(full.data[(2 * v + dv) * 400 + 2 * u + du]);
            half.push(((at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1)) / 4) as u8);
        }
    }
    let rig = [mounted];
    let (whole, _) = patches(&rig, vec![image.clone()]);
    image.image = Some(Bytes(half));
    let (halved, losses) = patches(&rig, vec![image]);
    assert!(losses.is_empty(), "{losses:?}");
    let cell = |patch: &GroundPatch, i: i32, j: i32| {
        let (c, r) = (i - patch.column, j - patch.row);
        let inside = c >= 0 && r >= 0 && c < patch.width as i32 && r < patch.height as i32;
        inside.then(|| f64::from(patch.values.0[(r * patch.width as i32 + c) as usize]))
    };
    let cells = (20..50).flat_map(|i| (-20..20).map(move |j| (i, j)));
    let errors: Vec<f64> = cells
        .filter_map(|(i, j)| Some((cell(&whole[0], i, j)? - cell(&halved[0], i, j)?).abs()))
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(
        errors.len() > 1_000 && mean < 10.0,
        "{mean} over {}",
        errors.len()
    );
}

#[test]
fn patches_that_contradict_themselves_are_counted_and_cells_are_not_mixed() {
    let mut patches = floor_patches();
    patches.truncate(4);
    patches[0].width += 1;
    patches[1].weights.0.pop();
    let values = patches[2].values.0.clone();
    patches[2].values.0.extend(values);
    let inputs = [inputs_of("patches", patches.clone()).unwrap()];
    let (tiles, losses) = yields::<OverheadTile>("overhead_tiles", json!({ "zooms": 1 }), inputs);
    assert!(!tiles.is_empty());
    assert_eq!(losses.total(), 3);

    let mut mixed = vec![patches[3].clone(), patches[3].clone()];
    mixed[1].cell_m = 0.1;
    let registry = evermap_catalog::registry();
    let inputs = [("patches".to_owned(), batch(mixed).unwrap())].into();
    let entry = registry.get("overhead_tiles").unwrap();
    for batch_rows in [1, 2] {
        let split = Split {
            batch_rows,
            partitions: 2,
            reverse: false,
        };
        let fault = run(entry, &json!({}), &inputs, split).unwrap_err();
        assert!(fault.to_string().contains("0.05 m and 0.1 m"), "{fault}");
    }
}

#[test]
fn senseless_parameters_are_the_users() {
    let registry = evermap_catalog::registry();
    for (operator, params) in [
        ("ground_patches", json!({ "cell_m": 0.0 })),
        ("ground_patches", json!({ "reach_m": 1e9 })),
        ("ground_patches", json!({ "max_angle_rad": -1.0 })),
        ("overhead_tiles", json!({ "zooms": 0 })),
        ("keyframes", json!({ "baseline_m": -1.0 })),
        ("keyframes", json!({ "max_gap_s": -1.0 })),
        ("road_network", json!({ "connect_m": 0.0 })),
    ] {
        let entry = registry.get(operator).unwrap();
        let fault = entry.normalise(&params).unwrap_err();
        assert_eq!(fault.kind.code(), "user", "{operator} {params}: {fault}");
    }
}
