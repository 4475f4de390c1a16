//! Intrinsic calibrations; logs repeat them with every image, the table does not.

use evermap_messages::MessageType;
use evermap_schemas::Fault;
use evermap_schemas::roles::Calibration;

use crate::roles::cameras::topic_camera;
use crate::roles::rows::{Decoded, FromMessages};
use crate::roles::{Provider, view};
use crate::scan::MessageAt;

/// A row stays where it is the first of its camera, or differs from the one before it in time.
const WITHOUT_REPEATS: &str = "
    SELECT site, session, stamp, camera, width, height, model, intrinsics, distortion
    FROM (
        SELECT *, lag(content) OVER (PARTITION BY site, session, camera ORDER BY stamp, content) AS previous
        FROM (
            SELECT *, concat_ws(' ', width, height, model, array_to_string(intrinsics, ','), '/',
                array_to_string(distortion, ',')) AS content
            FROM calibration_messages
        )
    )
    WHERE previous IS NULL OR previous <> content";

/// The table without repeats of an unchanged calibration.
pub(crate) fn without_repeats(messages: Provider) -> Result<Provider, Fault> {
    view(WITHOUT_REPEATS, [("calibration_messages", messages)])
}

impl FromMessages for Calibration {
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
    type Note = ();

    fn note(_: &MessageType, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn rows(message: Decoded<'_>, (): ()) -> Result<Vec<Self>, String> {
        let (columns, row) = (message.columns, message.row);
        let model = columns.text(&["distortion_model"], row);
        let model = plain_model(&model.unwrap_or_default());
        let intrinsics = columns.numbers(&["k", "K"], row);
        let distortion = columns.numbers(&["d", "D"], row);
        if intrinsics.iter().chain(&distortion).any(|n| !n.is_finite()) {
            return Err("expected finite intrinsics".to_owned());
        }
        // CameraInfo: "if K[0] is 0, the camera is uncalibrated".
        if intrinsics.first().is_none_or(|fx| *fx == 0.0) {
            return Ok(Vec::new());
        }
        let size = |name: &str| columns.number(&[name], row).unwrap_or(0.0) as u32;
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
            model,
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
