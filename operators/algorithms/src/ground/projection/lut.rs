//! The table: what the lens does to the ground beside the vehicle, evaluated once.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::geometry::camera::{Camera, Model};
use crate::geometry::pose::Pose;

/// A table larger than this (nodes) is a mistake in the parameters.
const MAX_NODES: f64 = 64e6;

/// How images are laid on the ground.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct GroundParams {
    /// Side of a cell of the map, and the distance between the table's nodes (m). A painted line is 0.1 m wide: two
    /// cells of the default.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub cell_m: f64,
    /// Ground farther than this from the camera's foot is not used (m). A 1280 px fisheye has 407 px per radian; 1 m
    /// above the ground and 8 m away a pixel is 0.16 m deep, more than a painted line.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub reach_m: f64,
    /// Height of the ground in the vehicle frame (m): 0 where the frame stands on it, minus the wheel's radius where it is
    /// the axle's.
    pub plane_m: f64,
    /// Looks flatter than this cosine of the angle ψ to the ground's normal are not used; 0 uses all within reach. The
    /// default is 85.4°, where one degree of pitch moves the ground by 15 %.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_cos: f64,
    /// p in weight = 255 (cos ψ)^p. Between foreshortening (1) and pixels per area (3), which leaves too little of what
    /// is only seen from afar.
    #[schemars(range(min = 0.0, max = 64.0))]
    pub weight_power: f64,
    /// Rays farther than this from a camera's axis are not used (rad): the nominal 180° of a fisheye, whose image circle
    /// ends soon after. Panoramas ignore it, as their axis is just the direction that they call forward.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_angle_rad: f64,
}

impl Default for GroundParams {
    fn default() -> Self {
        Self {
            cell_m: 0.05,
            reach_m: 8.0,
            plane_m: 0.0,
            min_cos: 0.08,
            weight_power: 2.0,
            max_angle_rad: FRAC_PI_2,
        }
    }
}

impl GroundParams {
    /// Whether a table of these lengths can be made.
    ///
    /// # Errors
    /// [`GroundParamsError::Nodes`].
    pub fn check(&self) -> Result<(), GroundParamsError> {
        let Self {
            reach_m, cell_m, ..
        } = *self;
        let side = 2.0 * reach_m / cell_m + 2.0;
        if cell_m > 0.0 && reach_m > cell_m && side * side <= MAX_NODES {
            return Ok(());
        }
        Err(GroundParamsError::Nodes { reach_m, cell_m })
    }
}

/// Parameters that give no table.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum GroundParamsError {
    /// The table has too many nodes, or none.
    #[error(
        "expected `reach_m` above `cell_m`, and less than 4000 times as much, found {reach_m} m with cells of {cell_m} m"
    )]
    Nodes {
        /// The reach given, metres.
        reach_m: f64,
        /// The side of a cell given, metres.
        cell_m: f64,
    },
    /// The camera is in or below the ground.
    #[error(
        "expected a camera above the ground (`plane_m` in the vehicle frame), found it {z_m} m above"
    )]
    BelowGround {
        /// Height above the ground found, metres.
        z_m: f64,
    },
    /// The image is too small to interpolate in, or too large for fixed point.
    #[error("expected an image of 2 to 32768 pixels a side, found {width} x {height}")]
    Size {
        /// Width found.
        width: u32,
        /// Height found.
        height: u32,
    },
    /// The mask does not fit the image.
    #[error("expected a mask of {expected} pixels like the image, found {found}")]
    Mask {
        /// Pixels of the image.
        expected: usize,
        /// Pixels of the mask.
        found: usize,
    },
}

/// Which pixels must not be used, usually the vehicle's own body: one byte per pixel, row by row,
/// anything but 0 is masked.
pub type PixelMask<'a> = &'a [u8];

/// `[u, v, weight, 0]`; NaN where the ground is not seen, which any interpolation that touches it
/// inherits.
pub(super) type Node = [f32; 4];

const UNSEEN: Node = [f32::NAN; 4];

/// For one camera on one vehicle: the pixel and the weight of every spot of the ground.
#[derive(Debug, Clone)]
pub struct GroundLut {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) node_m: f64,
    /// Height of the plane in the vehicle frame, metres.
    pub(super) plane_m: f64,
    /// Foot of the camera on the plane, in the vehicle frame, metres.
    pub(super) eye: [f64; 2],
    /// Height of the camera above the plane, metres.
    pub(super) height_m: f64,
    /// Node (column 0, row 0) is at `first * node_m` in the vehicle frame.
    pub(super) first: [i64; 2],
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) nodes: Vec<Node>,
}

impl GroundLut {
    /// Builds the table. `vehicle_from_camera` is the optical frame's pose on the vehicle.
    ///
    /// # Errors
    /// [`GroundParamsError`] says what does not fit.
    pub fn new(
        camera: &Camera,
        vehicle_from_camera: &Pose,
        params: &GroundParams,
        mask: Option<PixelMask<'_>>,
    ) -> Result<Self, GroundParamsError> {
        params.check()?;
        let plane_from_camera = above(-params.plane_m).compose(vehicle_from_camera);
        check(camera, &plane_from_camera, mask)?;
        let view = GroundCamera {
            camera: &within(camera, params.max_angle_rad),
            camera_from_vehicle: plane_from_camera.inverse(),
            eye: plane_from_camera.translation,
            params,
            mask,
        };
        let low = |x: f64| ((x - params.reach_m) / params.cell_m).floor() as i64;
        let first = [low(view.eye.x), low(view.eye.y)];
        let side = (2.0 * params.reach_m / params.cell_m).ceil() as usize + 2;
        let nodes: Vec<Node> = (0..side * side)
            .into_par_iter()
            .map(|at| {
                let (column, row) = (at % side, at / side);
                let x = (first[0] + column as i64) as f64 * params.cell_m;
                let y = (first[1] + row as i64) as f64 * params.cell_m;
                view.look(x, y).unwrap_or(UNSEEN)
            })
            .collect();
        let whole = Self {
            width: camera.width,
            height: camera.height,
            node_m: params.cell_m,
            plane_m: params.plane_m,
            eye: [view.eye.x, view.eye.y],
            height_m: view.eye.z,
            first,
            columns: side,
            rows: side,
            nodes,
        };
        Ok(whole.cropped())
    }

    /// Without the empty borders: a front camera's table does not cover the ground behind.
    fn cropped(self) -> Self {
        let seen = |column: usize, row: usize| !self.nodes[row * self.columns + column][0].is_nan();
        let any_in_row = |row: &usize| (0..self.columns).any(|column| seen(column, *row));
        let any_in_column = |column: &usize| (0..self.rows).any(|row| seen(*column, row));
        let span = |found: (Option<usize>, Option<usize>)| match found {
            (Some(low), Some(high)) => low..high + 1,
            _ => 0..0,
        };
        let rows = span((
            (0..self.rows).find(any_in_row),
            (0..self.rows).rev().find(any_in_row),
        ));
        let columns = span((
            (0..self.columns).find(any_in_column),
            (0..self.columns).rev().find(any_in_column),
        ));
        let nodes = rows
            .clone()
            .flat_map(|row| &self.nodes[row * self.columns..][columns.clone()])
            .copied()
            .collect();
        Self {
            first: [
                self.first[0] + columns.start as i64,
                self.first[1] + rows.start as i64,
            ],
            columns: columns.len(),
            rows: rows.len(),
            nodes,
            ..self
        }
    }

    /// Pixel `[u, v]` and weight of the spot `(x, y)` of the vehicle's ground plane (metres), as
    /// the table has it. `None` where it is not seen.
    pub fn look(&self, x: f64, y: f64) -> Option<([f64; 2], f64)> {
        let gx = x / self.node_m - self.first[0] as f64;
        let gy = y / self.node_m - self.first[1] as f64;
        if !(gx >= 0.0 && gy >= 0.0) {
            return None;
        }
        let (column, row) = (gx as usize, gy as usize);
        if column + 1 >= self.columns || row + 1 >= self.rows {
            return None;
        }
        let (fx, fy) = (gx.fract() as f32, gy.fract() as f32);
        let [u, v, weight, _] = self.between(row * self.columns + column, fx, fy)?;
        (weight >= 0.5).then_some(([f64::from(u), f64::from(v)], f64::from(weight)))
    }

    /// Bilinear between the node `at` and its three neighbours. Plain f32 arithmetic in a fixed
    /// order: the same bits on every machine.
    #[inline(always)]
    pub(super) fn between(&self, at: usize, fx: f32, fy: f32) -> Option<Node> {
        let [sw, se] = self.nodes.get(at..at + 2)? else {
            return None;
        };
        let [nw, ne] = self.nodes.get(at + self.columns..at + self.columns + 2)? else {
            return None;
        };
        let mut out = [0.0; 4];
        for k in 0..4 {
            let south = sw[k] + (se[k] - sw[k]) * fx;
            let north = nw[k] + (ne[k] - nw[k]) * fx;
            out[k] = south + (north - south) * fy;
        }
        Some(out)
    }
}

/// A frame without a turn, so much higher.
pub(super) fn above(height_m: f64) -> Pose {
    Pose::new(
        Vector3::z() * height_m,
        nalgebra::UnitQuaternion::identity(),
    )
}

/// The camera without what it shows too far from its axis.
fn within(camera: &Camera, max_angle_rad: f64) -> Camera {
    match camera.model {
        Model::Equirectangular(_) => camera.clone(),
        _ => camera.clone().with_max_angle(max_angle_rad),
    }
}

fn check(
    camera: &Camera,
    vehicle_from_camera: &Pose,
    mask: Option<PixelMask<'_>>,
) -> Result<(), GroundParamsError> {
    let eye = vehicle_from_camera.translation;
    let far_off = !(eye.x.abs() < 1e6 && eye.y.abs() < 1e6 && eye.z < 1e6);
    if far_off || eye.z <= 0.0 {
        return Err(GroundParamsError::BelowGround { z_m: eye.z });
    }
    let Camera { width, height, .. } = *camera;
    if width < 2 || height < 2 || width > 1 << 15 || height > 1 << 15 {
        return Err(GroundParamsError::Size { width, height });
    }
    let expected = width as usize * height as usize;
    match mask {
        Some(mask) if mask.len() != expected => Err(GroundParamsError::Mask {
            expected,
            found: mask.len(),
        }),
        _ => Ok(()),
    }
}

/// One camera over the vehicle's ground plane.
struct GroundCamera<'a> {
    camera: &'a Camera,
    camera_from_vehicle: Pose,
    eye: Vector3<f64>,
    params: &'a GroundParams,
    mask: Option<PixelMask<'a>>,
}

impl GroundCamera<'_> {
    /// The node at `(x, y, 0)` of the vehicle frame.
    fn look(&self, x: f64, y: f64) -> Option<Node> {
        let away = (x - self.eye.x).hypot(y - self.eye.y);
        let cos = self.eye.z / away.hypot(self.eye.z);
        if away > self.params.reach_m || cos < self.params.min_cos {
            return None;
        }
        let [u, v] = self
            .camera
            .project(&self.camera_from_vehicle.transform(&Vector3::new(x, y, 0.0)))?;
        let (right, bottom) = (
            f64::from(self.camera.width - 1),
            f64::from(self.camera.height - 1),
        );
        if !(u >= 0.0 && v >= 0.0 && u <= right && v <= bottom) || self.masked(u, v) {
            return None;
        }
        let weight = (255.0 * cos.powf(self.params.weight_power)).max(1.0);
        Some([u as f32, v as f32, weight as f32, 0.0])
    }

    fn masked(&self, u: f64, v: f64) -> bool {
        let at = v.round() as usize * self.camera.width as usize + u.round() as usize;
        self.mask
            .and_then(|mask| mask.get(at))
            .is_some_and(|byte| *byte != 0)
    }
}
