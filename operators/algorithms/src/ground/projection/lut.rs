//! The table: what the lens does to the ground beside the vehicle, evaluated once.

use crate::geometry::camera::Camera;
use crate::geometry::pose::Pose;
use nalgebra::Vector3;
use rayon::prelude::*;

/// A table larger than this (nodes) is a mistake in the parameters.
const MAX_NODES: f64 = 64e6;

/// How ground is looked at; lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundParams {
    /// Ground farther than this from the camera's foot is not used.
    pub reach_m: f64,
    /// Distance between the table's nodes; the map's cell size is a good choice.
    pub node_m: f64,
    /// Looks flatter than this cosine of the angle to the ground's normal are not used; 0 uses
    /// all within reach.
    pub min_cos: f64,
    /// p in weight = 255 (cos ψ)^p.
    pub weight_power: f64,
}

impl Default for GroundParams {
    fn default() -> Self {
        Self {
            reach_m: 8.0,
            node_m: 0.05,
            min_cos: 0.08,
            weight_power: 2.0,
        }
    }
}

/// Parameters that give no table.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum GroundParamsError {
    /// A length or exponent is out of range.
    #[error(
        "expected reach_m > node_m > 0, 0 <= min_cos < 1 and weight_power >= 0 with at most 64 \
         million nodes, found {found:?}"
    )]
    Range {
        /// The parameters given.
        found: GroundParams,
    },
    /// The camera is in or below the ground.
    #[error("expected a camera above the vehicle's ground plane z = 0, found it at z = {z_m} m")]
    BelowGround {
        /// Height found, metres.
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
        check(camera, vehicle_from_camera, params, mask)?;
        let view = GroundCamera {
            camera,
            camera_from_vehicle: vehicle_from_camera.inverse(),
            eye: vehicle_from_camera.translation,
            params,
            mask,
        };
        let low = |x: f64| ((x - params.reach_m) / params.node_m).floor() as i64;
        let first = [low(view.eye.x), low(view.eye.y)];
        let side = (2.0 * params.reach_m / params.node_m).ceil() as usize + 2;
        let nodes: Vec<Node> = (0..side * side)
            .into_par_iter()
            .map(|at| {
                let (column, row) = (at % side, at / side);
                let x = (first[0] + column as i64) as f64 * params.node_m;
                let y = (first[1] + row as i64) as f64 * params.node_m;
                view.look(x, y).unwrap_or(UNSEEN)
            })
            .collect();
        let whole = Self {
            width: camera.width,
            height: camera.height,
            node_m: params.node_m,
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

fn check(
    camera: &Camera,
    vehicle_from_camera: &Pose,
    params: &GroundParams,
    mask: Option<PixelMask<'_>>,
) -> Result<(), GroundParamsError> {
    let GroundParams {
        reach_m,
        node_m,
        min_cos,
        weight_power,
    } = *params;
    let side = 2.0 * reach_m / node_m + 2.0;
    let sound = node_m > 0.0
        && reach_m > node_m
        && side * side <= MAX_NODES
        && (0.0..1.0).contains(&min_cos)
        && (0.0..=64.0).contains(&weight_power);
    if !sound {
        return Err(GroundParamsError::Range { found: *params });
    }
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
