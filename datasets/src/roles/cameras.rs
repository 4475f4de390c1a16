//! What cameras are called: the frame of their calibration, if images and calibrations can be told to belong together.

use std::collections::BTreeMap;
use std::sync::Arc;

use evermap_schemas::roles::Calibration;
use evermap_schemas::{Fault, rows};
use futures::TryStreamExt;

use crate::roles::RoleScan;
use crate::scan::{Job, LogTable, Wanted, fault_of, stream};
use crate::session::LogPart;

/// Names by session.
pub(crate) type Cameras = BTreeMap<Arc<str>, CameraNames>;

/// The calibrated cameras of one session.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct CameraNames {
    /// Camera by the prefix of its calibration's topic.
    by_prefix: BTreeMap<String, String>,
}

impl CameraNames {
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
pub(crate) fn topic_camera(topic: &str) -> String {
    let mut parts: Vec<&str> = topic.split('/').filter(|part| !part.is_empty()).collect();
    while parts.len() > 1 && parts.last().is_some_and(|last| KINDS.contains(last)) {
        parts.pop();
    }
    parts.join("/")
}

/// Reads the first calibration of each calibration topic.
pub(crate) async fn read(scan: &RoleScan, parts: &[Arc<LogPart>]) -> Result<Cameras, Fault> {
    let mut cameras = Cameras::new();
    for part in parts {
        for topic in scan.topics(&part.session) {
            let names = cameras.entry(part.session.clone()).or_default();
            let prefix = topic_camera(topic);
            if names.by_prefix.contains_key(&prefix) {
                continue;
            }
            if let Some(first) = first(scan, part, topic).await? {
                names.by_prefix.insert(prefix, first.camera);
            }
        }
    }
    Ok(cameras)
}

/// The first calibration of a topic in a file.
async fn first(
    scan: &RoleScan,
    part: &Arc<LogPart>,
    topic: &str,
) -> Result<Option<Calibration>, Fault> {
    let schema = scan.role.layer().schema();
    let columns: Vec<usize> = (0..schema.fields().len()).collect();
    let units = Wanted {
        part,
        range: (0, u64::MAX),
        channels: part.index.channels_of(topic).map(|c| c.id).collect(),
        predicate: None,
        schema: &schema,
    }
    .units();
    let job = Job {
        part: part.clone(),
        units,
        rows: LogTable::Role(scan.clone()).rows(part, &schema, &columns)?,
        batch_rows: 1,
        pool: None,
        topic: topic.to_owned(),
    };
    let mut batches = stream(job);
    let batch = batches.try_next().await.map_err(|error| fault_of(&error))?;
    match batch {
        Some(batch) => Ok(rows::<Calibration>(&batch)?.into_iter().next()),
        None => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_named_by_its_calibration_or_by_its_topic() {
        let names = CameraNames {
            by_prefix: BTreeMap::from([("front".to_owned(), "front_optical".to_owned())]),
        };
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
