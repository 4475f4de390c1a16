//! What cameras are called: the frame of their calibration, if images and calibrations can be told to belong together;
//! and which of their images are read, those of the lens or those that were rectified.

use std::collections::{BTreeMap, BTreeSet};

use crate::Pose;
use crate::roles::content::{Content, content_of};
use crate::roles::stereo::{self, CalibratedCamera, CameraMount};
use crate::roles::{Role, depth_frames, frames, label_frames};

/// The calibrated cameras of one session.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraNames {
    /// Camera by the prefix of its calibration's topic.
    by_prefix: BTreeMap<String, NamedCamera>,
    /// The frames that calibrations name of which none is read, by the prefix of their topic.
    unread: BTreeMap<String, String>,
    /// The prefixes of which rectified images alone are read.
    rectified: BTreeSet<String>,
    /// The prefixes of which pictures are read.
    pictured: BTreeSet<String>,
}

/// A calibrated camera, and what it is called.
#[derive(Debug, Clone, PartialEq)]
struct NamedCamera {
    camera: String,
    said: CalibratedCamera,
    /// The first camera of its pair in the pair's axes, where it names that one's frame; in words, why nobody knows how the
    /// two stand to each other.
    first: Option<Result<Pose, String>>,
}

/// The first camera of those that name one frame.
struct First {
    prefix: String,
    /// The camera in the axes of its pair, or what is wrong with its calibration.
    pair_from_camera: Result<Pose, String>,
}

impl First {
    fn of((prefix, NamedCamera { said, .. }): (&String, &NamedCamera)) -> Self {
        let why = said.unplaced.clone().unwrap_or_default();
        Self {
            prefix: prefix.clone(),
            pair_from_camera: said.pair_from_camera.clone().ok_or(why),
        }
    }

    /// This camera in the axes of the pair, for a second one of it that its own calibration places, too.
    fn seen_by(&self, prefix: &str, said: &CalibratedCamera) -> Result<Pose, String> {
        let first = &self.prefix;
        let lost = |of: &str, why: &str| {
            format!(
                "/{prefix} names the frame {} of /{first}, and nobody knows how the two stand to each other, so its images \
                 are left out: calibration of /{of}: {why}; correct it, let /{prefix} name a frame of its own, or choose \
                 with `roles: frames` in a session manifest",
                said.frame
            )
        };
        match (&self.pair_from_camera, &said.unplaced) {
            (Err(why), _) => Err(lost(first, why)),
            (Ok(_), Some(why)) => Err(lost(prefix, why)),
            (Ok(pose), None) => Ok(pose.clone()),
        }
    }
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
            unread: BTreeMap::new(),
            rectified: rectified.map(|(prefix, _)| prefix).collect(),
            pictured: pictures.map(topic_camera).collect(),
        }
    }

    /// Whether a calibration topic is read as that of rectified images: no others of its prefix are read.
    pub(super) fn calibrates_rectified(&self, topic: &str) -> bool {
        self.rectified.contains(&topic_camera(topic))
    }

    /// Whether a camera's calibration is read as that of its rectified images; `None` where it has none, or one of either
    /// kind.
    pub(super) fn is_rectified(&self, camera: &str) -> Option<bool> {
        let named = self.by_prefix.iter();
        let of_camera = named.filter(|(_, named)| named.camera == camera);
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

    /// Notes the camera that a calibration topic describes. It is called by the frame that it names; one with pictures that
    /// stands beside another camera of that frame, the first of their pair, by its prefix.
    pub fn add(&mut self, topic: &str, said: CalibratedCamera) {
        let frame = said.frame.clone();
        let named = NamedCamera {
            camera: frame.clone(),
            said,
            first: None,
        };
        let prefix = topic_camera(topic);
        let before = self.unread.remove(&prefix);
        self.by_prefix.insert(prefix, named);
        self.pair(&frame);
        if let Some(before) = before {
            self.pair(&before);
        }
    }

    /// Notes the frame that a calibration topic names of which no calibration is read, as it makes no sense or has no lens:
    /// the camera may be the first of a pair.
    pub fn add_unread(&mut self, topic: &str, frame: String) {
        let prefix = topic_camera(topic);
        if !self.by_prefix.contains_key(&prefix) {
            self.unread.insert(prefix, frame.clone());
            self.pair(&frame);
        }
    }

    /// Tells the cameras apart that name this frame.
    fn pair(&mut self, frame: &str) {
        let first = self.first(frame);
        let pictured = &self.pictured;
        let of_frame = self.by_prefix.iter_mut();
        for (prefix, named) in of_frame.filter(|(_, named)| named.said.frame == frame) {
            let may_be_second = named.said.is_beside != Some(false) && pictured.contains(prefix);
            let first = first.as_ref();
            let first = first.filter(|first| may_be_second && first.prefix != *prefix);
            named.first = first.map(|first| first.seen_by(prefix, &named.said));
            named.camera = match named.first {
                Some(_) => prefix.clone(),
                None => frame.to_owned(),
            };
        }
    }

    /// The first camera of those that name this frame: one whose P has it stand beside no other; else one with pictures of
    /// which nobody knows. Range images that are aligned to a camera have its place, and often a P that does not say so: they
    /// are not the first of a pair.
    fn first(&self, frame: &str) -> Option<First> {
        let is_pictured = |prefix: &String| self.pictured.contains(prefix);
        let of_frame = || {
            let named = self.by_prefix.iter();
            named.filter(move |(_, named)| named.said.frame == frame)
        };
        let firsts = of_frame().filter(|(prefix, named)| {
            let is_picture = content_of(prefix) == Content::Picture;
            named.said.is_beside == Some(false) && (is_picture || is_pictured(prefix))
        });
        let first = firsts.min_by_key(|(prefix, _)| !is_pictured(prefix));
        let mut unread = self.unread.iter();
        let unread = unread.find(|(prefix, named)| *named == frame && is_pictured(prefix));
        let unread = unread.map(|(prefix, _)| First {
            prefix: prefix.clone(),
            pair_from_camera: Err("expected one with a lens, found none that is read".to_owned()),
        });
        let is_unknown = |(prefix, named): &(&String, &NamedCamera)| {
            named.said.is_beside.is_none() && is_pictured(prefix)
        };
        let unknown = || of_frame().find(is_unknown).map(First::of);
        first.map(First::of).or(unread).or_else(unknown)
    }

    /// The camera of a calibration of this topic that names a frame.
    pub(super) fn calibrated(&self, topic: &str, frame: &str) -> String {
        match self.pair_of(topic, frame) {
            Some(_) => topic_camera(topic),
            None => frame.to_owned(),
        }
    }

    /// The first camera of a pair, in the pair's axes, where the calibrations of this topic are of another one of the pair
    /// that names its frame.
    pub(super) fn first_of_pair(&self, topic: &str, frame: &str) -> Option<&Pose> {
        self.pair_of(topic, frame)?.as_ref().ok()
    }

    /// The same, or why nobody knows how the two stand to each other.
    fn pair_of(&self, topic: &str, frame: &str) -> Option<&Result<Pose, String>> {
        let named = self.by_prefix.get(&topic_camera(topic))?;
        named.first.as_ref().filter(|_| named.said.frame == frame)
    }

    /// Whether this topic's prefix is of this camera, and nobody knows how it stands to the first one of its pair: neither
    /// its images nor its calibrations are read.
    pub(super) fn is_unplaced(&self, topic: &str, camera: &str) -> bool {
        let named = self.by_prefix.get(&topic_camera(topic));
        named.is_some_and(|named| named.camera == camera && matches!(named.first, Some(Err(_))))
    }

    /// Where cameras are mounted by their first calibrations, by name; those that are not at the frame of their name.
    pub fn mounts(&self) -> BTreeMap<String, CameraMount> {
        let mount = |(prefix, named): (&String, &NamedCamera)| {
            if self.calibrated_by(prefix, &named.camera).is_some() {
                return None;
            }
            let (said, first) = (&named.said, named.first.as_ref());
            let first = first.map(Result::as_ref).transpose().ok()?;
            let is_rectified = self.rectified.contains(prefix);
            // Without a pose it is one that stands in its own frame, whose images are not rectified.
            let camera = said.pair_from_camera.as_ref()?;
            let mount = stereo::mount(&said.frame, camera, first, is_rectified)?;
            Some((named.camera.clone(), mount))
        };
        self.by_prefix.iter().filter_map(mount).collect()
    }

    /// The first of the prefixes with pictures whose calibrations are of a camera: what others send under its name is
    /// not read. `None` where nobody has both.
    fn first_pictured(&self, camera: &str) -> Option<&str> {
        let mut calibrated = self.by_prefix.iter();
        let first = calibrated
            .find(|(prefix, named)| named.camera == camera && self.pictured.contains(*prefix))?;
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
    /// camera, or nobody knows how it stands to the first one of its pair, in words; `None` where they are.
    pub fn left_out(&self, topic: &str) -> Option<String> {
        let NamedCamera { camera, first, .. } = self.by_prefix.get(&topic_camera(topic))?;
        if let Some(Err(why)) = first {
            return Some(why.clone());
        }
        let first = self.pictured_by(topic, camera)?;
        Some(both_of(first, topic, camera))
    }

    /// Whether the calibrations of this topic's prefix are of this camera.
    pub(super) fn is_calibrated_as(&self, topic: &str, camera: &str) -> bool {
        let named = self.by_prefix.get(&topic_camera(topic));
        named.is_some_and(|named| named.camera == camera)
    }

    /// The camera of an image: that of the calibration whose topic has the same prefix and which names the image's frame;
    /// else this frame where a calibration's camera is called so, else the camera of the same prefix, else the frame that it
    /// shares with the calibration of its prefix, which is not read, and with no others, else the prefix.
    pub fn name(&self, topic: &str, frame: &str) -> String {
        let prefix = topic_camera(topic);
        let own = self.by_prefix.get(&prefix);
        let is_of_other = own.is_none_or(|own| own.said.frame != frame) && !frame.is_empty();
        if is_of_other && self.by_prefix.values().any(|named| named.camera == frame) {
            return frame.to_owned();
        }
        let own = own.map(|own| own.camera.clone());
        own.or_else(|| self.unread_frame(&prefix, frame))
            .unwrap_or(prefix)
    }

    /// This frame, where the calibration of a prefix names it that is not read, and no other one does.
    fn unread_frame(&self, prefix: &str, frame: &str) -> Option<String> {
        let read = self.by_prefix.values().map(|named| &named.said.frame);
        let named = read.chain(self.unread.values());
        let is_its_own = named.filter(|named| *named == frame).count() == 1;
        let unread = self.unread.get(prefix);
        let unread = unread.filter(|unread| is_its_own && *unread == frame);
        unread.cloned()
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

/// Whether a part of a topic's name says that images are sent, or what is told of them, and not who sends.
pub(super) fn is_kind(part: &str) -> bool {
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
mod tests;
