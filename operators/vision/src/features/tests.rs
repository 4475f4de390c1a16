#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::ImageError;

fn features(image: &Grey, params: &FeatureParams, blind: &Blind) -> Result<KeyPoints, ImageError> {
    Detectors::default().features(image, params, blind)
}

/// Grey rectangles of all sizes at places from a seed, so that there are corners everywhere; `gain` dims it.
fn scene(width: u32, height: u32, gain: f64) -> Grey {
    let mut seed = 7_u32;
    let mut random = |below: u32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((u64::from(seed >> 8) * u64::from(below)) >> 24) as u32
    };
    let mut data = vec![90_u8; (width * height) as usize];
    for _ in 0..1200 {
        let (u, v) = (random(width), random(height));
        let (w, h) = (4 + random(width / 12), 4 + random(height / 12));
        let level = 20 + random(220) as u8;
        for row in v..(v + h).min(height) {
            data[(row * width + u) as usize..(row * width + (u + w).min(width)) as usize]
                .fill(level);
        }
    }
    let dim = |level: u8| (f64::from(level) * gain + 4.0) as u8;
    Grey {
        width,
        height,
        data: data.into_iter().map(dim).collect(),
    }
}

fn found(image: &Grey, params: &FeatureParams) -> KeyPoints {
    features(image, params, &Blind::default()).unwrap()
}

#[test]
fn features_cover_the_image_in_light_and_in_the_dark() {
    for gain in [1.0, 0.4, 0.12] {
        let image = scene(400, 300, gain);
        let points = found(&image, &FeatureParams::default());
        assert!(
            (400..=500).contains(&points.len()),
            "{gain}: {}",
            points.len()
        );
        assert_eq!(points.descriptors.len(), 64 * points.len());
        assert_eq!(
            (points.v.len(), points.size_px.len()),
            (points.len(), points.len())
        );
        let mut cells = [0; 12];
        for (u, v) in points.u.iter().zip(&points.v) {
            cells[(*u as usize / 100).min(3) + 4 * (*v as usize / 100).min(2)] += 1;
        }
        assert!(cells.iter().all(|cell| *cell >= 5), "{gain}: {cells:?}");
        assert_eq!(points, found(&image, &FeatureParams::default()));
    }
}

#[test]
fn an_image_without_contrast_has_no_features() {
    let black = Grey {
        width: 64,
        height: 48,
        data: vec![3; 64 * 48],
    };
    assert!(found(&black, &FeatureParams::default()).is_empty());
    let tiny = Grey {
        width: 1,
        height: 1,
        data: vec![200],
    };
    assert!(found(&tiny, &FeatureParams::default()).is_empty());
    let params = FeatureParams {
        scale: 1e-9,
        ..FeatureParams::default()
    };
    assert!(features(&black, &params, &Blind::default()).is_err());
    let wrong = Grey {
        width: 64,
        height: 48,
        data: vec![3; 7],
    };
    assert!(features(&wrong, &FeatureParams::default(), &Blind::default()).is_err());
}

#[test]
fn blind_polygons_and_the_outside_of_the_image_circle_stay_empty() {
    let mut image = scene(400, 300, 1.0);
    let body = vec![
        [100.0, 200.0],
        [300.0, 200.0],
        [300.0, 300.0],
        [100.0, 300.0],
    ];
    let blind = Blind {
        mask: None,
        polygons: vec![body, vec![[0.0, 0.0], [1.0, 1.0]]],
    };
    for at in 0..400 * 300_u32 {
        let (u, v) = (f64::from(at % 400) - 199.5, f64::from(at / 400) - 149.5);
        if u.hypot(v) > 200.0 {
            image.data[at as usize] = 5;
        }
    }
    let points = features(&image, &FeatureParams::default(), &blind).unwrap();
    assert!(points.len() > 300);
    for (u, v) in points.u.iter().zip(&points.v) {
        let (u, v) = (f64::from(*u), f64::from(*v));
        assert!(!(v > 200.0 && u > 100.0 && u < 300.0), "{u} {v}");
        assert!((u - 199.5).hypot(v - 149.5) < 195.0, "{u} {v}");
    }
}

#[test]
fn what_is_painted_is_what_is_covered() {
    let rings = vec![
        vec![[-3.0, 2.0], [20.0, 2.0], [9.5, 14.0], [4.0, 3.0]],
        vec![[12.0, 8.0], [30.0, 8.0], [30.0, 40.0], [12.0, 40.0]],
        vec![[1.0, 1.0], [2.0, 2.0]],
        vec![[-1e308, 5.0], [1e308, 6.5], [1e308, -1e308]],
    ];
    let dots = (0..24 * 18).map(|at| u8::from(at % 7 == 0)).collect();
    let mask = Grey {
        width: 24,
        height: 18,
        data: dots,
    };
    let image = |blind: &Blind| blind.painted(24, 18).unwrap().data;
    for polygons in [&rings[..3], &rings[..0]] {
        let blind = Blind {
            polygons: polygons.to_vec(),
            mask: Some(mask.clone()),
        };
        let covers = |at: u32| blind.covers([f64::from(at % 24), f64::from(at / 24)]);
        let covered = (0..24 * 18).map(|at| if covers(at) { 255 } else { 0 });
        assert_eq!(image(&blind), covered.collect::<Vec<u8>>());
    }
    let blind = Blind {
        polygons: rings,
        mask: Some(Grey::default()),
    };
    assert!(image(&blind).contains(&255));
    assert!(blind.painted(0, 18).is_err() && blind.painted(u32::MAX, 18).is_err());
}

/// A point found in the shrunk image lies where the full image has it.
#[test]
fn coordinates_are_those_of_the_full_image() {
    let full = scene(1280, 960, 1.0);
    assert_eq!(FeatureParams::default().scale_for(1280), 0.5);
    assert_eq!(FeatureParams::default().scale_for(400), 1.5);
    assert_eq!(FeatureParams::default().scale_for(100), 2.0);
    assert_eq!(FeatureParams::default().scale_for(700), 1.0);
    assert_eq!(FeatureParams::default().scale_for(2600), 0.25);
    let [half, whole] = [0.0, 1.0].map(|scale| {
        let params = FeatureParams {
            scale,
            count: 20_000,
            ..FeatureParams::default()
        };
        found(&full, &params)
    });
    let mut offsets = [Vec::new(), Vec::new()];
    for (u, v) in half.u.iter().zip(&half.v) {
        let near = whole.u.iter().zip(&whole.v).map(|(x, y)| [x - u, y - v]);
        let near = near
            .min_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])))
            .unwrap();
        if near[0].hypot(near[1]) < 2.0 {
            offsets[0].push(near[0]);
            offsets[1].push(near[1]);
        }
    }
    for mut axis in offsets {
        assert!(axis.len() > 500, "{}", axis.len());
        axis.sort_by(f32::total_cmp);
        let median = axis[axis.len() / 2];
        assert!(median.abs() < 0.15, "{median}");
    }
}
