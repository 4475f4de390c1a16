#![doc = include_str!("ground_patches.md")]

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::sync::{Arc, Mutex, PoisonError};

use arrow::array::{Array, RecordBatch};
use evermap_algorithms::geometry::camera::{BrownConrady, Camera, Model, Pinhole};
use evermap_algorithms::ground::projection::{GrayView, GroundLut, GroundParams, GroundParamsError};
use evermap_algorithms::geometry::pose::Pose;
use evermap_contract::{Emit, Fault, Grain, Kernel, MapKernel, Mapper, Operator, Port, Sides};
use evermap_schemas::layers::{GroundPatch, PosedImage};
use evermap_schemas::roles::{Calibration, Transform};
use evermap_schemas::{Bytes, Stamp, record, rows};
use evermap_vision::{Decoder, Grey};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::inputs::images::images;
use crate::inputs::rig::{self, Reason, Rig, SessionName, camera, frame};

/// See the module's page.
pub struct GroundPatches;

/// How images are laid on the ground.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GroundPatchesParams {
    /// Side of a cell of the map (m).
    pub cell_m: f64,
    /// Ground farther than this from the camera's foot is not used (m).
    pub reach_m: f64,
    /// Looks flatter than this cosine of the angle to the ground's normal are not used.
    pub min_cos: f64,
    /// p in weight = 255 (cosine of the angle to the ground's normal)^p.
    pub weight_power: f64,
    /// A fisheye's rays farther than this from its axis are not used (rad).
    pub max_angle_rad: f64,
    /// The frame that poses are of.
    pub vehicle_frame: String,
}

impl Default for GroundPatchesParams {
    fn default() -> Self {
        let GroundParams {
            reach_m,
            node_m,
            min_cos,
            weight_power,
        } = GroundParams::default();
        Self {
            cell_m: node_m,
            reach_m,
            min_cos,
            weight_power,
            max_angle_rad: FRAC_PI_2,
            vehicle_frame: "base_link".to_owned(),
        }
    }
}

impl GroundPatchesParams {
    fn ground(&self) -> GroundParams {
        GroundParams {
            reach_m: self.reach_m,
            node_m: self.cell_m,
            min_cos: self.min_cos,
            weight_power: self.weight_power,
        }
    }
}

impl Operator for GroundPatches {
    const NAME: &'static str = "ground_patches";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("ground_patches.md");
    type Params = GroundPatchesParams;
    type Output = GroundPatch;

    fn ports() -> Vec<Port> {
        vec![
            Port::of::<PosedImage>("images", Grain::Row).with_pixels("image"),
            Port::of::<Calibration>("calibration", Grain::SESSION),
            Port::of::<Transform>("transforms", Grain::SESSION),
        ]
    }

    fn kernel(params: GroundPatchesParams) -> Result<Kernel, Fault> {
        if params.max_angle_rad.is_nan() || params.max_angle_rad <= 0.0 {
            return Err(Fault::user(format!(
                "expected max_angle_rad > 0, found {}",
                params.max_angle_rad
            )));
        }
        refuse_senseless(&params.ground())?;
        Ok(Kernel::Map(Box::new(Opener { params })))
    }
}

/// A table over a picture of one pixel fails at its parameters, or else at the picture, before it costs anything.
fn refuse_senseless(params: &GroundParams) -> Result<(), Fault> {
    let lens = Pinhole::new([1.0; 2], [0.0; 2], BrownConrady::default());
    let camera = Camera::new(Model::Pinhole(lens), 1, 1);
    let above = Pose::new([0.0, 0.0, 1.0].into(), Pose::identity().rotation);
    match GroundLut::new(&camera, &above, params, None) {
        Err(error @ GroundParamsError::Range { .. }) => Err(Fault::user(error.to_string())),
        _ => Ok(()),
    }
}

struct Opener {
    params: GroundPatchesParams,
}

impl MapKernel for Opener {
    fn open(&self, sides: &Sides) -> Result<Box<dyn Mapper>, Fault> {
        let sessions = rig::sessions(sides)?;
        Ok(Box::new(Projector {
            params: self.params.clone(),
            sessions,
            tables: Mutex::default(),
        }))
    }
}

/// What a table depends on: the calibration (session, camera, stamp) and the size of the image.
type TableName = (SessionName, String, Stamp, [u32; 2]);

/// Tables kept at most: a camera whose calibration changes with every image must not fill the memory.
const MOST_TABLES: usize = 256;

struct Projector {
    params: GroundPatchesParams,
    sessions: BTreeMap<SessionName, Rig>,
    tables: Mutex<BTreeMap<TableName, Result<Arc<GroundLut>, Reason>>>,
}

record! {
    /// A posed image without its pixels.
    pub struct Look {
        /// Site of the map.
        site: String,
        /// Session that was driven.
        session: String,
        /// Exposure instant.
        stamp: Stamp,
        /// Camera that took it.
        camera: String,
        /// The vehicle in the map.
        map_from_vehicle: evermap_schemas::Pose,
    }
}

impl Mapper for Projector {
    fn map(&self, batch: &RecordBatch, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let images = images(batch, "images")?;
        let looks = rows::<Look>(batch)?.into_iter().enumerate();
        // Tables first, one after the other: making one already uses all cores.
        let planned: Vec<_> = looks
            .map(|(row, look)| {
                let bytes = (!images.is_null(row)).then(|| images.value(row));
                let table = self.plan(&look, bytes);
                (look, table)
            })
            .collect();
        let patches: Vec<Result<GroundPatch, Reason>> = planned
            .into_par_iter()
            .map_init(Grey::default, |grey, (look, plan)| {
                let (bytes, table) = plan?;
                self.patch(look, bytes, &table, grey)
            })
            .collect();
        let mut found = Vec::with_capacity(patches.len());
        for patch in patches {
            match patch {
                Ok(patch) => found.push(patch),
                Err(reason) => emit.skip(reason, 1),
            }
        }
        emit.rows(found)
    }
}

impl Projector {
    fn plan<'a>(
        &self,
        look: &Look,
        bytes: Option<&'a [u8]>,
    ) -> Result<(&'a [u8], Arc<GroundLut>), Reason> {
        let bytes = bytes.ok_or("image is missing")?;
        let size = Decoder::new()
            .size(bytes)
            .map_err(|_| "image does not decode")?;
        let session = (look.site.clone(), look.session.clone());
        let rig = self
            .sessions
            .get(&session)
            .ok_or("camera has no calibration")?;
        let camera = frame(&look.camera);
        let calibration = rig
            .calibration(camera, look.stamp)
            .ok_or("camera has no calibration")?;
        let name = (session, camera.to_owned(), calibration.stamp, size);
        let known = self.lock().get(&name).cloned();
        // Not under the lock: a thread that waits here for the table's parts may be given other rows to work on.
        let table = known.unwrap_or_else(|| self.table(rig, calibration, size));
        let mut tables = self.lock();
        if tables.len() >= MOST_TABLES {
            tables.clear();
        }
        tables
            .entry(name)
            .or_insert(table)
            .clone()
            .map(|table| (bytes, table))
    }

    fn lock(
        &self,
    ) -> std::sync::MutexGuard<'_, BTreeMap<TableName, Result<Arc<GroundLut>, Reason>>> {
        self.tables.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn table(
        &self,
        rig: &Rig,
        calibration: &Calibration,
        size: [u32; 2],
    ) -> Result<Arc<GroundLut>, Reason> {
        let vehicle_from_camera = rig
            .vehicle_from_camera(
                frame(&self.params.vehicle_frame),
                frame(&calibration.camera),
            )
            .ok_or("no fixed transforms from camera to vehicle")?;
        let camera = camera(calibration, size)?;
        let camera = match camera.model {
            // A panorama's axis is just the direction that it calls forward.
            Model::Equirectangular(_) => camera,
            _ => camera.with_max_angle(self.params.max_angle_rad),
        };
        GroundLut::new(&camera, &vehicle_from_camera, &self.params.ground(), None)
            .map(Arc::new)
            .map_err(|_| "camera is not above the ground")
    }

    fn patch(
        &self,
        look: Look,
        bytes: &[u8],
        table: &GroundLut,
        grey: &mut Grey,
    ) -> Result<GroundPatch, Reason> {
        let pose = Pose::from_array(look.map_from_vehicle.to_array())
            .map_err(|_| "pose is no rigid transform")?;
        Decoder::new()
            .decode_into(bytes, grey)
            .map_err(|_| "image does not decode")?;
        let image =
            GrayView::new(grey.width, grey.height, &grey.data).ok_or("image does not decode")?;
        let cells = Cells::seen(table, &image, &pose, self.params.cell_m);
        let [column, row, width, height] = cells.bounds().ok_or("image shows no ground")?;
        let place = |cell: i64| i32::try_from(cell).map_err(|_| "pose is out of the map");
        let size = |cells: i64| u32::try_from(cells).map_err(|_| "pose is out of the map");
        let (values, weights) = cells.rectangle([column, row, width, height]);
        Ok(GroundPatch {
            site: look.site,
            session: look.session,
            stamp: look.stamp,
            camera: look.camera,
            cell_m: self.params.cell_m,
            column: place(column)?,
            row: place(row)?,
            width: size(width)?,
            height: size(height)?,
            values: Bytes(values),
            weights: Bytes(weights),
        })
    }
}

/// Runs of cells as they come: first column, row, and where their bytes begin and end.
#[derive(Default)]
struct Cells {
    runs: Vec<(i64, i64, std::ops::Range<usize>)>,
    values: Vec<u8>,
    weights: Vec<u8>,
}

impl Cells {
    fn seen(table: &GroundLut, image: &GrayView<'_>, pose: &Pose, cell_m: f64) -> Self {
        let mut cells = Self::default();
        table.splat(image, pose, cell_m, |run| {
            let from = cells.values.len();
            cells.values.extend_from_slice(run.values);
            cells.weights.extend_from_slice(run.weights);
            cells.runs.push((run.i, run.j, from..cells.values.len()));
        });
        cells
    }

    /// Column, row, width and height of what was seen.
    fn bounds(&self) -> Option<[i64; 4]> {
        let column = self.runs.iter().map(|(i, _, _)| *i).min()?;
        let end = self
            .runs
            .iter()
            .map(|(i, _, run)| i + run.len() as i64)
            .max()?;
        let row = self.runs.iter().map(|(_, j, _)| *j).min()?;
        let top = self.runs.iter().map(|(_, j, _)| j + 1).max()?;
        Some([column, row, end - column, top - row])
    }

    /// Values and weights of the whole rectangle.
    fn rectangle(&self, [column, row, width, height]: [i64; 4]) -> (Vec<u8>, Vec<u8>) {
        let cells = (width * height) as usize;
        let (mut values, mut weights) = (vec![0; cells], vec![0; cells]);
        for (i, j, run) in &self.runs {
            let at = ((j - row) * width + i - column) as usize;
            values[at..at + run.len()].copy_from_slice(&self.values[run.clone()]);
            weights[at..at + run.len()].copy_from_slice(&self.weights[run.clone()]);
        }
        (values, weights)
    }
}
