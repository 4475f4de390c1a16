//! Points seen by every lens, with noise and with lies.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::UnitQuaternion;
use proptest::prelude::*;

use super::*;
use crate::camera::tests::{one_of_each, wide_fisheye};

/// A camera on a straight path, looking along z of the map.
fn path(camera: &Camera, count: usize, step_m: f64, point: &Vector3<f64>) -> Vec<View<'static>> {
    let camera: &'static Camera = Box::leak(Box::new(camera.clone()));
    (0..count)
        .map(|at| {
            let map_from_camera = Pose::new(
                Vector3::new(step_m * at as f64, 0.0, 0.1 * at as f64),
                UnitQuaternion::from_euler_angles(0.02 * at as f64, -0.01 * at as f64, 0.03),
            );
            let pixel = camera.project(&map_from_camera.inverse().transform(point));
            View {
                camera,
                map_from_camera,
                pixel: pixel.unwrap(),
                sigma_px: 0.5,
            }
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn exact_views_give_the_point_back(
        x in -2.0..2.0f64, y in -1.5..1.5f64, z in 4.0..20.0f64, count in 2..9usize
    ) {
        let point = Vector3::new(x, y, z);
        for camera in one_of_each() {
            let views = path(&camera, count, 0.8, &point);
            let found = triangulate(&views, &Options::default());
            let Ok(found) = found else {
                // Coarse lenses may find two views too uncertain.
                prop_assert!(count < 4, "{:?} {found:?}", camera.model);
                continue;
            };
            prop_assert!((found.position - point).norm() < 1e-6, "{:?}", camera.model);
            prop_assert!(found.inliers.iter().all(|inlier| *inlier) && found.rms_px < 1e-6);
        }
    }

    #[test]
    fn lies_are_found_out(
        lies in prop::collection::vec((0..10usize, 20.0..150.0f64, -3.0..3.0f64), 0..4),
        noise in prop::collection::vec(-0.6..0.6f64, 20)
    ) {
        let point = Vector3::new(1.0, 0.5, 5.0);
        let mut views = path(&wide_fisheye(), 10, 0.5, &point);
        for (view, noise) in views.iter_mut().zip(noise.chunks(2)) {
            view.pixel = [view.pixel[0] + noise[0], view.pixel[1] + noise[1]];
        }
        let mut honest = vec![true; 10];
        for (at, far, angle) in lies {
            let pixel = &mut views[at].pixel;
            *pixel = [pixel[0] + far * angle.cos(), pixel[1] + far * angle.sin()];
            honest[at] = false;
        }
        let found = triangulate(&views, &Options::default()).unwrap();
        prop_assert!((found.position - point).norm() < 0.15, "{found:?}");
        for (inlier, honest) in found.inliers.iter().zip(&honest) {
            // Two lies about one view may cancel.
            prop_assert!(!*honest || *inlier, "{found:?}");
        }
    }

    #[test]
    fn no_views_panic(
        numbers in prop::collection::vec(prop::array::uniform5(any::<f64>()), 0..6)
    ) {
        let camera = wide_fisheye();
        let views: Vec<View<'_>> = numbers.iter().map(|[x, y, z, u, v]| View {
            camera: &camera,
            map_from_camera: Pose::new(Vector3::new(*x, *y, *z), UnitQuaternion::identity()),
            pixel: [*u, *v],
            sigma_px: 1.0,
        }).collect();
        let _ = triangulate(&views, &Options::default());
    }
}

#[test]
fn beside_and_behind_the_camera_is_along_the_ray() {
    // 95° to the side of the first view: behind its image plane, along its ray.
    let point = Vector3::new(5.0, 0.3, -0.3);
    let views = path(&wide_fisheye(), 6, 0.3, &point);
    let found = triangulate(
        &views,
        &Options {
            max_relative_sigma: 1.0,
            ..Options::default()
        },
    );
    assert!(found.is_ok_and(|found| (found.position - point).norm() < 1e-6));
    // The same rays turned round meet behind all cameras.
    let mut turned = path(&wide_fisheye(), 4, 0.5, &Vector3::new(0.5, 0.2, 6.0));
    turned.reverse();
    let poses: Vec<Pose> = turned
        .iter()
        .rev()
        .map(|view| view.map_from_camera)
        .collect();
    for (view, pose) in turned.iter_mut().zip(poses) {
        view.map_from_camera = pose;
    }
    assert!(triangulate(&turned, &Options::default()).is_err());
}

#[test]
fn covariance_is_what_repeated_noise_shows() {
    let point = Vector3::new(1.0, 0.5, 6.0);
    let exact = path(&wide_fisheye(), 8, 0.4, &point);
    let mut noise = crate::bundle_adjustment::tests::Noise::new(7);
    let (mut sum, mut expected, runs) = (Matrix3::zeros(), Matrix3::zeros(), 400);
    let options = Options {
        outlier_sigmas: 8.0,
        ..Options::default()
    };
    for _ in 0..runs {
        let mut views = exact.clone();
        for view in &mut views {
            view.pixel = view.pixel.map(|x| x + 0.5 * noise.normal());
        }
        let found = triangulate(&views, &options).unwrap();
        let error = found.position - point;
        sum += error * error.transpose() / f64::from(runs);
        expected += found.covariance / f64::from(runs);
    }
    let ratio = sum.trace() / expected.trace();
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
}

#[test]
fn parallel_rays_and_far_points_are_refused() {
    let far = Vector3::new(1.0, 0.5, 150.0);
    let views = path(&wide_fisheye(), 3, 0.2, &far);
    assert_eq!(
        triangulate(&views, &Options::default()),
        Err(Refusal::Parallax)
    );
    assert_eq!(
        triangulate(&views[..1], &Options::default()),
        Err(Refusal::Views)
    );
    let near = path(&wide_fisheye(), 6, 0.5, &Vector3::new(0.0, 0.0, 5.0));
    let options = Options {
        max_depth_m: 4.0,
        ..Options::default()
    };
    assert_eq!(triangulate(&near, &options), Err(Refusal::Depth));
    let options = Options {
        max_relative_sigma: 1e-6,
        ..Options::default()
    };
    assert_eq!(triangulate(&near, &options), Err(Refusal::Uncertain));
}
