//! Where a camera or a reference is: rigid transforms, as people and calibrations write them.

use std::path::{Path, PathBuf};

use evermap_schemas::Fault;
use nalgebra::{Isometry3, Matrix4, Quaternion, Translation3, UnitQuaternion};
use serde::Deserialize;

use crate::import::calibration;

/// A rigid transform, in one of three spellings.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Placement {
    /// A SensorsCalibration JSON file (`sensor_calib.data`, 4 by 4).
    pub file: Option<PathBuf>,
    /// 4 by 4, rows.
    pub matrix: Option<Vec<Vec<f64>>>,
    /// `[x, y, z, qx, qy, qz, qw]`, m.
    pub pose: Option<[f64; 7]>,
    /// Factor of the translation, for calibrations in units of their own.
    pub scale: Option<f64>,
}

impl Placement {
    /// The transform; a file's path is relative to the folder.
    pub(super) fn read(&self, folder: &Path) -> Result<Isometry3<f64>, Fault> {
        let mut transform = match (&self.file, &self.matrix, &self.pose) {
            (Some(file), None, None) => {
                let path = folder.join(file);
                rigid(&calibration::extrinsic(&path)?).map_err(|fault| fault.at(path.display()))?
            }
            (None, Some(rows), None) => rigid(&matrix(rows)?)?,
            (None, None, Some(pose)) => from_pose(pose)?,
            _ => return Err(Fault::user("expected one of file, matrix and pose")),
        };
        transform.translation.vector *= self.scale.unwrap_or(1.0);
        Ok(transform)
    }
}

/// The transform of `[x, y, z, qx, qy, qz, qw]`.
pub(super) fn from_pose([x, y, z, qx, qy, qz, qw]: &[f64; 7]) -> Result<Isometry3<f64>, Fault> {
    let rotation = Quaternion::new(*qw, *qx, *qy, *qz);
    if rotation.norm() < 1e-6 {
        return Err(Fault::user(
            "expected a rotation, found a quaternion of length 0",
        ));
    }
    let rotation = UnitQuaternion::from_quaternion(rotation);
    Ok(Isometry3::from_parts(
        Translation3::new(*x, *y, *z),
        rotation,
    ))
}

/// A 4 by 4 matrix from its rows.
pub(super) fn matrix(rows: &[Vec<f64>]) -> Result<Matrix4<f64>, Fault> {
    let numbers: Vec<f64> = rows.iter().flatten().copied().collect();
    if rows.len() != 4 || numbers.len() != 16 || rows.iter().any(|row| row.len() != 4) {
        return Err(Fault::user("expected a matrix of 4 rows of 4 numbers"));
    }
    Ok(Matrix4::from_row_slice(&numbers))
}

/// The rigid transform of a matrix whose rotation was written with a few digits: the nearest rotation is taken. A
/// matrix that was written column by column would be another one, with its translation in the last row.
pub(super) fn rigid(matrix: &Matrix4<f64>) -> Result<Isometry3<f64>, Fault> {
    let last = [0, 1, 2, 3].map(|column| matrix[(3, column)]);
    let is_zero = |number: f64| number.abs() <= 1e-6;
    if !(last[..3].iter().all(|number| is_zero(*number)) && is_zero(last[3] - 1.0)) {
        return Err(Fault::user(format!(
            "expected 0, 0, 0, 1 in the last row of the matrix, found {}, {}, {}, {}",
            last[0], last[1], last[2], last[3]
        ))
        .next("write the matrix row by row; if it was written column by column, transpose it"));
    }
    let given = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let error = (given * given.transpose() - nalgebra::Matrix3::identity()).amax();
    if !(error < 1e-2 && given.determinant() > 0.0) {
        return Err(Fault::user(
            "expected a rotation in the upper left of the matrix",
        ));
    }
    let svd = given.svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else {
        return Err(Fault::bug("a decomposition without factors"));
    };
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(u * v);
    let translation = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    Ok(Isometry3::from_parts(
        translation.into(),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_matrix_is_rigid_by_its_last_row_too() {
        let pose = from_pose(&[1.5, 0.0, 1.2, 0.1, 0.2, 0.3, 0.9]).unwrap();
        let rows = pose.to_homogeneous();
        let found = rigid(&rows).unwrap();
        assert!((found.to_homogeneous() - rows).amax() < 1e-6, "{found}");
        let fault = rigid(&rows.transpose()).unwrap_err().to_string();
        assert!(fault.contains("found 1.5, 0, 1.2, 1"), "{fault}");
        // A rounded 1 is one.
        for (last, is_rigid) in [(1.0 - 1e-7, true), (2.0, false), (f64::NAN, false)] {
            let mut rows = rows;
            rows[(3, 3)] = last;
            assert_eq!(rigid(&rows).is_ok(), is_rigid, "{last}");
        }
    }
}
