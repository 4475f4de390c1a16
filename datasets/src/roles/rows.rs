//! The builder that all roles of messages share: decode the members that a role reads, then have it make rows of them.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::sync::Arc;

use arrow::array::{RecordBatch, StructArray};
use arrow::datatypes::{DataType, Field, SchemaRef};
use evermap_messages::{Decoder, MessageType};
use evermap_schemas::roles::{
    CameraNames, Fields, FoundImage, FromMessage, Message, Messages, Motion, OdometryOf,
    StillFrames, ZeroStamp,
};
use evermap_schemas::{Fault, ImageRef, Stamp};

use crate::log::definition::LogChannel;
use crate::losses::{Loss, Reason};
use crate::manifest::TopicBits;
use crate::roles::mounts::Mounts;
use crate::scan::{MessageAt, RowBuilder, projected};
use crate::session::LogPart;

/// Builds the rows of one role from one file.
pub(crate) struct RoleRows {
    role: Messages,
    part: Arc<LogPart>,
    known: SessionFacts,
    schema: SchemaRef,
    projection: Vec<usize>,
    topics: Vec<TopicMessages>,
    channels: BTreeMap<u16, usize>,
    pushed: usize,
}

/// What is known of a session before rows are made of its messages, where a role asks for it.
#[derive(Debug, Clone, Default)]
pub(crate) struct SessionFacts {
    /// What its cameras are called.
    pub cameras: CameraNames,
    /// The odometry that is meant, of those among transforms.
    pub robot: Meant,
    /// How many bits samples of its pictures have, by topic, where a person says so.
    pub bits: TopicBits,
    /// The frames that never move, though topics of moving transforms have them.
    pub still: Option<Arc<StillFrames>>,
    /// What it has said of frames that are fixed.
    pub mounts: Option<Arc<Mounts>>,
}

/// The odometry that is meant, of that among transforms.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meant {
    /// Which transforms it is.
    pub odometry: OdometryOf,
    /// One of them; none where there is none.
    pub motion: Option<Motion>,
}

impl Meant {
    /// How a transform contradicts this odometry; `None` where it does not.
    pub fn contradiction(&self, other: &Motion) -> Option<String> {
        self.odometry.contradiction(self.motion.as_ref()?, other)
    }
}

/// The messages of one channel.
struct TopicMessages {
    topic: String,
    message_type: MessageType,
    names: Vec<String>,
    decoder: Decoder,
    taken: Vec<KeptMessage>,
}

/// What is kept of a message beside its decoded members.
struct KeptMessage {
    order: usize,
    log_time: i64,
    place: u64,
    length: u64,
    image: Option<FoundImage>,
}

impl RoleRows {
    /// A builder of the projected columns from the messages of these topics.
    pub fn new(
        role: Messages,
        topics: &[String],
        known: SessionFacts,
        part: &Arc<LogPart>,
        schema: &SchemaRef,
        projection: &[usize],
    ) -> Result<Self, Fault> {
        let mut found = Vec::new();
        let mut channels = BTreeMap::new();
        let mut refused = Vec::new();
        for topic in topics {
            for channel in part.channels_of(topic) {
                match part.decodable(channel) {
                    Ok(_) if role.need_fields() && part.index.is_untyped(channel) => {
                        let none = "expected a schema that names the fields of messages, found JSON without any";
                        refused.push((channel, Fault::data(none).at(format!("topic {topic}"))));
                    }
                    Ok(message_type) if hides_images(&role, channel, message_type) => {
                        let none = "expected a schema that says `contentEncoding: base64` of the field that holds the \
                                    image, as images in JSON are found by it, found none";
                        part.lose_topic(channel, none.to_owned());
                    }
                    Ok(message_type) => {
                        channels.insert(channel.id, found.len());
                        let members = role.members;
                        found.push(TopicMessages::new(topic, message_type.clone(), members));
                    }
                    Err(fault) => refused.push((channel, fault)),
                }
            }
        }
        // Others play the role: then a topic that cannot be decoded is lost alone.
        for (channel, fault) in refused {
            if found.is_empty() {
                return Err(fault.next("take the topic out of the roles in a session manifest"));
            }
            part.lose_topic(channel, fault.to_string());
        }
        Ok(Self {
            role,
            part: part.clone(),
            known,
            schema: schema.clone(),
            projection: projection.to_vec(),
            topics: found,
            channels,
            pushed: 0,
        })
    }

    /// Counts the transforms of a message that move the vehicle as well, but in another frame than the one that is read.
    fn lose_other_parents(&self, taken: &KeptMessage, topic: &str, message: &Message<'_>) {
        if self.known.robot.motion.is_none() {
            return;
        }
        let motions = Motion::from_message(message).unwrap_or_default();
        let others = motions.iter();
        let others = others.filter_map(|motion| self.known.robot.contradiction(motion));
        let others: Vec<String> = others.collect();
        if let Some(first) = others.first() {
            let (count, losses) = (others.len() as u64, &self.part.losses);
            let loss = Loss { count, bytes: 0 };
            losses.note_topic(
                Reason::OtherParent,
                topic,
                taken.place,
                loss,
                first.as_str(),
            );
        }
    }
}

impl TopicMessages {
    fn new(topic: &str, message_type: MessageType, members: &[&str]) -> Self {
        let fields = message_type.fields();
        let wanted: Vec<usize> = (0..fields.len())
            .filter(|index| members.contains(&fields[*index].name().as_str()))
            .collect();
        let names = wanted.iter().map(|i| fields[*i].name().clone()).collect();
        Self {
            topic: topic.to_owned(),
            decoder: message_type.decoder(Some(&wanted)),
            names,
            message_type,
            taken: Vec::new(),
        }
    }

    /// The decoded members of the messages so far.
    fn members(&mut self) -> Result<StructArray, Fault> {
        let rows = self.decoder.len();
        let arrays = self.decoder.finish()?;
        let named = self.names.iter().zip(&arrays);
        let fields: Vec<Field> = named
            .map(|(name, array)| Field::new(name, array.data_type().clone(), true))
            .collect();
        let members = StructArray::try_new_with_length(fields.into(), arrays, None, rows)?;
        Ok(members)
    }
}

impl RowBuilder for RoleRows {
    fn wants(&self, channel: u16) -> bool {
        self.channels.contains_key(&channel)
    }

    fn push(&mut self, message: &MessageAt<'_>) -> Result<(), String> {
        let source = self.channels.get(&message.head.channel);
        let Some(source) = source.and_then(|index| self.topics.get_mut(*index)) else {
            return Ok(());
        };
        let image = match self.role.image {
            Some(member) => Some(find_image(&source.message_type, message, member)?),
            None => None,
        };
        source
            .decoder
            .push(message.payload)
            .map_err(|error| error.to_string())?;
        source.taken.push(KeptMessage {
            order: self.pushed,
            log_time: message.head.log_time,
            place: message.block.file_offset + message.at,
            length: message.payload.len() as u64,
            image,
        });
        self.pushed += 1;
        Ok(())
    }

    fn rows(&self) -> usize {
        self.pushed
    }

    /// Twice what is decoded: rows hold much the same.
    fn bytes(&self) -> usize {
        let decoded: usize = self.topics.iter().map(|s| s.decoder.bytes()).sum();
        2 * decoded + self.pushed * size_of::<KeptMessage>()
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        self.pushed = 0;
        let mut taken: Vec<(KeptMessage, usize, usize)> = Vec::new();
        let mut members = Vec::new();
        for (topic, messages) in self.topics.iter_mut().enumerate() {
            members.push(messages.members()?);
            let rows = std::mem::take(&mut messages.taken).into_iter().enumerate();
            taken.extend(rows.map(|(row, taken)| (taken, topic, row)));
        }
        taken.sort_by_key(|(taken, ..)| taken.order);
        let zeros: Vec<OnceCell<ZeroStamp>> = vec![OnceCell::new(); members.len()];
        let messages: Vec<Message<'_>> = taken
            .iter()
            .map(|(taken, topic, row)| Message {
                site: &self.part.site,
                session: &self.part.session,
                topic: &self.topics[*topic].topic,
                log_time: Stamp(taken.log_time),
                fields: Fields::new(&members[*topic], *row),
                zero: &zeros[*topic],
                image: taken.image.as_ref(),
                cameras: &self.known.cameras,
                bits: self.known.bits.get(&self.topics[*topic].topic).copied(),
                robot: &self.known.robot.odometry,
                still: self.known.still.as_deref(),
            })
            .collect();
        let read = (self.role.read)(&messages)?;
        for (index, detail) in read.senseless {
            let (taken, topic, _) = &taken[index];
            let loss = Loss::one(taken.length);
            let topic = &self.topics[*topic].topic;
            let losses = &self.part.losses;
            losses.note_topic(Reason::Senseless, topic, taken.place, loss, detail);
        }
        for ((taken, topic, _), message) in taken.iter().zip(&messages) {
            self.lose_other_parents(taken, &self.topics[*topic].topic, message);
        }
        if let (Some(said), Some(mounts)) = (self.role.mounts, &self.known.mounts) {
            for message in &messages {
                let of_message = said(message).into_iter();
                of_message.for_each(|mount| mounts.hear(message.topic, mount));
            }
        }
        let rows = read.columns.first().map_or(0, |column| column.len());
        projected(&self.schema, &self.projection, rows, |column| {
            read.columns[column].clone()
        })
    }
}

/// Whether a role reads images, and the schema of a JSON channel does not say that there are some.
fn hides_images(role: &Messages, channel: &LogChannel, message_type: &MessageType) -> bool {
    let is_bytes = |member| {
        let field = message_type.fields().find(member);
        field.is_some_and(|(_, field)| *field.data_type() == DataType::BinaryView)
    };
    channel.message_encoding == "json" && role.image.is_some_and(|member| !is_bytes(member))
}

/// Where the image of a message lies.
fn find_image(
    message_type: &MessageType,
    message: &MessageAt<'_>,
    member: &str,
) -> Result<FoundImage, String> {
    let block = message.block;
    if !block.addressable {
        return Err(
            "an image that is compressed inside a compressed chunk cannot be referred to: \
                    record with either chunk or message compression"
                .to_owned(),
        );
    }
    let located = message_type
        .locate(message.payload, &[member])
        .map_err(|error| error.to_string())?
        .ok_or_else(|| format!("expected image bytes in the field {member}"))?;
    let bytes = message.payload.get(located.range.clone());
    let bytes = bytes.ok_or("image bytes outside the payload")?;
    if bytes.is_empty() {
        return Err("an image without bytes".to_owned());
    }
    let mut magic = [0; 8];
    let known = bytes.len().min(magic.len());
    magic[..known].copy_from_slice(&bytes[..known]);
    let within = message.at + located.range.start as u64;
    let packing = block.packing.as_ref();
    let place = ImageRef {
        session: message.part.session.to_string(),
        part: message.part.part,
        chunk: packing.map(|_| block.file_offset),
        chunk_length: packing.map_or(0, |packing| packing.compressed_size),
        chunk_size: packing.map_or(0, |_| block.size),
        compression: packing.map_or_else(String::new, |packing| packing.compression.clone()),
        offset: match packing {
            Some(_) => within,
            None => block.file_offset + within,
        },
        length: bytes.len() as u64,
        ..ImageRef::default()
    };
    Ok(FoundImage { place, magic })
}
