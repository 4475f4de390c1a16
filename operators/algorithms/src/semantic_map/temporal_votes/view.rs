//! Views: what was seen, how far away, and from where.

use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use crate::semantic_map::class_scores::ScoresView;

/// What a pixel of a depth image says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Depth {
    /// Something is so far away (m).
    At(f64),
    /// Whatever is there is farther away than is measured, or nothing is there.
    Beyond,
    /// Nothing was measured, near or far: a hole.
    Unknown,
}

/// A depth image.
#[derive(Debug, Clone, Copy)]
pub struct DepthView<'a> {
    width: usize,
    height: usize,
    data: &'a [u16],
    scale_m: f64,
}

impl<'a> DepthView<'a> {
    /// Values in units of `scale_m` metres, row by row; 0 where nothing was measured, the largest value of 16 bits where all
    /// there is is beyond range. `None` for another number of values than the size asks for, none, or a scale that is not
    /// above zero.
    pub fn new([width, height]: [u32; 2], data: &'a [u16], scale_m: f64) -> Option<Self> {
        let (width, height) = (width as usize, height as usize);
        let fits = width.checked_mul(height) == Some(data.len()) && !data.is_empty();
        (fits && scale_m > 0.0 && scale_m.is_finite()).then_some(Self {
            width,
            height,
            data,
            scale_m,
        })
    }

    /// Whether it has the size of a camera's images.
    pub(super) fn fits(&self, camera: &Camera) -> bool {
        [self.width, self.height] == [camera.width as usize, camera.height as usize]
    }

    /// Whether there are pixels where nothing was measured.
    pub(super) fn has_holes(&self) -> bool {
        self.data.contains(&0)
    }

    /// What the nearest pixel says; nothing out of the image.
    pub(super) fn nearest(&self, [u, v]: [f64; 2]) -> Depth {
        let index = |x: f64, size: usize| {
            let inside = x >= -0.5 && x < size as f64 - 0.5;
            inside.then_some((x + 0.5) as usize)
        };
        let (Some(column), Some(row)) = (index(u, self.width), index(v, self.height)) else {
            return Depth::Unknown;
        };
        match self.data[row * self.width + column] {
            0 => Depth::Unknown,
            u16::MAX => Depth::Beyond,
            units => Depth::At(f64::from(units) * self.scale_m),
        }
    }
}

/// A view with its predictions.
#[derive(Debug, Clone, Copy)]
pub struct ScoredView<'a> {
    /// The probabilities of the classes.
    pub scores: ScoresView<'a>,
    /// How far away things are, if that is known.
    pub depth: Option<DepthView<'a>>,
    /// The optical frame in the odometry frame, which may drift slowly.
    pub odom_from_camera: Pose,
}
