//! What a log holds, whatever its messages are called: the tables that a session manifest maps topics to.
//!
//! These are the *sources* of every plan. `datasets` fills them; operators read them.

use crate::{ImageRef, Layer, LayerRow, Pose, Stamp, record};

record! {
    /// One image of one camera, by reference.
    pub struct Frame {
        /// Site that the session belongs to.
        site: String,
        /// Session that the image belongs to.
        session: String,
        /// Exposure instant, from the message header; the log time where the message has no header.
        stamp: Stamp ["ns"],
        /// Camera: the header's frame name where a calibration has the same one, else the topic without its last parts.
        camera: String,
        /// Topic that the image was recorded on.
        topic: String,
        /// When it was recorded.
        log_time: Stamp ["ns"],
        /// Where the pixels are.
        image: ImageRef,
    }
}
impl LayerRow for Frame {
    const NAME: &'static str = "frames";
    const DOC: &'static str = "One image of one camera, by reference.";
    const KEY: &'static [&'static str] = &["site", "session", "stamp", "camera"];
}
impl Frame {
    /// Range images: 16-bit, in units that the log's maker chose (mostly mm), 0 where there is none.
    pub fn depth_layer() -> Layer {
        Layer {
            name: "depth_frames",
            doc: "One range image of one camera, by reference.",
            ..Self::layer()
        }
    }

    /// Label images: 8-bit, each value a class; `label_classes` says which.
    pub fn label_layer() -> Layer {
        Layer {
            name: "label_frames",
            doc: "One image of class labels, by reference.",
            ..Self::layer()
        }
    }
}

record! {
    /// One odometry message.
    pub struct OdometryPose {
        /// Site that the session belongs to.
        site: String,
        /// Session that the pose belongs to.
        session: String,
        /// Instant of the pose.
        stamp: Stamp ["ns"],
        /// Topic that the pose was recorded on.
        topic: String,
        /// The vehicle in the drifting odometry frame.
        odom_from_vehicle: Pose ["", "odom"],
        /// Speed along the vehicle's x axis; null where the log does not say it.
        speed_mps: Option<f64> ["m/s", "vehicle"],
        /// Rate of turn about the vehicle's z axis; null where the log does not say it.
        yaw_rate_radps: Option<f64> ["rad/s", "vehicle"],
    }
}
impl LayerRow for OdometryPose {
    const NAME: &'static str = "odometry";
    const DOC: &'static str = "One odometry message: the vehicle in the drifting odometry frame.";
    const KEY: &'static [&'static str] = &["site", "session", "stamp"];
}

record! {
    /// One camera's intrinsic calibration, valid from its stamp on.
    pub struct Calibration {
        /// Site that the session belongs to.
        site: String,
        /// Session that the calibration belongs to.
        session: String,
        /// Instant from which it holds.
        stamp: Stamp ["ns"],
        /// Camera that it describes; the optical frame's name.
        camera: String,
        /// Image width that the intrinsics are for.
        width: u32 ["px"],
        /// Image height that the intrinsics are for.
        height: u32 ["px"],
        /// `plumb_bob`, `rational_polynomial`, `equidistant`, `equirectangular` or `ocam`.
        model: String,
        /// Camera matrix, row-major; equirectangular and OCam say on the camera model's page what theirs hold.
        intrinsics: Vec<f64> ["px"],
        /// Distortion coefficients of the model.
        distortion: Vec<f64>,
    }
}
impl LayerRow for Calibration {
    const NAME: &'static str = "calibration";
    const DOC: &'static str =
        "One camera's intrinsic calibration; repeats of an unchanged calibration are dropped.";
    const KEY: &'static [&'static str] = &["site", "session", "camera", "stamp"];
}

record! {
    /// One transform between two frames.
    pub struct Transform {
        /// Site that the session belongs to.
        site: String,
        /// Session that the transform belongs to.
        session: String,
        /// Instant of the transform.
        stamp: Stamp ["ns"],
        /// Frame that points come out in.
        parent: String,
        /// Frame that points are given in.
        child: String,
        /// The transform.
        parent_from_child: Pose,
        /// True where it holds for all time (`/tf_static`).
        fixed: bool,
    }
}
impl LayerRow for Transform {
    const NAME: &'static str = "transforms";
    const DOC: &'static str =
        "One transform between two frames, as `/tf` and `/tf_static` publish them.";
    const KEY: &'static [&'static str] = &["site", "session", "parent", "child", "stamp"];
}

record! {
    /// What a value in the label images of a session means.
    pub struct LabelClass {
        /// Site that the session belongs to.
        site: String,
        /// Session that it holds for.
        session: String,
        /// Pixel value.
        value: u8,
        /// Name of the class.
        class: String,
    }
}
impl LayerRow for LabelClass {
    const NAME: &'static str = "label_classes";
    const DOC: &'static str =
        "What a value in the label images of a session means: the log's metadata `label_classes`.";
    const KEY: &'static [&'static str] = &["site", "session", "value"];
}
