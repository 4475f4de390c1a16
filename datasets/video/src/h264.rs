//! Whether the pictures of H.264 follow each other (ITU-T H.264, 7.3.2.1.1, 7.3.2.2, 7.3.3 and 7.4.3: `frame_num`).

use std::collections::BTreeMap;

use crate::bits::{Bits, units};
use crate::gap::{AGAIN, Follow, MISSING};

/// Most entries of a list of references.
const MOST_REFERENCES: u32 = 32;

/// What has come of a stream.
#[derive(Debug, Default)]
pub(crate) struct Pictures {
    sequences: BTreeMap<u32, Sequence>,
    sets: BTreeMap<u32, Set>,
    /// The last reference picture; `None` before a key frame, and behind a head that is not understood.
    last: Option<Last>,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    number: u32,
    /// Whether it counts as 0 for those that follow (`memory_management_control_operation` 5).
    resets: bool,
}

/// What a sequence parameter set says of heads.
#[derive(Debug, Clone, Copy)]
struct Sequence {
    separate_planes: bool,
    has_chroma: bool,
    number_bits: u32,
    order: Order,
    gaps_allowed: bool,
    frames_only: bool,
}

/// How heads say in which order pictures are shown.
#[derive(Debug, Clone, Copy)]
enum Order {
    Lowest { bits: u32 },
    Differences { always_zero: bool },
    AsDecoded,
}

/// What a picture parameter set says of heads.
#[derive(Debug, Clone, Copy)]
struct Set {
    sequence: u32,
    order_of_bottom: bool,
    /// The entries of each list of references.
    references: [u32; 2],
    weighted: bool,
    weighted_both: u32,
    may_be_redundant: bool,
}

/// The head of a slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Head {
    is_key: bool,
    is_reference: bool,
    is_first: bool,
    is_field: bool,
    is_redundant: bool,
    number: u32,
    resets: bool,
}

/// What a slice is made of.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    One,
    Both,
    Intra,
}

impl Follow for Pictures {
    fn follow(&mut self, frame: &[u8]) -> Result<(), String> {
        let mut begins = true;
        for unit in units(frame) {
            match unit[0] & 0x1f {
                7 => self.sequences.extend(Sequence::read(unit)),
                8 => self.sets.extend(Set::read(unit)),
                1 | 2 | 5 => {
                    self.slice(unit, begins)?;
                    begins = false;
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl Pictures {
    fn slice(&mut self, unit: &[u8], begins: bool) -> Result<(), String> {
        let head = self.head(unit);
        let Some((head, sequence)) = head else {
            self.last = None;
            return Ok(());
        };
        let own = Last {
            number: head.number,
            resets: head.resets,
        };
        if head.is_key {
            self.last = Some(own);
            return Ok(());
        }
        let Some(last) = self.last else {
            return Ok(());
        };
        let previous = match last.resets && (begins || head.is_first) {
            true => 0,
            false => last.number,
        };
        let next = (previous + 1) % (1 << sequence.number_bits);
        if head.number != previous && head.number != next && !sequence.gaps_allowed {
            return Err(MISSING.to_owned());
        }
        let is_whole = head.is_reference && !head.is_field && !head.is_redundant;
        if begins && head.is_first && is_whole && head.number == previous {
            return Err(AGAIN.to_owned());
        }
        if head.is_reference {
            self.last = Some(own);
        }
        Ok(())
    }

    fn head(&self, unit: &[u8]) -> Option<(Head, Sequence)> {
        let mut bits = Bits::of(unit);
        bits.skip(1)?;
        let is_reference = bits.number(2)? != 0;
        let is_key = bits.number(5)? == 5;
        let is_first = bits.unsigned()? == 0;
        let kind = match bits.unsigned()? % 5 {
            0 | 3 => Kind::One,
            1 => Kind::Both,
            _ => Kind::Intra,
        };
        let set = self.sets.get(&bits.unsigned()?)?;
        let sequence = *self.sequences.get(&set.sequence)?;
        if sequence.separate_planes {
            bits.skip(2)?;
        }
        let number = bits.number(sequence.number_bits)?;
        let is_field = !sequence.frames_only && bits.flag()?;
        if is_field {
            bits.skip(1)?;
        }
        if is_key {
            bits.pass(1)?;
        }
        sequence.pass_order(&mut bits, set.order_of_bottom && !is_field)?;
        let is_redundant = set.may_be_redundant && bits.unsigned()? > 0;
        let resets = match is_reference {
            true => {
                set.pass_references(&mut bits, kind, sequence.has_chroma)?;
                resets(&mut bits, is_key)?
            }
            false => false,
        };
        let head = Head {
            is_key,
            is_reference,
            is_first,
            is_field,
            is_redundant,
            number,
            resets,
        };
        Some((head, sequence))
    }
}

impl Sequence {
    /// The set and its number.
    fn read(unit: &[u8]) -> Option<(u32, Self)> {
        let mut bits = Bits::of(unit);
        bits.skip(8)?;
        let profile = bits.number(8)?;
        bits.skip(16)?;
        let id = bits.up_to(31)?;
        let mut chroma = 1;
        let mut separate_planes = false;
        if [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135].contains(&profile) {
            chroma = bits.up_to(3)?;
            separate_planes = chroma == 3 && bits.flag()?;
            bits.pass(2)?;
            bits.skip(1)?;
            if bits.flag()? {
                pass_scaling(&mut bits, if chroma == 3 { 12 } else { 8 })?;
            }
        }
        let number_bits = bits.up_to(12)? + 4;
        let order = Order::read(&mut bits)?;
        bits.pass(1)?;
        let gaps_allowed = bits.flag()?;
        bits.pass(2)?;
        let sequence = Self {
            separate_planes,
            has_chroma: chroma > 0 && !separate_planes,
            number_bits,
            order,
            gaps_allowed,
            frames_only: bits.flag()?,
        };
        Some((id, sequence))
    }

    fn pass_order(&self, bits: &mut Bits<'_>, of_bottom: bool) -> Option<()> {
        match self.order {
            Order::Lowest { bits: lowest } => {
                bits.skip(lowest)?;
                bits.pass(u32::from(of_bottom))
            }
            Order::Differences { always_zero: false } => bits.pass(1 + u32::from(of_bottom)),
            Order::Differences { always_zero: true } | Order::AsDecoded => Some(()),
        }
    }
}

impl Order {
    fn read(bits: &mut Bits<'_>) -> Option<Self> {
        Some(match bits.up_to(2)? {
            0 => Self::Lowest {
                bits: bits.up_to(12)? + 4,
            },
            1 => {
                let always_zero = bits.flag()?;
                bits.pass(2)?;
                let cycle = bits.up_to(255)?;
                bits.pass(cycle)?;
                Self::Differences { always_zero }
            }
            _ => Self::AsDecoded,
        })
    }
}

impl Set {
    /// The set and its number. Those with groups of slices, which no decoder of FFmpeg has, are not understood.
    fn read(unit: &[u8]) -> Option<(u32, Self)> {
        let mut bits = Bits::of(unit);
        bits.skip(8)?;
        let id = bits.up_to(255)?;
        let sequence = bits.up_to(31)?;
        bits.skip(1)?;
        let order_of_bottom = bits.flag()?;
        bits.up_to(0)?;
        let references = [references(&mut bits)?, references(&mut bits)?];
        let weighted = bits.flag()?;
        let weighted_both = bits.number(2)?;
        bits.pass(3)?;
        bits.skip(2)?;
        let set = Self {
            sequence,
            order_of_bottom,
            references,
            weighted,
            weighted_both,
            may_be_redundant: bits.flag()?,
        };
        Some((id, set))
    }

    /// Leaves out what a head says of the pictures that it refers to, and of their weights.
    fn pass_references(&self, bits: &mut Bits<'_>, kind: Kind, has_chroma: bool) -> Option<()> {
        let lists = match kind {
            Kind::Intra => return Some(()),
            Kind::One => 1,
            Kind::Both => 2,
        };
        if kind == Kind::Both {
            bits.skip(1)?;
        }
        let mut counts = self.references;
        if bits.flag()? {
            for count in &mut counts[..lists] {
                *count = references(bits)?;
            }
        }
        for _ in 0..lists {
            if bits.flag()? {
                while bits.up_to(3)? < 3 {
                    bits.pass(1)?;
                }
            }
        }
        let is_weighted = match kind {
            Kind::Both => self.weighted_both == 1,
            _ => self.weighted,
        };
        match is_weighted {
            true => pass_weights(bits, &counts[..lists], has_chroma),
            false => Some(()),
        }
    }
}

fn references(bits: &mut Bits<'_>) -> Option<u32> {
    Some(bits.up_to(MOST_REFERENCES - 1)? + 1)
}

fn pass_weights(bits: &mut Bits<'_>, counts: &[u32], has_chroma: bool) -> Option<()> {
    bits.pass(1 + u32::from(has_chroma))?;
    for _ in 0..counts.iter().sum::<u32>() {
        if bits.flag()? {
            bits.pass(2)?;
        }
        if has_chroma && bits.flag()? {
            bits.pass(4)?;
        }
    }
    Some(())
}

/// Whether a reference picture counts as number 0 from then on: of what its head says of marking, operation 5.
fn resets(bits: &mut Bits<'_>, is_key: bool) -> Option<bool> {
    if is_key || !bits.flag()? {
        return Some(false);
    }
    let mut resets = false;
    loop {
        match bits.up_to(6)? {
            0 => return Some(resets),
            5 => resets = true,
            3 => bits.pass(2)?,
            _ => bits.pass(1)?,
        }
    }
}

/// Leaves out so many scaling lists (7.3.2.1.1.1).
fn pass_scaling(bits: &mut Bits<'_>, lists: u32) -> Option<()> {
    for list in 0..lists {
        if !bits.flag()? {
            continue;
        }
        let (mut last, mut next) = (8u32, 8u32);
        let numbers = if list < 6 { 16 } else { 64 };
        for _ in 0..numbers {
            if next != 0 {
                // From -128 to 127: 1 is 1, 2 is -1, 3 is 2 …
                let step = bits.up_to(256)?;
                next = match step % 2 {
                    0 => last.wrapping_sub(step / 2) & 0xff,
                    _ => (last + step.div_ceil(2)) & 0xff,
                };
            }
            if next != 0 {
                last = next;
            }
        }
    }
    Some(())
}

#[cfg(test)]
mod tests;
