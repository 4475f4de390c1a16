//! Intrinsic calibrations; logs repeat them with every image, the table does not.

use crate::roles::cameras::topic_camera;
use crate::roles::{FromMessage, Message, Messages, Role};
use crate::{Stamp, record};

record! {
    /// One camera's intrinsic calibration, valid from its stamp on; repeats of an unchanged calibration are dropped.
    #[layer("calibration", key(site, session, camera, stamp))]
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

/// Topics with intrinsic calibrations.
pub const ROLE: Role = Role::of::<Calibration>(Messages {
    drop_repeats: true,
    lasting: true,
    ..Messages::of::<Calibration>(&["sensor_msgs/CameraInfo", "foxglove.CameraCalibration"])
});

impl FromMessage for Calibration {
    const MEMBERS: &'static [&'static str] = &[
        "header",
        "timestamp",
        "frame_id",
        "width",
        "height",
        "distortion_model",
        "d",
        "D",
        "k",
        "K",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let fields = &message.fields;
        let intrinsics = fields.numbers(&["k", "K"]);
        let distortion = fields.numbers(&["d", "D"]);
        if intrinsics.iter().chain(&distortion).any(|n| !n.is_finite()) {
            return Err("expected finite intrinsics".to_owned());
        }
        // CameraInfo: "if K[0] is 0, the camera is uncalibrated".
        if intrinsics.first().is_none_or(|fx| *fx == 0.0) {
            return Ok(Vec::new());
        }
        let size = |name: &str| fields.number(&[name]).unwrap_or(0.0) as u32;
        let model = fields.text(&["distortion_model"]).unwrap_or_default();
        let frame = message.frame();
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp(),
            camera: match frame.is_empty() {
                true => topic_camera(message.topic),
                false => frame,
            },
            width: size("width"),
            height: size("height"),
            model: plain_model(&model),
            intrinsics,
            distortion,
        }])
    }
}

/// The model's name as the layer spells it; a model that is not known here stays as it is.
fn plain_model(model: &str) -> String {
    match model.to_lowercase().as_str() {
        "" | "radtan" | "brown_conrady" => "plumb_bob".to_owned(),
        "fisheye" | "kannala_brandt" | "kannalabrandt" | "kannala_brandt4" => {
            "equidistant".to_owned()
        }
        other => other.to_owned(),
    }
}
