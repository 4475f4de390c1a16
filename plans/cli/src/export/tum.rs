//! Trajectories as the TUM RGB-D benchmark writes them, read by evo and others.

use arrow::array::RecordBatch;
use arrow::compute::{cast, filter, is_not_null};
use arrow::datatypes::DataType;
use evermap_algorithms::geometry;
use evermap_algorithms::geometry::trajectory::{StampedPose, tum};
use evermap_schemas::{Cell, Fault, Pose, Stamp};

use crate::reader::{one_session, texts};

/// `seconds x y z qx qy qz qw`, ordered by stamp, with all nine digits of the nanoseconds.
///
/// # Errors
/// A user fault where there is no pose column or more than one session.
pub fn text(batches: &[RecordBatch]) -> Result<String, Fault> {
    let sessions = batches.iter().filter_map(|batch| texts(batch, "session"));
    one_session(sessions.flatten().flatten())?;
    let mut poses: Vec<(Stamp, Pose)> = Vec::new();
    for batch in batches {
        let stamps = batch
            .column_by_name("stamp")
            .ok_or_else(|| no_poses("stamp"))?;
        let column = batch
            .columns()
            .iter()
            .find(|column| is_pose(column.data_type()))
            .ok_or_else(|| no_poses("pose"))?;
        // Where a vehicle was lost there is no pose.
        let known = is_not_null(column)?;
        let (stamps, column) = (filter(stamps, &known)?, filter(column, &known)?);
        let stamps = Stamp::decode(&cast(&stamps, &Stamp::data_type())?)?;
        let found = Pose::decode(&cast(&column, &Pose::data_type())?)?;
        poses.extend(stamps.into_iter().zip(found));
    }
    poses.sort_by_key(|(stamp, _)| *stamp);
    let stamped = |(Stamp(stamp_ns), pose): &(Stamp, Pose)| -> Result<StampedPose, Fault> {
        let pose = geometry::pose::Pose::from_array(pose.to_array())
            .map_err(|error| Fault::data(format!("the pose at {stamp_ns} ns: {error}")))?;
        Ok(StampedPose {
            stamp_ns: *stamp_ns,
            pose,
        })
    };
    let poses = poses.iter().map(stamped).collect::<Result<Vec<_>, _>>()?;
    Ok(tum(&poses))
}

fn is_pose(data_type: &DataType) -> bool {
    let DataType::Struct(fields) = data_type else {
        return false;
    };
    let names = fields.iter().map(|field| field.name().as_str());
    names.eq(["x", "y", "z", "qx", "qy", "qz", "qw"])
}

fn no_poses(column: &str) -> Fault {
    Fault::user(format!("it has no {column} column")).next("export a layer of poses or keyframes")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use evermap_schemas::batch;
    use evermap_schemas::layers::{Localisation, VehiclePose};

    fn pose(session: &str, stamp: i64, x: f64) -> VehiclePose {
        let map_from_vehicle = Pose {
            x,
            ..Pose::IDENTITY
        };
        VehiclePose {
            site: "s".into(),
            session: session.into(),
            stamp: Stamp(stamp),
            map_from_vehicle,
        }
    }

    #[test]
    fn stamps_are_exact_and_sorted() {
        let rows = batch(vec![
            pose("a", 1_780_300_800_000_000_001, 2.5),
            pose("a", 1_500_000_000, -1.0),
        ])
        .unwrap();
        let text = text(&[rows]).unwrap();
        let lines: Vec<_> = text.lines().skip(1).collect();
        assert_eq!(
            lines,
            [
                "1.500000000 -1 0 0 0 0 0 1",
                "1780300800.000000001 2.5 0 0 0 0 0 1"
            ]
        );
    }

    #[test]
    fn where_a_vehicle_was_lost_there_is_no_pose() {
        let row = |stamp, map_from_vehicle: Option<Pose>| Localisation {
            site: "s".into(),
            session: "a".into(),
            stamp: Stamp(stamp),
            keyframe: 0,
            state: "localised".into(),
            map_from_vehicle,
            covariance: vec![],
            sigma_m: None,
            sigma_rad: None,
            candidates: 0,
            matches: 0,
            inliers: 0,
            rms_px: None,
            observations: vec![],
        };
        let rows = batch(vec![row(1, None), row(2, Some(Pose::IDENTITY))]).unwrap();
        let text = text(&[rows]).unwrap();
        assert_eq!(
            text.lines().skip(1).collect::<Vec<_>>(),
            ["0.000000002 0 0 0 0 0 0 1"]
        );
    }

    #[test]
    fn two_sessions_are_no_trajectory() {
        let rows = batch(vec![pose("a", 1, 0.0), pose("b", 2, 0.0)]).unwrap();
        assert!(
            text(&[rows])
                .unwrap_err()
                .to_string()
                .contains("--session: a, b")
        );
    }
}
