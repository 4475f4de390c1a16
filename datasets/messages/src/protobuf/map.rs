//! Maps, which lie on the wire as their entries: of a key, the last one counts.

use super::plan::{Plan, Shape, Slot};
use super::wire::{Value, WireReader};
use super::{OpenMessage, Sink};
use crate::DecodeError;
use crate::buffers::{Node, offset};
use std::collections::HashMap;

/// Number of the key among an entry's fields.
const KEY: u32 = 1;

/// What tells entries apart.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Key<'a> {
    /// A number or truth, by its bits.
    Number(u64),
    Text(&'a [u8]),
}

impl Plan {
    /// The key, of a message that is the entry of a map.
    fn key(&self) -> Option<&Slot> {
        let slot = &self.slots[self.slot(KEY, 0)?];
        let tells = !matches!(slot.shape, Shape::Bytes | Shape::Message(_));
        (tells && !slot.repeated).then_some(slot)
    }
}

impl Slot {
    /// The entry's plan and its key, where the field is a map.
    pub(super) fn entry(&self) -> Option<(&Plan, &Slot)> {
        match &self.shape {
            Shape::Message(plan) if self.map => Some((plan.as_ref(), plan.key()?)),
            _ => None,
        }
    }
}

impl Sink<'_> {
    /// Takes all entries of a map together, from where in the message the first was met.
    pub(super) fn entries(
        &mut self,
        open: OpenMessage,
        index: usize,
        (entry, key): (&Plan, &Slot),
        at: usize,
    ) -> Result<(), DecodeError> {
        let slot = &open.plan.slots[index];
        let list = open.to.member(slot.column);
        let mut last = HashMap::new();
        let mut reader = WireReader::new(&open.data[at..]);
        while let Some((end, bytes)) = next(slot, &mut reader)? {
            last.insert(key_of(key, bytes)?, end);
        }
        let mut count = 0;
        let mut reader = WireReader::new(&open.data[at..]);
        while let Some((end, bytes)) = next(slot, &mut reader)? {
            if last.get(&key_of(key, bytes)?) == Some(&end) {
                let row = list.elements(self.pool) + count;
                offset(row)?;
                self.message(entry, list.element(), row, bytes)?;
                count += 1;
            } else {
                self.message(entry, Node::left_out(), 0, bytes)?;
            }
        }
        let met = &mut self.met[open.base + index];
        (met.count, met.merged) = (count, true);
        Ok(())
    }
}

/// The next entry: where it ends, and its bytes.
fn next<'a>(
    slot: &Slot,
    reader: &mut WireReader<'a>,
) -> Result<Option<(usize, &'a [u8])>, DecodeError> {
    while let Some((number, value)) = reader.field()? {
        if number == slot.number && slot.takes(&value) {
            let end = reader.position();
            return Ok(value.bytes().map(|bytes| (end, bytes)));
        }
    }
    Ok(None)
}

/// The key of an entry: the last that it has, or the zero of its type.
fn key_of<'a>(slot: &Slot, entry: &'a [u8]) -> Result<Key<'a>, DecodeError> {
    let mut key = match slot.shape {
        Shape::Text => Key::Text(&[]),
        _ => Key::Number(0),
    };
    let mut reader = WireReader::new(entry);
    while let Some((number, value)) = reader.field()? {
        if number != slot.number || !slot.takes(&value) {
            continue;
        }
        key = match (&slot.shape, value) {
            (Shape::Bool, Value::Varint(value)) => Key::Number(u64::from(value != 0)),
            (Shape::Varint32 { .. }, Value::Varint(value)) => Key::Number(u64::from(value as u32)),
            (_, Value::Varint(value)) => Key::Number(value),
            (_, Value::Fixed32(bytes)) => Key::Number(u32::from_le_bytes(bytes).into()),
            (_, Value::Fixed64(bytes)) => Key::Number(u64::from_le_bytes(bytes)),
            (_, Value::Bytes { bytes, .. } | Value::Group { bytes, .. }) => Key::Text(bytes),
        };
    }
    Ok(key)
}
