//! Evidence at all headings that are tried, from one look at two areas.

use super::description::{Measure, share};

/// Headings that are looked at together.
const TOGETHER: usize = 8;

/// Headings at equal steps around the circle, and how many of them two areas can speak for. A row has a number for each, and
/// for the first ones once more at its end, so that those that two areas speak for lie side by side.
#[derive(Debug, Clone)]
pub(super) struct Headings {
    /// As a row: `2^16` is a full turn.
    turns: Vec<u16>,
    number: usize,
    /// Two areas speak for this many headings in sequence, at most.
    reach: usize,
    /// Difference of bearing in units from one heading to the next, rounded down.
    step: u16,
    measure: Measure,
    /// Evidence has so many bits less than sixteen.
    spare_bits: u32,
}

/// What evidence weighs, halved, so that sums fit 16 bits: see [`Headings::rounded`].
pub(super) struct RoundedWeight(u16);

impl RoundedWeight {
    pub(super) fn new(weight: u32) -> Self {
        Self(u16::try_from(weight.div_ceil(2)).unwrap_or(u16::MAX))
    }
}

impl Headings {
    /// Turns at equal steps, from straight ahead on, and how evidence is measured.
    pub(super) fn new(turns: &[u16], measure: Measure) -> Self {
        let number = turns.len();
        let step = measure.bearing / u16::try_from(number.max(1)).unwrap_or(u16::MAX);
        // One more for what is rounded.
        let side = (measure.limit + 1)
            .checked_div(step)
            .map_or(number, |side| usize::from(side) + 1);
        let reach = (2 * side).next_multiple_of(TOGETHER);
        let (reach, again) = if reach < number {
            (reach, reach)
        } else {
            let all = number.next_multiple_of(TOGETHER);
            (all, all - number)
        };
        let row = turns.iter().cycle().take(number + again);
        Self {
            turns: row.copied().collect(),
            number,
            reach,
            step,
            measure,
            spare_bits: measure.limit.leading_zeros().min(15),
        }
    }

    /// How many bits are left out of sums that are rounded up.
    fn bits(&self) -> u32 {
        17 - self.spare_bits
    }

    /// A sum rounded up to 16 bits. The largest number is also any beyond.
    pub(super) fn rounded(&self, sum: u32) -> u16 {
        u16::try_from(sum.div_ceil(1 << self.bits())).unwrap_or(u16::MAX)
    }

    /// What a sum that was rounded up is no higher than.
    #[inline(always)]
    pub(super) fn most(&self, rounded: u16) -> u32 {
        let most = u64::from(rounded) << self.bits();
        if rounded == u16::MAX {
            u32::MAX
        } else {
            u32::try_from(most).unwrap_or(u32::MAX)
        }
    }

    /// Adds the evidence of two areas to a row of sums, rounded up.
    #[inline(always)]
    pub(super) fn add(
        &self,
        [likeness, apart]: [u16; 2],
        RoundedWeight(weight): &RoundedWeight,
        row: &mut [u16],
    ) {
        let (measure, bits, weight) = (self.measure, self.spare_bits, *weight);
        let mut at = self.first(apart);
        let end = at + self.reach;
        // Not in chunks, several of which would be shuffled into one vector, and with copies, which nothing else can change.
        while at < end {
            let turns = self.turns[at..].first_chunk::<TOGETHER>();
            let Some((turns, sums)) = turns.zip(row[at..].first_chunk_mut::<TOGETHER>()) else {
                return;
            };
            let evidence = turns.map(
                #[inline(always)]
                |turn| measure.at_bearing(likeness, apart.wrapping_sub(turn)) << bits,
            );
            let mut joined = *sums;
            for (sum, evidence) in joined.iter_mut().zip(evidence) {
                *sum = sum.saturating_add(share(evidence, weight) + 1);
            }
            *sums = joined;
            at += TOGETHER;
        }
    }

    /// Length of a row.
    pub(super) fn row(&self) -> usize {
        self.turns.len()
    }

    /// Whether a likeness of areas whose bearings are `apart` may be evidence at some heading. Where it is, it says so.
    #[inline(always)]
    pub(super) fn may_tell(&self, likeness: u16, apart: u16) -> bool {
        let beside = apart.wrapping_mul(self.number as u16);
        let beside = beside.min(beside.wrapping_neg());
        // Turns are rounded, by less than a unit.
        likeness > share(beside, self.step).saturating_sub(1)
    }

    /// Joins the evidence of two areas, `weight` times, to a row.
    #[inline(always)]
    pub(super) fn join(
        &self,
        [likeness, apart]: [u16; 2],
        weight: u32,
        row: &mut [u32],
        join: impl Fn(u32, u32) -> u32,
    ) {
        let first = self.first(apart);
        let turns = self.turns[first..first + self.reach].as_chunks::<TOGETHER>();
        let row = row[first..first + self.reach].as_chunks_mut::<TOGETHER>();
        for (joined, turns) in row.0.iter_mut().zip(turns.0) {
            let mut evidence = [0; TOGETHER];
            for (evidence, turn) in evidence.iter_mut().zip(turns) {
                let apart = apart.wrapping_sub(*turn);
                *evidence = self.measure.at_bearing(likeness, apart);
            }
            for (joined, evidence) in joined.iter_mut().zip(evidence) {
                *joined = join(*joined, u32::from(evidence) * weight);
            }
        }
    }

    /// The first heading that areas so far apart can speak for.
    #[inline(always)]
    fn first(&self, apart: u16) -> usize {
        if self.reach >= self.number {
            return 0;
        }
        let before = (usize::from(apart) * self.number) >> 16;
        let first = before + self.number + 1 - self.reach / 2;
        if first >= self.number {
            first - self.number
        } else {
            first
        }
    }

    /// A row's numbers, one for each heading.
    #[inline(always)]
    pub(super) fn closed<'a, T: Copy>(
        &self,
        row: &'a mut [T],
        join: impl Fn(T, T) -> T,
    ) -> &'a [T] {
        let (closed, again) = row.split_at_mut(self.number);
        if self.reach < self.number {
            for (closed, again) in closed.iter_mut().zip(again) {
                *closed = join(*closed, *again);
            }
        }
        closed
    }
}
