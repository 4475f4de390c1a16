//! The shape of a ROS message, whichever language declared it, and its Arrow type.

use crate::buffers::required;
use arrow::datatypes::{DataType, Field, FieldRef, Fields};
use std::sync::Arc;

/// The type of a member as it lies on the wire.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Wire {
    /// A number or flag of fixed size.
    Scalar(DataType),
    /// An IDL enumeration: a 32-bit number, yet not primitive to CDR2.
    Enumeration,
    Text,
    /// UTF-16 text.
    WideText,
    Sequence(Arc<Wire>),
    Array(Arc<Wire>, usize),
    Struct(Arc<StructType>),
}

/// What CDR2 writes around a struct.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extensibility {
    /// Not annotated: as the payload's header says.
    Unstated,
    Final,
    Appendable,
}

/// A message or struct.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StructType {
    pub(crate) members: Vec<(String, Wire)>,
    pub(crate) extensibility: Extensibility,
    /// Columns below, itself included: bounds what a schema may unfold to.
    pub(crate) columns: usize,
    /// Levels of nesting below, itself included.
    pub(crate) depth: usize,
    /// Bytes in Arrow of one value, not counting what sequences hold.
    pub(crate) fixed_bytes: u64,
}

/// ROS 2 gives an empty message this one member, as IDL knows no empty struct.
pub(crate) const EMPTY_MEMBER: &str = "structure_needs_at_least_one_member";

/// The integer of this name, where messages and IDL name it alike.
pub(crate) fn integer(name: &str) -> Option<DataType> {
    Some(match name {
        "int8" => DataType::Int8,
        "uint8" => DataType::UInt8,
        "int16" => DataType::Int16,
        "uint16" => DataType::UInt16,
        "int32" => DataType::Int32,
        "uint32" => DataType::UInt32,
        "int64" => DataType::Int64,
        "uint64" => DataType::UInt64,
        _ => return None,
    })
}

impl Wire {
    /// Whether a run of these is kept as binary.
    pub(crate) fn is_octet(&self) -> bool {
        *self == Wire::Scalar(DataType::UInt8)
    }

    /// Number, flag or enumeration: its bytes on the wire and in Arrow (a flag is one byte until the batch is finished).
    pub(crate) fn fixed_width(&self) -> Option<usize> {
        match self {
            Wire::Scalar(DataType::Boolean) => Some(1),
            Wire::Scalar(number) => number.primitive_width(),
            Wire::Enumeration => Some(4),
            _ => None,
        }
    }

    pub(crate) fn columns(&self) -> usize {
        match self {
            Wire::Sequence(item) | Wire::Array(item, _) => item.columns().saturating_add(1),
            Wire::Struct(body) => body.columns,
            _ => 1,
        }
    }

    pub(crate) fn depth(&self) -> usize {
        match self {
            Wire::Sequence(item) | Wire::Array(item, _) => item.depth() + 1,
            Wire::Struct(body) => body.depth,
            _ => 1,
        }
    }

    /// Bytes in Arrow of one value, not counting what sequences hold.
    pub(crate) fn fixed_bytes(&self) -> u64 {
        match self {
            Wire::Scalar(_) | Wire::Enumeration => self.fixed_width().unwrap_or(1) as u64,
            Wire::Sequence(item) if item.is_octet() => 16,
            Wire::Text | Wire::WideText | Wire::Sequence(_) => 4,
            Wire::Array(item, size) => item.fixed_bytes().saturating_mul(*size as u64),
            Wire::Struct(body) => body.fixed_bytes,
        }
    }

    pub(crate) fn data_type(&self) -> DataType {
        match self {
            Wire::Scalar(scalar) => scalar.clone(),
            Wire::Enumeration => DataType::Int32,
            Wire::Text | Wire::WideText => DataType::Utf8,
            Wire::Sequence(item) if item.is_octet() => DataType::BinaryView,
            Wire::Sequence(item) => DataType::List(element(item)),
            Wire::Array(item, size) if item.is_octet() => DataType::FixedSizeBinary(*size as i32),
            Wire::Array(item, size) => DataType::FixedSizeList(element(item), *size as i32),
            Wire::Struct(body) => DataType::Struct(body.fields()),
        }
    }
}

fn element(item: &Wire) -> FieldRef {
    Arc::new(required(Field::LIST_FIELD_DEFAULT_NAME, item.data_type()))
}

impl StructType {
    pub(crate) fn new(mut members: Vec<(String, Wire)>, extensibility: Extensibility) -> Self {
        if matches!(members.as_slice(), [(name, _)] if name == EMPTY_MEMBER) {
            members.clear();
        }
        let wires = || members.iter().map(|(_, wire)| wire);
        let columns = wires().fold(1, |sum: usize, w| sum.saturating_add(w.columns()));
        let depth = 1 + wires().map(Wire::depth).max().unwrap_or(0);
        let fixed_bytes = wires().fold(1, |sum: u64, w| sum.saturating_add(w.fixed_bytes()));
        StructType {
            members,
            extensibility,
            columns,
            depth,
            fixed_bytes,
        }
    }

    /// The Arrow fields, in declaration order.
    pub(crate) fn fields(&self) -> Fields {
        self.members
            .iter()
            .map(|(name, wire)| required(name, wire.data_type()))
            .collect()
    }
}
