//! Growing columns as flat byte buffers, addressed by number.
//!
//! Arrow's builders cannot take a row back. These can: every buffer's length
//! follows from the number of rows, so a failed row costs one truncation and a
//! good one costs nothing.
//!
//! ```text
//! Node (mirrors the Arrow type) ──numbers──▶ Pool: [bytes] [bytes] [offsets] ...
//!        └─ finish ──▶ ArrayRef                 ▲ programs append here
//! ```

use crate::DecodeError;
use crate::views::{Shared, VIEW, Views};
use arrow::array::{ArrayData, ArrayRef, make_array};
use arrow::buffer::{BooleanBuffer, MutableBuffer, NullBuffer};
use arrow::datatypes::{DataType, Field, FieldRef, Fields, ToByteSlice};
use arrow::error::ArrowError;

/// Most elements or bytes under one 32-bit offset column.
const OFFSET_LIMIT: usize = i32::MAX as usize;

/// All buffers of a decoder.
#[derive(Debug, Default)]
pub(crate) struct Pool {
    pub(crate) buffers: Vec<MutableBuffer>,
    pub(crate) shared: Shared,
}

/// Where the values of one Arrow field live, or nowhere: what is appended to a field that is left out is forgotten, so
/// that readers need not know the projection.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    data_type: DataType,
    /// One byte per row, 0 for null; only for nullable fields.
    validity: Option<usize>,
    layout: Layout,
}

/// A field that is left out, and all fields within it.
static LEFT_OUT: Node = Node {
    data_type: DataType::Null,
    validity: None,
    layout: Layout::None,
};

/// Offsets and data buffer of a variable-length column.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Target {
    pub(crate) offsets: usize,
    pub(crate) data: usize,
}

/// The buffers behind one Arrow type.
#[derive(Debug, Clone)]
enum Layout {
    /// None: the field is left out.
    None,
    /// Native-endian values of `width` bytes; also fixed-size binary.
    Fixed { data: usize, width: usize },
    /// One byte per value, non-zero for true.
    Bool { data: usize },
    /// Utf8.
    Bytes { offsets: usize, data: usize },
    /// BinaryView; `data` holds what is no view into a block.
    Views(Views),
    /// Lists; offsets count rows of `child`.
    List { offsets: usize, child: Box<Node> },
    /// Lists of `size` elements each.
    FixedList { size: usize, child: Box<Node> },
    /// Structs; no buffer of their own.
    Struct { children: Vec<Node> },
}

impl Pool {
    /// Appends `bytes` as one value of a Utf8 column.
    pub(crate) fn append_text(
        &mut self,
        offsets: usize,
        data: usize,
        bytes: &[u8],
    ) -> Result<(), DecodeError> {
        let total = self.buffers[data].len() + bytes.len();
        let end = offset(total)?;
        self.buffers[data].extend_from_slice(bytes);
        self.buffers[offsets].push(end);
        Ok(())
    }

    /// The last value of an offsets buffer.
    pub(crate) fn last_offset(&self, offsets: usize) -> usize {
        last_offset(&self.buffers[offsets])
    }

    /// Bytes in all buffers, and of all values that are views.
    pub(crate) fn bytes(&self) -> usize {
        let own: usize = self.buffers.iter().map(MutableBuffer::len).sum();
        own + self.shared.bytes
    }
}

/// `value` as an Arrow offset.
pub(crate) fn offset(value: usize) -> Result<i32, DecodeError> {
    i32::try_from(value).map_err(|_| DecodeError::Full {
        limit: OFFSET_LIMIT,
    })
}

fn last_offset(buffer: &MutableBuffer) -> usize {
    let tail = buffer.as_slice().last_chunk::<4>();
    tail.map_or(0, |bytes| i32::from_ne_bytes(*bytes) as usize)
}

fn offset_at(buffer: &MutableBuffer, row: usize) -> usize {
    let bytes = buffer.as_slice().get(row * 4..row * 4 + 4);
    bytes
        .and_then(|b| b.first_chunk::<4>())
        .map_or(0, |b| i32::from_ne_bytes(*b) as usize)
}

impl Node {
    /// Lays out the members of a message over buffers appended to `pool`; those not in `projection` are left out.
    pub(crate) fn message(members: &Fields, projection: &[usize], pool: &mut Pool) -> Node {
        let mut children = vec![LEFT_OUT.clone(); members.len()];
        for index in projection {
            children[*index] = Node::new(&members[*index], pool);
        }
        Node {
            data_type: DataType::Struct(members.clone()),
            validity: None,
            layout: Layout::Struct { children },
        }
    }

    fn new(field: &FieldRef, pool: &mut Pool) -> Node {
        Node {
            data_type: field.data_type().clone(),
            validity: field.is_nullable().then(|| pool.bytes_buffer()),
            layout: Layout::new(field.data_type(), pool),
        }
    }

    /// A field that is left out.
    pub(crate) fn left_out() -> &'static Node {
        &LEFT_OUT
    }

    /// Whether what is appended is forgotten.
    pub(crate) fn is_left_out(&self) -> bool {
        matches!(self.layout, Layout::None)
    }

    /// The member of a struct.
    pub(crate) fn member(&self, index: usize) -> &Node {
        match &self.layout {
            Layout::Struct { children } => children.get(index).unwrap_or(&LEFT_OUT),
            _ => &LEFT_OUT,
        }
    }

    /// The elements of a list.
    pub(crate) fn element(&self) -> &Node {
        match &self.layout {
            Layout::List { child, .. } | Layout::FixedList { child, .. } => child,
            _ => &LEFT_OUT,
        }
    }

    /// The buffer of numbers, flags or fixed-size binary.
    pub(crate) fn data(&self) -> Option<usize> {
        match &self.layout {
            Layout::Fixed { data, .. } | Layout::Bool { data } => Some(*data),
            _ => None,
        }
    }

    /// The offsets of a list.
    pub(crate) fn offsets(&self) -> Option<usize> {
        match &self.layout {
            Layout::List { offsets, .. } => Some(*offsets),
            _ => None,
        }
    }

    /// The buffers of a binary column.
    pub(crate) fn views(&self) -> Option<Views> {
        match &self.layout {
            Layout::Views(views) => Some(*views),
            _ => None,
        }
    }

    /// Offsets and data of a string, or of a list of numbers.
    pub(crate) fn target(&self) -> Option<Target> {
        let (offsets, data) = match &self.layout {
            Layout::Bytes { offsets, data } => (*offsets, *data),
            Layout::List { offsets, child } => (*offsets, child.data()?),
            _ => return None,
        };
        Some(Target { offsets, data })
    }

    /// Appends a number, or a flag as a byte.
    pub(crate) fn append_value(&self, pool: &mut Pool, value: impl ToByteSlice) {
        if let Some(data) = self.data() {
            pool.buffers[data].push(value);
        }
    }

    /// Appends a string or binary.
    pub(crate) fn append_bytes(&self, pool: &mut Pool, bytes: &[u8]) -> Result<(), DecodeError> {
        match &self.layout {
            Layout::Bytes { offsets, data } => pool.append_text(*offsets, *data, bytes),
            Layout::Views(views) => pool.append_view(*views, bytes),
            _ => Ok(()),
        }
    }

    /// The elements of a list's rows so far.
    pub(crate) fn elements(&self, pool: &Pool) -> usize {
        self.offsets()
            .map_or(0, |offsets| pool.last_offset(offsets))
    }

    /// Ends a row of a list: `count` elements were appended to it.
    pub(crate) fn end_list(&self, pool: &mut Pool, count: usize) -> Result<(), DecodeError> {
        if let Some(offsets) = self.offsets() {
            let end = offset(pool.last_offset(offsets) + count)?;
            pool.buffers[offsets].push(end);
        }
        Ok(())
    }

    /// Appends a row that the payload does not hold: null where allowed, else zero or empty.
    pub(crate) fn append_absent(&self, pool: &mut Pool) {
        if let Some(validity) = self.validity {
            pool.buffers[validity].push(0_u8);
        }
        match &self.layout {
            Layout::None => {}
            Layout::Fixed { data, width } => pool.buffers[*data].extend_zeros(*width),
            Layout::Bool { data } => pool.buffers[*data].push(0_u8),
            Layout::Views(to) => pool.buffers[to.views].extend_zeros(VIEW),
            Layout::Bytes { offsets, .. } | Layout::List { offsets, .. } => {
                let end = pool.last_offset(*offsets) as i32;
                pool.buffers[*offsets].push(end);
            }
            Layout::FixedList { size, child } => {
                for _ in 0..*size {
                    child.append_absent(pool);
                }
            }
            Layout::Struct { children } => {
                for child in children {
                    child.append_absent(pool);
                }
            }
        }
    }

    /// Notes that the value about to be appended is there.
    pub(crate) fn append_present(&self, pool: &mut Pool) {
        if let Some(validity) = self.validity {
            pool.buffers[validity].push(1_u8);
        }
    }

    /// Cuts the column back to `rows` rows.
    pub(crate) fn truncate(&self, pool: &mut Pool, rows: usize) {
        if let Some(validity) = self.validity {
            pool.buffers[validity].truncate(rows);
        }
        match &self.layout {
            Layout::None => {}
            Layout::Fixed { data, width } => pool.buffers[*data].truncate(rows * width),
            Layout::Bool { data } => pool.buffers[*data].truncate(rows),
            Layout::Bytes { offsets, data } => {
                let end = cut_offsets(&mut pool.buffers[*offsets], rows);
                pool.buffers[*data].truncate(end);
            }
            // Bytes that no view is left of go with the batch.
            Layout::Views(to) => pool.buffers[to.views].truncate(rows * VIEW),
            Layout::List { offsets, child } => {
                let end = cut_offsets(&mut pool.buffers[*offsets], rows);
                child.truncate(pool, end);
            }
            Layout::FixedList { size, child } => child.truncate(pool, rows * size),
            Layout::Struct { children } => {
                for child in children {
                    child.truncate(pool, rows);
                }
            }
        }
    }

    /// Takes the first `rows` rows out of the pool as an Arrow array.
    pub(crate) fn finish(&self, pool: &mut Pool, rows: usize) -> Result<ArrayRef, ArrowError> {
        Ok(make_array(self.finish_data(pool, rows)?))
    }

    fn finish_data(&self, pool: &mut Pool, rows: usize) -> Result<ArrayData, ArrowError> {
        let nulls = self.validity.map(|validity| {
            let bytes = pool.take(validity);
            NullBuffer::new(pack_bits(&bytes, rows))
        });
        let array = ArrayData::builder(self.data_type.clone())
            .len(rows)
            .nulls(nulls.filter(|n| n.null_count() > 0));
        match &self.layout {
            Layout::None => array,
            Layout::Fixed { data, .. } => array.add_buffer(pool.take(*data).into()),
            Layout::Bool { data } => {
                let bytes = pool.take(*data);
                array.add_buffer(pack_bits(&bytes, rows).into_inner())
            }
            Layout::Views(to) => array
                .add_buffer(pool.take(to.views).into())
                .add_buffer(pool.take(to.data).into())
                .add_buffers(pool.shared.blocks.clone()),
            Layout::Bytes { offsets, data } => array
                .add_buffer(pool.take_offsets(*offsets).into())
                .add_buffer(pool.take(*data).into()),
            Layout::List { offsets, child } => {
                let offsets = pool.take_offsets(*offsets);
                let elements = child.finish_data(pool, last_offset(&offsets))?;
                array.add_buffer(offsets.into()).add_child_data(elements)
            }
            Layout::FixedList { size, child } => {
                array.add_child_data(child.finish_data(pool, rows * size)?)
            }
            Layout::Struct { children } => {
                let columns: Result<Vec<_>, _> = children
                    .iter()
                    .map(|child| child.finish_data(pool, rows))
                    .collect();
                array.child_data(columns?)
            }
        }
        .build()
    }
}

impl Layout {
    fn new(data_type: &DataType, pool: &mut Pool) -> Layout {
        match data_type {
            DataType::Boolean => Layout::Bool {
                data: pool.bytes_buffer(),
            },
            DataType::Utf8 => Layout::Bytes {
                offsets: pool.offsets_buffer(),
                data: pool.bytes_buffer(),
            },
            DataType::BinaryView => Layout::Views(Views {
                views: pool.bytes_buffer(),
                data: pool.bytes_buffer(),
            }),
            DataType::List(item) => Layout::List {
                offsets: pool.offsets_buffer(),
                child: Box::new(Node::new(item, pool)),
            },
            DataType::FixedSizeList(item, size) => Layout::FixedList {
                size: *size as usize,
                child: Box::new(Node::new(item, pool)),
            },
            DataType::Struct(fields) => Layout::Struct {
                children: fields.iter().map(|f| Node::new(f, pool)).collect(),
            },
            DataType::FixedSizeBinary(size) => Layout::Fixed {
                data: pool.bytes_buffer(),
                width: *size as usize,
            },
            other => Layout::Fixed {
                data: pool.bytes_buffer(),
                width: other.primitive_width().unwrap_or(1),
            },
        }
    }
}

impl Pool {
    fn bytes_buffer(&mut self) -> usize {
        self.buffers.push(MutableBuffer::default());
        self.buffers.len() - 1
    }

    fn offsets_buffer(&mut self) -> usize {
        let id = self.bytes_buffer();
        self.buffers[id].push(0_i32);
        id
    }

    /// The offsets so far; the buffer starts again at zero.
    fn take_offsets(&mut self, id: usize) -> MutableBuffer {
        let offsets = self.take(id);
        self.buffers[id].push(0_i32);
        offsets
    }

    /// What a buffer holds so far. The next batch will be about as large: its memory is asked for at once, rather
    /// than grown by copying.
    fn take(&mut self, id: usize) -> MutableBuffer {
        let next = MutableBuffer::with_capacity(self.buffers[id].len());
        std::mem::replace(&mut self.buffers[id], next)
    }
}

/// Keeps `rows` values; returns where the last of them ends.
fn cut_offsets(offsets: &mut MutableBuffer, rows: usize) -> usize {
    let end = offset_at(offsets, rows);
    offsets.truncate((rows + 1) * 4);
    end
}

fn pack_bits(bytes: &MutableBuffer, rows: usize) -> BooleanBuffer {
    let bytes = bytes.as_slice();
    BooleanBuffer::collect_bool(rows, |row| bytes.get(row).is_some_and(|b| *b != 0))
}

/// A non-null field; list elements are all named `item`.
pub(crate) fn required(name: &str, data_type: DataType) -> Field {
    Field::new(name, data_type, false)
}
