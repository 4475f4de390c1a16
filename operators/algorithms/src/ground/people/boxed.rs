//! Where somebody stands around whom a person has drawn a box in an image.
//!
//! In an image of a fisheye people lie on their side, so no edge of a box is at their feet. But a place on the ground tells
//! what box is around who stands there, and in which direction they are the middle of the box says: what is left is the
//! range, and the box of the best one is most like the one that was drawn. That box is what is shown of them afterwards.

use super::PeopleParams;
use super::search::SLENDER;
use super::upright::{Stance, Upright};
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;

/// Range over that of the place before.
const STEP: f64 = 1.02;
/// Who is boxed may be nearer than where people are looked for, and farther, by this factor.
const BEYOND: f64 = 1.2;
/// The boxes of nobody share as much with what was drawn: it is around no person on the ground.
const LEAST: f64 = 0.2;

/// A rectangle of an image: least column and row, largest column and row (px).
pub type Rectangle = [f64; 4];

/// What two rectangles share, as a part of what they cover together.
pub fn overlap(a: &Rectangle, b: &Rectangle) -> f64 {
    let area = |of: &Rectangle| (of[2] - of[0]).max(0.0) * (of[3] - of[1]).max(0.0);
    let shared = area(&[
        a[0].max(b[0]),
        a[1].max(b[1]),
        a[2].min(b[2]),
        a[3].min(b[3]),
    ]);
    let covered = area(a) + area(b) - shared;
    if covered > 0.0 { shared / covered } else { 0.0 }
}

/// Where on the ground, in the vehicle frame (m), somebody of usual size stands around whom this box is drawn; `None` where
/// nobody there would fill it.
pub fn standing(
    camera: &Camera,
    vehicle_from_camera: &Pose,
    drawn: &Rectangle,
    params: &PeopleParams,
) -> Option<[f64; 2]> {
    let upright = Upright::unrolled(camera.clone(), vehicle_from_camera, params)?;
    let middle = [(drawn[0] + drawn[2]) / 2.0, (drawn[1] + drawn[3]) / 2.0];
    let ray = vehicle_from_camera.rotate(&camera.unproject(middle)?);
    let azimuth = ray.y.atan2(ray.x);
    let (first, last) = (params.nearest_m / BEYOND, params.farthest_m * BEYOND);
    let ranges = std::iter::successors(Some(first), |range_m| Some(range_m * STEP));
    let mut best = (LEAST, None);
    for range_m in ranges.take_while(|range_m| *range_m <= last) {
        let around = usual(&upright, [azimuth, range_m], params);
        let alike = around.map_or(0.0, |around| overlap(&around, drawn));
        if alike > best.0 {
            best = (alike, Some(upright.on_ground(azimuth, range_m)));
        }
    }
    best.1
}

/// The box around somebody of usual size who stands at a point of the ground in the vehicle frame (m); `None` where the image
/// shows neither their feet nor their head.
pub fn around(
    camera: &Camera,
    vehicle_from_camera: &Pose,
    position: [f64; 2],
    params: &PeopleParams,
) -> Option<Rectangle> {
    let upright = Upright::unrolled(camera.clone(), vehicle_from_camera, params)?;
    usual(&upright, upright.sight(position), params)
}

/// The box around somebody of usual size, by direction (rad) and range (m).
fn usual(
    upright: &Upright,
    [azimuth, range_m]: [f64; 2],
    params: &PeopleParams,
) -> Option<Rectangle> {
    let stance = Stance {
        azimuth,
        range_m,
        foot_m: 0.0,
        height_m: params.height_m,
    };
    upright.rectangle(&stance, SLENDER * params.height_m)
}
