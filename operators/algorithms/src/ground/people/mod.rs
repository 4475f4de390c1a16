//! People in images, and where on the ground they stand.
//!
//! | module | what it knows |
//! |---|---|
//! | [`upright`] | images as they would be if every person in them stood upright and had one size |
//! | [`search`] | where a detector of windows finds people, one place for each |
//! | [`boxed`] | where somebody stands around whom a box is drawn |
//! | [`placing`] | how exactly a person is placed, on the ground and in the map |
//! | [`teaching`] | what answers of people teach about who is found, and what to ask |
//!
//! A lens that sees half of the world bends people and lays them on their side; detectors know upright ones. But where a
//! person stands tells how they appear, so the image is looked at as if on cylinders about the camera, upright on the
//! ground: on the one of 4 m, all who stand 4 m away are upright and of one size, at whatever side of the lens they are. What
//! is looked for is therefore two numbers, direction and range, instead of three.
//!
//! Source: *Integrating metric and semantic maps for vision-only automated parking*, section VI-B, where windows of the raw
//! image are described; Dalal & Triggs, *Histograms of oriented gradients for human detection* (2005).

pub mod boxed;
pub mod placing;
pub mod search;
pub mod teaching;
pub mod upright;

#[cfg(test)]
mod tests;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How people are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PeopleParams {
    /// People nearer to the camera than this are not looked for (m): from 1 m above the ground a fisheye no longer shows
    /// feet and head of one who is nearer.
    #[schemars(range(min = 0.1, max = 100.0))]
    pub nearest_m: f64,
    /// People farther from the camera than this are left out (m). On a fisheye of 127 px per radian a person of 10 m is
    /// 22 px high, a quarter of what the detector was taught with.
    #[schemars(range(min = 0.1, max = 100.0))]
    pub farthest_m: f64,
    /// Height of a person (m): the mean of adults, in shoes.
    #[schemars(range(min = 0.1, max = 10.0))]
    pub height_m: f64,
    /// Its standard deviation among people (m).
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub height_sd_m: f64,
    /// By how much the ground may leave the plane that the vehicle stands on: rise over run, one standard deviation.
    /// Floors are laid with falls of 1 to 2 %, so that they drain.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub slope: f64,
    /// Height of the ground in the vehicle frame (m): 0 where the frame stands on it, minus the wheel's radius where it is
    /// the axle's.
    pub plane_m: f64,
    /// What is less probably a person than this, before anybody taught, is left out: who is asked about, and what answers may
    /// bring back, is more than what is believed.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least_probability: f64,
}

impl Default for PeopleParams {
    fn default() -> Self {
        Self {
            nearest_m: 1.5,
            farthest_m: 10.0,
            height_m: 1.74,
            height_sd_m: 0.12,
            slope: 0.015,
            plane_m: 0.0,
            least_probability: 0.05,
        }
    }
}

/// What tells people from all else: windows of [`upright::WINDOW`] pixels with an upright person of
/// [`upright::PERSON_PX`] pixels in the middle.
pub trait WindowDetector {
    /// Windows of an image that score at least `least`: column and row of their first pixel, and the score. Windows may be
    /// looked at on a grid of a few pixels.
    fn scan(&mut self, image: &upright::Picture, least: f64) -> Vec<([usize; 2], f64)>;

    /// The score of an image that is one window; not a number where it is none.
    fn score(&mut self, window: &upright::Picture) -> f64;

    /// What an image that is one window shows, for who is taught to tell windows apart: as many numbers for each; none where
    /// it is none.
    fn describe(&mut self, window: &upright::Picture) -> Vec<f32>;
}
