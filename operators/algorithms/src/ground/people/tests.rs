#![allow(clippy::unwrap_used)]

use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::search::{people, person_at, probability};
use super::upright::{Picture, Stance, Upright, WINDOW};
use super::{PeopleParams, WindowDetector, boxed, placing};
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::ground::projection::GrayView;

const SIZE: [u32; 2] = [400, 300];

/// A fisheye of half a turn, 1 m above the ground, that looks to the left and 20° down.
fn mounted() -> (Camera, Pose) {
    let intrinsics = [127.0, 0.0, 199.5, 0.0, 127.0, 149.5, 0.0, 0.0, 1.0];
    let [width, height] = SIZE;
    let camera =
        Camera::from_calibration("equidistant", width, height, &intrinsics, &[0.0; 4]).unwrap();
    let down = 20_f64.to_radians();
    let forward = Vector3::new(0.0, down.cos(), -down.sin());
    let right = Vector3::new(1.0, 0.0, 0.0);
    let axes = [right, forward.cross(&right), forward];
    let rotation = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&axes));
    let pose = Pose::new(
        Vector3::new(1.0, 0.9, 1.0),
        UnitQuaternion::from_rotation_matrix(&rotation),
    );
    (camera, pose)
}

/// An image of people who are bright cylinders, 1.74 m high and 0.5 m wide, at places of the vehicle frame.
fn image(places: &[[f64; 2]]) -> Vec<u8> {
    let (camera, pose) = mounted();
    let eye = pose.translation;
    let value = |at: u32| {
        let pixel = [at % SIZE[0], at / SIZE[0]].map(f64::from);
        let Some(ray) = camera.unproject(pixel) else {
            return 0;
        };
        let ray = pose.rotate(&ray);
        let hit = places.iter().any(|[x, y]| {
            // Where the sight passes nearest to the cylinder's axis.
            let (dx, dy) = (x - eye.x, y - eye.y);
            let along = (dx * ray.x + dy * ray.y) / (ray.x * ray.x + ray.y * ray.y);
            let aside = (dx * ray.y - dy * ray.x).abs() / ray.x.hypot(ray.y);
            let height = eye.z + along * ray.z;
            along > 0.0 && aside < 0.25 && (0.0..1.74).contains(&height)
        });
        if hit { 250 } else { 50 }
    };
    (0..SIZE[0] * SIZE[1]).map(value).collect()
}

/// Knows those cylinders: 96 rows high and 28 columns wide.
struct Cylinders;

impl Cylinders {
    fn likeness(picture: &Picture, [left, top]: [usize; 2]) -> f64 {
        let person =
            |row: usize, column: usize| (16..112).contains(&row) && (18..46).contains(&column);
        let mut alike = 0.0;
        for row in (0..WINDOW[1]).step_by(2) {
            for column in (0..WINDOW[0]).step_by(2) {
                let value = picture.values[(top + row) * picture.width + left + column];
                let is_bright = value > 150;
                alike += if is_bright == person(row, column) {
                    1.0
                } else {
                    -3.0
                };
            }
        }
        3.0 * alike / 2048.0
    }
}

impl WindowDetector for Cylinders {
    fn scan(&mut self, image: &Picture, least: f64) -> Vec<([usize; 2], f64)> {
        let rows = image.values.len() / image.width;
        let mut found = Vec::new();
        for top in (0..=rows - WINDOW[1]).step_by(8) {
            for left in (0..=image.width - WINDOW[0]).step_by(8) {
                let score = Self::likeness(image, [left, top]);
                if score >= least {
                    found.push(([left, top], score));
                }
            }
        }
        found
    }

    fn score(&mut self, window: &Picture) -> f64 {
        Self::likeness(window, [0, 0])
    }

    /// The part of the window that is bright.
    fn describe(&mut self, window: &Picture) -> Vec<f32> {
        let bright = window.values.iter().filter(|value| **value > 150).count();
        vec![bright as f32 / window.values.len() as f32]
    }
}

#[test]
fn people_anywhere_in_a_fisheye_image_stand_where_they_are_found() {
    let (camera, pose) = mounted();
    let params = PeopleParams {
        least_probability: 0.5,
        ..PeopleParams::default()
    };
    let upright = Upright::new(camera, &pose, &params).unwrap();
    // Ahead of the camera, near its image's edges, and far.
    let places = [[1.5, 4.0], [-3.0, 2.5], [4.5, 2.6], [0.2, 8.5]];
    let pixels = image(&places);
    let view = GrayView::new(SIZE[0], SIZE[1], &pixels).unwrap();
    let found = people(&upright, &view, &mut Cylinders, &params);
    assert_eq!(found.len(), places.len(), "{found:?}");
    for place in places {
        let off = |x: [f64; 2]| (x[0] - place[0]).hypot(x[1] - place[1]);
        let one = found.iter().map(|one| (off(one.position), one));
        let (off_m, one) = one.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        let [xx, xy, yy] = one.covariance;
        assert!(xx * yy - xy * xy > 0.0 && one.probability > 0.5, "{one:?}");
        assert!(off_m < 0.06 * one.range_m + 0.05, "{place:?}: {one:?}");
        assert!(off_m < 2.0 * (xx + yy).sqrt(), "{place:?}: {one:?}");
    }
    assert!(
        people(
            &upright,
            &view,
            &mut Cylinders,
            &PeopleParams {
                least_probability: 1.0,
                ..params
            }
        )
        .is_empty()
    );
}

/// Who is said to stand somewhere is moved to where they are, described as they would be if they had been found, and described
/// also where nothing is like a person.
#[test]
fn who_is_said_to_stand_somewhere_is_described_there() {
    let (camera, pose) = mounted();
    let params = PeopleParams::default();
    let upright = Upright::new(camera, &pose, &params).unwrap();
    let pixels = image(&[[1.5, 4.0]]);
    let view = GrayView::new(SIZE[0], SIZE[1], &pixels).unwrap();
    let found = people(&upright, &view, &mut Cylinders, &params).remove(0);
    let at = |place: [f64; 2]| person_at(&upright, &view, &mut Cylinders, &params, place);
    let said = at([1.6, 4.1]).unwrap();
    let off_m = (said.position[0] - 1.5).hypot(said.position[1] - 4.0);
    assert!(off_m < 0.06 * said.range_m + 0.1, "{said:?}");
    assert!(said.probability > 0.5, "{said:?}");
    assert!((said.description[0] - found.description[0]).abs() < 0.05);
    assert!((0.15..0.35).contains(&said.description[0]), "{said:?}");
    let nobody = at([-3.0, 2.5]).unwrap();
    assert!(
        nobody.probability < 1e-3 && nobody.description == [0.0],
        "{nobody:?}"
    );
    // Not in the image, too near, too far.
    for place in [[1.0, -4.0], [1.0, 1.0], [1.0, 40.0]] {
        assert_eq!(at(place), None);
    }
}

#[test]
fn a_camera_on_the_ground_finds_nobody() {
    let (camera, pose) = mounted();
    let params = PeopleParams {
        plane_m: 0.95,
        ..PeopleParams::default()
    };
    assert!(Upright::new(camera, &pose, &params).is_none());
}

#[test]
fn scores_make_probabilities() {
    assert!(probability(-5.0) < 1e-6 && probability(5.0) > 1.0 - 1e-6);
    assert!((probability(1.3) - 0.5).abs() < 1e-12);
}

#[test]
fn covariances_turn_with_the_vehicle_and_grow_by_its_pose() {
    let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
    let quarter = std::f64::consts::FRAC_PI_2;
    assert!(close(
        placing::turned([4.0, 0.0, 1.0], quarter),
        [1.0, 0.0, 4.0]
    ));
    assert!(close(
        placing::turned([4.0, 1.0, 1.0], quarter),
        [1.0, -1.0, 4.0]
    ));
    let eighth = placing::turned([4.0, 0.0, 1.0], 0.5 * quarter);
    assert!(close(eighth, [2.5, 1.5, 2.5]));
    // 10 m ahead, a heading of 0.01 rad is 0.1 m to the side; the vehicle drives along y.
    let found = placing::in_map([0.04, 0.0, 0.01], [10.0, 0.0], quarter, [0.1, 0.01]);
    assert!(close(found, [0.03, 0.0, 0.05]));
}

/// Where somebody stands is told by a box around them, drawn exactly or by hand, wherever the lens bends them.
#[test]
fn who_is_boxed_stands_where_their_box_would_be() {
    let (camera, pose) = mounted();
    let params = PeopleParams::default();
    let upright = Upright::unrolled(camera.clone(), &pose, &params).unwrap();
    let places = [
        [1.5, 4.0],
        [-2.0, 3.0],
        [3.0, 2.5],
        [1.0, 8.0],
        [5.0, 6.0],
        [-4.0, 2.5],
        [1.0, 2.6],
    ];
    for place in places {
        let [azimuth, range_m] = upright.sight(place);
        let stance = Stance {
            azimuth,
            range_m,
            foot_m: 0.0,
            height_m: params.height_m,
        };
        let exact = upright.rectangle(&stance, 0.4 * params.height_m).unwrap();
        let around = boxed::around(&camera, &pose, place, &params);
        assert_eq!(around, Some(exact), "{place:?}");
        let off_m = |drawn: [f64; 4]| {
            let [x, y] = boxed::standing(&camera, &pose, &drawn, &params).unwrap();
            (x - place[0]).hypot(y - place[1])
        };
        assert!(off_m(exact) < 0.1, "{place:?}: {}", off_m(exact));
        let [left, top, right, bottom] = exact;
        let wide = [left - 3.0, top - 3.0, right + 3.0, bottom + 3.0];
        let allowed = if range_m < 5.5 { 0.6 } else { 2.0 };
        assert!(off_m(wide) < allowed, "{place:?}: {}", off_m(wide));
    }
    // In the sky, in a corner that the lens does not show, and at the vehicle's feet nobody stands.
    for nobody in [
        [190.0, 2.0, 200.0, 20.0],
        [10.0, 10.0, 20.0, 20.0],
        [150.0, 250.0, 250.0, 299.0],
        [0.0, 0.0, 0.0, 0.0],
        [f64::NAN; 4],
    ] {
        assert_eq!(boxed::standing(&camera, &pose, &nobody, &params), None);
    }
    // Who stands behind the camera is in no box.
    let behind = boxed::around(&camera, &pose, [1.0, -5.0], &params);
    assert_eq!(behind, None);
}

#[test]
fn what_boxes_share_is_a_part_of_what_they_cover() {
    let one = [0.0, 0.0, 2.0, 2.0];
    assert_eq!(boxed::overlap(&one, &one), 1.0);
    assert_eq!(boxed::overlap(&one, &[1.0, 0.0, 3.0, 2.0]), 1.0 / 3.0);
    assert_eq!(boxed::overlap(&one, &[2.0, 0.0, 3.0, 2.0]), 0.0);
    assert_eq!(boxed::overlap(&one, &[5.0, 5.0, 6.0, 6.0]), 0.0);
    assert_eq!(boxed::overlap(&[1.0; 4], &[1.0; 4]), 0.0);
}
