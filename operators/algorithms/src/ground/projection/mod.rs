//! From a camera image to cells of the ground: the mathematics of overhead mosaics.
//!
//! Paper 1 (V-A1) rectifies the fisheye image and projects it to the ground plane by the pose.
//! Done naively that is a lens model, a square root and an arc tangent per cell per image. But
//! seen from the vehicle the lens never moves: where a spot of the ground beside the car appears
//! in the image is the same in every frame. So the lens is evaluated once per camera, on a grid
//! fixed to the *vehicle* ([`GroundLut`]), and each image only needs
//!
//! ```text
//! map cell ──affine, one addition per cell──▶ place in the vehicle's grid
//!          ──bilinear between 4 grid nodes──▶ pixel and weight, at every fourth cell or so
//!          ──bilinear, fixed point─────────▶ grey value, or red, green and blue
//! ```
//!
//! The table is bilinear, not nearest: with 5 cm nodes and a 400 px, 180° lens 1 m above ground
//! the interpolated pixel is within 0.03 px of the lens model, the nearest node would be 3 px off. Between
//! looks into the table the pixel moves in equal steps, over spans so short that no cell is put
//! off by more than a tenth of itself. (A mask finer than a span may therefore be stepped over.)
//!
//! **Which plane.** The ground is taken to be a plane of the vehicle's own, the one its wheels
//! stand on ([`GroundParams::plane_m`]), at whatever attitude the pose gives it. A map cell is a vertical line; where it meets
//! that plane is an affine function of the cell for *every* six-degree pose, so slopes and ramps
//! cost nothing and nothing is approximated. Where poses tell how the ground bends ([`crate::ground::floor`]), a cell is
//! looked up where the line of sight to it meets that plane: with the camera at height H, a spot h above the plane is seen
//! at H / (H − h) times its distance from the camera's foot.
//!
//! **Weight.** A look straight down shows more than a glance along the floor. With ψ the angle
//! between the ray and the ground's normal, cos ψ = height / distance, a cell weighs
//! 255 (cos ψ)^p. p = 1 is Lambert's foreshortening, the usual weight of view blending (Debevec,
//! Taylor & Malik 1996, section 6.2); p = 3 is proportional to the pixels that a square metre of
//! ground fills in an equidistant image (solid angle per area is h / d³), the weight that
//! minimises the variance of a mean. The default p = 2 lies between: p = 3 leaves nothing of what
//! is only ever seen from a distance when 8 bits have to hold it. Weights are integers, so that
//! sums are exact.
//!
//! Medians and modes of all looks were tried in place of the mean, against parked cars that smear
//! (BENCHMARKS.md): they keep less of the floor, and no more of what cars hide.

mod lut;
mod patch;
mod splat;
#[cfg(test)]
mod tests;

pub use lut::{GroundLut, GroundParams, GroundParamsError, PixelMask};
pub use splat::GroundRow;

use super::channels::Channels;

/// An image that somebody else owns, grey or in colour.
#[derive(Debug, Clone, Copy)]
pub struct ImageView<'a> {
    width: u32,
    height: u32,
    channels: Channels,
    pixels: &'a [u8],
}

impl<'a> ImageView<'a> {
    /// Red, green and blue of each pixel, row by row, without gaps. `None` when there are not `3 * width * height` values.
    pub fn of_colours(width: u32, height: u32, pixels: &'a [u8]) -> Option<Self> {
        let channels = Channels::Colour;
        let expected = (width as usize).checked_mul(height as usize)?;
        let expected = expected.checked_mul(channels.count())?;
        (pixels.len() == expected).then_some(Self {
            width,
            height,
            channels,
            pixels,
        })
    }
}

impl<'a> From<&GrayView<'a>> for ImageView<'a> {
    fn from(image: &GrayView<'a>) -> Self {
        Self {
            width: image.width,
            height: image.height,
            channels: Channels::Grey,
            pixels: image.pixels,
        }
    }
}

/// A grey image that somebody else owns.
#[derive(Debug, Clone, Copy)]
pub struct GrayView<'a> {
    width: u32,
    height: u32,
    pixels: &'a [u8],
}

impl<'a> GrayView<'a> {
    /// `pixels` row by row, without gaps. `None` when there are not `width * height` of them.
    pub fn new(width: u32, height: u32, pixels: &'a [u8]) -> Option<Self> {
        let expected = (width as usize).checked_mul(height as usize)?;
        (pixels.len() == expected).then_some(Self {
            width,
            height,
            pixels,
        })
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The pixels, row by row.
    pub fn pixels(&self) -> &'a [u8] {
        self.pixels
    }
}
