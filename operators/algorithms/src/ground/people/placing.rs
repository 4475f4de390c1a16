//! How exactly a person is placed, on the ground and in the map.

use super::PeopleParams;
use super::upright::{PERSON_PX, Stance, Upright};

/// Windows are placed to half a cell of eight pixels, feet and head alike: a part of the person's height.
const PLACED: f64 = 4.0 / PERSON_PX;
/// The ground is never known better than this, m.
const ROUGH_M: f64 = 0.02;
/// Feet above the horizon stand nowhere: the least slope at which they are seen.
const FLATTEST: f64 = 0.02;

/// The range at which sight through the feet meets the plane, m.
pub(super) fn range_by_feet(seen: &Stance, eye_m: f64) -> f64 {
    let slope = (eye_m - seen.foot_m) / seen.range_m;
    eye_m / slope.max(FLATTEST)
}

/// By how much the ground may be off the vehicle's plane at a range, m, one standard deviation.
pub(super) fn ground_sd_m(range_m: f64, params: &PeopleParams) -> f64 {
    ROUGH_M.hypot(params.slope * range_m)
}

/// Variance of x, covariance of x and y, variance of y in the vehicle frame, m². The range is told by the feet, as well as
/// they are found and the ground is known, and by the size, as well as it is found and people are alike; both weigh by their
/// variance.
pub(super) fn covariance(upright: &Upright, of: &Stance, params: &PeopleParams) -> [f64; 3] {
    let pixel_m = 0.5 * of.range_m / upright.px_per_rad();
    let placed_m = (PLACED * of.height_m).hypot(pixel_m);
    let feet_m = placed_m.hypot(ground_sd_m(of.range_m, params));
    let by_feet = of.range_m * feet_m / upright.eye_m();
    let size_m = (std::f64::consts::SQRT_2 * placed_m).hypot(params.height_sd_m);
    let by_size = of.range_m * size_m / params.height_m;
    let along = 1.0 / (by_feet.powi(-2) + by_size.powi(-2));
    turned([along, 0.0, placed_m * placed_m], of.azimuth)
}

/// A covariance in axes that are turned by an angle, anticlockwise, in those before.
pub fn turned([xx, xy, yy]: [f64; 3], by: f64) -> [f64; 3] {
    let (sin, cos) = by.sin_cos();
    [
        cos * cos * xx - 2.0 * sin * cos * xy + sin * sin * yy,
        sin * cos * (xx - yy) + (cos * cos - sin * sin) * xy,
        sin * sin * xx + 2.0 * sin * cos * xy + cos * cos * yy,
    ]
}

/// A covariance in the map: one in the vehicle frame, m², of a point there, with what is not known of the vehicle's pose: its
/// place (m) and heading (rad), standard deviations.
pub fn in_map(
    covariance: [f64; 3],
    point: [f64; 2],
    yaw: f64,
    [place_sd_m, heading_sd_rad]: [f64; 2],
) -> [f64; 3] {
    let [x, y] = point;
    let (place, heading) = (place_sd_m.powi(2), heading_sd_rad.powi(2));
    // A small turn moves the point at right angles to where it is.
    let uncertain = [
        covariance[0] + place + heading * y * y,
        covariance[1] - heading * x * y,
        covariance[2] + place + heading * x * x,
    ];
    turned(uncertain, yaw)
}
