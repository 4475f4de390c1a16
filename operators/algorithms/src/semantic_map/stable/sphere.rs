//! Panoramas with range: what a view looks like in every direction, and how far away it is.

use std::f64::consts::PI;

use nalgebra::Vector3;

use crate::geometry::camera::{Camera, Equirectangular, Model};

/// The lens of a panorama: columns are longitude, rows are latitude, as [`crate::geometry::camera::Equirectangular`] has
/// it, with an image's size.
#[derive(Debug, Clone, PartialEq)]
pub struct Lens {
    /// Width (px).
    pub width: usize,
    /// Height (px).
    pub height: usize,
    /// Pixels per radian along a row and along a column.
    pub focal: [f64; 2],
    /// The pixel that looks straight ahead.
    pub centre: [f64; 2],
    /// Whether the last column is next to the first.
    pub wraps: bool,
    /// Sine and cosine of each column's longitude.
    longitudes: Vec<[f64; 2]>,
    /// Sine and cosine of each row's latitude.
    latitudes: Vec<[f64; 2]>,
}

impl Lens {
    /// From what a calibration says: `[fx, fy]` in pixels per radian and `[cx, cy]` in pixels. `None` for an image without
    /// pixels, numbers that are not finite, or focal lengths that are not above zero.
    pub fn new([width, height]: [usize; 2], focal: [f64; 2], centre: [f64; 2]) -> Option<Self> {
        let numbers = focal.into_iter().chain(centre);
        let sound = numbers.into_iter().all(f64::is_finite) && focal.iter().all(|f| *f > 0.0);
        if !sound || width == 0 || height == 0 {
            return None;
        }
        let angles = |count: usize, centre: f64, focal: f64| {
            let angle = move |index: usize| (index as f64 - centre) / focal;
            (0..count)
                .map(angle)
                .map(|angle| [angle.sin(), angle.cos()])
                .collect()
        };
        Some(Self {
            width,
            height,
            focal,
            centre,
            wraps: Equirectangular::new(focal, centre).wraps(width),
            longitudes: angles(width, centre[0], focal[0]),
            latitudes: angles(height, centre[1], focal[1]),
        })
    }

    /// The lens of a camera; `None` where it is no panorama.
    pub fn of_camera(camera: &Camera) -> Option<Self> {
        let Model::Equirectangular(lens) = &camera.model else {
            return None;
        };
        let size = [camera.width as usize, camera.height as usize];
        Self::new(size, lens.focal(), lens.centre())
    }

    /// The lens of the image at half the size.
    pub(super) fn halved(&self) -> Option<Self> {
        let half = |x: f64| (x + 0.5) / 2.0 - 0.5;
        let size = [self.width / 2, self.height / 2];
        Self::new(size, self.focal.map(|f| f / 2.0), self.centre.map(half))
    }

    /// The unit vector that a pixel looks along, in the optical frame.
    pub fn ray(&self, column: usize, row: usize) -> Vector3<f64> {
        let ([sin, cos], [up, level]) = (self.longitudes[column], self.latitudes[row]);
        Vector3::new(level * sin, up, level * cos)
    }

    /// The unit vector along a column at latitude zero.
    pub(super) fn ahead(&self, column: usize) -> Vector3<f64> {
        let [sin, cos] = self.longitudes[column];
        Vector3::new(sin, 0.0, cos)
    }

    /// Sine and cosine of a row's latitude.
    pub(super) fn latitude(&self, row: usize) -> [f64; 2] {
        self.latitudes[row]
    }

    /// Where a point or direction of the optical frame appears (px).
    pub fn pixel(&self, point: &Vector3<f64>) -> [f64; 2] {
        Equirectangular::new(self.focal, self.centre).pixel(point)
    }

    /// The pixel at whole numbers: its index, row by row; `None` out of the image.
    pub fn index(&self, column: i64, row: i64) -> Option<usize> {
        let width = self.width as i64;
        let column = if self.wraps {
            column.rem_euclid(width)
        } else {
            column
        };
        let inside = (0..width).contains(&column) && (0..self.height as i64).contains(&row);
        inside.then(|| row as usize * self.width + column as usize)
    }

    /// The angle between neighbouring pixels (rad).
    pub fn pixel_rad(&self) -> f64 {
        (1.0 / self.focal[0]).min(PI)
    }
}

/// A panorama with range, both of the lens's size, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Sphere<'a> {
    /// Where its pixels look.
    pub lens: &'a Lens,
    /// Brightness.
    pub grey: &'a [u8],
    /// Distance along the ray, in units of `unit_m`; 0 where nothing was measured.
    pub range: &'a [u16],
    /// Metres per unit.
    pub unit_m: f64,
}

impl Sphere<'_> {
    /// Whether images have the lens's size and range a unit.
    pub fn is_sound(&self) -> bool {
        let pixels = self.lens.width * self.lens.height;
        let sized = self.grey.len() == pixels && self.range.len() == pixels;
        sized && self.unit_m > 0.0 && self.unit_m.is_finite()
    }
}
