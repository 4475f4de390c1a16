//! What cameras are called: the frame of their calibration, if images and calibrations can be told to belong together;
//! and which of their images are read, those of the lens or those that were rectified.

use std::collections::{BTreeMap, BTreeSet};

use crate::roles::{Role, depth_frames, frames, label_frames};

/// The calibrated cameras of one session.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CameraNames {
    /// Camera by the prefix of its calibration's topic.
    by_prefix: BTreeMap<String, String>,
    /// The prefixes of which rectified images alone are read.
    rectified: BTreeSet<String>,
    /// The prefixes of which pictures are read.
    pictured: BTreeSet<String>,
}

impl CameraNames {
    /// No names yet, but which images are read, by the topics of each role that has some. Where pictures are read of a
    /// prefix, they decide.
    pub fn of_images<'a>(topics: impl Fn(&Role) -> Vec<&'a str>) -> Self {
        let mut known = BTreeMap::<String, bool>::new();
        for role in [frames::ROLE, depth_frames::ROLE, label_frames::ROLE] {
            let mut of_role = BTreeMap::<String, bool>::new();
            for topic in topics(&role) {
                *of_role.entry(topic_camera(topic)).or_insert(true) &= is_rectified(topic);
            }
            for (prefix, rectified) in of_role {
                known.entry(prefix).or_insert(rectified);
            }
        }
        let rectified = known.into_iter().filter(|(_, rectified)| *rectified);
        let pictures = topics(&frames::ROLE).into_iter();
        Self {
            by_prefix: BTreeMap::new(),
            rectified: rectified.map(|(prefix, _)| prefix).collect(),
            pictured: pictures.map(topic_camera).collect(),
        }
    }

    /// The same images, without any names.
    #[must_use]
    pub fn unnamed(&self) -> Self {
        Self {
            by_prefix: BTreeMap::new(),
            ..self.clone()
        }
    }

    /// Whether a calibration topic is read as that of rectified images: no others of its prefix are read.
    pub(super) fn calibrates_rectified(&self, topic: &str) -> bool {
        self.rectified.contains(&topic_camera(topic))
    }

    /// Whether a camera's calibration is read as that of its rectified images; `None` where it has none, or one of either
    /// kind.
    pub(super) fn is_rectified(&self, camera: &str) -> Option<bool> {
        let of_camera = self.by_prefix.iter().filter(|(_, name)| *name == camera);
        let first = self.first_pictured(camera);
        let is_left_out =
            |prefix: &String| self.pictured.contains(prefix) && first != Some(prefix.as_str());
        let of_camera = of_camera.filter(|(prefix, _)| !is_left_out(prefix));
        let mut read = of_camera.map(|(prefix, _)| self.rectified.contains(prefix));
        let first = read.next()?;
        read.all(|other| other == first).then_some(first)
    }

    /// Whether the camera of a calibration topic, or of one with the same prefix, is known.
    pub fn knows(&self, topic: &str) -> bool {
        self.by_prefix.contains_key(&topic_camera(topic))
    }

    /// Notes the camera that a calibration topic describes.
    pub fn add(&mut self, topic: &str, camera: String) {
        self.by_prefix.insert(topic_camera(topic), camera);
    }

    /// The first of the prefixes with pictures whose calibrations are of a camera: what others send under its name is
    /// not read. `None` where nobody has both.
    fn first_pictured(&self, camera: &str) -> Option<&str> {
        let mut calibrated = self.by_prefix.iter();
        let first =
            calibrated.find(|(prefix, name)| *name == camera && self.pictured.contains(*prefix))?;
        Some(first.0)
    }

    /// The prefix whose calibrations are read for a camera instead of those of this topic; `None` where these are.
    pub(super) fn calibrated_by(&self, topic: &str, camera: &str) -> Option<&str> {
        let first = self.first_pictured(camera)?;
        (first != topic_camera(topic)).then_some(first)
    }

    /// The prefix whose images are read for a camera instead of those of this topic; `None` where these are. Range and
    /// label images may have a prefix of their own.
    pub(super) fn pictured_by(&self, topic: &str, camera: &str) -> Option<&str> {
        let is_pictured = self.pictured.contains(&topic_camera(topic));
        self.calibrated_by(topic, camera).filter(|_| is_pictured)
    }

    /// What is wrong with a calibration topic whose pictures are not read, as another one with pictures is of the same
    /// camera, in words; `None` where they are.
    pub fn doubled(&self, topic: &str) -> Option<String> {
        let camera = self.by_prefix.get(&topic_camera(topic))?;
        let first = self.pictured_by(topic, camera)?;
        Some(both_of(first, topic, camera))
    }

    /// Whether the calibrations of this topic's prefix are of this camera.
    pub(super) fn is_calibrated_as(&self, topic: &str, camera: &str) -> bool {
        let named = self.by_prefix.get(&topic_camera(topic));
        named.is_some_and(|name| name == camera)
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

/// That the pictures of two prefixes are of one camera.
pub(super) fn both_of(first: &str, topic: &str, camera: &str) -> String {
    let other = topic_camera(topic);
    format!(
        "/{first} and /{other} are both of frame {camera}: only the first is read; choose with `roles: frames` in a \
         session manifest"
    )
}

/// Last parts of a topic that say what is sent, not who sends it.
const KINDS: [&str; 14] = [
    "compressed",
    "compressedDepth",
    "ffmpeg",
    "compressed_image",
    "image",
    "image_raw",
    "image_raw_compressed",
    "image_color",
    "image_mono",
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
    while parts.len() > 1 && parts.last().is_some_and(|last| is_kind(last)) {
        parts.pop();
    }
    parts.join("/")
}

fn is_kind(part: &str) -> bool {
    KINDS.contains(&part) || part.starts_with("image") && is_rectified(part)
}

/// Whether a topic says that its images were rectified, as those of ROS do: `image_rect`, `image_rect_color`.
pub(super) fn is_rectified(topic: &str) -> bool {
    let said = |word: &str| {
        let words = ["rect", "rectified"];
        words.iter().any(|known| word.eq_ignore_ascii_case(known))
    };
    topic.split(['/', '_']).any(said)
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
        assert_eq!(names.name("/left/image_rect_mono/ffmpeg", ""), "left");
        assert_eq!(names.name("/front_rect/image", ""), "front_rect");
    }

    #[test]
    fn a_topic_says_that_its_images_are_rectified_by_a_word_of_its_own() {
        for topic in [
            "/l/image_rect",
            "/l/image_rect_color/compressed",
            "/rect/l",
            "/l/Image_Rectified",
        ] {
            assert!(is_rectified(topic), "{topic}");
        }
        for topic in ["/l/image_raw", "/direct/image", "/l/rectangles"] {
            assert!(!is_rectified(topic), "{topic}");
        }
    }

    #[test]
    fn calibrations_are_of_the_images_that_are_read_and_pictures_decide() {
        let topics = |role: &Role| match role.name {
            "frames" => vec!["/left/image_rect", "/right/image_raw", "/right/image_rect"],
            "depth_frames" => vec![
                "/left/depth/image",
                "/range/image_rect_raw",
                "/right/depth/image_rect",
            ],
            _ => Vec::new(),
        };
        let mut names = CameraNames::of_images(topics);
        let expected = [
            ("left", true),
            ("right", false),
            ("range", true),
            ("rear", false),
        ];
        for (camera, rectified) in expected {
            let topic = format!("/{camera}/camera_info");
            assert_eq!(names.calibrates_rectified(&topic), rectified, "{camera}");
            assert_eq!(names.is_rectified(camera), None);
            names.add(&topic, camera.to_owned());
            assert_eq!(names.is_rectified(camera), Some(rectified));
        }
        names.add("/rear/camera_info", "left".to_owned());
        assert_eq!(names.is_rectified("left"), None);
    }

    #[test]
    fn of_two_prefixes_with_pictures_under_one_name_the_first_is_read() {
        let topics = |role: &Role| match role.name {
            "frames" => vec![
                "/left/image_raw",
                "/left/image/compressed",
                "/right/image_raw",
            ],
            "depth_frames" => vec!["/aligned/image_raw", "/right/depth"],
            _ => Vec::new(),
        };
        let mut names = CameraNames::of_images(topics);
        for prefix in ["right", "aligned", "left"] {
            let topic = format!("/{prefix}/camera_info");
            names.add(&topic, "optical".to_owned());
        }
        for (topic, instead) in [
            ("/left/image_raw", None),
            ("/left/image_rect_color/compressed", None),
            ("/left/depth", None),
            ("/right/image_raw", Some("left")),
            ("/right/depth", Some("left")),
            ("/aligned/image_raw", None),
        ] {
            assert_eq!(names.pictured_by(topic, "optical"), instead, "{topic}");
            assert_eq!(names.pictured_by(topic, "other"), None);
        }
        // The lens of a camera is that of its pictures.
        let info = |prefix: &str| format!("/{prefix}/camera_info");
        let calibrated = |prefix| names.calibrated_by(&info(prefix), "optical");
        assert_eq!(calibrated("left"), None);
        assert_eq!(calibrated("right"), Some("left"));
        assert_eq!(calibrated("aligned"), Some("left"));
        let said = "/left and /right are both of frame optical: only the first is read; choose with `roles: frames` in \
                    a session manifest";
        assert_eq!(names.doubled(&info("right")).as_deref(), Some(said));
        assert_eq!(names.doubled(&info("left")), None);
        assert_eq!(names.doubled(&info("aligned")), None);
        let unnamed = names.unnamed();
        assert_eq!(unnamed.calibrated_by(&info("right"), "optical"), None);
    }
}
