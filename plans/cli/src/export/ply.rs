//! Points as a PLY file, for MeshLab, CloudCompare and Open3D: doubles, little-endian.

use std::io::Write;

use arrow::array::RecordBatch;
use evermap_schemas::Fault;

use crate::reader::typed;
use crate::shown::LandmarkPoint;

/// The points of a layer with columns `x`, `y` and `z`.
///
/// # Errors
/// A user fault for a layer that has other columns.
pub fn points(batches: &[RecordBatch]) -> Result<Vec<u8>, Fault> {
    let rows: Vec<LandmarkPoint> = typed(batches).map_err(|fault| {
        let what = fault.message;
        Fault::user(format!("expected points in columns x, y and z: {what}"))
            .next("export landmarks or surface_points")
    })?;
    let mut file = format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres in the map frame, z up\nelement vertex {}\n\
         property double x\nproperty double y\nproperty double z\nend_header\n",
        rows.len()
    )
    .into_bytes();
    for row in &rows {
        for value in [row.x, row.y, row.z] {
            let _ = file.write_all(&value.to_le_bytes());
        }
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::batch;
    use evermap_schemas::layers::SpeedCell;

    #[test]
    fn points_are_behind_the_header_that_counts_them() {
        let row = |x: f64| LandmarkPoint {
            site: "lot".into(),
            x,
            y: 2.5,
            z: -1.0,
        };
        let file = points(&[batch(vec![row(1.0), row(7.0)]).unwrap()]).unwrap();
        let text = String::from_utf8_lossy(&file);
        let header = &text[..text.find("end_header\n").unwrap() + "end_header\n".len()];
        assert!(header.starts_with("ply\n") && header.contains("element vertex 2\n"));
        let numbers = file[header.len()..].chunks(8);
        let numbers: Vec<f64> = numbers
            .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()))
            .collect();
        assert_eq!(numbers, [1.0, 2.5, -1.0, 7.0, 2.5, -1.0]);
        let cells: Vec<SpeedCell> = Vec::new();
        assert!(points(&[batch(cells).unwrap()]).is_err());
    }
}
