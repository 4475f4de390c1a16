//! The ROS 2 messages of a session.

use crate::cdr::CdrWriter;
use crate::odometry::OdometrySample;
use evermap_algorithms::geometry::pose::Pose;

/// A message type: its name and full definition.
#[derive(Debug, Clone, Copy)]
pub struct MessageType {
    /// `package/msg/Name`.
    pub name: &'static str,
    /// The definition and, after separators, those of all types it uses.
    pub definition: &'static str,
}

/// `sensor_msgs/msg/CompressedImage`.
pub const COMPRESSED_IMAGE: MessageType = MessageType {
    name: "sensor_msgs/msg/CompressedImage",
    definition: include_str!("definitions/CompressedImage.msg"),
};
/// `sensor_msgs/msg/CameraInfo`.
pub const CAMERA_INFO: MessageType = MessageType {
    name: "sensor_msgs/msg/CameraInfo",
    definition: include_str!("definitions/CameraInfo.msg"),
};
/// `nav_msgs/msg/Odometry`.
pub const ODOMETRY: MessageType = MessageType {
    name: "nav_msgs/msg/Odometry",
    definition: include_str!("definitions/Odometry.msg"),
};
/// `tf2_msgs/msg/TFMessage`.
pub const TF_MESSAGE: MessageType = MessageType {
    name: "tf2_msgs/msg/TFMessage",
    definition: include_str!("definitions/TFMessage.msg"),
};

/// The vehicle's frame: x forward, y left, z up, on the ground below the rear axle.
pub const VEHICLE_FRAME: &str = "base_link";
/// The frame odometry is given in.
pub const ODOM_FRAME: &str = "odom";

fn header(cdr: &mut CdrWriter, stamp_ns: u64, frame_id: &str) {
    cdr.i32((stamp_ns / 1_000_000_000) as i32);
    cdr.u32((stamp_ns % 1_000_000_000) as u32);
    cdr.string(frame_id);
}

/// The `format` of a grey JPEG, as some drivers write it.
pub const GREY_JPEG: &str = "mono8; jpeg compressed ";

/// A `CompressedImage` around an encoded image.
pub fn compressed_image(stamp_ns: u64, frame_id: &str, format: &str, image: &[u8]) -> Vec<u8> {
    let mut cdr = CdrWriter::default();
    header(&mut cdr, stamp_ns, frame_id);
    cdr.string(format);
    cdr.u8_sequence(image);
    cdr.finish()
}

/// What a `CameraInfo` says.
#[derive(Debug, Clone, Copy)]
pub struct Calibration<'a> {
    /// The optical frame.
    pub frame_id: &'a str,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// `distortion_model`.
    pub model: &'a str,
    /// Focal lengths, pixels; of a panorama, pixels per radian.
    pub focal: [f64; 2],
    /// Principal point, pixels.
    pub centre: [f64; 2],
    /// D.
    pub distortion: &'a [f64],
}

/// A `CameraInfo`.
pub fn camera_info(stamp_ns: u64, camera: &Calibration<'_>) -> Vec<u8> {
    let ([fx, fy], [cx, cy]) = (camera.focal, camera.centre);
    let mut cdr = CdrWriter::default();
    header(&mut cdr, stamp_ns, camera.frame_id);
    cdr.u32(camera.size[1]);
    cdr.u32(camera.size[0]);
    cdr.string(camera.model);
    cdr.f64_sequence(camera.distortion);
    cdr.f64_array(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    cdr.f64_array(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    cdr.f64_array(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    for _ in 0..6 {
        cdr.u32(0);
    }
    cdr.u8(0);
    cdr.finish()
}

/// An `Odometry` message. Its covariance grows with the distance driven.
pub fn odometry(sample: &OdometrySample) -> Vec<u8> {
    let pose = Pose::from_yaw(sample.x, sample.y, sample.yaw);
    let mut cdr = CdrWriter::default();
    header(&mut cdr, sample.stamp_ns, ODOM_FRAME);
    cdr.string(VEHICLE_FRAME);
    cdr.f64_array(&pose.to_array());
    let place = 1e-4 + (0.01 * sample.driven).powi(2);
    let turn = 1e-5 + (0.001 * sample.driven).powi(2);
    cdr.f64_array(&diagonal([place, place, 0.01, 1e-4, 1e-4, turn]));
    cdr.f64_array(&[sample.speed, 0.0, 0.0, 0.0, 0.0, sample.yaw_rate]);
    cdr.f64_array(&diagonal([0.01, 1e-4, 1e-6, 1e-6, 1e-6, 0.01]));
    cdr.finish()
}

fn diagonal(values: [f64; 6]) -> [f64; 36] {
    let mut matrix = [0.0; 36];
    for (k, value) in values.into_iter().enumerate() {
        matrix[7 * k] = value;
    }
    matrix
}

/// The static transforms of a rig: each camera's frame and `vehicle_from_camera`.
pub fn static_transforms(stamp_ns: u64, rig: &[(&str, &Pose)]) -> Vec<u8> {
    let mut cdr = CdrWriter::default();
    cdr.u32(rig.len() as u32);
    for (frame_id, vehicle_from_camera) in rig {
        header(&mut cdr, stamp_ns, VEHICLE_FRAME);
        cdr.string(frame_id);
        cdr.f64_array(&vehicle_from_camera.to_array());
    }
    cdr.finish()
}
