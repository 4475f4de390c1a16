//! Runs a compiled message over a payload.

use super::program::{Dialect, Move, Step};
use crate::DecodeError;
use crate::buffers::{Pool, Target, offset};
use crate::views::Views;
use std::borrow::Cow;
use std::ops::Range;

/// Elements that take no bytes (empty ROS 1 messages) are believed up to this many in a payload, and as many more as it
/// has bytes.
const SIZELESS: u64 = 65_536;

/// Reads `steps` from `data`. `SWAP`: the payload's byte order is not this machine's.
pub(crate) struct Runner<'a, const SWAP: bool> {
    data: &'a [u8],
    position: usize,
    dialect: Dialect,
    /// Elements that take no bytes and are still believed.
    sizeless: u64,
    found: Option<Range<usize>>,
}

impl<'a, const SWAP: bool> Runner<'a, SWAP> {
    /// `data` starts where alignment counts from.
    pub(crate) fn new(data: &'a [u8], dialect: Dialect) -> Self {
        Runner {
            data,
            position: 0,
            dialect,
            sizeless: SIZELESS + data.len() as u64,
            found: None,
        }
    }

    /// Where [`Step::Here`] was met.
    pub(crate) fn found(self) -> Option<Range<usize>> {
        self.found
    }

    /// Appends one value for each step; on error the pool holds part of a row.
    pub(crate) fn run(&mut self, steps: &[Step], pool: &mut Pool) -> Result<(), DecodeError> {
        let mut next = 0;
        while let Some(step) = steps.get(next) {
            next += 1;
            match step {
                Step::Block { align, size, moves } => {
                    let block = self.take_aligned(*align, *size)?;
                    copy_block::<SWAP>(block, moves, pool);
                }
                Step::Text { to } => self.text(*to, pool)?,
                Step::WideText { to } => self.wide_text(*to, pool)?,
                Step::Octets { to } => self.octets(*to, pool)?,
                Step::Run { width, align, to } => self.numbers(*width, *align, *to, pool)?,
                Step::Sequence {
                    body,
                    min_size,
                    offsets,
                } => {
                    let count = u64::from(self.length()?);
                    self.check_count(count, *min_size)?;
                    if let Some(offsets) = *offsets {
                        let end = offset(pool.last_offset(offsets) + count as usize)?;
                        pool.buffers[offsets].push(end);
                    }
                    let inner = &steps[next..next + body];
                    self.repeat(inner, count, pool)?;
                    next += body;
                }
                Step::Repeat {
                    body,
                    min_size,
                    count,
                } => {
                    let inner = &steps[next..next + body];
                    self.check_count(*count as u64, *min_size)?;
                    self.repeat(inner, *count as u64, pool)?;
                    next += body;
                }
                Step::Delimited { body } => {
                    self.delimited(&steps[next..next + body], pool)?;
                    next += body;
                }
                Step::Here { size } => {
                    let size = match size {
                        Some(size) => *size,
                        None => self.length()? as usize,
                    };
                    let start = self.position;
                    self.take(size)?;
                    self.found = Some(start..self.position);
                }
            }
        }
        Ok(())
    }

    fn repeat(&mut self, body: &[Step], count: u64, pool: &mut Pool) -> Result<(), DecodeError> {
        if body.is_empty() {
            return Ok(());
        }
        if let [Step::Block { align, size, moves }] = body {
            return self.repeat_block(*align, *size, moves, count, pool);
        }
        for _ in 0..count {
            self.run(body, pool)?;
        }
        Ok(())
    }

    /// Elements of static layout, without going through the step list.
    fn repeat_block(
        &mut self,
        align: usize,
        size: usize,
        moves: &[Move],
        count: u64,
        pool: &mut Pool,
    ) -> Result<(), DecodeError> {
        if moves.is_empty() && count > 0 {
            let stride = size.next_multiple_of(align) as u64;
            let total = (count - 1)
                .saturating_mul(stride)
                .saturating_add(size as u64);
            self.take_aligned(align, usize::try_from(total).unwrap_or(usize::MAX))?;
            return Ok(());
        }
        for _ in 0..count {
            let block = self.take_aligned(align, size)?;
            copy_block::<SWAP>(block, moves, pool);
        }
        Ok(())
    }

    /// Refuses counts that the rest of the payload cannot hold, before anything is appended.
    fn check_count(&mut self, count: u64, min_size: u64) -> Result<(), DecodeError> {
        let available = self.data.len().saturating_sub(self.position);
        let needed = count.saturating_mul(min_size);
        if needed > available as u64 {
            return Err(self.truncated(needed));
        }
        if min_size == 0 {
            let left = self.sizeless.checked_sub(count);
            self.sizeless = left.ok_or(DecodeError::Unfolds {
                limit: self.data.len() + SIZELESS as usize,
            })?;
        }
        Ok(())
    }

    fn delimited(&mut self, body: &[Step], pool: &mut Pool) -> Result<(), DecodeError> {
        let size = self.length()? as usize;
        let start = self.position;
        self.take(size)?;
        let end = self.position;
        let whole = self.data;
        self.data = &whole[..end];
        self.position = start;
        let outcome = self.run(body, pool);
        self.data = whole;
        self.position = end;
        outcome
    }

    fn numbers(
        &mut self,
        width: usize,
        align: usize,
        to: Option<Target>,
        pool: &mut Pool,
    ) -> Result<(), DecodeError> {
        let count = self.length()? as usize;
        // Writers pad before the first element, so an empty run has no padding.
        let bytes = match count {
            0 => &[],
            _ => self.take_aligned(align, count.saturating_mul(width))?,
        };
        if let Some(Target { offsets, data }) = to {
            let end = offset(pool.last_offset(offsets) + count)?;
            copy_values::<SWAP>(bytes, width, data, pool);
            pool.buffers[offsets].push(end);
        }
        Ok(())
    }

    fn octets(&mut self, to: Option<Views>, pool: &mut Pool) -> Result<(), DecodeError> {
        let count = self.length()? as usize;
        let bytes = self.take(count)?;
        to.map_or(Ok(()), |to| pool.append_view(to, bytes))
    }

    fn text(&mut self, to: Option<Target>, pool: &mut Pool) -> Result<(), DecodeError> {
        let length = self.length()? as usize;
        let bytes = self.take(length)?;
        let Some(Target { offsets, data }) = to else {
            return Ok(());
        };
        let bytes = match bytes.split_last() {
            Some((0, head)) if self.dialect.terminated => head,
            _ => bytes,
        };
        // ROS never checks encodings; what is not UTF-8 is replaced, as a row is worth more.
        match String::from_utf8_lossy(bytes) {
            Cow::Borrowed(text) => pool.append_text(offsets, data, text.as_bytes()),
            Cow::Owned(text) => pool.append_text(offsets, data, text.as_bytes()),
        }
    }

    /// CDR as ROS 2 writes it: a count of cells of 32 bits, each with a unit of UTF-16 or, of other writers, a whole
    /// character. CDR2: a length in bytes, units of 16 bits. Neither is terminated.
    fn wide_text(&mut self, to: Option<Target>, pool: &mut Pool) -> Result<(), DecodeError> {
        let (width, bytes) = self.wide_cells()?;
        let Some(Target { offsets, data }) = to else {
            return Ok(());
        };
        let big_endian = SWAP != cfg!(target_endian = "big");
        let units = bytes.chunks_exact(width).flat_map(|cell| {
            let append = |value: u32, byte: &u8| (value << 8) | u32::from(*byte);
            units(match big_endian {
                true => cell.iter().fold(0, append),
                false => cell.iter().rev().fold(0, append),
            })
        });
        let text: String = char::decode_utf16(units)
            .map(|unit| unit.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect();
        pool.append_text(offsets, data, text.as_bytes())
    }

    fn wide_cells(&mut self) -> Result<(usize, &'a [u8]), DecodeError> {
        let length = self.length()? as usize;
        if self.dialect.cdr2 {
            return Ok((2, self.take(length)?));
        }
        Ok((4, self.take(length.saturating_mul(4))?))
    }

    fn length(&mut self) -> Result<u32, DecodeError> {
        let bytes = self.take_aligned(self.dialect.max_align.min(4), 4)?;
        let value = bytes
            .first_chunk::<4>()
            .map_or(0, |b| u32::from_ne_bytes(*b));
        Ok(if SWAP { value.swap_bytes() } else { value })
    }

    fn take_aligned(&mut self, align: usize, size: usize) -> Result<&'a [u8], DecodeError> {
        // Alignments are powers of two; the position never exceeds the payload's length.
        let start = (self.position + align - 1) & !(align - 1);
        let end = start.saturating_add(size);
        match self.data.get(start..end) {
            Some(bytes) => {
                self.position = end;
                Ok(bytes)
            }
            None => Err(self.truncated(size as u64)),
        }
    }

    fn take(&mut self, size: usize) -> Result<&'a [u8], DecodeError> {
        self.take_aligned(1, size)
    }

    #[cold]
    fn truncated(&self, needed: u64) -> DecodeError {
        DecodeError::truncated(self.data, self.position, needed)
    }
}

/// The units of UTF-16 in a cell of a wide text: one, or the two of a character beyond 16 bits. What is neither is
/// replaced.
fn units(cell: u32) -> impl Iterator<Item = u16> {
    let mut pair = [0; 2];
    let length = match u16::try_from(cell) {
        Ok(unit) => {
            pair[0] = unit;
            1
        }
        Err(_) => {
            let character = char::from_u32(cell).unwrap_or(char::REPLACEMENT_CHARACTER);
            character.encode_utf16(&mut pair).len()
        }
    };
    pair.into_iter().take(length)
}

#[inline]
fn copy_block<const SWAP: bool>(block: &[u8], moves: &[Move], pool: &mut Pool) {
    for m in moves {
        let source = &block[m.offset..];
        if m.count == 1 {
            copy_one::<SWAP>(source, m.width, m.buffer, pool);
        } else {
            copy_values::<SWAP>(&source[..m.width * m.count], m.width, m.buffer, pool);
        }
    }
}

#[inline]
fn copy_one<const SWAP: bool>(source: &[u8], width: usize, buffer: usize, pool: &mut Pool) {
    let buffer = &mut pool.buffers[buffer];
    match width {
        8 => {
            if let Some(bytes) = source.first_chunk::<8>() {
                let value = u64::from_ne_bytes(*bytes);
                buffer.push(if SWAP { value.swap_bytes() } else { value });
            }
        }
        4 => {
            if let Some(bytes) = source.first_chunk::<4>() {
                let value = u32::from_ne_bytes(*bytes);
                buffer.push(if SWAP { value.swap_bytes() } else { value });
            }
        }
        2 => {
            if let Some(bytes) = source.first_chunk::<2>() {
                let value = u16::from_ne_bytes(*bytes);
                buffer.push(if SWAP { value.swap_bytes() } else { value });
            }
        }
        _ => buffer.extend_from_slice(&source[..1]),
    }
}

fn copy_values<const SWAP: bool>(source: &[u8], width: usize, buffer: usize, pool: &mut Pool) {
    let buffer = &mut pool.buffers[buffer];
    let start = buffer.len();
    buffer.extend_from_slice(source);
    if SWAP && width > 1 {
        for value in buffer.as_slice_mut()[start..].chunks_exact_mut(width) {
            value.reverse();
        }
    }
}
