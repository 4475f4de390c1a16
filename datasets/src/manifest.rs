//! Session manifests: which files are which session, and which topics play which part.
//!
//! ```yaml
//! site: car_park
//! sessions:
//!   - name: monday
//!     files: [logs/monday_*.mcap]      # parts of one recording; relative to the manifest
//! roles:
//!   frames: ["/camera/*/image_raw/compressed"]
//!   depth_frames: ["/camera/*/depth"]
//!   label_frames: ["/camera/*/labels"]
//!   odometry: /odom
//!   calibration: ["/camera/*/camera_info"]
//!   transforms: [/tf, /tf_static]
//! ```
//!
//! Everything is optional. Roles that are not given are inferred from message types; see [`Roles::infer`].

use std::collections::BTreeMap;
use std::path::Path;

use evermap_schemas::Fault;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A session manifest.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Manifest {
    /// Site of every session that names none itself.
    pub site: Option<String>,
    /// Sessions, in addition to those given on the command line.
    pub sessions: Vec<ManifestSession>,
    /// Topics by role, for all sessions.
    pub roles: ManifestRoles,
}

/// One session of a manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ManifestSession {
    /// Name, unique in the manifest.
    pub name: String,
    /// Files, globs or URLs: the parts of one recording.
    pub files: Vec<String>,
    /// Site that was driven, where it differs from the manifest's.
    #[serde(default)]
    pub site: Option<String>,
}

/// Topics by role. A topic may be a pattern, in which `*` stands for anything.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ManifestRoles {
    /// Topics with images.
    pub frames: Option<Vec<String>>,
    /// Topics with range images.
    pub depth_frames: Option<Vec<String>>,
    /// Topics with images of class labels.
    pub label_frames: Option<Vec<String>>,
    /// The one topic with wheel or visual odometry.
    pub odometry: Option<String>,
    /// Topics with intrinsic calibrations.
    pub calibration: Option<Vec<String>>,
    /// Topics with transforms.
    pub transforms: Option<Vec<String>>,
}

impl Manifest {
    /// Reads a manifest's text.
    ///
    /// # Errors
    /// A user fault with line and column.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        if text.trim().is_empty() {
            return Ok(Self::default());
        }
        serde_yaml_ng::from_str(text)
            .map_err(|error| Fault::user(format!("expected a session manifest, found {error}")))
    }

    /// Reads a manifest file; its relative paths become relative to the manifest's folder.
    ///
    /// # Errors
    /// A user fault when the file cannot be read or is no manifest.
    pub fn load(path: &Path) -> Result<Self, Fault> {
        let place = path.display();
        let text = std::fs::read_to_string(path).map_err(|error| {
            Fault::user(format!("expected a session manifest, found {error}")).at(place.to_string())
        })?;
        let mut manifest = Self::parse(&text).map_err(|fault| fault.at(place.to_string()))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for file in manifest.sessions.iter_mut().flat_map(|s| &mut s.files) {
            if !file.contains("://") && !Path::new(file).is_absolute() {
                *file = folder.join(&*file).to_string_lossy().into_owned();
            }
        }
        Ok(manifest)
    }
}

/// The topics of one session that play a part.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Roles {
    /// Topics with images, ascending.
    pub frames: Vec<String>,
    /// Topics with range images, ascending.
    pub depth_frames: Vec<String>,
    /// Topics with images of class labels, ascending.
    pub label_frames: Vec<String>,
    /// The topic with odometry.
    pub odometry: Option<String>,
    /// Topics with intrinsic calibrations, ascending.
    pub calibration: Vec<String>,
    /// Topics with transforms, ascending.
    pub transforms: Vec<String>,
}

/// What inference needs to know of a topic.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TopicInfo {
    /// Name of the message type, as the log spells it.
    pub schema: String,
    /// Number of messages; 0 where it is not known.
    pub messages: u64,
}

/// The part that a message type plays, whatever it is called: `sensor_msgs/msg/Image` (ROS 2), `sensor_msgs/Image`
/// (ROS 1) and `foxglove.RawImage` (protobuf, JSON) are the same.
pub(crate) fn plain_type(schema: &str) -> String {
    schema
        .replace("/msg/", "/")
        .replace("foxglove_msgs/", "foxglove.")
}

const FRAMES: [&str; 4] = [
    "sensor_msgs/CompressedImage",
    "sensor_msgs/Image",
    "foxglove.CompressedImage",
    "foxglove.RawImage",
];
/// Parts of a topic's name that tell range images and label images from pictures.
const DEPTH: [&str; 1] = ["depth"];
const LABELS: [&str; 3] = ["label", "segmentation", "semantic"];
const CALIBRATION: [&str; 2] = ["sensor_msgs/CameraInfo", "foxglove.CameraCalibration"];
const ODOMETRY: [&str; 1] = ["nav_msgs/Odometry"];
const POSES: [&str; 2] = ["foxglove.PoseInFrame", "geometry_msgs/PoseStamped"];
const TRANSFORMS: [&str; 4] = [
    "tf2_msgs/TFMessage",
    "tf/tfMessage",
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
];

impl Roles {
    /// Roles from message types.
    ///
    /// - `frames`: `CompressedImage` and `Image` of sensor_msgs, `CompressedImage` and `RawImage` of foxglove. Where a
    ///   topic and its `/compressed` twin are both there, the compressed one counts; `/compressedDepth` never does.
    /// - `depth_frames` and `label_frames`: those of them with a part of the name that speaks of depth, or of labels,
    ///   segmentation or semantics. Of several label topics beside each other the first by name.
    /// - `calibration`: `CameraInfo`, `CameraCalibration`. `transforms`: `TFMessage`, `FrameTransform(s)`.
    /// - `odometry`: one `nav_msgs/Odometry` topic: `/odom` if there is one, else that with most messages, else the
    ///   first by name. Where there is none, a `PoseInFrame` or `PoseStamped` topic whose name speaks of odometry.
    ///
    /// Choices that another reader might have made differently are told in the notes.
    pub fn infer(topics: &BTreeMap<String, TopicInfo>) -> (Self, Vec<String>) {
        let mut notes = Vec::new();
        let of = |types: &[&str]| -> Vec<String> {
            let fits = |info: &TopicInfo| types.contains(&plain_type(&info.schema).as_str());
            let fitting = topics.iter().filter(|(_, info)| fits(info));
            fitting.map(|(topic, _)| topic.clone()).collect()
        };
        let all = of(&FRAMES);
        let twin = |topic: &String| all.contains(&format!("{topic}/compressed"));
        let images = all
            .iter()
            .filter(|topic| !twin(topic) && !topic.ends_with("/compressedDepth"));
        let (special, frames): (Vec<String>, Vec<String>) = images
            .cloned()
            .partition(|topic| speaks_of(topic, &DEPTH) || speaks_of(topic, &LABELS));
        let (labels, depth_frames) = special
            .into_iter()
            .partition(|topic| speaks_of(topic, &LABELS));
        let label_frames = choose_labels(labels, &mut notes);
        let mut candidates = of(&ODOMETRY);
        if candidates.is_empty() {
            candidates = of(&POSES);
            candidates.retain(|topic| topic.to_lowercase().contains("odom"));
        }
        let odometry = choose_odometry(&candidates, topics);
        if let Some(chosen) = odometry.as_ref().filter(|_| candidates.len() > 1) {
            notes.push(format!(
                "odometry is read from {chosen}; {} would do too: say roles.odometry in a session manifest to choose",
                others(&candidates, chosen)
            ));
        }
        let roles = Self {
            frames,
            depth_frames,
            label_frames,
            odometry,
            calibration: of(&CALIBRATION),
            transforms: of(&TRANSFORMS),
        };
        (roles, notes)
    }

    /// The topics of a role, by the role's name.
    pub fn topics(&self, role: &str) -> &[String] {
        match role {
            "frames" => &self.frames,
            "depth_frames" => &self.depth_frames,
            "label_frames" => &self.label_frames,
            "odometry" => self.odometry.as_slice(),
            "calibration" => &self.calibration,
            "transforms" => &self.transforms,
            _ => &[],
        }
    }

    /// Roles from a manifest; what it leaves out is inferred.
    ///
    /// # Errors
    /// A user fault when a pattern is malformed, or two topics match the pattern for odometry.
    pub fn resolve(
        manifest: &ManifestRoles,
        topics: &BTreeMap<String, TopicInfo>,
    ) -> Result<(Self, Vec<String>), Fault> {
        let (mut roles, mut notes) = Self::infer(topics);
        if let Some(patterns) = &manifest.frames {
            roles.frames = matching(patterns, topics)?;
        }
        if let Some(patterns) = &manifest.depth_frames {
            roles.depth_frames = matching(patterns, topics)?;
        }
        if let Some(patterns) = &manifest.label_frames {
            roles.label_frames = matching(patterns, topics)?;
            notes.retain(|note| !note.starts_with("label_frames"));
        }
        if let Some(patterns) = &manifest.calibration {
            roles.calibration = matching(patterns, topics)?;
        }
        if let Some(patterns) = &manifest.transforms {
            roles.transforms = matching(patterns, topics)?;
        }
        if let Some(pattern) = &manifest.odometry {
            let mut found = matching(std::slice::from_ref(pattern), topics)?;
            if found.len() > 1 {
                return Err(Fault::user(format!(
                    "expected one odometry topic, found {}",
                    found.join(", ")
                ))
                .at("roles.odometry"));
            }
            notes.retain(|note| !note.starts_with("odometry"));
            roles.odometry = found.pop();
        }
        Ok((roles, notes))
    }
}

fn others(candidates: &[String], chosen: &str) -> String {
    let others: Vec<&str> = candidates
        .iter()
        .map(String::as_str)
        .filter(|topic| *topic != chosen)
        .collect();
    others.join(", ")
}

fn speaks_of(topic: &str, words: &[&str]) -> bool {
    let topic = topic.to_lowercase();
    words.iter().any(|word| topic.contains(word))
}

/// Of label topics that differ only from the part that speaks of labels on, the first by name.
fn choose_labels(candidates: Vec<String>, notes: &mut Vec<String>) -> Vec<String> {
    let owner = |topic: &str| {
        let parts = topic.split('/');
        let parts: Vec<_> = parts.take_while(|part| !speaks_of(part, &LABELS)).collect();
        parts.join("/")
    };
    let mut owners = BTreeMap::<String, Vec<String>>::new();
    for topic in candidates {
        owners.entry(owner(&topic)).or_default().push(topic);
    }
    let mut chosen = Vec::new();
    for topics in owners.into_values() {
        let Some(first) = topics.first() else {
            continue;
        };
        if topics.len() > 1 {
            notes.push(format!(
                "label_frames are read from {first}; {} would do too: say roles.label_frames in a session manifest to choose",
                others(&topics, first)
            ));
        }
        chosen.push(first.clone());
    }
    chosen.sort();
    chosen
}

fn choose_odometry(candidates: &[String], topics: &BTreeMap<String, TopicInfo>) -> Option<String> {
    let messages = |topic: &String| topics.get(topic).map_or(0, |info| info.messages);
    let rank = |topic: &&String| {
        let plain = topic.trim_start_matches('/') == "odom";
        (!plain, u64::MAX - messages(topic), (*topic).clone())
    };
    candidates.iter().min_by_key(rank).cloned()
}

fn matching(
    patterns: &[String],
    topics: &BTreeMap<String, TopicInfo>,
) -> Result<Vec<String>, Fault> {
    let patterns = patterns
        .iter()
        .map(|pattern| {
            glob::Pattern::new(pattern)
                .map_err(|error| Fault::user(format!("the topic pattern {pattern}: {error}")))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let fits = |topic: &&String| patterns.iter().any(|pattern| pattern.matches(topic));
    Ok(topics.keys().filter(fits).cloned().collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn topics(list: &[(&str, &str, u64)]) -> BTreeMap<String, TopicInfo> {
        let info = |(topic, schema, messages): &(&str, &str, u64)| {
            let info = TopicInfo {
                schema: (*schema).to_owned(),
                messages: *messages,
            };
            ((*topic).to_owned(), info)
        };
        list.iter().map(info).collect()
    }

    #[test]
    fn roles_follow_from_types_in_every_spelling() {
        for (odometry, image, tf) in [
            (
                "nav_msgs/msg/Odometry",
                "sensor_msgs/msg/Image",
                "tf2_msgs/msg/TFMessage",
            ),
            (
                "nav_msgs/Odometry",
                "sensor_msgs/CompressedImage",
                "tf/tfMessage",
            ),
            (
                "foxglove.PoseInFrame",
                "foxglove.RawImage",
                "foxglove.FrameTransforms",
            ),
        ] {
            let (roles, notes) = Roles::infer(&topics(&[
                ("/my_odometry", odometry, 1),
                ("/cam", image, 1),
                ("/tf", tf, 1),
                ("/goal_pose", "geometry_msgs/msg/PoseStamped", 9),
            ]));
            assert_eq!(roles.odometry.as_deref(), Some("/my_odometry"));
            assert_eq!(roles.frames, ["/cam"]);
            assert_eq!(roles.transforms, ["/tf"]);
            assert!(notes.is_empty());
        }
    }

    #[test]
    fn range_and_label_images_are_no_pictures() {
        let image = "sensor_msgs/msg/CompressedImage";
        let (roles, notes) = Roles::infer(&topics(&[
            ("/pano/image/compressed", image, 1),
            ("/pano/depth", image, 1),
            ("/pano/labels", image, 1),
            ("/pano/labels_noisy", image, 1),
            ("/front/semantic_segmentation/image", image, 1),
        ]));
        assert_eq!(roles.frames, ["/pano/image/compressed"]);
        assert_eq!(roles.depth_frames, ["/pano/depth"]);
        assert_eq!(
            roles.label_frames,
            ["/front/semantic_segmentation/image", "/pano/labels"]
        );
        assert!(notes[0].contains("/pano/labels_noisy"), "{notes:?}");
    }

    #[test]
    fn one_odometry_topic_is_chosen_and_told() {
        let nav = "nav_msgs/msg/Odometry";
        let (roles, notes) = Roles::infer(&topics(&[("/a", nav, 5), ("/b", nav, 9)]));
        assert_eq!(roles.odometry.as_deref(), Some("/b"));
        assert!(notes[0].contains("/a"));
        let (roles, _) = Roles::infer(&topics(&[("/odom", nav, 1), ("/b", nav, 9)]));
        assert_eq!(roles.odometry.as_deref(), Some("/odom"));
    }

    #[test]
    fn a_compressed_twin_is_preferred() {
        let (roles, _) = Roles::infer(&topics(&[
            ("/c/image", "sensor_msgs/msg/Image", 1),
            ("/c/image/compressed", "sensor_msgs/msg/CompressedImage", 1),
            (
                "/c/image/compressedDepth",
                "sensor_msgs/msg/CompressedImage",
                1,
            ),
        ]));
        assert_eq!(roles.frames, ["/c/image/compressed"]);
    }

    #[test]
    fn a_manifest_overrules_and_refuses_unknown_keys() {
        let manifest = Manifest::parse("roles: {frames: ['/x/*']}\nsite: here").unwrap();
        let known = topics(&[("/x/1", "any", 1), ("/y", "sensor_msgs/msg/Image", 1)]);
        let (roles, _) = Roles::resolve(&manifest.roles, &known).unwrap();
        assert_eq!(roles.frames, ["/x/1"]);
        let fault = Manifest::parse("sights: here").unwrap_err();
        assert!(fault.to_string().contains("sights"), "{fault}");
    }
}
