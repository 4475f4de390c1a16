//! Protobuf messages, from wire straight to columns.
//!
//! Fields may come in any order, more than once, or not at all, so each appends to its
//! own column as it is met, and at the end of the message those not met append null or
//! their zero. As the specification has it: of a number or string the last one counts,
//! parts of a message are merged, and of a `oneof` the last member stands.
//!
//! Maps are lists of `{key, value}`, in wire order; of a key, the last entry. A message inside itself is kept as
//! its bytes. Source: protobuf.dev, "Encoding".

mod descriptors;
mod map;
mod plan;
mod wire;

use crate::budget::MessageBudget;
use crate::buffers::{Node, Pool, offset};
use crate::decoder::Format;
use crate::{DecodeError, Located};
pub(crate) use plan::Plan;
use plan::{Shape, Slot};
use std::sync::Arc;
use wire::{Value, WireReader};

/// What was met of a slot in the message at hand.
#[derive(Debug, Clone, Copy, Default)]
struct SlotState {
    count: usize,
    /// Where in the message the first was met.
    first: usize,
    /// All parts of a split message, or entries of a map, were taken together.
    merged: bool,
}

/// Reads payloads of one message type.
pub(crate) struct Reader {
    plan: Arc<Plan>,
    met: Vec<SlotState>,
}

impl Reader {
    pub(crate) fn new(plan: Arc<Plan>) -> Self {
        let met = Vec::new();
        Self { plan, met }
    }
}

impl Format for Reader {
    fn append(
        &mut self,
        payload: &[u8],
        message: &Node,
        row: usize,
        pool: &mut Pool,
    ) -> Result<(), DecodeError> {
        self.met.clear();
        let mut sink = Sink {
            pool,
            met: &mut self.met,
            budget: MessageBudget::of(payload),
        };
        sink.message(&self.plan, message, row, payload)
    }
}

/// Where values go, and what is kept while a message is read.
struct Sink<'a> {
    pool: &'a mut Pool,
    /// A stack: one stretch for each message that is open.
    met: &'a mut Vec<SlotState>,
    budget: MessageBudget,
}

/// A message being read into row `row` of its columns.
#[derive(Clone, Copy)]
struct OpenMessage<'a> {
    plan: &'a Plan,
    to: &'a Node,
    row: usize,
    data: &'a [u8],
    /// Start of its stretch of `met`.
    base: usize,
}

impl Sink<'_> {
    /// Appends row `row` of a message's columns.
    fn message(
        &mut self,
        plan: &Plan,
        to: &Node,
        row: usize,
        data: &[u8],
    ) -> Result<(), DecodeError> {
        self.budget.spend(plan.own_bytes)?;
        let base = self.met.len();
        self.met
            .resize(base + plan.slots.len(), SlotState::default());
        let open = OpenMessage {
            plan,
            to,
            row,
            data,
            base,
        };
        self.fields(open)?;
        for (index, slot) in plan.slots.iter().enumerate() {
            self.complete(slot, to.member(slot.column), base + index)?;
        }
        self.met.truncate(base);
        Ok(())
    }

    fn fields(&mut self, open: OpenMessage) -> Result<(), DecodeError> {
        let mut reader = WireReader::new(open.data);
        let mut guess = 0;
        loop {
            let at = reader.position();
            let Some((number, value)) = reader.field()? else {
                return Ok(());
            };
            let Some(index) = open.plan.slot(number, guess) else {
                continue;
            };
            let slot = &open.plan.slots[index];
            guess = index + usize::from(!slot.repeated);
            if let Some(entry) = slot.entry() {
                if slot.takes(&value) && !self.met[open.base + index].merged {
                    self.entries(open, index, entry, at)?;
                }
            } else if slot.repeated {
                let list = open.to.member(slot.column);
                let count = self.met[open.base + index].count;
                self.met[open.base + index].count = self.elements(slot, list, count, value)?;
            } else if slot.takes(&value) {
                self.clear_siblings(open, index)?;
                self.singular(open, index, value, at)?;
            }
        }
    }

    /// Ends a row of one field: closes a list, or appends what was not met.
    fn complete(&mut self, slot: &Slot, node: &Node, met: usize) -> Result<(), DecodeError> {
        let count = self.met[met].count;
        if slot.repeated {
            return node.end_list(self.pool, count);
        }
        if count == 0 {
            if let Shape::Message(plan) = &slot.shape {
                self.budget.spend(plan.absent_bytes)?;
            }
            node.append_absent(self.pool);
        }
        Ok(())
    }

    /// Of a `oneof`, only the last member met stands.
    fn clear_siblings(&mut self, open: OpenMessage, index: usize) -> Result<(), DecodeError> {
        let Some(oneof) = open.plan.slots[index].oneof else {
            return Ok(());
        };
        // Each of them is looked at.
        self.budget.spend(open.plan.slots.len())?;
        for (other, slot) in open.plan.slots.iter().enumerate() {
            let met = &mut self.met[open.base + other];
            if other != index && slot.oneof == Some(oneof) && met.count > 0 {
                *met = SlotState::default();
                let node = open.to.member(slot.column);
                node.truncate(self.pool, open.row);
            }
        }
        Ok(())
    }

    fn singular(
        &mut self,
        open: OpenMessage,
        index: usize,
        value: Value,
        at: usize,
    ) -> Result<(), DecodeError> {
        let slot = &open.plan.slots[index];
        let node = open.to.member(slot.column);
        let met = self.met[open.base + index];
        if let (Shape::Message(plan), Some(bytes)) = (&slot.shape, value.bytes()) {
            return self.part(open, index, plan, bytes, at);
        }
        if met.count > 0 {
            node.truncate(self.pool, open.row);
        }
        node.append_present(self.pool);
        scalar(&slot.shape, node, value, self.pool)?;
        self.met[open.base + index].count = 1;
        Ok(())
    }

    /// Takes a message in a field; a further one is merged with those before by reading all
    /// of them as one, which is what merging means.
    fn part(
        &mut self,
        open: OpenMessage,
        index: usize,
        plan: &Plan,
        bytes: &[u8],
        at: usize,
    ) -> Result<(), DecodeError> {
        let slot = &open.plan.slots[index];
        let node = open.to.member(slot.column);
        let met = self.met[open.base + index];
        if met.count == 0 {
            node.append_present(self.pool);
            self.message(plan, node, open.row, bytes)?;
            let met = &mut self.met[open.base + index];
            (met.count, met.first) = (1, at);
            return Ok(());
        }
        self.message(plan, Node::left_out(), 0, bytes)?;
        if !node.is_left_out() && !met.merged {
            let whole = joined(slot, &open.data[met.first..])?;
            node.truncate(self.pool, open.row);
            node.append_present(self.pool);
            self.message(plan, node, open.row, &whole)?;
        }
        self.met[open.base + index].merged = true;
        Ok(())
    }

    /// Appends the element or, packed, the elements of a repeated field; returns their count so far.
    fn elements(
        &mut self,
        slot: &Slot,
        list: &Node,
        mut count: usize,
        value: Value,
    ) -> Result<usize, DecodeError> {
        let child = list.element();
        match (&slot.shape, value) {
            (Shape::Message(plan), _) if slot.takes(&value) => {
                let row = list.elements(self.pool) + count;
                offset(row)?;
                let bytes = value.bytes().unwrap_or_default();
                self.message(plan, child, row, bytes)?;
                count += 1;
            }
            (shape, Value::Bytes { bytes, .. }) if shape.packs() => {
                let mut packed = WireReader::new(bytes);
                while !packed.is_empty() {
                    let element = shape.unpack(&mut packed)?;
                    self.budget.spend(shape.fixed_bytes())?;
                    scalar(shape, child, element, self.pool)?;
                    count += 1;
                }
            }
            _ if slot.takes(&value) => {
                self.budget.spend(slot.shape.fixed_bytes())?;
                scalar(&slot.shape, child, value, self.pool)?;
                count += 1;
            }
            _ => {}
        }
        Ok(count)
    }
}

/// The parts of a message field, one after the other.
fn joined(slot: &Slot, data: &[u8]) -> Result<Vec<u8>, DecodeError> {
    let mut whole = Vec::new();
    let mut reader = WireReader::new(data);
    while let Some((number, value)) = reader.field()? {
        if number == slot.number && slot.takes(&value) {
            whole.extend_from_slice(value.bytes().unwrap_or_default());
        }
    }
    Ok(whole)
}

impl Slot {
    /// Whether `value` has this field's wire type; others are unknown fields, which are skipped.
    fn takes(&self, value: &Value) -> bool {
        match (&self.shape, value) {
            (Shape::Varint32 { .. } | Shape::Varint64 { .. } | Shape::Bool, Value::Varint(_))
            | (Shape::Fixed32, Value::Fixed32(_))
            | (Shape::Fixed64, Value::Fixed64(_))
            | (Shape::Text, Value::Bytes { .. }) => true,
            (Shape::Bytes | Shape::Message(_), Value::Bytes { .. }) => !self.group,
            (Shape::Bytes | Shape::Message(_), Value::Group { .. }) => self.group,
            _ => false,
        }
    }
}

impl Shape {
    fn packs(&self) -> bool {
        !matches!(self, Shape::Text | Shape::Bytes | Shape::Message(_))
    }

    fn unpack<'a>(&self, packed: &mut WireReader<'a>) -> Result<Value<'a>, DecodeError> {
        Ok(match self {
            Shape::Fixed32 => Value::Fixed32(packed.chunk()?),
            Shape::Fixed64 => Value::Fixed64(packed.chunk()?),
            _ => Value::Varint(packed.varint()?),
        })
    }
}

/// Appends a value that is not a message to its column; its presence is noted already.
fn scalar(shape: &Shape, node: &Node, value: Value, pool: &mut Pool) -> Result<(), DecodeError> {
    if node.is_left_out() {
        return Ok(());
    }
    match (shape, value) {
        (Shape::Varint32 { zigzag }, Value::Varint(v)) => {
            let v = v as u32;
            let sign = if *zigzag { (v & 1).wrapping_neg() } else { 0 };
            node.append_value(pool, if *zigzag { (v >> 1) ^ sign } else { v });
        }
        (Shape::Varint64 { zigzag }, Value::Varint(v)) => {
            let sign = if *zigzag { (v & 1).wrapping_neg() } else { 0 };
            node.append_value(pool, if *zigzag { (v >> 1) ^ sign } else { v });
        }
        (_, Value::Varint(v)) => node.append_value(pool, u8::from(v != 0)),
        (_, Value::Fixed32(bytes)) => node.append_value(pool, u32::from_le_bytes(bytes)),
        (_, Value::Fixed64(bytes)) => node.append_value(pool, u64::from_le_bytes(bytes)),
        (Shape::Text, Value::Bytes { bytes, .. }) => {
            let text = String::from_utf8_lossy(bytes);
            return node.append_bytes(pool, text.as_bytes());
        }
        (_, Value::Bytes { bytes, .. } | Value::Group { bytes, .. }) => {
            return node.append_bytes(pool, bytes);
        }
    }
    Ok(())
}

/// Where the bytes of the field at `path` lie.
pub(crate) fn locate(
    plan: &Plan,
    payload: &[u8],
    path: &[&str],
) -> Result<Option<Located>, DecodeError> {
    let Some((name, rest)) = path.split_first() else {
        return Ok(None);
    };
    let Some(slot) = plan.slots.iter().find(|slot| slot.name == *name) else {
        return Ok(None);
    };
    let mut located = None;
    let mut reader = WireReader::new(payload);
    while let Some((number, value)) = reader.field()? {
        if number != slot.number || slot.repeated || !slot.takes(&value) {
            continue;
        }
        let (Value::Bytes { bytes, start } | Value::Group { bytes, start }) = value else {
            continue;
        };
        match &slot.shape {
            Shape::Bytes if rest.is_empty() => {
                located = Some(Located {
                    range: start..start + bytes.len(),
                    base64: false,
                });
            }
            Shape::Message(plan) => {
                if let Some(found) = locate(plan, bytes, rest)? {
                    located = Some(Located {
                        range: found.range.start + start..found.range.end + start,
                        base64: false,
                    });
                }
            }
            _ => {}
        }
    }
    Ok(located)
}
