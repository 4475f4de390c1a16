//! A protobuf message type as slots by field number, and its Arrow fields.

use super::descriptors::{Descriptors, FieldDescriptor, ResolvedType};
use crate::{MAX_DEPTH, SchemaError};
use arrow::datatypes::{DataType, Field, Fields};
use std::collections::HashSet;
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

/// What a field's type makes of it.
struct Kind {
    shape: Shape,
    data_type: DataType,
    is_message: bool,
    /// Lies between tags, not behind a length.
    group: bool,
    /// It is the entry of a map.
    entry: bool,
}

/// `TYPE_GROUP` and `TYPE_MESSAGE` of `FieldDescriptorProto.Type`.
const GROUP: u64 = 10;
const MESSAGE: u64 = 11;

/// One field.
#[derive(Debug, Clone)]
pub(super) struct Slot {
    pub(super) name: String,
    pub(super) number: u32,
    /// Place among the message's columns.
    pub(super) column: usize,
    pub(super) shape: Shape,
    pub(super) repeated: bool,
    /// Repeated entries of a map.
    pub(super) map: bool,
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
    /// Bytes of a row's own columns: numbers, offsets and validity, without those of messages within.
    pub(super) own_bytes: usize,
    /// Bytes of a row that holds nothing.
    pub(super) absent_bytes: usize,
}

/// Where a plan is being built.
struct Builder<'a> {
    schema: &'a str,
    types: Descriptors<'a>,
    /// Messages that are being built, outermost first.
    open: Vec<usize>,
    columns: usize,
}

impl Plan {
    /// The message `schema_name` of a serialised `FileDescriptorSet`.
    pub(crate) fn parse(schema_name: &str, set: &[u8]) -> Result<Arc<Plan>, SchemaError> {
        let mut types = Descriptors::read(schema_name, set)?;
        let message = types.message_named(schema_name.trim_start_matches('.'))?;
        let mut builder = Builder {
            schema: schema_name,
            types,
            open: Vec::new(),
            columns: 0,
        };
        builder.message(message)
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

impl Shape {
    /// Bytes that a value takes in its column at least; of a message, those of its columns.
    pub(super) fn fixed_bytes(&self) -> usize {
        match self {
            Shape::Bool => 1,
            Shape::Bytes => 16,
            Shape::Varint32 { .. } | Shape::Fixed32 | Shape::Text => 4,
            Shape::Varint64 { .. } | Shape::Fixed64 => 8,
            Shape::Message(plan) => plan.absent_bytes,
        }
    }
}

impl<'a> Builder<'a> {
    fn refused(&self, reason: String) -> SchemaError {
        SchemaError::refused(self.schema, reason)
    }

    fn message(&mut self, place: usize) -> Result<Arc<Plan>, SchemaError> {
        if self.open.len() >= MAX_DEPTH {
            return Err(self.refused(format!("expected at most {MAX_DEPTH} levels of nesting")));
        }
        let Some(message) = self.types.message_at(place) else {
            return Err(self.refused("expected a message, found something else".to_owned()));
        };
        self.open.push(place);
        let mut declared = Vec::new();
        for field in self.types.fields(message) {
            self.columns += 1;
            self.types.budget.check_columns(self.columns)?;
            declared.push(field?);
        }
        self.check_distinct(&declared)?;
        let mut slots = Vec::with_capacity(declared.len());
        let mut fields = Vec::with_capacity(declared.len());
        for (column, field) in declared.iter().enumerate() {
            let (slot, arrow) = self.field(place, field, column, message.map_entry)?;
            slots.push(slot);
            fields.push(arrow);
        }
        slots.sort_by_key(|slot| slot.number);
        self.open.pop();
        let own = |slot: &Slot, field: &Field| match (&slot.shape, slot.repeated) {
            (_, true) => 4,
            (Shape::Message(_), false) => 1,
            (shape, false) => shape.fixed_bytes() + usize::from(field.is_nullable()),
        };
        let within = |slot: &Slot| match (&slot.shape, slot.repeated) {
            (Shape::Message(plan), false) => plan.absent_bytes,
            _ => 0,
        };
        let own_bytes = slots.iter().map(|slot| own(slot, &fields[slot.column]));
        let own_bytes: usize = own_bytes.sum();
        Ok(Arc::new(Plan {
            own_bytes,
            absent_bytes: own_bytes + slots.iter().map(within).sum::<usize>(),
            slots,
            fields: fields.into(),
        }))
    }

    fn check_distinct(&self, fields: &[FieldDescriptor<'a>]) -> Result<(), SchemaError> {
        let mut names = HashSet::new();
        let mut numbers = HashSet::new();
        for field in fields {
            if !names.insert(field.name) || !numbers.insert(field.number) {
                return Err(self.refused(format!(
                    "expected fields of distinct names and numbers, found '{}' = {} twice",
                    field.name, field.number
                )));
            }
        }
        Ok(())
    }

    fn field(
        &mut self,
        place: usize,
        field: &FieldDescriptor<'a>,
        column: usize,
        in_map: bool,
    ) -> Result<(Slot, Field), SchemaError> {
        let Kind {
            shape,
            mut data_type,
            is_message,
            group,
            entry,
        } = self.kind(place, field)?;
        let mut nullable = is_message || (field.presence && !in_map);
        if field.repeated {
            let item = Field::new(Field::LIST_FIELD_DEFAULT_NAME, data_type, false);
            data_type = DataType::List(Arc::new(item));
            nullable = false;
        }
        let slot = Slot {
            name: field.name.to_owned(),
            number: field.number,
            column,
            shape,
            repeated: field.repeated,
            map: field.repeated && entry,
            group: group && !in_map,
            oneof: field.oneof,
        };
        Ok((slot, Field::new(field.name, data_type, nullable)))
    }

    /// By the numbers of `FieldDescriptorProto.Type`.
    fn kind(&mut self, place: usize, field: &FieldDescriptor<'a>) -> Result<Kind, SchemaError> {
        let (shape, data_type) = match field.kind {
            1 => (Shape::Fixed64, DataType::Float64),
            2 => (Shape::Fixed32, DataType::Float32),
            3 => (Shape::Varint64 { zigzag: false }, DataType::Int64),
            4 => (Shape::Varint64 { zigzag: false }, DataType::UInt64),
            5 | 14 => (Shape::Varint32 { zigzag: false }, DataType::Int32),
            6 => (Shape::Fixed64, DataType::UInt64),
            7 => (Shape::Fixed32, DataType::UInt32),
            8 => (Shape::Bool, DataType::Boolean),
            9 => (Shape::Text, DataType::Utf8),
            12 => (Shape::Bytes, DataType::BinaryView),
            13 => (Shape::Varint32 { zigzag: false }, DataType::UInt32),
            15 => (Shape::Fixed32, DataType::Int32),
            16 => (Shape::Fixed64, DataType::Int64),
            17 => (Shape::Varint32 { zigzag: true }, DataType::Int32),
            18 => (Shape::Varint64 { zigzag: true }, DataType::Int64),
            0 | GROUP | MESSAGE => return self.named(place, field),
            other => {
                return Err(self.refused(format!(
                    "expected a type from 1 to 18 for the field '{}', found {other}",
                    field.name
                )));
            }
        };
        Ok(Kind {
            shape,
            data_type,
            is_message: false,
            group: false,
            entry: false,
        })
    }

    fn named(&mut self, place: usize, field: &FieldDescriptor<'a>) -> Result<Kind, SchemaError> {
        let target = match self.types.resolve(place, field.type_name)? {
            ResolvedType::Message(target) => target,
            ResolvedType::Enumeration => {
                return Ok(Kind {
                    shape: Shape::Varint32 { zigzag: false },
                    data_type: DataType::Int32,
                    is_message: false,
                    group: false,
                    entry: false,
                });
            }
        };
        let of_map = self.types.message_at(target).is_some_and(|m| m.map_entry);
        let (shape, data_type) = if self.open.contains(&target) {
            (Shape::Bytes, DataType::BinaryView)
        } else {
            let plan = self.message(target)?;
            let data_type = DataType::Struct(plan.fields.clone());
            (Shape::Message(plan), data_type)
        };
        Ok(Kind {
            shape,
            data_type,
            is_message: true,
            group: field.kind == GROUP || (field.delimited && !of_map),
            entry: of_map,
        })
    }
}
