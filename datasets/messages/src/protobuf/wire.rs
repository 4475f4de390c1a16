//! Protobuf's wire format: tags and the values behind them.

use crate::DecodeError;

/// A value as it lies on the wire; `start` is where its bytes begin in the message.
#[derive(Debug, Clone, Copy)]
pub(super) enum Value<'a> {
    Varint(u64),
    Fixed32([u8; 4]),
    Fixed64([u8; 8]),
    Bytes { bytes: &'a [u8], start: usize },
    Group { bytes: &'a [u8], start: usize },
}

impl<'a> Value<'a> {
    /// The bytes of a string, message or group.
    pub(super) fn bytes(self) -> Option<&'a [u8]> {
        match self {
            Value::Bytes { bytes, .. } | Value::Group { bytes, .. } => Some(bytes),
            _ => None,
        }
    }
}

/// Reads one message.
#[derive(Debug, Clone, Copy)]
pub(super) struct WireReader<'a> {
    data: &'a [u8],
    position: usize,
}

/// Groups within groups that are followed.
const MAX_GROUPS: usize = 100;

impl<'a> WireReader<'a> {
    pub(super) fn new(data: &'a [u8]) -> Self {
        WireReader { data, position: 0 }
    }

    /// The next field's number and value; none at the end.
    pub(super) fn field(&mut self) -> Result<Option<(u32, Value<'a>)>, DecodeError> {
        if self.position >= self.data.len() {
            return Ok(None);
        }
        let (number, wire_type) = self.tag()?;
        let value = match wire_type {
            0 => Value::Varint(self.varint()?),
            1 => Value::Fixed64(self.chunk()?),
            2 => {
                let length = self.varint()?;
                let start = self.position;
                let bytes = self.take(usize::try_from(length).unwrap_or(usize::MAX))?;
                Value::Bytes { bytes, start }
            }
            3 => self.group(number)?,
            5 => Value::Fixed32(self.chunk()?),
            _ => return Err(self.malformed("a wire type of 0, 1, 2, 3 or 5")),
        };
        Ok(Some((number, value)))
    }

    fn tag(&mut self) -> Result<(u32, u8), DecodeError> {
        let tag = self.varint()?;
        match u32::try_from(tag >> 3) {
            Ok(number @ 1..=0x1FFF_FFFF) => Ok((number, (tag & 7) as u8)),
            _ => Err(self.malformed("a field number from 1 to 536870911")),
        }
    }

    /// What lies between a group's start, already read, and its end.
    fn group(&mut self, number: u32) -> Result<Value<'a>, DecodeError> {
        let start = self.position;
        let mut open = vec![number];
        loop {
            let end = self.position;
            let (number, wire_type) = self.tag()?;
            match wire_type {
                0 => drop(self.varint()?),
                1 => drop(self.take(8)?),
                2 => {
                    let length = self.varint()?;
                    self.take(usize::try_from(length).unwrap_or(usize::MAX))?;
                }
                3 if open.len() < MAX_GROUPS => open.push(number),
                4 if open.pop() == Some(number) => {
                    if open.is_empty() {
                        let bytes = &self.data[start..end];
                        return Ok(Value::Group { bytes, start });
                    }
                }
                5 => drop(self.take(4)?),
                _ => return Err(self.malformed("a field or the end of the group")),
            }
        }
    }

    pub(super) fn position(&self) -> usize {
        self.position
    }

    pub(super) fn is_empty(&self) -> bool {
        self.position >= self.data.len()
    }

    pub(super) fn varint(&mut self) -> Result<u64, DecodeError> {
        let mut value = 0_u64;
        for shift in (0..70).step_by(7) {
            let Some(byte) = self.data.get(self.position) else {
                return Err(self.truncated(1));
            };
            self.position += 1;
            value |= u64::from(byte & 0x7F) << shift;
            if *byte < 0x80 {
                return Ok(value);
            }
        }
        Err(self.malformed("a varint of at most 10 bytes"))
    }

    pub(super) fn chunk<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let bytes = self.take(N)?;
        bytes.first_chunk::<N>().copied().ok_or(self.truncated(N))
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], DecodeError> {
        let end = self.position.saturating_add(length);
        match self.data.get(self.position..end) {
            Some(bytes) => {
                self.position = end;
                Ok(bytes)
            }
            None => Err(self.truncated(length)),
        }
    }

    fn truncated(&self, needed: usize) -> DecodeError {
        DecodeError::truncated(self.data, self.position, needed as u64)
    }

    fn malformed(&self, expected: &str) -> DecodeError {
        DecodeError::Malformed {
            format: "protobuf",
            offset: self.position,
            expected: expected.to_owned(),
        }
    }
}
