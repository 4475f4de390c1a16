//! The builder that all roles share: decode the members that a role reads, then make typed rows of them.

use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::sync::Arc;

use arrow::array::{RecordBatch, StructArray};
use evermap_messages::{Decoder, MessageType};
use evermap_schemas::{Fault, LayerRow, Stamp, batch};

use crate::log::record::MessageHead;
use crate::losses::{Loss, Reason};
use crate::roles::columns::Columns;
use crate::roles::{CameraNames, RoleScan};
use crate::scan::{MessageAt, RowBuilder};
use crate::session::LogPart;

/// A layer whose rows come from messages.
pub(crate) trait FromMessages: LayerRow + Send {
    /// Members of a message that are decoded, if it has them.
    const MEMBERS: &'static [&'static str];

    /// What is kept of a payload beside the decoded members.
    type Note: Send;

    /// Takes what is kept.
    ///
    /// # Errors
    /// In words, when the message has nothing of what the role needs.
    fn note(message_type: &MessageType, message: &MessageAt<'_>) -> Result<Self::Note, String>;

    /// The rows of one message.
    ///
    /// # Errors
    /// In words, when its values make no sense: the message is then counted as lost.
    fn rows(message: Decoded<'_>, note: Self::Note) -> Result<Vec<Self>, String>;
}

/// One decoded message.
pub(crate) struct Decoded<'a> {
    pub site: &'a str,
    pub session: &'a str,
    pub topic: &'a str,
    pub cameras: &'a CameraNames,
    pub log_time: Stamp,
    pub columns: &'a Columns,
    pub row: usize,
}

impl Decoded<'_> {
    /// The header's stamp; the log time where there is none.
    pub fn stamp(&self) -> Stamp {
        let header = self.columns.stamp(&["header", "stamp"], self.row);
        let own = || self.columns.stamp(&["timestamp"], self.row);
        header.or_else(own).unwrap_or(self.log_time)
    }

    /// The header's frame, without the slash that ROS 1 puts in front; empty where there is none.
    pub fn frame(&self) -> String {
        let header = self.columns.text(&["header", "frame_id"], self.row);
        let own = || self.columns.text(&["frame_id"], self.row);
        plain_frame(&header.or_else(own).unwrap_or_default())
    }
}

/// A frame's name without the slash in front.
pub(crate) fn plain_frame(frame: &str) -> String {
    frame.trim_start_matches('/').to_owned()
}

/// Builds the rows of one role from one file.
pub(crate) struct RoleRows<T: FromMessages> {
    part: Arc<LogPart>,
    cameras: Arc<crate::roles::Cameras>,
    projection: Vec<usize>,
    sources: Vec<Source<T::Note>>,
    channels: BTreeMap<u16, usize>,
    pushed: usize,
    row: PhantomData<T>,
}

/// One channel's messages.
struct Source<N> {
    topic: String,
    message_type: MessageType,
    names: Vec<String>,
    decoder: Box<dyn Decoder>,
    taken: Vec<Taken<N>>,
}

struct Taken<N> {
    order: usize,
    head: MessageHead,
    place: u64,
    length: u64,
    note: N,
}

impl<T: FromMessages> RoleRows<T> {
    pub fn new(scan: &RoleScan, part: &Arc<LogPart>, projection: &[usize]) -> Result<Self, Fault> {
        let mut sources = Vec::new();
        let mut channels = BTreeMap::new();
        for topic in scan.topics(&part.session) {
            for channel in part.index.channels_of(topic) {
                let message_type = match part.message_type(channel.id) {
                    Some(Ok(message_type)) => message_type.clone(),
                    Some(Err(error)) => {
                        return Err(Fault::data(error.to_string())
                            .at(format!("topic {topic}"))
                            .at(&part.url)
                            .next("take the topic out of the roles in a session manifest"));
                    }
                    None => continue,
                };
                channels.insert(channel.id, sources.len());
                sources.push(Source::new(topic, message_type, T::MEMBERS));
            }
        }
        Ok(Self {
            part: part.clone(),
            cameras: scan.cameras.clone(),
            projection: projection.to_vec(),
            sources,
            channels,
            pushed: 0,
            row: PhantomData,
        })
    }
}

impl<N> Source<N> {
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

    fn columns(&mut self) -> Result<Columns, Fault> {
        let rows = self.decoder.len();
        let arrays = self.decoder.finish()?;
        let fields: Vec<_> = self
            .names
            .iter()
            .zip(&arrays)
            .map(|(name, array)| {
                arrow::datatypes::Field::new(name, array.data_type().clone(), true)
            })
            .collect();
        let columns = StructArray::try_new_with_length(fields.into(), arrays, None, rows)?;
        Ok(Columns(columns))
    }
}

impl<T: FromMessages> RowBuilder for RoleRows<T> {
    fn wants(&self, channel: u16) -> bool {
        self.channels.contains_key(&channel)
    }

    fn push(&mut self, message: &MessageAt<'_>) -> Result<(), String> {
        let source = self.channels.get(&message.head.channel);
        let Some(source) = source.and_then(|index| self.sources.get_mut(*index)) else {
            return Ok(());
        };
        let note = T::note(&source.message_type, message)?;
        source
            .decoder
            .push(message.payload)
            .map_err(|error| error.to_string())?;
        source.taken.push(Taken {
            order: self.pushed,
            head: message.head,
            place: message.block.file_offset + message.start as u64,
            length: message.payload.len() as u64,
            note,
        });
        self.pushed += 1;
        Ok(())
    }

    fn rows(&self) -> usize {
        self.pushed
    }

    fn bytes(&self) -> usize {
        let decoded: usize = self.sources.iter().map(|s| s.decoder.bytes()).sum();
        decoded + self.pushed * (size_of::<Taken<T::Note>>() + size_of::<T>())
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        let nobody = CameraNames::default();
        let cameras = self.cameras.get(&self.part.session).unwrap_or(&nobody);
        let mut ordered: Vec<(usize, Vec<T>)> = Vec::with_capacity(self.pushed);
        for source in &mut self.sources {
            let columns = source.columns()?;
            for (row, taken) in std::mem::take(&mut source.taken).into_iter().enumerate() {
                let decoded = Decoded {
                    site: &self.part.site,
                    session: &self.part.session,
                    topic: &source.topic,
                    cameras,
                    log_time: Stamp(taken.head.log_time),
                    columns: &columns,
                    row,
                };
                match T::rows(decoded, taken.note) {
                    Ok(rows) => ordered.push((taken.order, rows)),
                    Err(detail) => {
                        let loss = Loss {
                            count: 1,
                            bytes: taken.length,
                        };
                        let losses = &self.part.losses;
                        losses.note_topic(
                            Reason::Senseless,
                            &source.topic,
                            taken.place,
                            loss,
                            detail,
                        );
                    }
                }
            }
        }
        self.pushed = 0;
        ordered.sort_by_key(|(order, _)| *order);
        let rows: Vec<T> = ordered.into_iter().flat_map(|(_, rows)| rows).collect();
        if rows.is_empty() {
            return Ok(Vec::new());
        }
        Ok(vec![batch(rows)?.project(&self.projection)?])
    }
}
