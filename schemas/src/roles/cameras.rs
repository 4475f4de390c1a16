//! What cameras are called: the frame of their calibration, if images and calibrations can be told to belong together.

use std::collections::BTreeMap;

/// The calibrated cameras of one session.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CameraNames {
    /// Camera by the prefix of its calibration's topic.
    by_prefix: BTreeMap<String, String>,
}

impl CameraNames {
    /// Whether the camera of a calibration topic, or of one with the same prefix, is known.
    pub fn knows(&self, topic: &str) -> bool {
        self.by_prefix.contains_key(&topic_camera(topic))
    }

    /// Notes the camera that a calibration topic describes.
    pub fn add(&mut self, topic: &str, camera: String) {
        self.by_prefix.insert(topic_camera(topic), camera);
    }

    /// The camera of an image: the image's frame where a calibration has the same one, else that of the calibration
    /// whose topic has the same prefix, else the topic's own prefix.
    pub fn name(&self, topic: &str, frame: &str) -> String {
        if !frame.is_empty() && self.by_prefix.values().any(|camera| camera == frame) {
            return frame.to_owned();
        }
        let prefix = topic_camera(topic);
        self.by_prefix.get(&prefix).cloned().unwrap_or(prefix)
    }
}

/// Last parts of a topic that say what is sent, not who sends it.
const KINDS: [&str; 14] = [
    "compressed",
    "compressed_image",
    "image",
    "image_raw",
    "image_raw_compressed",
    "image_color",
    "image_mono",
    "image_rect",
    "image_rect_color",
    "camera_info",
    "calibration",
    "raw",
    "labels",
    "depth",
];

/// A topic without the last parts that say what is sent, and without the slash in front: `/front/image_raw/compressed`
/// is of `front`.
pub(super) fn topic_camera(topic: &str) -> String {
    let mut parts: Vec<&str> = topic.split('/').filter(|part| !part.is_empty()).collect();
    while parts.len() > 1 && parts.last().is_some_and(|last| KINDS.contains(last)) {
        parts.pop();
    }
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_named_by_its_calibration_or_by_its_topic() {
        let mut names = CameraNames::default();
        names.add("/front/camera_info", "front_optical".to_owned());
        assert!(names.knows("/front/calibration") && !names.knows("/left/camera_info"));
        assert_eq!(
            names.name("/front/image_raw", "front_optical"),
            "front_optical"
        );
        assert_eq!(
            names.name("/front/image_raw/compressed", ""),
            "front_optical"
        );
        assert_eq!(names.name("/left/image_raw", "left_optical"), "left");
        assert_eq!(names.name("/image", ""), "image");
    }
}
