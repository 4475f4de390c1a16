//! A map as a recording that Foxglove, Lichtblick and Rerun show as it is: what was driven, with camera images, in the map
//! that came of it. Messages are Foxglove's own, as protobuf, and of what Foxglove has none for, those of ROS 2.
//!
//! ```text
//!   /tf                        map → SESSION/VEHICLE at each pose; from there to its cameras
//!   /trajectory/SESSION        all its poses
//!   /location/SESSION          where on earth each is, if the map has georeference
//!   /camera/SESSION/CAMERA     images of keyframes, …/calibration, …/people
//!   /ground, /speed            grids: the overhead image, m/s
//!   /danger, /speed_mask       occupancy grids, 0 to 100 and -1: how probably somebody is there, the mask of Nav2's speed filter
//!   /landmarks                 a point cloud
//!   /lanes, /intersections, /spaces, /labels       lines and boxes
//! ```
//! What does not move is said once, when the first session begins; each session is at the time that it was driven.

mod drives;
mod grids;
mod images;
mod messages;
mod still;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use datafusion::prelude::SessionContext;
use evermap_datasets::annotations::RecordingError;
use evermap_datasets::{LogWriter, Times, ros2};
use evermap_schemas::Fault;
use evermap_schemas::layers::VehiclePose;
use foxglove::{Encode, Schema};

use crate::annotate::unwritten;
use crate::ending::{Ending, Failure, Lost};
use crate::export::Selection;
use crate::output::outside_of_maps;
use crate::reader::{MapReader, nothing, one_site};

pub use images::Images;
use messages::{encoded, encoded_ros, kind};

/// Messages that are read and written together.
const TOGETHER: usize = 64;

/// Writes a site of a map, of one session where it is named; what a recording does not hold is counted.
///
/// # Errors
/// A user fault for a map without poses, or of several sites; a data fault for logs that are gone or damaged.
pub async fn export(reader: &MapReader, selection: &Selection, out: &Path) -> Ending {
    outside_of_maps(out)?;
    let mut lost = Lost::default();
    let said = said(reader, selection, &mut lost).await?;
    write(reader, &said, out).await?;
    Ok(lost)
}

/// What there is to say of a site of a map, of one session where it is named, in the order of time; what is left out is
/// counted.
///
/// # Errors
/// A user fault for a map without poses, or of several sites.
pub async fn said(
    reader: &MapReader,
    selection: &Selection,
    lost: &mut Lost,
) -> Result<Vec<TopicMessage>, Fault> {
    let mut poses: Vec<VehiclePose> = reader.needed(None).await?;
    let site = selection.site.as_deref();
    let site = one_site(poses.iter().map(|pose| pose.site.as_str()), site)?;
    let wanted = selection.session.as_deref();
    poses.retain(|pose| pose.site == site && wanted.is_none_or(|session| session == pose.session));
    let first = poses.iter().map(|pose| pose.stamp.0).min();
    let none = || match wanted {
        Some(session) => Fault::user(format!("it has no poses of session {session}")),
        None => nothing(),
    };
    let first = first.ok_or_else(none)?;
    let mut said = drives::said(reader, &site, poses).await?;
    let still = still::said(reader, (&site, first), lost).await?;
    said.extend(still.into_iter().map(TopicMessage::for_good));
    said.sort_by(|a, b| (a.stamp, &a.topic).cmp(&(b.stamp, &b.topic)));
    Ok(said)
}

/// A message of a topic.
pub struct TopicMessage {
    /// When, ns since the epoch.
    pub stamp: i64,
    /// Of which topic.
    pub topic: String,
    /// Whether it holds from then on: who comes later needs it too.
    pub lasts: bool,
    what: What,
}

enum What {
    Message(Payload),
    /// An image that a keyframe names: its bytes are read when they are asked for.
    Image(Box<drives::Image>),
}

/// An encoded message.
#[derive(Clone)]
pub struct Payload {
    /// What it is made of.
    pub kind: MessageKind,
    /// It.
    pub bytes: Vec<u8>,
}

/// Of which kind messages are, and how they are encoded.
#[derive(Clone)]
pub struct MessageKind {
    /// The schema, with its name and encoding.
    pub schema: Schema,
    /// How messages are encoded.
    pub encoding: &'static str,
}

impl TopicMessage {
    fn new<M: Encode>(stamp: i64, topic: impl Into<String>, message: &M) -> Result<Self, Fault> {
        Ok(Self::of(stamp, topic, What::Message(encoded(message)?)))
    }

    fn of_ros<M: ros2::Message>(stamp: i64, topic: impl Into<String>, message: &M) -> Self {
        Self::of(stamp, topic, What::Message(encoded_ros(message)))
    }

    fn of(stamp: i64, topic: impl Into<String>, what: What) -> Self {
        Self {
            stamp,
            topic: topic.into(),
            lasts: false,
            what,
        }
    }

    /// The same, holding from then on.
    fn for_good(mut self) -> Self {
        self.lasts = true;
        self
    }

    /// Of which kind it is.
    ///
    /// # Errors
    /// A bug fault where the kind has no schema.
    pub fn kind(&self) -> Result<Cow<'_, MessageKind>, Fault> {
        match &self.what {
            What::Message(payload) => Ok(Cow::Borrowed(&payload.kind)),
            What::Image(_) => Ok(Cow::Owned(kind::<drives::Picture>()?)),
        }
    }

    /// Bytes of memory that it takes, about.
    pub fn size(&self) -> usize {
        let what = match &self.what {
            What::Message(payload) => payload.bytes.len(),
            What::Image(_) => size_of::<drives::Image>(),
        };
        size_of::<Self>() + self.topic.len() + what
    }
}

async fn write(reader: &MapReader, said: &[TopicMessage], out: &Path) -> Result<(), Failure> {
    // Only what an export has written is replaced by one.
    let library = concat!("evermap export ", env!("CARGO_PKG_VERSION"));
    let log = LogWriter::create(out, library, "").map_err(unwritten)?;
    let mut file = File {
        log,
        channels: BTreeMap::new(),
    };
    let mut images = Images::new(reader, SessionContext::default().runtime_env());
    for together in said.chunks(TOGETHER) {
        let together: Vec<&TopicMessage> = together.iter().collect();
        let payloads = images.payloads(&together).await?;
        for (one, payload) in together.iter().zip(&payloads) {
            file.write(one, payload).map_err(unwritten)?;
        }
    }
    file.log.finish().map_err(unwritten)?;
    Ok(())
}

/// The file that is written.
struct File {
    log: LogWriter,
    channels: BTreeMap<String, u16>,
}

impl File {
    fn write(&mut self, said: &TopicMessage, payload: &Payload) -> Result<(), RecordingError> {
        let channel = match self.channels.get(&said.topic) {
            Some(channel) => *channel,
            None => {
                let MessageKind { schema, encoding } = &payload.kind;
                let text = (&schema.name[..], &schema.encoding[..], &schema.data[..]);
                let channel = self.log.channel(&said.topic, text, encoding)?;
                self.channels.insert(said.topic.clone(), channel);
                channel
            }
        };
        let stamp_ns = said.stamp.max(0) as u64;
        let times = Times {
            log_ns: stamp_ns,
            stamp_ns,
        };
        self.log.send(channel, times, &payload.bytes)
    }
}
