//! A topic's messages as a table: four columns that every message has, then the message's own fields.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::Arc;

use arrow::array::{
    ArrayRef, RecordBatch, StringArray, TimestampNanosecondArray, UInt32Array, new_null_array,
};
use arrow::datatypes::{DataType, Field, FieldRef, Fields, Schema, SchemaRef};
use async_trait::async_trait;
use evermap_messages::{Decoder, MessageType};
use evermap_schemas::{Cell, Fault, Stamp};

use crate::log::definition::LogChannel;
use crate::log::record::MessageHead;
use crate::scan::rows::{MessageAt, RowBuilder, projected};
use crate::scan::table::LogTable;
use crate::session::LogPart;

/// The columns that every message has.
pub(crate) fn head_fields() -> [Field; 4] {
    [
        Field::new("session", DataType::Utf8, false),
        Field::new("log_time", Stamp::data_type(), false),
        Field::new("publish_time", Stamp::data_type(), false),
        Field::new("sequence", DataType::UInt32, false),
    ]
}
const HEAD: usize = 4;

/// Column names of a message's fields: their own, with `_` appended until they differ from the four columns of every
/// message and from each other.
fn column_names(fields: &Fields) -> Vec<String> {
    let mut taken: HashSet<String> = head_fields().iter().map(|f| f.name().clone()).collect();
    let mut names = Vec::with_capacity(fields.len());
    for field in fields {
        let mut name = field.name().clone();
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        names.push(name);
    }
    names
}

/// Bytes of the largest value of fixed size that messages may lack. A null takes as much, though nothing is there.
const LARGEST_LACKING: usize = 64 << 10;

/// Bytes that any value of a type takes, also a null.
fn fixed_bytes(data_type: &DataType) -> usize {
    match data_type {
        DataType::FixedSizeBinary(size) => *size as usize,
        DataType::FixedSizeList(item, size) => {
            fixed_bytes(item.data_type()).saturating_mul(*size as usize)
        }
        DataType::Struct(fields) => {
            let members = fields.iter().map(|field| fixed_bytes(field.data_type()));
            members.fold(0, usize::saturating_add)
        }
        DataType::BinaryView => 16,
        other => other.primitive_width().unwrap_or(4),
    }
}

/// The messages of one topic, decoded.
#[derive(Debug)]
pub(crate) struct TopicTable {
    topic: String,
    schema: SchemaRef,
}

impl TopicTable {
    /// The table of a topic in these files.
    ///
    /// # Errors
    /// A data fault when a channel's messages cannot be decoded, or when two channels give a field different types.
    pub fn new(topic: &str, parts: &[Arc<LogPart>]) -> Result<Self, Fault> {
        Ok(Self {
            topic: topic.to_owned(),
            schema: topic_schema(topic, parts)?,
        })
    }
}

#[async_trait]
impl LogTable for TopicTable {
    fn name(&self) -> &str {
        &self.topic
    }

    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn topic(&self) -> &str {
        &self.topic
    }

    /// Messages may have a topic and a site of their own.
    fn indexed_columns(&self) -> &'static [&'static str] {
        &["log_time", "session"]
    }

    fn is_in(&self, part: &LogPart) -> bool {
        part.has_any(std::slice::from_ref(&self.topic))
    }

    async fn rows(
        &self,
        part: &Arc<LogPart>,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault> {
        let rows = TopicRows::new(&self.topic, part, &self.schema, projection)?;
        Ok(Box::new(rows))
    }
}

/// The schema of a topic over several files: the union of its channels' fields by name. A field that some channels
/// lack is nullable.
fn topic_schema(topic: &str, parts: &[Arc<LogPart>]) -> Result<SchemaRef, Fault> {
    let at_topic = |fault: Fault| {
        let place = format!("topic {topic}");
        fault.at(place).next(instead_of(topic, parts))
    };
    let mut columns = Columned::default();
    let mut seen: HashSet<Fields> = HashSet::new();
    for part in parts {
        for channel in part.channels_of(topic) {
            let fields = message_type(part, channel)?.fields();
            if !seen.contains(fields) {
                let merged = columns.merge(fields);
                merged.map_err(|fault| at_topic(fault).at(&part.url))?;
                seen.insert(fields.clone());
            }
        }
    }
    let mut own = Vec::with_capacity(columns.columns.len());
    for (field, count) in columns.columns {
        let lacking = count < seen.len();
        let bytes = fixed_bytes(field.data_type());
        if lacking && bytes > LARGEST_LACKING {
            return Err(at_topic(Fault::data(format!(
                "expected a field of at most {LARGEST_LACKING} B where some channels lack it, found {} of {bytes} B",
                field.name()
            ))));
        }
        let nullable = field.is_nullable() || lacking;
        own.push(Arc::new(field.as_ref().clone().with_nullable(nullable)));
    }
    let head = head_fields().into_iter().map(Arc::new);
    Ok(Arc::new(Schema::new(head.chain(own).collect::<Fields>())))
}

/// Schemas that are named where there are too many for one table.
const NAMED: usize = 4;

/// What can be asked of a topic whose messages are not of one table.
fn instead_of(topic: &str, parts: &[Arc<LogPart>]) -> String {
    let mut sessions = HashSet::new();
    let mut schemas = BTreeSet::new();
    for part in parts {
        for channel in part.channels_of(topic) {
            sessions.insert(&part.session);
            let name = part.index.schema_of(channel).map(|schema| &schema.name);
            schemas.extend(name.map(|name| (channel.schema_id, name)));
        }
    }
    if sessions.len() > 1 {
        return "scan the sessions apart, or read the payloads from the table messages".to_owned();
    }
    let named = schemas.iter().take(NAMED);
    let named: Vec<String> = named.map(|(id, name)| format!("{id} ({name})")).collect();
    format!(
        "its schemas are {}: query a role that it plays, or read the payloads from the table messages by channel",
        named.join(", ")
    )
}

fn message_type<'a>(part: &'a LogPart, channel: &LogChannel) -> Result<&'a MessageType, Fault> {
    let decodable = part.decodable(channel);
    decodable.map_err(|fault| fault.next("its payloads are in the table messages, as bytes"))
}

/// Columns so far, each with the number of message types that have it.
#[derive(Default)]
struct Columned {
    columns: Vec<(FieldRef, usize)>,
    places: HashMap<String, usize>,
}

impl Columned {
    fn merge(&mut self, fields: &Fields) -> Result<(), Fault> {
        for (field, name) in fields.iter().zip(column_names(fields)) {
            let next = self.columns.len();
            let place = *self.places.entry(name.clone()).or_insert(next);
            let field = Arc::new(field.as_ref().clone().with_name(name));
            match self.columns.get_mut(place) {
                None => self.columns.push((field, 1)),
                Some((known, count)) if known.data_type() == field.data_type() => {
                    *count += 1;
                    if field.is_nullable() {
                        *known = field;
                    }
                }
                Some((known, _)) => {
                    return Err(Fault::data(format!(
                        "expected one type for the field {}, found {} and {}",
                        field.name(),
                        known.data_type(),
                        field.data_type()
                    )));
                }
            }
        }
        Ok(())
    }
}

/// Builds the rows of one topic from one file.
struct TopicRows {
    session: Arc<str>,
    schema: SchemaRef,
    projection: Vec<usize>,
    channels: BTreeMap<u16, usize>,
    decoders: Vec<Columns>,
    current: usize,
    heads: Vec<MessageHead>,
    done: Vec<RecordBatch>,
    done_rows: usize,
    done_bytes: usize,
}

/// One message type's decoder, and where its columns go.
struct Columns {
    decoder: Decoder,
    /// Which of the decoder's columns a column of the table is, of those that are projected and that this type has.
    places: BTreeMap<usize, usize>,
    /// Bytes of a row in the columns that this type lacks.
    lacking_bytes: usize,
}

impl TopicRows {
    fn new(
        topic: &str,
        part: &LogPart,
        schema: &SchemaRef,
        projection: &[usize],
    ) -> Result<Self, Fault> {
        let mut types: Vec<&LogChannel> = Vec::new();
        let mut decoders = Vec::new();
        let mut channels = BTreeMap::new();
        for channel in part.channels_of(topic) {
            let same = |other: &&LogChannel| {
                let schema = |channel| part.index.schema_of(channel);
                schema(other) == schema(channel)
                    && other.message_encoding == channel.message_encoding
            };
            let decoder = types.iter().position(same).unwrap_or(types.len());
            if decoder == types.len() {
                types.push(channel);
                let found = message_type(part, channel)?;
                decoders.push(Columns::new(found, schema, projection));
            }
            channels.insert(channel.id, decoder);
        }
        Ok(Self {
            session: part.session.clone(),
            schema: schema.clone(),
            projection: projection.to_vec(),
            channels,
            decoders,
            current: 0,
            heads: Vec::new(),
            done: Vec::new(),
            done_rows: 0,
            done_bytes: 0,
        })
    }

    /// Closes the batch of the current decoder: another message type follows.
    fn close(&mut self) -> Result<(), Fault> {
        let Some(columns) = self.decoders.get_mut(self.current) else {
            return Ok(());
        };
        let heads = std::mem::take(&mut self.heads);
        let decoded = columns.decoder.finish()?;
        let column = |column: usize| match columns.places.get(&column) {
            _ if column < HEAD => head_column(column, &self.session, &heads),
            Some(place) => decoded[*place].clone(),
            None => new_null_array(self.schema.field(column).data_type(), heads.len()),
        };
        for batch in projected(&self.schema, &self.projection, heads.len(), column)? {
            self.done_rows += batch.num_rows();
            self.done_bytes += batch.get_array_memory_size();
            self.done.push(batch);
        }
        Ok(())
    }
}

/// One of the four columns that every message has.
pub(crate) fn head_column(column: usize, session: &str, heads: &[MessageHead]) -> ArrayRef {
    let times = |time: fn(&MessageHead) -> i64| -> ArrayRef {
        let times = TimestampNanosecondArray::from_iter_values(heads.iter().map(time));
        Arc::new(times.with_timezone("UTC"))
    };
    match column {
        0 => Arc::new(StringArray::from_iter_values(heads.iter().map(|_| session))),
        1 => times(|head| head.log_time),
        2 => times(|head| head.publish_time),
        _ => Arc::new(UInt32Array::from_iter_values(
            heads.iter().map(|head| head.sequence),
        )),
    }
}

impl Columns {
    fn new(message_type: &MessageType, schema: &SchemaRef, projection: &[usize]) -> Self {
        let names = column_names(message_type.fields()).into_iter();
        let names: HashMap<String, usize> =
            names.enumerate().map(|(at, name)| (name, at)).collect();
        let own = || projection.iter().filter(|column| **column >= HEAD);
        let field = |column: &usize| names.get(schema.field(*column).name()).copied();
        let mut wanted: Vec<usize> = own().filter_map(field).collect();
        wanted.sort_unstable();
        wanted.dedup();
        let place = |column: &usize| {
            let place = wanted.binary_search(&field(column)?).ok()?;
            Some((*column, place))
        };
        let places: BTreeMap<usize, usize> = own().filter_map(place).collect();
        let lacking_bytes = own()
            .filter(|column| !places.contains_key(*column))
            .map(|column| fixed_bytes(schema.field(*column).data_type()))
            .fold(0, usize::saturating_add);
        Self {
            decoder: message_type.decoder(Some(&wanted)),
            places,
            lacking_bytes,
        }
    }
}

impl RowBuilder for TopicRows {
    fn wants(&self, channel: u16) -> bool {
        self.channels.contains_key(&channel)
    }

    fn push(&mut self, message: &MessageAt<'_>) -> Result<(), String> {
        let Some(decoder) = self.channels.get(&message.head.channel).copied() else {
            return Ok(());
        };
        if decoder != self.current {
            self.close().map_err(|fault| fault.to_string())?;
            self.current = decoder;
        }
        let Some(columns) = self.decoders.get_mut(decoder) else {
            return Ok(());
        };
        let decoder = &mut columns.decoder;
        let pushed = match message.shares {
            true => decoder.push_of(&message.block.bytes, message.payload),
            false => decoder.push(message.payload),
        };
        pushed.map_err(|error| error.to_string())?;
        self.heads.push(message.head);
        Ok(())
    }

    fn rows(&self) -> usize {
        self.done_rows + self.heads.len()
    }

    fn bytes(&self) -> usize {
        let decoder = self.decoders.get(self.current);
        let decoded = decoder.map_or(0, |columns| columns.decoder.bytes());
        let lacking = decoder.map_or(0, |columns| columns.lacking_bytes);
        let head = size_of::<MessageHead>() + self.session.len();
        self.done_bytes
            + decoded
            + self
                .heads
                .len()
                .saturating_mul(head.saturating_add(lacking))
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        self.close()?;
        self.done_rows = 0;
        self.done_bytes = 0;
        Ok(std::mem::take(&mut self.done))
    }
}
