//! The ROS 2 messages that evermap records itself: their definitions, and their bytes in CDR.

use crate::cdr::CdrWriter;

/// The vehicle's frame (REP-105): x forward, y left, z up, on the ground below the rear axle.
pub const VEHICLE_FRAME: &str = "base_link";
/// The frame of odometry (REP-105).
pub const ODOM_FRAME: &str = "odom";

/// A message that can be recorded.
pub trait Message {
    /// `package/msg/Name`.
    const NAME: &'static str;
    /// The definition (`ros2msg`) and, after separators, those of all types that it uses.
    const DEFINITION: &'static str;

    /// Writes its members.
    fn write(&self, cdr: &mut CdrWriter);

    /// The payload, with its encapsulation header.
    fn encode(&self) -> Vec<u8> {
        let mut cdr = CdrWriter::new();
        self.write(&mut cdr);
        cdr.finish()
    }
}

/// Position, m, and unit quaternion: `x, y, z, qx, qy, qz, qw`.
pub type Pose = [f64; 7];

/// `std_msgs/msg/Header`.
#[derive(Debug, Clone, Copy)]
pub struct Header<'a> {
    /// Nanoseconds since the epoch.
    pub stamp_ns: u64,
    /// The frame that the message is given in.
    pub frame_id: &'a str,
}

impl Header<'_> {
    fn write(&self, cdr: &mut CdrWriter) {
        cdr.u32((self.stamp_ns / 1_000_000_000) as u32);
        cdr.u32((self.stamp_ns % 1_000_000_000) as u32);
        cdr.string(self.frame_id);
    }
}

/// `sensor_msgs/msg/CompressedImage`.
#[derive(Debug, Clone, Copy)]
pub struct CompressedImage<'a> {
    /// When it was taken, and the optical frame.
    pub header: Header<'a>,
    /// `png`, `jpeg` or as a driver writes it.
    pub format: &'a str,
    /// The encoded image.
    pub data: &'a [u8],
}

impl Message for CompressedImage<'_> {
    const NAME: &'static str = "sensor_msgs/msg/CompressedImage";
    const DEFINITION: &'static str = include_str!("definitions/CompressedImage.msg");

    fn write(&self, cdr: &mut CdrWriter) {
        self.header.write(cdr);
        cdr.string(self.format);
        cdr.octets(self.data);
    }
}

/// What is known of a camera's lens.
#[derive(Debug, Clone, Copy)]
pub struct Calibration<'a> {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// `distortion_model`.
    pub model: &'a str,
    /// D.
    pub distortion: &'a [f64],
    /// K, row by row, pixels; of a panorama, focal lengths are pixels per radian.
    pub k: [f64; 9],
}

/// `sensor_msgs/msg/CameraInfo` of one camera: R is the identity, P is K, and all of the image is of interest.
#[derive(Debug, Clone, Copy)]
pub struct CameraInfo<'a> {
    /// When it holds, and the optical frame.
    pub header: Header<'a>,
    /// What it says.
    pub calibration: Calibration<'a>,
}

impl Message for CameraInfo<'_> {
    const NAME: &'static str = "sensor_msgs/msg/CameraInfo";
    const DEFINITION: &'static str = include_str!("definitions/CameraInfo.msg");

    fn write(&self, cdr: &mut CdrWriter) {
        let Calibration {
            size: [width, height],
            model,
            distortion,
            k,
        } = self.calibration;
        self.header.write(cdr);
        cdr.u32(height);
        cdr.u32(width);
        cdr.string(model);
        cdr.u32(distortion.len() as u32);
        cdr.f64s(distortion);
        cdr.f64s(&k);
        cdr.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        for row in k.chunks_exact(3) {
            cdr.f64s(row);
            cdr.f64s(&[0.0]);
        }
        // Binning, and a region of interest that is the whole image.
        (0..6).for_each(|_| cdr.u32(0));
        cdr.u8(0);
    }
}

/// `nav_msgs/msg/Odometry` of the vehicle, in the odometry frame.
#[derive(Debug, Clone, Copy)]
pub struct Odometry {
    /// When it was measured, ns since the epoch.
    pub stamp_ns: u64,
    /// `odom_from_vehicle`.
    pub pose: Pose,
    /// Variances of x, y, z (m²), roll, pitch and yaw (rad²); 0 where nobody says.
    pub pose_variances: [f64; 6],
    /// Speeds along and around the vehicle's axes, m/s and rad/s.
    pub twist: [f64; 6],
    /// Their variances; 0 where nobody says.
    pub twist_variances: [f64; 6],
}

impl Message for Odometry {
    const NAME: &'static str = "nav_msgs/msg/Odometry";
    const DEFINITION: &'static str = include_str!("definitions/Odometry.msg");

    fn write(&self, cdr: &mut CdrWriter) {
        let header = Header {
            stamp_ns: self.stamp_ns,
            frame_id: ODOM_FRAME,
        };
        header.write(cdr);
        cdr.string(VEHICLE_FRAME);
        cdr.f64s(&self.pose);
        cdr.f64s(&diagonal(self.pose_variances));
        cdr.f64s(&self.twist);
        cdr.f64s(&diagonal(self.twist_variances));
    }
}

/// A covariance, row by row, of quantities that vary independently.
fn diagonal(variances: [f64; 6]) -> [f64; 36] {
    let mut matrix = [0.0; 36];
    for (k, variance) in variances.into_iter().enumerate() {
        matrix[7 * k] = variance;
    }
    matrix
}

/// `tf2_msgs/msg/TFMessage` that places sensors on the vehicle.
#[derive(Debug, Clone)]
pub struct StaticTransforms<'a> {
    /// Since when they are there, ns since the epoch.
    pub stamp_ns: u64,
    /// Frame and `vehicle_from_frame` of each.
    pub frames: Vec<(&'a str, Pose)>,
}

impl Message for StaticTransforms<'_> {
    const NAME: &'static str = "tf2_msgs/msg/TFMessage";
    const DEFINITION: &'static str = include_str!("definitions/TFMessage.msg");

    fn write(&self, cdr: &mut CdrWriter) {
        let header = Header {
            stamp_ns: self.stamp_ns,
            frame_id: VEHICLE_FRAME,
        };
        cdr.u32(self.frames.len() as u32);
        for (frame_id, vehicle_from_frame) in &self.frames {
            header.write(cdr);
            cdr.string(frame_id);
            cdr.f64s(vehicle_from_frame);
        }
    }
}

/// `sensor_msgs/msg/Imu` of a sensor that says nothing of its orientation.
#[derive(Debug, Clone, Copy)]
pub struct Imu<'a> {
    /// When it was measured, and the sensor's frame.
    pub header: Header<'a>,
    /// Rates of turn about the sensor's axes, rad/s.
    pub angular_velocity: [f64; 3],
    /// Acceleration along them as it is felt, m/s².
    pub linear_acceleration: [f64; 3],
}

impl Message for Imu<'_> {
    const NAME: &'static str = "sensor_msgs/msg/Imu";
    const DEFINITION: &'static str = include_str!("definitions/Imu.msg");

    fn write(&self, cdr: &mut CdrWriter) {
        let mut not_measured = [0.0; 9];
        not_measured[0] = -1.0;
        self.header.write(cdr);
        cdr.f64s(&[0.0, 0.0, 0.0, 1.0]);
        cdr.f64s(&not_measured);
        for measured in [self.angular_velocity, self.linear_acceleration] {
            cdr.f64s(&measured);
            cdr.f64s(&[0.0; 9]);
        }
    }
}

/// `sensor_msgs/msg/NavSatFix`.
#[derive(Debug, Clone, Copy)]
pub struct NavSatFix<'a> {
    /// When it was measured, and the antenna's frame.
    pub header: Header<'a>,
    /// Latitude and longitude (deg) and height above the ellipsoid (m); `None` where there is no fix.
    pub place: Option<[f64; 3]>,
    /// Variances along east, north and up, m².
    pub variances: [f64; 3],
}

impl Message for NavSatFix<'_> {
    const NAME: &'static str = "sensor_msgs/msg/NavSatFix";
    const DEFINITION: &'static str = include_str!("definitions/NavSatFix.msg");

    fn write(&self, cdr: &mut CdrWriter) {
        let [east, north, up] = self.variances;
        self.header.write(cdr);
        // STATUS_FIX or STATUS_NO_FIX, of GPS.
        cdr.u8(if self.place.is_some() { 0 } else { 0xff });
        cdr.u16(1);
        cdr.f64s(&self.place.unwrap_or([f64::NAN; 3]));
        cdr.f64s(&[east, 0.0, 0.0, 0.0, north, 0.0, 0.0, 0.0, up]);
        // COVARIANCE_TYPE_DIAGONAL_KNOWN.
        cdr.u8(2);
    }
}

/// `nav_msgs/msg/OccupancyGrid`: cells of the ground, in rows along y.
#[derive(Debug, Clone, Copy)]
pub struct OccupancyGrid<'a> {
    /// When it holds, and the frame of the ground.
    pub header: Header<'a>,
    /// Side of a cell, m.
    pub cell_m: f64,
    /// Cells along x and along y.
    pub size: [u32; 2],
    /// The corner of the first cell, where x and y are least; its axes are those of the frame.
    pub corner: [f64; 3],
    /// Cells along x, row after row along y: 0 to 100, or -1 where nobody knows.
    pub cells: &'a [i8],
}

impl Message for OccupancyGrid<'_> {
    const NAME: &'static str = "nav_msgs/msg/OccupancyGrid";
    const DEFINITION: &'static str = include_str!("definitions/OccupancyGrid.msg");

    fn write(&self, cdr: &mut CdrWriter) {
        let [width, height] = self.size;
        self.header.write(cdr);
        // When the map was loaded: never, as it comes out of a log.
        (0..2).for_each(|_| cdr.u32(0));
        cdr.f32(self.cell_m as f32);
        cdr.u32(width);
        cdr.u32(height);
        cdr.f64s(&self.corner);
        cdr.f64s(&[0.0, 0.0, 0.0, 1.0]);
        let cells: Vec<u8> = self.cells.iter().map(|cell| cell.cast_unsigned()).collect();
        cdr.octets(&cells);
    }
}
