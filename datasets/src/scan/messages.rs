//! The table over all messages of a log, with their payloads as bytes.

use std::sync::Arc;

use arrow::array::{ArrayRef, BinaryViewBuilder, RecordBatch, StringArray, UInt32Array};
use arrow::datatypes::{DataType, Field, Schema, SchemaRef};
use async_trait::async_trait;
use bytes::Bytes;
use evermap_schemas::{Cell, Fault, Stamp};

use crate::log::record::MessageHead;
use crate::scan::rows::{MessageAt, RowBuilder, projected};
use crate::scan::table::LogTable;
use crate::scan::topic::head_column;
use crate::session::LogPart;

/// All messages of a log, with their payloads as bytes.
#[derive(Debug, Clone, Copy)]
pub struct MessagesTable;

#[async_trait]
impl LogTable for MessagesTable {
    fn name(&self) -> &str {
        "messages"
    }

    fn schema(&self) -> SchemaRef {
        Arc::new(Schema::new(vec![
            Field::new("session", DataType::Utf8, false),
            Field::new("topic", DataType::Utf8, false),
            Field::new("log_time", Stamp::data_type(), false),
            Field::new("publish_time", Stamp::data_type(), false),
            Field::new("sequence", DataType::UInt32, false),
            Field::new("channel", DataType::UInt32, false),
            Field::new("schema_name", DataType::Utf8, true),
            Field::new("data", DataType::BinaryView, false),
        ]))
    }

    fn is_in(&self, _: &LogPart) -> bool {
        true
    }

    async fn rows(
        &self,
        part: &Arc<LogPart>,
        projection: &[usize],
    ) -> Result<Box<dyn RowBuilder>, Fault> {
        Ok(Box::new(MessageRows::new(part, projection)))
    }
}

/// Rows of `messages`.
struct MessageRows {
    part: Arc<LogPart>,
    projection: Vec<usize>,
    heads: Vec<MessageHead>,
    with_data: bool,
    data: BinaryViewBuilder,
    /// The block that the last view is into, and its number in the column.
    block: Option<(Bytes, u32)>,
    bytes: usize,
}

impl MessageRows {
    const DATA: usize = 7;

    fn new(part: &Arc<LogPart>, projection: &[usize]) -> Self {
        Self {
            part: part.clone(),
            projection: projection.to_vec(),
            heads: Vec::new(),
            with_data: projection.contains(&Self::DATA),
            data: BinaryViewBuilder::new(),
            block: None,
            bytes: 0,
        }
    }
}

impl MessageRows {
    fn append(&mut self, message: &MessageAt<'_>) -> Result<(), String> {
        let (whole, payload) = (&message.block.bytes, message.payload);
        let place = (u32::try_from(message.at), u32::try_from(payload.len()));
        let (Ok(start), Ok(length)) = place else {
            return Err("a payload larger than 4 GiB".to_owned());
        };
        if !message.shares {
            self.data.append_value(payload);
            return Ok(());
        }
        let known = self.block.as_ref();
        let known = known.filter(|(bytes, _)| bytes.as_ptr() == whole.as_ptr());
        let number = match known {
            Some((_, number)) => *number,
            None => {
                let number = self.data.append_block(whole.clone().into());
                self.block = Some((whole.clone(), number));
                number
            }
        };
        let viewed = self.data.try_append_view(number, start, length);
        viewed.map_err(|error| error.to_string())
    }
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
            self.append(message)?;
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
        self.block = None;
        let channels = &self.part.index.channels;
        let topic = |head: &MessageHead| Some(channels.get(&head.channel)?.topic.as_str());
        let schema_name = |head: &MessageHead| {
            let found = self.part.index.schema_of(channels.get(&head.channel)?)?;
            Some(found.name.as_str())
        };
        let schema = MessagesTable.schema();
        projected(
            &schema,
            &self.projection,
            heads.len(),
            |column| match column {
                0 => head_column(0, &self.part.session, &heads),
                1 => Arc::new(heads.iter().map(topic).collect::<StringArray>()),
                2..=4 => head_column(column - 1, &self.part.session, &heads),
                5 => Arc::new(UInt32Array::from_iter_values(
                    heads.iter().map(|head| u32::from(head.channel)),
                )),
                6 => Arc::new(heads.iter().map(schema_name).collect::<StringArray>()),
                _ => data.clone(),
            },
        )
    }
}
