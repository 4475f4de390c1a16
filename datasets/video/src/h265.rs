//! Whether the pictures that one of H.265 refers to have come (ITU-T H.265, 7.3.2.3, 7.3.6.1, 8.3.1 and 8.3.2).

use std::collections::BTreeMap;

use crate::bits::{Bits, index_bits, units};
use crate::gap::{AGAIN, Follow, MISSING};

mod references;
mod sequence;

use references::{Picture, Reference, References};
use sequence::Sequence;

/// What has come of a stream.
#[derive(Debug, Default)]
pub(crate) struct Pictures {
    sequences: BTreeMap<u32, Sequence>,
    sets: BTreeMap<u32, Set>,
    /// `None` where a sequence begins, and behind a head that is not understood.
    held: Option<PictureBuffer>,
    /// Whether pictures are left out that are shown before the last key frame, and refer to some before it.
    skips_leading: bool,
}

/// Pictures that the next one may refer to.
#[derive(Debug)]
struct PictureBuffer {
    orders: Vec<i64>,
    /// That of the last picture which all later ones may refer to.
    base: i64,
}

/// What a picture parameter set says of heads.
#[derive(Debug, Clone, Copy)]
struct Set {
    sequence: u32,
    says_whether_shown: bool,
    extra_bits: u32,
}

/// What a picture is, by the type of its units (table 7-1).
#[derive(Debug, Clone, Copy)]
struct Kind(u8);

impl Kind {
    fn is_key(self) -> bool {
        (16..=23).contains(&self.0)
    }

    /// Whether nothing before it is held any more.
    fn clears(self) -> bool {
        (16..=20).contains(&self.0)
    }

    /// Whether it begins counting at 0.
    fn is_at_zero(self) -> bool {
        matches!(self.0, 19 | 20)
    }

    fn is_skipped_leading(self) -> bool {
        matches!(self.0, 8 | 9)
    }

    /// Whether pictures of its own layer do not count from it.
    fn is_no_base(self) -> bool {
        matches!(self.0, 6..=9) || (self.0 <= 14 && self.0.is_multiple_of(2))
    }
}

impl Set {
    /// The set and its number.
    fn read(unit: &[u8]) -> Option<(u32, Self)> {
        let mut bits = Bits::of(unit);
        bits.skip(16)?;
        let id = bits.up_to(63)?;
        let sequence = bits.up_to(15)?;
        bits.skip(1)?;
        let set = Self {
            sequence,
            says_whether_shown: bits.flag()?,
            extra_bits: bits.number(3)?,
        };
        Some((id, set))
    }
}

/// What the head of a picture's first slice says.
struct Head {
    /// The lowest bits of its order count, its place among pictures as they are shown, and how many.
    lowest: i64,
    bits: u32,
    references: Vec<Reference>,
}

impl Follow for Pictures {
    fn follow(&mut self, frame: &[u8]) -> Result<(), String> {
        for unit in units(frame) {
            let &[head, second, ..] = unit else {
                continue;
            };
            let layer = ((head & 1) << 5) | (second >> 3);
            if layer != 0 {
                continue;
            }
            match (head >> 1) & 0x3f {
                33 => self.sequences.extend(Sequence::read(unit)),
                34 => self.sets.extend(Set::read(unit)),
                // The end of a sequence, or of all.
                36 | 37 => self.held = None,
                kind @ (0..=9 | 16..=21) => self.slice(Kind(kind), second & 7 == 1, unit)?,
                _ => {}
            }
        }
        Ok(())
    }
}

impl Pictures {
    fn slice(&mut self, kind: Kind, is_lowest_layer: bool, unit: &[u8]) -> Result<(), String> {
        let mut bits = Bits::of(unit);
        // All slices of a picture say the same.
        if bits.skip(16).and_then(|()| bits.flag()) != Some(true) {
            return Ok(());
        }
        let begins = kind.is_key() && (kind.clears() || self.held.is_none());
        if kind.is_key() {
            self.skips_leading = begins;
        } else if kind.is_skipped_leading() && self.skips_leading {
            return Ok(());
        }
        let Some(head) = self.head(kind, bits) else {
            self.held = None;
            return Ok(());
        };
        if begins {
            self.held = Some(PictureBuffer {
                orders: vec![head.lowest],
                base: head.lowest,
            });
            return Ok(());
        }
        let Some(held) = &mut self.held else {
            return Ok(());
        };
        held.add(&head, is_lowest_layer && !kind.is_no_base())
    }

    fn head(&self, kind: Kind, mut bits: Bits<'_>) -> Option<Head> {
        if kind.is_key() {
            bits.skip(1)?;
        }
        let set = self.sets.get(&bits.unsigned()?)?;
        let sequence = self.sequences.get(&set.sequence)?;
        bits.skip(set.extra_bits)?;
        bits.pass(1)?;
        bits.skip(u32::from(set.says_whether_shown))?;
        bits.skip(if sequence.separate_planes { 2 } else { 0 })?;
        let mut head = Head {
            lowest: 0,
            bits: sequence.order_bits,
            references: Vec::new(),
        };
        if kind.is_at_zero() {
            return Some(head);
        }
        head.lowest = i64::from(bits.number(sequence.order_bits)?);
        let sets = &sequence.references;
        let short = match bits.flag()? {
            false => References::read(&mut bits, sets, sets.len())?,
            true => {
                let count = u32::try_from(sets.len()).ok()?;
                let index = bits.number(index_bits(count))?;
                sets.get(usize::try_from(index).ok()?)?.clone()
            }
        };
        head.references = short.0.into_iter().map(Reference::near).collect();
        sequence.add_far(&mut bits, head.lowest, &mut head.references)?;
        Some(head)
    }
}

impl PictureBuffer {
    /// Adds a picture, and forgets those that it does not name.
    fn add(&mut self, head: &Head, is_base: bool) -> Result<(), String> {
        let round = 1i64 << head.bits;
        let picture = Picture {
            order: self.order(head.lowest, round),
            round,
        };
        if self.orders.contains(&picture.order) {
            return Err(AGAIN.to_owned());
        }
        let is = |reference: &Reference, order: &i64| picture.is(reference, *order);
        let mut needed = head.references.iter().filter(|reference| reference.used);
        if needed.any(|reference| !self.orders.iter().any(|order| is(reference, order))) {
            return Err(MISSING.to_owned());
        }
        let named = |order: &i64| head.references.iter().any(|named| is(named, order));
        self.orders.retain(named);
        self.orders.push(picture.order);
        if is_base {
            self.base = picture.order;
        }
        Ok(())
    }

    /// The order count of which these are the lowest bits: the one next to that of the base (8-1).
    fn order(&self, lowest: i64, round: i64) -> i64 {
        let base = self.base.rem_euclid(round);
        let high = self.base - base;
        if lowest < base && base - lowest >= round / 2 {
            high + round + lowest
        } else if lowest > base && lowest - base > round / 2 {
            high - round + lowest
        } else {
            high + lowest
        }
    }
}

#[cfg(test)]
mod tests;
