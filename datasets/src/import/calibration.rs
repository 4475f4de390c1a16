//! Calibration files.

use std::path::Path;

use evermap_messages::ros2::Calibration;
use evermap_schemas::Fault;
use nalgebra::Matrix4;
use serde_json::Value;

use crate::import::placement::matrix;
use crate::import::read;

/// What a `CameraInfo` says of a lens.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Intrinsics {
    pub model: String,
    /// Row-major.
    pub k: [f64; 9],
    pub d: Vec<f64>,
}

impl Intrinsics {
    /// As the description gives them.
    pub fn given(model: Option<&str>, k: &[f64], d: &[f64]) -> Result<Self, Fault> {
        let k = <[f64; 9]>::try_from(k).map_err(|_| {
            Fault::user(format!(
                "expected 9 intrinsics, row by row, found {}",
                k.len()
            ))
        })?;
        Ok(Self {
            model: model.unwrap_or("plumb_bob").to_owned(),
            k,
            d: d.to_vec(),
        })
    }

    /// From a SensorsCalibration file. Eleven distortion coefficients are those of OCamCalib's inverse polynomial.
    pub fn read(path: &Path, model: Option<&str>) -> Result<Self, Fault> {
        let param = param(path)?;
        let k = numbers(&param["cam_K"]["data"]).concat();
        let d = numbers(&param["cam_dist"]["data"]).concat();
        let model = model.unwrap_or(match d.len() {
            11.. => "ocam",
            _ => "plumb_bob",
        });
        Self::given(Some(model), &k, &d).map_err(|fault| fault.at(path.display()))
    }

    /// As messages say it of a camera with images of this size, pixels.
    pub fn published(&self, size: [u32; 2]) -> Calibration<'_> {
        Calibration {
            size,
            model: &self.model,
            distortion: &self.d,
            k: self.k,
        }
    }
}

/// The matrix of a SensorsCalibration extrinsic file.
pub(super) fn extrinsic(path: &Path) -> Result<Matrix4<f64>, Fault> {
    let rows = numbers(&param(path)?["sensor_calib"]["data"]);
    matrix(&rows).map_err(|fault| fault.at(path.display()))
}

/// The parameters: the member `param` of the file's only member.
fn param(path: &Path) -> Result<Value, Fault> {
    let file: Value = serde_json::from_str(&read(path)?)
        .map_err(|error| Fault::user(format!("expected JSON, found {error}")).at(path.display()))?;
    let sensor = file.as_object().and_then(|file| file.values().next());
    let param = sensor.and_then(|sensor| sensor.get("param"));
    param.cloned().ok_or_else(|| {
        Fault::user("expected a calibration with the member param").at(path.display())
    })
}

fn numbers(rows: &Value) -> Vec<Vec<f64>> {
    let row = |row: &Value| -> Vec<f64> {
        let numbers = row.as_array().into_iter().flatten();
        numbers.filter_map(Value::as_f64).collect()
    };
    rows.as_array().into_iter().flatten().map(row).collect()
}
