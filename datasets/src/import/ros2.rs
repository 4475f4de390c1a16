//! The four ROS 2 messages that an import writes, as plain little-endian CDR (OMG DDS-XTypes 7.4.1).

use nalgebra::Isometry3;

use crate::import::calibration::Intrinsics;

/// A message type: its name, and its definition with those of all types that it uses.
pub(super) struct MessageType {
    pub name: &'static str,
    pub definition: &'static str,
}

pub(super) const COMPRESSED_IMAGE: MessageType = MessageType {
    name: "sensor_msgs/msg/CompressedImage",
    definition: include_str!("definitions/CompressedImage.msg"),
};
pub(super) const CAMERA_INFO: MessageType = MessageType {
    name: "sensor_msgs/msg/CameraInfo",
    definition: include_str!("definitions/CameraInfo.msg"),
};
pub(super) const ODOMETRY: MessageType = MessageType {
    name: "nav_msgs/msg/Odometry",
    definition: include_str!("definitions/Odometry.msg"),
};
pub(super) const TF_MESSAGE: MessageType = MessageType {
    name: "tf2_msgs/msg/TFMessage",
    definition: include_str!("definitions/TFMessage.msg"),
};

/// The vehicle's frame.
pub(super) const VEHICLE: &str = "base_link";
/// The frame of poses.
const ODOM: &str = "odom";

/// Writes one message. Numbers are aligned to their own size, counted from behind the four bytes of the header.
struct Cdr(Vec<u8>);

const HEADER: [u8; 4] = [0, 1, 0, 0];

impl Cdr {
    fn new() -> Self {
        Self(HEADER.to_vec())
    }

    fn aligned(&mut self, bytes: &[u8]) {
        while !(self.0.len() - HEADER.len()).is_multiple_of(bytes.len()) {
            self.0.push(0);
        }
        self.0.extend_from_slice(bytes);
    }

    fn u32(&mut self, value: u32) {
        self.aligned(&value.to_le_bytes());
    }

    fn f64s(&mut self, values: &[f64]) {
        values
            .iter()
            .for_each(|value| self.aligned(&value.to_le_bytes()));
    }

    fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
    }

    fn header(&mut self, stamp_ns: u64, frame: &str) {
        self.u32((stamp_ns / 1_000_000_000) as u32);
        self.u32((stamp_ns % 1_000_000_000) as u32);
        self.text(frame);
    }

    /// Position, then quaternion.
    fn pose(&mut self, pose: &Isometry3<f64>) {
        self.f64s(pose.translation.vector.as_slice());
        self.f64s(pose.rotation.coords.as_slice());
    }
}

/// A `CompressedImage` around an encoded image.
pub(super) fn compressed_image(stamp_ns: u64, frame: &str, format: &str, bytes: &[u8]) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.header(stamp_ns, frame);
    cdr.text(format);
    cdr.u32(bytes.len() as u32);
    cdr.0.extend_from_slice(bytes);
    cdr.0
}

/// A `CameraInfo`.
pub(super) fn camera_info(
    stamp_ns: u64,
    frame: &str,
    (width, height): (u32, u32),
    lens: &Intrinsics,
) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.header(stamp_ns, frame);
    cdr.u32(height);
    cdr.u32(width);
    cdr.text(&lens.model);
    cdr.u32(lens.d.len() as u32);
    cdr.f64s(&lens.d);
    let k = &lens.k;
    cdr.f64s(k);
    cdr.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    cdr.f64s(&[
        k[0], k[1], k[2], 0.0, k[3], k[4], k[5], 0.0, k[6], k[7], k[8], 0.0,
    ]);
    // Binning, and a region of interest that is the whole image.
    (0..6).for_each(|_| cdr.u32(0));
    cdr.0.push(0);
    cdr.0
}

/// An `Odometry` message; covariances and speeds are zero: the source does not say them.
pub(super) fn odometry(stamp_ns: u64, odom_from_vehicle: &Isometry3<f64>) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.header(stamp_ns, ODOM);
    cdr.text(VEHICLE);
    cdr.pose(odom_from_vehicle);
    cdr.f64s(&[0.0; 36]);
    cdr.f64s(&[0.0; 6]);
    cdr.f64s(&[0.0; 36]);
    cdr.0
}

/// A `TFMessage` from each camera to the vehicle.
pub(super) fn transforms(stamp_ns: u64, cameras: &[(&str, Isometry3<f64>)]) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.u32(cameras.len() as u32);
    for (camera, vehicle_from_camera) in cameras {
        cdr.header(stamp_ns, VEHICLE);
        cdr.text(camera);
        cdr.pose(vehicle_from_camera);
    }
    cdr.0
}
