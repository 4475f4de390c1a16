//! A map as a recording that Foxglove, Lichtblick and Rerun show as it is: what was driven, with camera images, in the map
//! that came of it. Messages are Foxglove's own, as protobuf.
//!
//! ```text
//!   /tf                        map → SESSION/base_link at each pose; from there to its cameras
//!   /trajectory/SESSION        all its poses
//!   /location/SESSION          where on earth each is, if the map has georeference
//!   /camera/SESSION/CAMERA     images of keyframes, …/calibration, …/people
//!   /ground, /speed            grids
//!   /landmarks                 a point cloud
//!   /lanes, /intersections, /spaces, /labels       lines and boxes
//! ```
//! What does not move is said once, when the first session begins; each session is at the time that it was driven.

mod drives;
mod messages;
mod still;

use std::collections::BTreeMap;
use std::path::Path;

use evermap_datasets::annotations::RecordingError;
use evermap_datasets::{ImageReader, LogWriter, Times};
use evermap_schemas::Fault;
use evermap_schemas::layers::VehiclePose;
use foxglove::Encode;

use crate::annotate::unwritten;
use crate::ending::Failure;
use crate::export::Selection;
use crate::reader::{MapReader, one_site};

use messages::encoded;

/// Bytes of logs that stay decompressed while images are copied.
const CACHE_BYTES: u64 = 64 << 20;
/// Images that are read together.
const TOGETHER: usize = 64;

/// Writes a site of a map, of one session where it is named.
///
/// # Errors
/// A user fault for a map without poses, or of several sites; a data fault for logs that are gone or damaged.
pub async fn export(reader: &MapReader, selection: &Selection, out: &Path) -> Result<(), Failure> {
    let mut poses: Vec<VehiclePose> = reader.needed(None).await?;
    let site = selection.site.as_deref();
    let site = one_site(poses.iter().map(|pose| pose.site.as_str()), site)?;
    let wanted = selection.session.as_deref();
    poses.retain(|pose| pose.site == site && wanted.is_none_or(|session| session == pose.session));
    let first = poses.iter().map(|pose| pose.stamp.0).min();
    let first = first.ok_or_else(|| Fault::user("it has no poses of that session"))?;
    let mut said = drives::said(reader, &site, poses).await?;
    said.extend(still::said(reader, &site, first).await?);
    said.sort_by(|a, b| (a.stamp, &a.topic).cmp(&(b.stamp, &b.topic)));
    write(reader, &said, out).await
}

/// A message of a topic.
struct Said {
    stamp: i64,
    topic: String,
    what: What,
}

enum What {
    Message(Payload),
    /// An image that a keyframe names: its bytes are read when they are written.
    Image(Box<drives::Image>),
}

/// An encoded message.
struct Payload {
    schema: foxglove::Schema,
    bytes: Vec<u8>,
}

impl Said {
    fn new<M: Encode>(stamp: i64, topic: impl Into<String>, message: &M) -> Result<Self, Fault> {
        Ok(Self {
            stamp,
            topic: topic.into(),
            what: What::Message(encoded(message)?),
        })
    }
}

async fn write(reader: &MapReader, said: &[Said], out: &Path) -> Result<(), Failure> {
    let library = concat!("evermap ", env!("CARGO_PKG_VERSION"));
    let log = LogWriter::create(out, library, "").map_err(unwritten)?;
    let mut file = File {
        log,
        channels: BTreeMap::new(),
    };
    let mut images = Images::new(reader);
    for together in said.chunks(TOGETHER) {
        let mut pictures = images.read(together).await?.into_iter();
        for one in together {
            let read;
            let payload = match &one.what {
                What::Message(payload) => payload,
                What::Image(image) => {
                    let bytes = pictures.next().unwrap_or_default();
                    read = encoded(&image.message(one.stamp, bytes))?;
                    &read
                }
            };
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
    fn write(&mut self, said: &Said, payload: &Payload) -> Result<(), RecordingError> {
        let channel = match self.channels.get(&said.topic) {
            Some(channel) => *channel,
            None => {
                let foxglove::Schema {
                    name,
                    encoding,
                    data,
                } = &payload.schema;
                let schema = (name.as_str(), encoding.as_str(), &data[..]);
                let channel = self.log.channel(&said.topic, schema, "protobuf")?;
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

/// The images of a map's logs.
struct Images<'r> {
    reader: &'r MapReader,
    context: datafusion::prelude::SessionContext,
    logs: BTreeMap<String, ImageReader>,
}

impl<'r> Images<'r> {
    fn new(reader: &'r MapReader) -> Self {
        Self {
            reader,
            context: Default::default(),
            logs: BTreeMap::new(),
        }
    }

    /// The bytes of the images among these, in their order.
    async fn read(&mut self, said: &[Said]) -> Result<Vec<Vec<u8>>, Fault> {
        let mut asked: BTreeMap<&str, Vec<(usize, _)>> = BTreeMap::new();
        let images = said.iter().filter_map(|one| match &one.what {
            What::Image(image) => Some(image),
            What::Message(_) => None,
        });
        let mut count = 0;
        for (place, image) in images.enumerate() {
            count += 1;
            let of_session = asked.entry(image.session.as_str()).or_default();
            of_session.push((place, image.reference.clone()));
        }
        let mut read = vec![Vec::new(); count];
        for (session, images) in asked {
            let (places, references): (Vec<usize>, Vec<_>) = images.into_iter().unzip();
            let found = self.log(session).await?.resolve(&references).await?;
            for (place, bytes) in places.into_iter().zip(found) {
                read[place] = bytes?.to_vec();
            }
        }
        Ok(read)
    }

    async fn log(&mut self, session: &str) -> Result<&ImageReader, Fault> {
        if !self.logs.contains_key(session) {
            let runtime = self.context.runtime_env();
            let log = self.reader.map.log(session, &runtime).await?;
            let gone = || Fault::data(format!("the map has no log of session {session}"));
            let images = ImageReader::new(&log.ok_or_else(gone)?, CACHE_BYTES);
            self.logs.insert(session.to_owned(), images);
        }
        let log = self.logs.get(session);
        log.ok_or_else(|| Fault::bug("a log that was opened is not there"))
    }
}
