//! The tables over a whole log: `messages` with their payloads as bytes, `attachments`, `metadata`.

use std::sync::Arc;

use arrow::array::{
    ArrayRef, BinaryBuilder, MapBuilder, RecordBatch, RecordBatchOptions, StringBuilder,
    TimestampNanosecondArray, UInt32Array, UInt64Array,
};
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use evermap_schemas::Fault;
use mcap::records::Record;

use crate::log::index::Unit;
use crate::log::record::{MessageHead, nanoseconds, parse, split};
use crate::scan::rows::{MessageAt, RowBuilder};
use crate::scan::topic::{head_column, timestamp};
use crate::session::LogPart;

/// Columns of `messages`.
pub(crate) fn messages_schema() -> SchemaRef {
    Arc::new(Schema::new(vec![
        Field::new("session", DataType::Utf8, false),
        Field::new("topic", DataType::Utf8, false),
        Field::new("log_time", timestamp(), false),
        Field::new("publish_time", timestamp(), false),
        Field::new("sequence", DataType::UInt32, false),
        Field::new("channel", DataType::UInt32, false),
        Field::new("schema_name", DataType::Utf8, true),
        Field::new("data", DataType::Binary, false),
    ]))
}

/// Columns of `attachments`.
pub(crate) fn attachments_schema() -> SchemaRef {
    Arc::new(Schema::new(vec![
        Field::new("session", DataType::Utf8, false),
        Field::new("name", DataType::Utf8, false),
        Field::new("media_type", DataType::Utf8, false),
        Field::new("log_time", timestamp(), false),
        Field::new("create_time", timestamp(), false),
        Field::new("size", DataType::UInt64, false),
        Field::new("data", DataType::Binary, false),
    ]))
}

/// Columns of `metadata`.
pub(crate) fn metadata_schema() -> SchemaRef {
    Arc::new(Schema::new(vec![
        Field::new("session", DataType::Utf8, false),
        Field::new("name", DataType::Utf8, false),
        Field::new("metadata", text_map_type(), false),
    ]))
}

/// The type of a column of text by text.
pub(crate) fn text_map_type() -> DataType {
    let entries = vec![
        Field::new("keys", DataType::Utf8, false),
        Field::new("values", DataType::Utf8, true),
    ];
    let entries = Field::new("entries", DataType::Struct(entries.into()), false);
    DataType::Map(Arc::new(entries), false)
}

/// A builder for [`text_map_type`].
pub(crate) fn text_map_builder() -> MapBuilder<StringBuilder, StringBuilder> {
    MapBuilder::new(None, StringBuilder::new(), StringBuilder::new())
}

/// Appends one map.
pub(crate) fn append_map<'a>(
    builder: &mut MapBuilder<StringBuilder, StringBuilder>,
    entries: impl IntoIterator<Item = (&'a String, &'a String)>,
) -> Result<(), Fault> {
    for (key, value) in entries {
        builder.keys().append_value(key);
        builder.values().append_value(value);
    }
    Ok(builder.append(true)?)
}

/// A batch of the projected columns; `column` makes each one.
fn project(
    schema: &SchemaRef,
    projection: &[usize],
    rows: usize,
    mut column: impl FnMut(usize) -> ArrayRef,
) -> Result<Vec<RecordBatch>, Fault> {
    if rows == 0 {
        return Ok(Vec::new());
    }
    let columns = projection.iter().map(|index| column(*index)).collect();
    let options = RecordBatchOptions::new().with_row_count(Some(rows));
    let schema = Arc::new(schema.project(projection)?);
    Ok(vec![RecordBatch::try_new_with_options(
        schema, columns, &options,
    )?])
}

/// Rows of `messages`.
pub(crate) struct MessageRows {
    part: Arc<LogPart>,
    projection: Vec<usize>,
    heads: Vec<MessageHead>,
    with_data: bool,
    data: BinaryBuilder,
    bytes: usize,
}

impl MessageRows {
    const DATA: usize = 7;

    pub fn new(part: &Arc<LogPart>, projection: &[usize]) -> Self {
        Self {
            part: part.clone(),
            projection: projection.to_vec(),
            heads: Vec::new(),
            with_data: projection.contains(&Self::DATA),
            data: BinaryBuilder::new(),
            bytes: 0,
        }
    }
}

fn texts<'a>(texts: impl Iterator<Item = Option<&'a str>>) -> ArrayRef {
    let mut builder = StringBuilder::new();
    texts.for_each(|text| builder.append_option(text));
    Arc::new(builder.finish())
}

impl RowBuilder for MessageRows {
    fn decodes(&self) -> bool {
        false
    }

    fn wants(&self, channel: u16) -> bool {
        self.part.index.channels.contains_key(&channel)
    }

    fn push(&mut self, message: &MessageAt<'_>) -> Result<(), String> {
        if self.with_data {
            if self.bytes + message.payload.len() > i32::MAX as usize {
                return Err("a payload beyond 2 GiB".to_owned());
            }
            self.data.append_value(message.payload);
            self.bytes += message.payload.len();
        }
        self.heads.push(message.head);
        self.bytes += size_of::<MessageHead>();
        Ok(())
    }

    fn rows(&self) -> usize {
        self.heads.len()
    }

    fn bytes(&self) -> usize {
        self.bytes
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        let heads = std::mem::take(&mut self.heads);
        let data: ArrayRef = Arc::new(self.data.finish());
        self.bytes = 0;
        let channels = &self.part.index.channels;
        let channel = |head: &MessageHead| channels.get(&head.channel);
        project(
            &messages_schema(),
            &self.projection,
            heads.len(),
            |column| match column {
                0 => head_column(0, &self.part.session, &heads),
                1 => texts(
                    heads
                        .iter()
                        .map(|head| channel(head).map(|c| c.topic.as_str())),
                ),
                2..=4 => head_column(column - 1, &self.part.session, &heads),
                5 => Arc::new(UInt32Array::from_iter_values(
                    heads.iter().map(|head| u32::from(head.channel)),
                )),
                6 => texts(heads.iter().map(|head| {
                    let schema = channel(head).and_then(|channel| channel.schema.as_ref());
                    schema.map(|schema| schema.name.as_str())
                })),
                _ => data.clone(),
            },
        )
    }
}

/// Rows of `attachments`.
pub(crate) struct AttachmentRows {
    session: Arc<str>,
    projection: Vec<usize>,
    heads: Vec<mcap::records::AttachmentHeader>,
    sizes: Vec<u64>,
    data: BinaryBuilder,
    bytes: usize,
}

impl AttachmentRows {
    pub fn new(part: &LogPart, projection: &[usize]) -> Self {
        Self {
            session: part.session.clone(),
            projection: projection.to_vec(),
            heads: Vec::new(),
            sizes: Vec::new(),
            data: BinaryBuilder::new(),
            bytes: 0,
        }
    }
}

impl RowBuilder for AttachmentRows {
    fn wants(&self, _: u16) -> bool {
        false
    }

    fn push(&mut self, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn push_record(&mut self, _: &LogPart, _: &Unit, record: &[u8]) -> Result<(), String> {
        let (opcode, body, _) = split(record).ok_or("a record that is cut")?;
        let Record::Attachment { header, data, .. } = parse(opcode, body)? else {
            return Err("expected an attachment record".to_owned());
        };
        if self.bytes + data.len() > i32::MAX as usize {
            return Err("an attachment beyond 2 GiB".to_owned());
        }
        self.heads.push(header);
        self.sizes.push(data.len() as u64);
        self.data.append_value(&data);
        self.bytes += data.len();
        Ok(())
    }

    fn rows(&self) -> usize {
        self.heads.len()
    }

    fn bytes(&self) -> usize {
        self.bytes
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        let heads = std::mem::take(&mut self.heads);
        let sizes = std::mem::take(&mut self.sizes);
        let data: ArrayRef = Arc::new(self.data.finish());
        self.bytes = 0;
        let times = |time: fn(&mcap::records::AttachmentHeader) -> u64| -> ArrayRef {
            let times = heads.iter().map(|head| nanoseconds(time(head)));
            Arc::new(TimestampNanosecondArray::from_iter_values(times).with_timezone("UTC"))
        };
        let schema = attachments_schema();
        project(
            &schema,
            &self.projection,
            heads.len(),
            |column| match column {
                0 => texts(heads.iter().map(|_| Some(&*self.session))),
                1 => texts(heads.iter().map(|head| Some(head.name.as_str()))),
                2 => texts(heads.iter().map(|head| Some(head.media_type.as_str()))),
                3 => times(|head| head.log_time),
                4 => times(|head| head.create_time),
                5 => Arc::new(UInt64Array::from(sizes.clone())),
                _ => data.clone(),
            },
        )
    }
}

/// Rows of `metadata`.
pub(crate) struct MetadataRows {
    session: Arc<str>,
    projection: Vec<usize>,
    records: Vec<mcap::records::Metadata>,
}

impl MetadataRows {
    pub fn new(part: &LogPart, projection: &[usize]) -> Self {
        Self {
            session: part.session.clone(),
            projection: projection.to_vec(),
            records: Vec::new(),
        }
    }
}

impl RowBuilder for MetadataRows {
    fn wants(&self, _: u16) -> bool {
        false
    }

    fn push(&mut self, _: &MessageAt<'_>) -> Result<(), String> {
        Ok(())
    }

    fn push_record(&mut self, _: &LogPart, _: &Unit, record: &[u8]) -> Result<(), String> {
        let (opcode, body, _) = split(record).ok_or("a record that is cut")?;
        let Record::Metadata(metadata) = parse(opcode, body)? else {
            return Err("expected a metadata record".to_owned());
        };
        self.records.push(metadata);
        Ok(())
    }

    fn rows(&self) -> usize {
        self.records.len()
    }

    fn bytes(&self) -> usize {
        let lengths = self
            .records
            .iter()
            .flat_map(|record| &record.metadata)
            .map(|(key, value)| key.len() + value.len());
        lengths.sum()
    }

    fn finish(&mut self) -> Result<Vec<RecordBatch>, Fault> {
        let records = std::mem::take(&mut self.records);
        let mut maps = text_map_builder();
        for record in &records {
            append_map(&mut maps, &record.metadata)?;
        }
        let maps: ArrayRef = Arc::new(maps.finish());
        let schema = metadata_schema();
        project(
            &schema,
            &self.projection,
            records.len(),
            |column| match column {
                0 => texts(records.iter().map(|_| Some(&*self.session))),
                1 => texts(records.iter().map(|record| Some(record.name.as_str()))),
                _ => maps.clone(),
            },
        )
    }
}
