//! Trajectories as the TUM RGB-D benchmark writes them, read by evo and others.

use std::collections::BTreeSet;

use arrow::array::{Array, AsArray, RecordBatch};
use arrow::compute::{cast, filter, is_not_null};
use arrow::datatypes::DataType;
use evermap_algorithms::geometry::trajectory::{StampedPose, tum};
use evermap_schemas::{Cell, Fault, Pose, Stamp};

/// `seconds x y z qx qy qz qw`, ordered by stamp, with all nine digits of the nanoseconds.
///
/// # Errors
/// A user fault where there is no pose column or more than one session.
pub fn text(batches: &[RecordBatch]) -> Result<String, Fault> {
    one_session(batches)?;
    let mut poses: Vec<(Stamp, Pose)> = Vec::new();
    for batch in batches {
        let stamps = batch
            .column_by_name("stamp")
            .ok_or_else(|| no_poses("stamp"))?;
        let is_pose = |column: &&arrow::array::ArrayRef| {
            let names = |fields: &arrow::datatypes::Fields| {
                fields.iter().map(|field| field.name().clone()).collect()
            };
            let found: Vec<String> = if let DataType::Struct(fields) = column.data_type() {
                names(fields)
            } else {
                vec![]
            };
            found == ["x", "y", "z", "qx", "qy", "qz", "qw"]
        };
        let column = batch
            .columns()
            .iter()
            .find(is_pose)
            .ok_or_else(|| no_poses("pose"))?;
        // Where a vehicle was lost there is no pose.
        let known = is_not_null(column)?;
        let (stamps, column) = (filter(stamps, &known)?, filter(column, &known)?);
        let stamps = Stamp::decode(&cast(&stamps, &Stamp::data_type())?)?;
        let found = Pose::decode(&cast(&column, &Pose::data_type())?)?;
        poses.extend(stamps.into_iter().zip(found));
    }
    poses.sort_by_key(|(stamp, _)| *stamp);
    let stamped =
        |(stamp, pose): &(Stamp, Pose)| match evermap_algorithms::geometry::pose::Pose::from_array(
            pose.to_array(),
        ) {
            Ok(pose) => Ok(StampedPose {
                stamp_ns: stamp.0,
                pose,
            }),
            Err(error) => Err(Fault::data(format!("the pose at {} ns: {error}", stamp.0))),
        };
    let poses = poses.iter().map(stamped).collect::<Result<Vec<_>, _>>()?;
    Ok(tum(&poses))
}

fn no_poses(column: &str) -> Fault {
    Fault::user(format!("it has no {column} column")).next("export a layer of poses or keyframes")
}

fn one_session(batches: &[RecordBatch]) -> Result<(), Fault> {
    let mut sessions = BTreeSet::new();
    for batch in batches {
        let column = batch
            .column_by_name("session")
            .filter(|column| *column.data_type() == DataType::Utf8);
        if let Some(column) = column {
            sessions.extend(
                column
                    .as_string::<i32>()
                    .iter()
                    .flatten()
                    .map(str::to_owned),
            );
        }
    }
    if sessions.len() > 1 {
        let names: Vec<_> = sessions.into_iter().collect();
        return Err(Fault::user("a trajectory is of one session")
            .next(format!("choose one with --session: {}", names.join(", "))));
    }
    Ok(())
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
