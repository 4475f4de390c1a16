//! Images as they would be if every person in them stood upright and had one size.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;
use rayon::prelude::*;

use super::PeopleParams;
use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::ground::projection::GrayView;

/// Width and height of a window, pixels.
pub const WINDOW: [usize; 2] = [64, 128];
/// Height of a person in it, in the middle.
pub const PERSON_PX: f64 = 96.0;
/// Rows below the feet, and above the head.
const MARGIN: f64 = 16.0;
/// Rows by which a window may be moved up and down in a strip: feet a hand's breadth off the plane.
const PLAY: usize = 8;
/// Range of a strip over that of the one before: a window of a person in between is off by 6 % in size at most, half of what
/// people differ by.
const STEP: f64 = 1.12;
/// A camera lower than this above the ground sees no range, m.
const LOWEST_M: f64 = 0.2;

/// A grey image: rows from the top, 0 where nothing was seen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Pixels per row.
    pub width: usize,
    /// Values, row by row.
    pub values: Vec<u8>,
}

/// Where a person is that may be in an image: upright, `range_m` from the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stance {
    /// Direction from the camera, anticlockwise from the vehicle's x axis (rad).
    pub azimuth: f64,
    /// Distance from the camera along the ground (m).
    pub range_m: f64,
    /// Height of the feet above the vehicle's plane (m).
    pub foot_m: f64,
    /// Height of the person (m).
    pub height_m: f64,
}

/// One camera on its vehicle, and where in its image upright people of one size are.
#[derive(Debug, Clone)]
pub struct Upright {
    camera: Camera,
    camera_from_plane: Pose,
    eye: Vector3<f64>,
    strips: Vec<Strip>,
}

/// The part of a cylinder about the camera that it sees.
#[derive(Debug, Clone)]
struct Strip {
    range_m: f64,
    px_per_m: f64,
    /// Of the first column's left edge; columns turn clockwise.
    azimuth: f64,
    columns: usize,
    /// What of the image is shown, row by row.
    shown: Vec<Four>,
}

impl Upright {
    /// `vehicle_from_camera` is the optical frame's pose on the vehicle. `None` where the camera is not above the ground.
    pub fn new(camera: Camera, vehicle_from_camera: &Pose, params: &PeopleParams) -> Option<Self> {
        let mut upright = Self::unrolled(camera, vehicle_from_camera, params)?;
        let steps = (params.farthest_m / params.nearest_m).ln() / STEP.ln();
        let ranges: Vec<f64> = (0..=steps.max(0.0).ceil() as i32)
            .map(|step| params.nearest_m * STEP.powi(step))
            .collect();
        let strip = |range_m: f64| upright.strip(range_m, PERSON_PX / params.height_m);
        let strips = ranges.into_par_iter().filter_map(strip).collect();
        upright.strips = strips;
        Some(upright)
    }

    /// As [`Upright::new`], without what images are looked at with.
    pub(super) fn unrolled(
        camera: Camera,
        vehicle_from_camera: &Pose,
        params: &PeopleParams,
    ) -> Option<Self> {
        let mut plane_from_camera = *vehicle_from_camera;
        plane_from_camera.translation.z -= params.plane_m;
        let upright = Self {
            eye: plane_from_camera.translation,
            camera_from_plane: plane_from_camera.inverse(),
            camera,
            strips: Vec::new(),
        };
        (upright.eye.z > LOWEST_M).then_some(upright)
    }

    /// Height of the camera above the ground, m.
    pub fn eye_m(&self) -> f64 {
        self.eye.z
    }

    /// Pixels per radian in the middle of the image.
    pub fn px_per_rad(&self) -> f64 {
        self.camera.px_per_rad()
    }

    /// A point on the ground in the vehicle frame, m, in a direction from the camera.
    pub fn on_ground(&self, azimuth: f64, range_m: f64) -> [f64; 2] {
        let (sin, cos) = azimuth.sin_cos();
        [self.eye.x + range_m * cos, self.eye.y + range_m * sin]
    }

    /// In which direction from the camera a point on the ground in the vehicle frame (m) lies (rad), and how far away (m).
    pub fn sight(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (dx, dy) = (x - self.eye.x, y - self.eye.y);
        [dy.atan2(dx), dx.hypot(dy)]
    }

    /// The pixel of a point at a height above one on the ground.
    fn pixel(&self, [x, y]: [f64; 2], height_m: f64) -> Option<[f64; 2]> {
        let point = Vector3::new(x, y, height_m);
        let pixel = self
            .camera
            .project(&self.camera_from_plane.transform(&point))?;
        self.camera.contains(pixel).then_some(pixel)
    }

    /// What the image shows of a point at a height above one on the ground.
    fn four(&self, foot: [f64; 2], height_m: f64) -> Four {
        let pixel = self.pixel(foot, height_m);
        let size = [self.camera.width, self.camera.height];
        pixel.map_or(Four::NONE, |pixel| Four::about(pixel, size))
    }

    fn strip(&self, range_m: f64, px_per_m: f64) -> Option<Strip> {
        let axis = self.camera_from_plane.inverse().rotate(&Vector3::z());
        let behind = axis.y.atan2(axis.x) + PI;
        let per_column = 1.0 / (range_m * px_per_m);
        let around = (TAU / per_column) as usize;
        let azimuth = |column: usize| behind - (column as f64 + 0.5) * per_column;
        let middle_m = 0.5 * PERSON_PX / px_per_m;
        let foot = |column: usize| self.on_ground(azimuth(column), range_m);
        let seen = |column: &usize| self.pixel(foot(*column), middle_m).is_some();
        let first = (0..around).find(seen)?;
        let last = (0..around).rev().find(seen)?;
        let columns = last - first + 1;
        let feet: Vec<[f64; 2]> = (first..=last).map(foot).collect();
        let rows = WINDOW[1] + 2 * PLAY;
        let height = |row: usize| {
            let below = (rows - PLAY) as f64 - MARGIN - (row as f64 + 0.5);
            below / px_per_m
        };
        let shown = |at: usize| {
            let (row, column) = (at / columns, at % columns);
            self.four(feet[column], height(row))
        };
        (columns >= WINDOW[0]).then(|| Strip {
            range_m,
            px_per_m,
            azimuth: behind - first as f64 * per_column,
            columns,
            shown: (0..columns * rows).map(shown).collect(),
        })
    }

    /// What an image shows on each cylinder, with what turns windows of it into where a person is.
    pub fn strips<'a>(
        &'a self,
        image: &'a GrayView<'a>,
    ) -> impl Iterator<Item = (Picture, impl Fn([usize; 2]) -> Stance)> {
        self.strips.iter().map(|strip| {
            let values = strip.shown.iter().map(|four| four.value(image));
            let picture = Picture {
                width: strip.columns,
                values: values.collect(),
            };
            (picture, |window| strip.stance(window))
        })
    }

    /// The window of a person that an image shows.
    pub fn window(&self, image: &GrayView<'_>, of: &Stance) -> Picture {
        let per_px = of.height_m / PERSON_PX;
        let [width, height] = WINDOW;
        let foot = |column: usize| {
            let aside = column as f64 + 0.5 - 0.5 * width as f64;
            self.on_ground(of.azimuth - aside * per_px / of.range_m, of.range_m)
        };
        let feet: Vec<[f64; 2]> = (0..width).map(foot).collect();
        let value = |at: usize| {
            let row = (at / width) as f64 + 0.5;
            let above = of.foot_m + (height as f64 - MARGIN - row) * per_px;
            self.four(feet[at % width], above).value(image)
        };
        Picture {
            width,
            values: (0..width * height).map(value).collect(),
        }
    }

    /// The rectangle of the image around a person of this width: least column and row, largest column and row; `None` where
    /// the image shows neither feet nor head.
    pub fn rectangle(&self, of: &Stance, width_m: f64) -> Option<[f64; 4]> {
        let aside = 0.5 * width_m / of.range_m;
        let heights = [of.foot_m, of.foot_m + of.height_m];
        let feet = [-aside, aside].map(|by| self.on_ground(of.azimuth + by, of.range_m));
        let corners = heights
            .into_iter()
            .flat_map(|height| feet.map(|foot| self.pixel(foot, height)));
        corners.flatten().fold(None, |around, [u, v]| {
            let [left, top, right, bottom] = around.unwrap_or([u, v, u, v]);
            Some([left.min(u), top.min(v), right.max(u), bottom.max(v)])
        })
    }
}

impl Strip {
    /// Who a window would show that is as high as the strip's people.
    fn stance(&self, [column, row]: [usize; 2]) -> Stance {
        let middle = column as f64 + 0.5 * WINDOW[0] as f64;
        Stance {
            azimuth: self.azimuth - middle / (self.range_m * self.px_per_m),
            range_m: self.range_m,
            foot_m: (PLAY as f64 - row as f64) / self.px_per_m,
            height_m: PERSON_PX / self.px_per_m,
        }
    }
}

/// Four pixels about a point of an image.
#[derive(Debug, Clone, Copy)]
struct Four {
    /// The upper left one's number, row by row.
    first: u32,
    /// How far the point lies from it, as a share of the way to the next one: across and down.
    shares: [f32; 2],
}

impl Four {
    /// Nothing is seen.
    const NONE: Self = Self {
        first: u32::MAX,
        shares: [0.0; 2],
    };

    /// About a point on a pixel of an image of this width and height.
    fn about([u, v]: [f64; 2], [width, height]: [u32; 2]) -> Self {
        let split = |at: f64, size: u32| {
            let at = (at as f32).clamp(0.0, size.saturating_sub(1) as f32);
            let low = (at as u32).min(size.saturating_sub(2));
            (low, at - low as f32)
        };
        let (left, across) = split(u, width);
        let (upper, down) = split(v, height);
        Self {
            first: upper * width + left,
            shares: [across, down],
        }
    }

    /// The value between them; 0 where nothing is seen.
    #[inline]
    fn value(&self, image: &GrayView<'_>) -> u8 {
        let (first, below) = (self.first as usize, image.width() as usize);
        let pixels = image.pixels();
        let at = |number: usize| f32::from(pixels.get(number).copied().unwrap_or(0));
        let [across, down] = self.shares;
        let between = |from: usize| at(from) + across * (at(from + 1) - at(from));
        let (above, below) = (between(first), between(first + below));
        (above + down * (below - above) + 0.5) as u8
    }
}
