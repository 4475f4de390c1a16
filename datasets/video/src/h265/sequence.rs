//! What a sequence parameter set says of heads (7.3.2.2).

use crate::bits::{Bits, index_bits};
use crate::h265::references::{OrderCount, Reference, References};

/// Most sets of references of a sequence.
const MOST_SETS: u32 = 64;

/// Most pictures far away that a sequence, or a head, names.
const MOST_FAR: u32 = 32;

#[derive(Debug, Clone)]
pub(super) struct Sequence {
    pub(super) separate_planes: bool,
    /// Bits of an order count that heads say.
    pub(super) order_bits: u32,
    pub(super) references: Vec<References>,
    far: Option<Far>,
}

/// Pictures far away that heads may name by an index: their lowest bits, and whether they are used.
type Far = Vec<(i64, bool)>;

impl Sequence {
    /// The set and its number.
    pub(super) fn read(unit: &[u8]) -> Option<(u32, Self)> {
        let mut bits = Bits::of(unit);
        bits.skip(16 + 4)?;
        let layers = bits.number(3)?;
        bits.skip(1)?;
        pass_profile(&mut bits, layers)?;
        let id = bits.up_to(15)?;
        let separate_planes = bits.up_to(3)? == 3 && bits.flag()?;
        bits.pass(2)?;
        if bits.flag()? {
            bits.pass(4)?;
        }
        bits.pass(2)?;
        let order_bits = bits.up_to(12)? + 4;
        let told = if bits.flag()? { layers + 1 } else { 1 };
        bits.pass(3 * told)?;
        bits.pass(6)?;
        if bits.flag()? && bits.flag()? {
            pass_scaling(&mut bits)?;
        }
        bits.skip(2)?;
        if bits.flag()? {
            bits.skip(8)?;
            bits.pass(2)?;
            bits.skip(1)?;
        }
        let mut references = Vec::new();
        for _ in 0..bits.up_to(MOST_SETS)? {
            // None of them is a slice's own.
            let set = References::read(&mut bits, &references, usize::MAX)?;
            references.push(set);
        }
        let far = match bits.flag()? {
            true => Some(far(&mut bits, order_bits)?),
            false => None,
        };
        let sequence = Self {
            separate_planes,
            order_bits,
            references,
            far,
        };
        Some((id, sequence))
    }

    /// Adds the pictures far away that a head names, whose own order count has these lowest bits (7-52, 8-5).
    pub(super) fn add_far(
        &self,
        bits: &mut Bits<'_>,
        lowest: i64,
        references: &mut Vec<Reference>,
    ) -> Option<()> {
        let Some(known) = &self.far else {
            return Some(());
        };
        let count = u32::try_from(known.len()).ok()?;
        let by_index = if count > 0 { bits.up_to(MOST_FAR)? } else { 0 };
        let own = bits.up_to(MOST_FAR)?;
        let mut rounds = 0;
        for at in 0..by_index + own {
            let (low, used) = match at < by_index {
                true => {
                    let index = bits.number(index_bits(count))?;
                    *known.get(usize::try_from(index).ok()?)?
                }
                false => (i64::from(bits.number(self.order_bits)?), bits.flag()?),
            };
            if at == by_index {
                rounds = 0;
            }
            let is_exact = bits.flag()?;
            if is_exact {
                rounds += i64::from(bits.unsigned()?);
            }
            let order = match is_exact {
                true => OrderCount::Behind(low - lowest - (rounds << self.order_bits)),
                false => OrderCount::Lowest(low),
            };
            references.push(Reference { order, used });
        }
        Some(())
    }
}

fn far(bits: &mut Bits<'_>, order_bits: u32) -> Option<Far> {
    let mut far = Vec::new();
    for _ in 0..bits.up_to(MOST_FAR)? {
        far.push((i64::from(bits.number(order_bits)?), bits.flag()?));
    }
    Some(far)
}

/// Leaves out profile, tier and level of all layers and of each (7.3.3).
fn pass_profile(bits: &mut Bits<'_>, layers: u32) -> Option<()> {
    const PROFILE: u32 = 88;
    const LEVEL: u32 = 8;
    bits.skip(PROFILE + LEVEL)?;
    let mut own = 0;
    for _ in 0..layers {
        own += if bits.flag()? { PROFILE } else { 0 };
        own += if bits.flag()? { LEVEL } else { 0 };
    }
    if layers > 0 {
        bits.skip(2 * 8u32.saturating_sub(layers))?;
    }
    bits.skip(own)
}

/// Leaves out the scaling lists (7.3.4).
fn pass_scaling(bits: &mut Bits<'_>) -> Option<()> {
    for size in 0..4 {
        let matrices = if size == 3 { 2 } else { 6 };
        for _ in 0..matrices {
            if bits.flag()? {
                let numbers = (1u32 << (4 + 2 * size)).min(64);
                bits.pass(numbers + u32::from(size > 1))?;
            } else {
                bits.pass(1)?;
            }
        }
    }
    Some(())
}
