//! A protobuf message type as slots by field number, and its Arrow fields.

use crate::{MAX_COLUMNS, MAX_DEPTH, SchemaError};
use arrow::datatypes::{DataType, Field, Fields};
use prost_reflect::{DescriptorPool, FieldDescriptor, Kind, MessageDescriptor};
use std::sync::Arc;

/// How one value lies on the wire.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    /// Varint kept in 32 bits; zigzag for `sint32`.
    Varint32 {
        zigzag: bool,
    },
    /// Varint kept in 64 bits; zigzag for `sint64`.
    Varint64 {
        zigzag: bool,
    },
    Bool,
    Fixed32,
    Fixed64,
    /// `string`.
    Text,
    /// `bytes`, and messages inside themselves.
    Bytes,
    Message(Arc<Plan>),
}

/// One field.
#[derive(Debug, Clone)]
pub(super) struct Slot {
    pub(super) name: String,
    pub(super) number: u32,
    /// Place among the message's columns.
    pub(super) column: usize,
    pub(super) shape: Shape,
    pub(super) repeated: bool,
    pub(super) group: bool,
    /// Fields of one oneof share a number.
    pub(super) oneof: Option<usize>,
}

/// One message type.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// By field number.
    pub(super) slots: Vec<Slot>,
    pub(super) fields: Fields,
}

/// Where a plan is being built.
struct Builder<'a> {
    schema: &'a str,
    open: Vec<String>,
    columns: usize,
}

impl Plan {
    /// The message `schema_name` of a serialised `FileDescriptorSet`.
    pub(crate) fn parse(schema_name: &str, set: &[u8]) -> Result<Arc<Plan>, SchemaError> {
        let pool = DescriptorPool::decode(set).map_err(|error| {
            let reason = format!("expected a complete FileDescriptorSet, found: {error}");
            SchemaError::refused(schema_name, reason)
        })?;
        let message = pool.get_message_by_name(schema_name.trim_start_matches('.'));
        let message = message.ok_or_else(|| SchemaError::UnknownType {
            schema: schema_name.to_owned(),
            missing: schema_name.to_owned(),
        })?;
        let mut builder = Builder {
            schema: schema_name,
            open: Vec::new(),
            columns: 0,
        };
        builder.message(&message)
    }

    /// The Arrow fields, in declaration order.
    pub(crate) fn fields(&self) -> &Fields {
        &self.fields
    }

    /// The slot of `number`; `guess` is tried first.
    pub(super) fn slot(&self, number: u32, guess: usize) -> Option<usize> {
        match self.slots.get(guess) {
            Some(slot) if slot.number == number => Some(guess),
            _ => self
                .slots
                .binary_search_by_key(&number, |slot| slot.number)
                .ok(),
        }
    }
}

impl Builder<'_> {
    fn refused(&self, reason: String) -> SchemaError {
        SchemaError::refused(self.schema, reason)
    }

    fn message(&mut self, message: &MessageDescriptor) -> Result<Arc<Plan>, SchemaError> {
        if self.open.len() >= MAX_DEPTH {
            return Err(self.refused(format!("expected at most {MAX_DEPTH} levels of nesting")));
        }
        self.open.push(message.full_name().to_owned());
        let mut slots = Vec::new();
        let mut fields = Vec::new();
        for (column, field) in message.fields().enumerate() {
            self.columns += 1;
            if self.columns > MAX_COLUMNS {
                return Err(self.refused(format!("expected at most {MAX_COLUMNS} columns")));
            }
            let (slot, arrow) = self.field(&field, column, message.is_map_entry())?;
            slots.push(slot);
            fields.push(arrow);
        }
        slots.sort_by_key(|slot| slot.number);
        self.open.pop();
        Ok(Arc::new(Plan {
            slots,
            fields: fields.into(),
        }))
    }

    fn field(
        &mut self,
        field: &FieldDescriptor,
        column: usize,
        in_map: bool,
    ) -> Result<(Slot, Field), SchemaError> {
        let repeated = field.is_list() || field.is_map();
        let (shape, mut data_type) = self.shape(&field.kind())?;
        let is_message = matches!(field.kind(), Kind::Message(_));
        let mut nullable =
            (field.supports_presence() || field.is_required()) && (is_message || !in_map);
        if repeated {
            let item = Field::new(Field::LIST_FIELD_DEFAULT_NAME, data_type, false);
            data_type = DataType::List(Arc::new(item));
            nullable = false;
        }
        let oneof = field.containing_oneof().and_then(|oneof| {
            let name = oneof.full_name().to_owned();
            field
                .parent_message()
                .oneofs()
                .position(|known| known.full_name() == name)
        });
        let slot = Slot {
            name: field.name().to_owned(),
            number: field.number(),
            column,
            shape,
            repeated,
            group: field.is_group(),
            oneof,
        };
        Ok((slot, Field::new(field.name(), data_type, nullable)))
    }

    fn shape(&mut self, kind: &Kind) -> Result<(Shape, DataType), SchemaError> {
        Ok(match kind {
            Kind::Double => (Shape::Fixed64, DataType::Float64),
            Kind::Float => (Shape::Fixed32, DataType::Float32),
            Kind::Int32 | Kind::Enum(_) => (Shape::Varint32 { zigzag: false }, DataType::Int32),
            Kind::Int64 => (Shape::Varint64 { zigzag: false }, DataType::Int64),
            Kind::Uint32 => (Shape::Varint32 { zigzag: false }, DataType::UInt32),
            Kind::Uint64 => (Shape::Varint64 { zigzag: false }, DataType::UInt64),
            Kind::Sint32 => (Shape::Varint32 { zigzag: true }, DataType::Int32),
            Kind::Sint64 => (Shape::Varint64 { zigzag: true }, DataType::Int64),
            Kind::Fixed32 => (Shape::Fixed32, DataType::UInt32),
            Kind::Fixed64 => (Shape::Fixed64, DataType::UInt64),
            Kind::Sfixed32 => (Shape::Fixed32, DataType::Int32),
            Kind::Sfixed64 => (Shape::Fixed64, DataType::Int64),
            Kind::Bool => (Shape::Bool, DataType::Boolean),
            Kind::String => (Shape::Text, DataType::Utf8),
            Kind::Bytes => (Shape::Bytes, DataType::Binary),
            Kind::Message(message) => {
                if self.open.iter().any(|open| open == message.full_name()) {
                    return Ok((Shape::Bytes, DataType::Binary));
                }
                let plan = self.message(message)?;
                let data_type = DataType::Struct(plan.fields.clone());
                (Shape::Message(plan), data_type)
            }
        })
    }
}
