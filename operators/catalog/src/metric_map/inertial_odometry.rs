#![doc = include_str!("inertial_odometry.md")]

use evermap_algorithms::geometry::pose::Pose;
use evermap_algorithms::metric_map::inertial::{self, ImuSample, InertialError};
use evermap_contract::{Emit, Fault, Key, Operator, Port, Reach, Reason, Sides, Work};
use evermap_schemas::roles::{ImuMeasurement, OdometryPose};
use nalgebra::Vector3;

use crate::inputs::rig::{self, VehicleFrame, frame};

/// See the module's page.
pub struct InertialOdometry;

impl Operator for InertialOdometry {
    const NAME: &'static str = "inertial_odometry";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("inertial_odometry.md");
    type Params = VehicleFrame;
    type Output = OdometryPose;

    fn work() -> Work<Self::Params> {
        let odometry = Port::session::<OdometryPose>("odometry");
        let [_, transforms] = rig::ports(Reach::Session);
        let sides = vec![
            Port::session::<ImuMeasurement>("imu").optional(),
            transforms.optional(),
        ];
        Work::group(odometry, Key::SESSION, sides, stand_up)
    }
}

fn stand_up(
    vehicle: &VehicleFrame,
    mut rows: Vec<OdometryPose>,
    sides: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let imu: Vec<ImuMeasurement> = sides.rows("imu")?;
    if let Some(first) = imu.first() {
        let mounts = rig::rigs(Vec::new(), sides.rows("transforms")?);
        let mounts = mounts.into_values().next().unwrap_or_default();
        let mounted = mounts.vehicle_from_frame(vehicle.name(), frame(&first.frame));
        let stood_up = mounted
            .map_err(|reason| format!("IMU without a place on the vehicle: {reason}").into())
            .and_then(|mount| upright(&mut rows, &imu, &mount).map_err(reason));
        if let Err(reason) = stood_up {
            emit.skip(reason, imu.len() as u64);
        }
    }
    emit.rows(rows)
}

/// Writes the upright poses into the rows; those that are not rigid transforms are left as they are.
fn upright(
    rows: &mut [OdometryPose],
    imu: &[ImuMeasurement],
    vehicle_from_imu: &Pose,
) -> Result<(), InertialError> {
    let mut odometry = Vec::with_capacity(rows.len());
    let mut written = Vec::with_capacity(rows.len());
    for row in rows {
        let stamp = row.stamp.0;
        if let Ok(pose) = Pose::from_array(row.odom_from_vehicle.to_array()) {
            odometry.push((stamp, pose));
            written.push(&mut row.odom_from_vehicle);
        }
    }
    let samples: Vec<ImuSample> = imu.iter().map(sample).collect();
    let found = inertial::upright(&odometry, &samples, vehicle_from_imu)?;
    for (written, found) in written.into_iter().zip(found) {
        *written = evermap_schemas::Pose::from_array(found.to_array());
    }
    Ok(())
}

fn sample(row: &ImuMeasurement) -> ImuSample {
    ImuSample {
        stamp: row.stamp.0,
        angular_velocity: Vector3::new(
            row.angular_velocity_x_radps,
            row.angular_velocity_y_radps,
            row.angular_velocity_z_radps,
        ),
        specific_force: Vector3::new(
            row.linear_acceleration_x_mps2,
            row.linear_acceleration_y_mps2,
            row.linear_acceleration_z_mps2,
        ),
    }
}

fn reason(refused: InertialError) -> Reason {
    match refused {
        InertialError::Silent => "IMU that was silent for most of the drive".into(),
        InertialError::NoGravity => {
            "IMU whose acceleration is not gravity's (9.81 m/s² at rest)".into()
        }
        InertialError::NotUpright => "IMU by whose mount the vehicle does not stand upright".into(),
        InertialError::TurnsOtherwise => {
            "IMU by whose mount the vehicle turns otherwise than its odometry".into()
        }
    }
}
